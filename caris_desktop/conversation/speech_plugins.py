"""Interface of voices and recognisers for plug-ins of the group ``caris_desktop.speech``, and their processes."""

import functools
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.plugin_process import PluginProcess
from caris_desktop.domain.plugins import Plugin, PluginError, find
from caris_desktop.domain.translation import QT_TR_NOOP

PLUGIN = "plugin:"
LOAD_SPEECH_WITHIN_S = 20.0
"""The engine of voices has 30 s to start."""
SPEAK_WITHIN_S, TRANSCRIBE_WITHIN_S = 2.5, 10.0
_RECOGNISER_RATE_HZ = 16_000
_RATES_HZ = range(8_000, 48_001)


class SpeechPlugin(Protocol):
    """Voice, recogniser or both: a class with the attribute ``caris_interface = 1``, called as
    ``Plugin(language="en")`` with the language of the scenario, empty for any. A voice has ``rate_hz`` and
    :meth:`speak`, a recogniser has :meth:`transcribe`.

    A scenario names it by ``speech: {name: "plugin:NAME"}`` or ``listening: {model: "plugin:NAME"}``. One instance is
    made for each use, in a process of its own, and called in its main thread; it has 20 seconds to be imported and
    made. The process is not the window's, the robot link's or the recorder's, and neither plays sound nor reads a
    microphone. The console cannot know where a plug-in sends speech: a scenario with ``cloud_models: false`` cannot
    name one.

    One that raises, prints, is too slow, ends its process or returns anything else than is described here is switched
    off until the console is started again, and the wizard is told its name. The utterance fails that it was to speak or
    to transcribe; then a voice of the program in the scenario's language speaks, or its usual recogniser transcribes.
    Log with :mod:`logging`.
    """

    caris_interface: ClassVar[int]
    rate_hz: int
    """Sample rate of its sound, 8000 to 48000."""

    def speak(self, text: str, *, rate: float, volume: float) -> NDArray[np.int16]:
        """Sound of one utterance of at most 1,000 characters: int16, shape (samples,), not empty.

        ``rate`` is 1 for the usual speed (0.5 to 2), ``volume`` 0 to 1. Within 2.5 s, since a person waits; texts that
        are likely to be said next are asked for in advance.
        """
        ...

    def transcribe(self, sound: NDArray[np.float32], *, before: str) -> Sequence[tuple[str, float, float]]:
        """Words of ``sound``: ``(word, start, end)`` in seconds from its start, in order; nothing for no speech.

        ``sound`` is float32 from -1 to 1 at 16 kHz, shape (samples,), up to 30 s; ``before`` is the text before it.
        While somebody speaks, the same sound returns every two seconds with more at its end. Within 10 s; a tenth of
        the duration of the sound is good.
        """
        ...


def open_speech(name: str, language: str) -> tuple[PluginProcess, Plugin]:
    """Start the process of the plug-in that a scenario calls ``name``. Raises PluginError."""
    plugin = find("speech", name.removeprefix(PLUGIN))
    return PluginProcess(plugin, functools.partial(_host, plugin, language), load_within_s=LOAD_SPEECH_WITHIN_S), plugin


def _host(plugin: Plugin, language: str, make: Callable[..., SpeechPlugin]) -> Callable[..., Any]:
    """Host of a speech plug-in in its process."""
    made = make(language=language)

    def answer(
        _report: object, request: str, values: Sequence[Any] = (), settings: dict[str, Any] | None = None
    ) -> Any:
        match request:
            case "speak":
                return checked_sound(plugin, made.speak(*values, **(settings or {})))
            case "transcribe":
                seconds = len(values[0]) / _RECOGNISER_RATE_HZ
                return checked_words(plugin, made.transcribe(*values, **(settings or {})), seconds)
        return made.rate_hz

    return answer


def checked_rate(plugin: Plugin, rate_hz: object) -> int:
    """Sample rate of a plug-in's voice. Raises PluginError."""
    if not isinstance(rate_hz, int) or rate_hz not in _RATES_HZ:
        raise PluginError(plugin, QT_TR_NOOP("its rate_hz is not a sample rate"))
    return rate_hz


def checked_sound(plugin: Plugin, sound: object) -> NDArray[np.int16]:
    """Sound that a plug-in's voice returned. Raises PluginError."""
    if not isinstance(sound, np.ndarray) or sound.dtype != np.int16 or sound.ndim != 1 or not sound.size:
        raise PluginError(plugin, QT_TR_NOOP("it did not return an array of int16 samples"))
    return sound


def checked_words(plugin: Plugin, words: object, seconds: float) -> tuple[tuple[str, float, float], ...]:
    """Words that a plug-in's recogniser returned for a sound of that duration. Raises PluginError."""
    try:
        found = tuple((str(word).strip(), float(start), float(end)) for word, start, end in words)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        raise PluginError(plugin, QT_TR_NOOP("it did not return words with start and end")) from None
    times_s = [time_s for _, *both in found for time_s in both]
    if times_s != sorted(times_s) or not all(0 <= time_s <= seconds + 1 for time_s in times_s):
        raise PluginError(plugin, QT_TR_NOOP("it returned times that are not in order, or outside the sound"))
    return tuple(word for word in found if word[0])
