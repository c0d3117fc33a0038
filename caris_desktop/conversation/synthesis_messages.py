"""Messages between the console and the speech synthesis process, in addition to the link commands Say and Silence."""

from dataclasses import replace

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.value_class import Value


class SynthesisSettings(Value):
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


class UseVoice(Value):
    """Settings from the next utterance on. The first message; equal settings have no effect."""

    settings: SynthesisSettings
    actor: Actor = ""


class Prepare(Value):
    """Texts that may be said next, most likely first, to synthesise in advance. Replaces earlier ones."""

    texts: tuple[str, ...]


class Draft(Value):
    """Text being typed, to synthesise before all prepared texts."""

    text: str


class SynthesisReady(Value):
    """Ready for requests. Sent again whenever ``audible`` changes."""

    voice: str
    audible: bool


class VoicesFound(Value):
    """Voices of this computer, named as in the scenario file, each with its language."""

    voices: tuple[tuple[str, str], ...]
