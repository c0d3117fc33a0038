"""Intents of microphones, the robot's sound and the wizard's own voice."""

from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable, Permission
from caris_desktop.domain.sound_values import Role, TalkTo
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class UseMicrophone(Intent):
    """Use this input of this computer for the participant, or the wizard; None: none. Saved for the next time.

    The scenario selects a participant microphone that is not of this computer.
    """

    microphone: str | None
    role: Role = "participant"


@dataclass(frozen=True, slots=True)
class PushToTalk(Intent):
    """Send the wizard's speech to the robot, or as text to the Speak field, until it is off."""

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
    """Start or stop playing the participant's microphone to the wizard, at this volume."""

    on: bool
    volume: float = 1.0


SOUND: IntentTable = {
    PushToTalk: IntentSpec(QT_TR_NOOP("Speaking through the robot"), "own_voice"),
    HearRobot: IntentSpec(QT_TR_NOOP("Listening to the robot"), bounds={"volume": (0.0, 1.0)}),
    UseMicrophone: IntentSpec(QT_TR_NOOP("Choosing a microphone")),
}
