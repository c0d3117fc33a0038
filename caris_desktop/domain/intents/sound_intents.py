"""Intents of microphones, the robot's sound and the wizard's own voice."""

from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable, Permission
from caris_desktop.domain.sound_values import Role, TalkTo
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class UseMicrophone(Intent):
    """Hear the participant, or the wizard, with this input of this computer; None: with none. Kept for the next time.

    Which microphone hears the participant where that is none of this computer's, the scenario says.
    """

    microphone: str | None
    role: Role = "participant"


@dataclass(frozen=True, slots=True)
class PushToTalk(Intent):
    """What the wizard says goes out through the robot, or becomes text in the Speak field, until it is off."""

    on: bool
    to: TalkTo = "robot"

    @property
    def reduces_motion(self) -> bool:
        return not self.on

    @property
    def needs_permissions(self) -> tuple[Permission, ...]:
        # Dictation is meant to be spoken.
        return ("own_voice",) if self.to == "robot" else ("transcription", "speech")


@dataclass(frozen=True, slots=True)
class HearRobot(Intent):
    """Play to the wizard what the participant's microphone hears, as loud as that, or no longer."""

    on: bool
    volume: float = 1.0


SOUND: IntentTable = {
    PushToTalk: IntentSpec(QT_TR_NOOP("Speaking through the robot"), "own_voice"),
    HearRobot: IntentSpec(QT_TR_NOOP("Listening to the robot"), bounds={"volume": (0.0, 1.0)}),
    UseMicrophone: IntentSpec(QT_TR_NOOP("Choosing a microphone")),
}
