"""Messages between the console and the speech synthesis process."""

from dataclasses import replace

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import Problem, UtteranceOrigin
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class SynthesisSettings:
    """``voice``, ``language``, ``rate``, ``volume`` and ``device`` as in the scenario file, which is in ``folder``.

    ``at_hand``: it will be used, so everything is loaded and the output stays open.
    """

    voice: str = ""
    language: str = ""
    rate: float = 1.0
    volume: float = 1.0
    device: str = ""
    folder: str = ""
    at_hand: bool = False

    def tunes(self, before: "SynthesisSettings") -> bool:
        """True if only rate or volume differ, which needs no loading."""
        return replace(self, rate=before.rate, volume=before.volume) == before


@dataclass(frozen=True, slots=True)
class UseVoice:
    """Settings from the next utterance on. The first message; equal settings have no effect."""

    settings: SynthesisSettings
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class Speak:
    """Say ``text`` after the queued utterances.

    ``recorded`` (empty: ``text``), ``origin`` and ``person_id`` are returned in reports: names are spoken, but never
    recorded.
    """

    utterance_id: str
    text: str
    origin: UtteranceOrigin
    actor: Actor = ""
    person_id: str = ""
    recorded: str = ""


@dataclass(frozen=True, slots=True)
class Prepare:
    """Texts that may be said next, most likely first, to synthesise in advance. Replaces earlier ones."""

    texts: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Draft:
    """Text being typed, to synthesise before all prepared texts."""

    text: str


@dataclass(frozen=True, slots=True)
class SilenceSpeech:
    """Stop the present utterance at once and clear the queue."""

    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class CloseSynthesis:
    """Stop speaking and end the process."""


@dataclass(frozen=True, slots=True)
class SynthesisReady:
    """Ready for requests. Sent again whenever ``audible`` changes."""

    voice: str
    audible: bool


@dataclass(frozen=True, slots=True)
class VoicesFound:
    """Voices of this computer, named as in the scenario file, each with its language."""

    voices: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class SynthesisFailed:
    """Speech synthesis failed; each further Speak tries again."""

    problem: Problem
