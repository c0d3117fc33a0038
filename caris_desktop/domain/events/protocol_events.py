"""Events of the study protocol: planned and entered steps."""

from typing import Literal

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.value_class import dataclass

LATE_FROM_S = 1.0
"""Least overrun of a late step; a shorter one counts as in time."""
StepHow = Literal["started", "next", "skipped", "back", "branch", "chosen"]
"""How a step was entered: as the first or the next, after skipping one, back from another, by a branch, or from the
list."""


@dataclass(frozen=True, slots=True)
class PlannedStep:
    """A step of the scenario. ``expected_s`` is zero if no time is expected; ``tick`` is its checklist."""

    step_id: str
    title: str
    expected_s: float = 0.0
    tick: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ProtocolOpened:
    """A protocol is in force from now on; without steps: none."""

    stamp_ns: int
    steps: tuple[PlannedStep, ...] = ()


@dataclass(frozen=True, slots=True)
class StepEntered:
    """A step started. ``left_step_id`` is the step before, skipped if ``how`` says so; empty if there was none.
    ``branch`` is what the participant did, if a branch led here.
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
    """A checklist item of a step was ticked off, or unticked (not ``on``)."""

    stamp_ns: int
    step_id: str
    item: str
    on: bool = True
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class ProtocolEnded:
    """The wizard finished the last step, or ``skipped`` it."""

    stamp_ns: int
    left_step_id: str
    skipped: bool = False
    actor: Actor = ""
