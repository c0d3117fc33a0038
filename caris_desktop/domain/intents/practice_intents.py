"""Intents of the guided exercise for wizards."""

from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class BeginPractice(Intent):
    """Start the exercise on the simulated robot. ``wizard`` is the trainee."""

    wizard: str = ""


@dataclass(frozen=True, slots=True)
class SkipPracticeStep(Intent):
    """Continue with the next step without completing this one."""


@dataclass(frozen=True, slots=True)
class EndPractice(Intent):
    """End the exercise, or dismiss its result."""


PRACTICE: IntentTable = {
    BeginPractice: IntentSpec(QT_TR_NOOP("Starting the practice")),
    SkipPracticeStep: IntentSpec(QT_TR_NOOP("Skipping a practice step")),
    EndPractice: IntentSpec(QT_TR_NOOP("Ending the practice")),
}
