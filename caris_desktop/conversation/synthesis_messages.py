"""What the console and the process that makes speech say to one another."""

from dataclasses import replace

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import Problem, UtteranceOrigin
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class SynthesisSettings:
    """``voice``, ``language``, ``rate``, ``volume`` and ``device`` as in the scenario file, which is in ``folder``.

    ``at_hand``: it will be spoken with it, so that everything is loaded and the loudspeaker is kept open.
    """

    voice: str = ""
    language: str = ""
    rate: float = 1.0
    volume: float = 1.0
    device: str = ""
    folder: str = ""
    at_hand: bool = False

    def tunes(self, before: "SynthesisSettings") -> bool:
        """Whether it is the same voice, with another rate or volume at most: nothing is loaded for that."""
        return replace(self, rate=before.rate, volume=before.volume) == before


@dataclass(frozen=True, slots=True)
class UseVoice:
    """Speak like this from the next utterance on. The first message; the same settings change nothing."""

    settings: SynthesisSettings
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class Speak:
    """Say ``text`` after whatever is waiting.

    ``recorded`` (empty: ``text`` itself), ``origin`` and ``person_id`` come back with what is told of it: names are
    spoken, and never recorded.
    """

    utterance_id: str
    text: str
    origin: UtteranceOrigin
    actor: Actor = ""
    person_id: str = ""
    recorded: str = ""


@dataclass(frozen=True, slots=True)
class Prepare:
    """These may be said next, the likeliest first: their sound is made ahead of time. Those of an earlier one go."""

    texts: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Draft:
    """Somebody types this and may ask for it any moment: its sound is made before that of all prepared texts."""

    text: str


@dataclass(frozen=True, slots=True)
class SilenceSpeech:
    """Interrupt what is being said at once and drop what is waiting."""

    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class CloseSynthesis:
    """Fall silent and end the process."""


@dataclass(frozen=True, slots=True)
class SynthesisReady:
    """Speech can be asked for. Sent again whenever ``audible`` changes."""

    voice: str
    audible: bool


@dataclass(frozen=True, slots=True)
class VoicesFound:
    """The voices of this computer, as in the scenario file, each with its language."""

    voices: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class SynthesisFailed:
    """No speech can be made; each further Speak tries again."""

    problem: Problem
