"""Automation levels of the language model."""

from typing import Annotated, get_args

from caris_desktop.domain.events import AssistanceLevel
from caris_desktop.domain.schema_fields import FieldSpec
from caris_desktop.domain.value_class import dataclass


def levels_up_to(highest: AssistanceLevel) -> tuple[AssistanceLevel, ...]:
    """Levels that a scenario with that maximum permits, from off upwards."""
    levels: tuple[AssistanceLevel, ...] = get_args(AssistanceLevel)
    return levels[: levels.index(highest) + 1]


@dataclass(frozen=True, slots=True)
class AssistanceSettings:
    """Automation level of each function: `off`, `suggest` (the wizard's key carries it out) or `act` (carried out after
    a countdown that the wizard sees and can stop). During a session, the wizard can lower each level, and raise it
    again to the level in the scenario. Actions that move the robot always wait for the wizard's key.
    """

    replies: Annotated[
        AssistanceLevel,
        FieldSpec("Replies to participants, from the language model. With `act`, the first reply is said."),
    ] = "suggest"
    fillers: Annotated[
        AssistanceLevel,
        FieldSpec("The filler when no reply arrives in time: `suggest` highlights its key, `act` says it."),
    ] = "off"
    actions: Annotated[
        AssistanceLevel,
        FieldSpec(
            "Next actions of the robot, from the language model: places, gestures, controls, photos. With "
            "`act`, actions without motion are carried out."
        ),
    ] = "off"
    countdown_s: Annotated[
        float,
        FieldSpec(
            "Time for the wizard to stop an automatic action.",
            title="Countdown",
            unit="seconds",
            at_least=1,
            at_most=30,
        ),
    ] = 3.0
    filler_after_s: Annotated[
        float,
        FieldSpec(
            "Time after a participant's last word from which a reply is late.",
            title="A reply is late after",
            unit="seconds",
            at_least=0.5,
            at_most=30,
        ),
    ] = 1.5
