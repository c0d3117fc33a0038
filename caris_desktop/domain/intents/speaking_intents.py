"""Intents of the robot's speech: utterances, queue and voice."""

from caris_desktop.domain.events import UtteranceOrigin, VoiceOutput
from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class Say(Intent):
    """Speak after whatever is waiting. ``{name}`` and ``{place}`` in it are filled in."""

    text: str
    origin: UtteranceOrigin
    person_id: str = ""
    """To whom; empty: to whom the wizard attends, or else to whoever is nearest."""
    gesture: str = ""
    """What the robot does as it begins: a control, ``nod`` or ``look``."""
    face: str = ""
    """The expression that its face takes as it begins."""


@dataclass(frozen=True, slots=True)
class DraftSpeech(Intent):
    """This is being typed and may be said any moment: let its sound be made ahead of time. Recorded nowhere."""

    text: str


@dataclass(frozen=True, slots=True)
class FillGap(Intent):
    """What stands in the gap that is asked for; empty: that is not said after all."""

    words: str


@dataclass(frozen=True, slots=True)
class MoveQueued(Intent):
    """Let what waits be said at another place of the queue, 0 for the next."""

    utterance_id: str
    place: int


@dataclass(frozen=True, slots=True)
class EditQueued(Intent):
    """Say something else in the place of what waits."""

    utterance_id: str
    text: str


@dataclass(frozen=True, slots=True)
class CancelQueued(Intent):
    """Do not say what waits."""

    utterance_id: str


@dataclass(frozen=True, slots=True)
class Silence(Intent):
    """Interrupt speech at once and drop what is waiting."""


@dataclass(frozen=True, slots=True)
class SetVoice(Intent):
    """Who speaks from the next utterance on, and how this computer does, as in the scenario file."""

    output: VoiceOutput
    name: str = ""
    language: str = ""
    rate: float = 1.0
    volume: float = 1.0


SPEAKING: IntentTable = {
    Say: IntentSpec(QT_TR_NOOP("Speaking"), "speech", proposable=True),
    DraftSpeech: IntentSpec(QT_TR_NOOP("Preparing speech"), "speech", quiet=True),
    FillGap: IntentSpec(QT_TR_NOOP("Filling in the placeholder"), "speech"),
    MoveQueued: IntentSpec(QT_TR_NOOP("Reordering the speech queue"), "speech", bounds={"place": (0, 1000)}),
    EditQueued: IntentSpec(QT_TR_NOOP("Editing a queued utterance"), "speech"),
    CancelQueued: IntentSpec(QT_TR_NOOP("Removing a queued utterance")),
    Silence: IntentSpec(QT_TR_NOOP("Interrupting speech")),
    SetVoice: IntentSpec(QT_TR_NOOP("Changing the voice"), "speech", bounds={"rate": (0.5, 2.0), "volume": (0.0, 1.0)}),
}
