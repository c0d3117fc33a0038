"""Intents of the study protocol: moving between steps."""

from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class NextStep(Intent):
    """Continue with the next step: the first if none has started, the end after the last."""


@dataclass(frozen=True, slots=True)
class PreviousStep(Intent):
    """Return to the step before this one, as after a mistake: its time and ticks continue."""


@dataclass(frozen=True, slots=True)
class SkipStep(Intent):
    """Skip this step and start the next one."""


@dataclass(frozen=True, slots=True)
class TakeBranch(Intent):
    """Follow this branch of the current step, as the participant did, to its step."""

    branch: str


@dataclass(frozen=True, slots=True)
class GoToStep(Intent):
    """Start this step, by its id; restart it if current."""

    step_id: str


@dataclass(frozen=True, slots=True)
class TickItem(Intent):
    """Tick or untick a checklist item of the current step."""

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
