"""Events of the study protocol: planned and entered steps."""

from typing import Literal

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.value_class import dataclass

LATE_FROM_S = 1.0
"""A step that takes longer than expected by less is called in time."""
StepHow = Literal["started", "next", "skipped", "back", "branch", "chosen"]
"""How somebody came to a step: it was the first, the next, the next as the one before was skipped, back from another,
by a branch, or out of the list."""


@dataclass(frozen=True, slots=True)
class PlannedStep:
    """A step as the scenario has it; ``expected_s`` is zero where nothing is expected, ``tick`` what to tick off."""

    step_id: str
    title: str
    expected_s: float = 0.0
    tick: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ProtocolOpened:
    """This protocol holds from now on; without steps: none does."""

    stamp_ns: int
    steps: tuple[PlannedStep, ...] = ()


@dataclass(frozen=True, slots=True)
class StepEntered:
    """A step began. ``left_step_id`` is the one before, which ``how`` says was skipped where it was; empty where there
    was none. ``branch`` is what the participant did, where it was that.
    """

    stamp_ns: int
    step_id: str
    title: str = ""
    number: int = 0
    how: StepHow = "next"
    left_step_id: str = ""
    branch: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class StepTicked:
    """Something that belongs to a step was ticked off, or is not done after all (not ``on``)."""

    stamp_ns: int
    step_id: str
    item: str
    on: bool = True
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class ProtocolEnded:
    """The wizard went on from the last step, or ``skipped`` it."""

    stamp_ns: int
    left_step_id: str
    skipped: bool = False
    actor: Actor = ""
