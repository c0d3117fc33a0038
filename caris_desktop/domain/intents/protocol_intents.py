"""Intents of the study protocol: moving between steps."""

from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class NextStep(Intent):
    """Go on to the next step of the list: to the first where none has begun, to the end from the last."""


@dataclass(frozen=True, slots=True)
class PreviousStep(Intent):
    """Go back to the step before this one, as after a slip: its time and ticks go on where they were."""


@dataclass(frozen=True, slots=True)
class SkipStep(Intent):
    """Go on to the next step; this one was left out."""


@dataclass(frozen=True, slots=True)
class TakeBranch(Intent):
    """The participant did what this branch of the present step says: go on to its step."""

    branch: str


@dataclass(frozen=True, slots=True)
class GoToStep(Intent):
    """Begin this step, by its id; the present one anew where it is that."""

    step_id: str


@dataclass(frozen=True, slots=True)
class TickItem(Intent):
    """Something that belongs to the present step is done, or is not after all."""

    item: str
    on: bool = True


PROTOCOL: IntentTable = {
    NextStep: IntentSpec(QT_TR_NOOP("Going to the next step")),
    PreviousStep: IntentSpec(QT_TR_NOOP("Going back to the previous step")),
    SkipStep: IntentSpec(QT_TR_NOOP("Skipping the step")),
    TakeBranch: IntentSpec(QT_TR_NOOP("Taking the branch")),
    GoToStep: IntentSpec(QT_TR_NOOP("Going to the step")),
    TickItem: IntentSpec(QT_TR_NOOP("Ticking off the item")),
}
