"""Intents of the robot's speech: utterances, queue and voice."""

from caris_desktop.domain.events import UtteranceOrigin, VoiceOutput
from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class Say(Intent):
    """Speak after the queued utterances. ``{name}`` and ``{place}`` are filled in."""

    text: str
    origin: UtteranceOrigin
    person_id: str = ""
    """Person addressed; empty: the attended person, or else the nearest."""
    gesture: str = ""
    """Gesture at the start: a control, ``nod`` or ``look``."""
    face: str = ""
    """Expression of the face at the start."""


@dataclass(frozen=True, slots=True)
class DraftSpeech(Intent):
    """Synthesise a text in advance that is being typed and may be said at any moment. Never recorded."""

    text: str


@dataclass(frozen=True, slots=True)
class FillGap(Intent):
    """Fill the placeholder that was asked for; empty: do not say it."""

    words: str


@dataclass(frozen=True, slots=True)
class MoveQueued(Intent):
    """Move a queued utterance to another place, 0 for the next."""

    utterance_id: str
    place: int


@dataclass(frozen=True, slots=True)
class EditQueued(Intent):
    """Replace the text of a queued utterance."""

    utterance_id: str
    text: str


@dataclass(frozen=True, slots=True)
class CancelQueued(Intent):
    """Drop a queued utterance."""

    utterance_id: str


@dataclass(frozen=True, slots=True)
class Silence(Intent):
    """Interrupt speech at once and drop the queue."""


@dataclass(frozen=True, slots=True)
class SetVoice(Intent):
    """Set who speaks from the next utterance on, and this computer's voice, as in the scenario."""

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
