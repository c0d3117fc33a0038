"""What the console and the speech process say to one another."""

from dataclasses import dataclass

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import Problem, UtteranceOrigin


@dataclass(frozen=True, slots=True)
class SpeechSettings:
    """``voice`` is a pyttsx3 voice id (empty: the system's default), ``device`` part of an output device's name."""

    voice: str = ""
    rate_wpm: int = 165
    volume: float = 1.0
    device: str = ""


@dataclass(frozen=True, slots=True)
class Speak:
    """Say ``text`` after whatever is waiting.

    ``text``, ``origin`` and ``person_id`` come back with what is told of it.
    """

    utterance_id: str
    text: str
    origin: UtteranceOrigin
    actor: Actor = ""
    person_id: str = ""


@dataclass(frozen=True, slots=True)
class SilenceSpeech:
    """Interrupt what is being said at once and drop what is waiting."""

    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class CloseSpeech:
    """Fall silent and end the process."""


@dataclass(frozen=True, slots=True)
class SpeechReady:
    """Speech can be asked for. Sent again whenever ``audible`` changes."""

    voice: str
    audible: bool


@dataclass(frozen=True, slots=True)
class SpeechFailed:
    """No speech can be made; each further Speak tries again."""

    problem: Problem
