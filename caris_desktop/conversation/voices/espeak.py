"""System voices through pyttsx3, used in its only reliable way: ``save_to_file``, one file per sentence."""

import queue
import time
import wave
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from caris_desktop.conversation.voices.installed_voices import ESPEAK, base_language, normalised
from caris_desktop.conversation.voices.utterance_sound import Samples, Stop

_USUAL_WPM = 165
# espeak applies settings in its own thread, within milliseconds on an idle computer.
_TUNED_WITHIN_S = 1.0


class EspeakVoice:
    """One system voice. ``name`` is its id, empty for the default, or else one of that language."""

    least_audible = None

    def __init__(self, name: str, language: str, *, rate: float, volume: float, folder: Path) -> None:
        import pyttsx3

        self._engine = pyttsx3.init()
        self._completions: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._engine.connect("finished-utterance", lambda name, completed: self._completions.put(completed))
        voices = self.others = _voices(self._engine)
        self.has_wanted = not name or name in voices
        voice_name = name if name in voices else self._of_language(language, voices)
        if voice_name:
            self._engine.setProperty("voice", voice_name)
        self.tune(rate, volume)
        # The first run returns after 10 ms, whatever it should do.
        self._engine.runAndWait()
        self.name = ESPEAK + str(self._engine.getProperty("voice") or "")
        self.rate_hz = 22050
        self._path = folder / "utterance.wav"
        # The sample rate is only known from a file.
        self.rate_hz = self._rendered("a")[1]

    def tune(self, rate: float, volume: float) -> None:
        self._tuned: dict[str, float] = {"rate": round(_USUAL_WPM * rate), "volume": round(volume, 2)}
        self._is_tuned = False

    def _of_language(self, language: str, voices: dict[str, str]) -> str:
        """Voice of that language; empty for the default voice, which is preferred to those of another country."""
        exact = next((voice for voice, spoken in voices.items() if normalised(spoken) == normalised(language)), "")
        usual = voices.get(str(self._engine.getProperty("voice")), "")
        if exact or not language or base_language(usual) == base_language(language):
            return exact
        return next((voice for voice, spoken in voices.items() if base_language(spoken) == base_language(language)), "")

    def parts(self, text: str, stop: Stop) -> Iterator[Samples]:
        stop.check()
        yield self._rendered(text)[0]

    def _rendered(self, text: str) -> tuple[Samples, int]:
        for pause_s in (0.05, 0.1, 0.2, 0.4, 0.8, 0.0):
            rendered = self._attempt(text)
            if rendered is not None:
                return rendered
            time.sleep(pause_s)
        raise ValueError("the voice produced no audio")

    def _tune_now(self) -> None:
        """Wait until espeak has applied the settings: unfinished work would cancel the next sentence.

        Unchanged settings are not sent, since they would count as such work.
        """
        for name, value in self._tuned.items():
            if self._engine.getProperty(name) != value:
                self._engine.setProperty(name, value)
        until_s = time.monotonic() + _TUNED_WITHIN_S
        while time.monotonic() < until_s and any(
            self._engine.getProperty(name) != value for name, value in self._tuned.items()
        ):
            time.sleep(0.005)
        self._is_tuned = True

    def _attempt(self, text: str) -> tuple[Samples, int] | None:
        """None if pyttsx3 cancelled its own work, as it does while espeak seems busy."""
        if not self._is_tuned:
            self._tune_now()
        while not self._completions.empty():
            self._completions.get()
        self._path.unlink(missing_ok=True)
        self._engine.save_to_file(text, str(self._path))
        self._engine.runAndWait()
        completions = [self._completions.get()]
        while not self._completions.empty():
            completions.append(self._completions.get())
        if not all(completions):
            self._is_tuned = False
            return None
        with wave.open(str(self._path), "rb") as file:
            if file.getnchannels() != 1 or file.getsampwidth() != 2:
                raise ValueError(f"the voice produced {file.getnchannels()} channels of {file.getsampwidth()} bytes")
            sound = np.frombuffer(file.readframes(file.getnframes()), "<i2").astype(np.int16, copy=False)
            rate_hz = file.getframerate()
        self._path.unlink()
        return (sound, rate_hz) if sound.size else None


def system_voices() -> dict[str, str]:
    """All system voices with their languages."""
    import pyttsx3

    return _voices(pyttsx3.init())


def _voices(engine: Any) -> dict[str, str]:
    return {str(one.id): _language_of(one) for one in engine.getProperty("voices") or ()}


def _language_of(voice: Any) -> str:
    first = next(iter(voice.languages or ()), "")
    # Some drivers prefix the language with a priority byte.
    text = first.decode("ascii", "ignore") if isinstance(first, bytes) else str(first)
    return text.lstrip("\x00\x01\x02\x03\x04\x05")
