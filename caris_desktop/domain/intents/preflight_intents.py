"""Intents of the preflight checks before a recording."""

from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class TickCheck(Intent):
    """Tick or untick one of the scenario's own checks."""

    check_id: str
    done: bool = True


@dataclass(frozen=True, slots=True)
class TryMicrophone(Intent):
    """Test the participant's microphone for a short time; nothing is recorded."""

    on: bool = True

    @property
    def reduces_motion(self) -> bool:
        return not self.on


PREFLIGHT: IntentTable = {
    TickCheck: IntentSpec(QT_TR_NOOP("Ticking a check")),
    TryMicrophone: IntentSpec(QT_TR_NOOP("Testing the microphone"), "audio_recording"),
}
