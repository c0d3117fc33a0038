"""Audio of an utterance: silence trimming, streaming buffer and cache."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.translation import LocalizedText

Samples = NDArray[np.int16]
"""Signed 16 bit, one channel."""

# Voices add up to a third of a second of silence. This much remains, so that sound begins and ends smoothly.
_PADDING_S = 0.005


def words_of(error: Exception) -> str:
    """Error text in one line."""
    message = str(error)
    return message if isinstance(message, LocalizedText) else " ".join(message.split()) or type(error).__name__


class RenderingStoppedError(Exception):
    """The audio is no longer needed."""


class Stop:
    """Cancels rendering from another thread; calls ``at_once`` callbacks, which may make the interrupted code raise."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._at_once: list[Callable[[], None]] = []
        self.is_set = False

    def set(self) -> None:
        with self._lock:
            self.is_set = True
            for call in self._at_once:
                call()

    def at_once(self, call: Callable[[], None]) -> None:
        with self._lock:
            self._at_once.append(call)
            if self.is_set:
                call()

    def check(self) -> None:
        if self.is_set:
            raise RenderingStoppedError


class Voice(Protocol):
    """Text-to-speech voice. Called in one thread."""

    @property
    def name(self) -> str:
        """Name as in the scenario file: ``piper:NAME`` or ``espeak:NAME``."""

    @property
    def rate_hz(self) -> int:
        """Sample rate of its audio."""

    @property
    def least_audible(self) -> int | None:
        """Amplitude below which samples are silence; None: relative to the maximum, for voices that return whole
        sounds.
        """

    def tune(self, rate: float, volume: float) -> None:
        """Set rate (1 is normal) and volume (0 to 1)."""

    def parts(self, text: str, stop: Stop) -> Iterator[Samples]:
        """Audio of ``text`` in parts, each as soon as it is ready.

        Raises RenderingStoppedError after ``stop``, and ValueError if there is no sound.
        """


def trimmed(parts: Iterator[Samples], rate_hz: int, least: int | None) -> Iterator[Samples]:
    """Parts without silence before the first and after the last sample of at least ``least``; None: relative to the
    maximum of the first part. Silence is held back until sound follows.
    """
    margin_frames = round(_PADDING_S * rate_hz)
    begun, held = False, np.zeros(0, np.int16)
    for part in parts:
        if least is None:
            least = max(1, round(int(np.abs(part.astype(np.int32)).max(initial=0)) * 0.005))
        sound = np.concatenate([held, part])
        loud = np.flatnonzero(np.abs(sound.astype(np.int32)) >= least)
        if loud.size == 0:
            held = sound if begun else sound[-margin_frames:]
            continue
        first = 0 if begun else max(0, int(loud[0]) - margin_frames)
        end = int(loud[-1]) + 1 + margin_frames
        begun, held = True, sound[end:]
        yield sound[first:end]


class StreamingBuffer:
    """Streaming buffer: synthesis appends, the audio device reads; any thread.

    Frames count from the start. On an underrun silence is played, and later audio is delayed. ``changed`` is called
    after each addition, and when the end is known.
    """

    def __init__(self, rate_hz: int, changed: Callable[[], None]) -> None:
        self.rate_hz = rate_hz
        self._changed = changed
        self._lock = threading.Lock()
        self._parts: list[tuple[int, Samples]] = []
        self.position = 0
        self.end = 0
        self.complete = False
        self.trouble = ""

    @property
    def begun(self) -> bool:
        return self.end > 0

    @property
    def over(self) -> bool:
        """True when everything was read."""
        with self._lock:
            return self.complete and self.position >= self.end

    def append(self, samples: Samples) -> int:
        """Append samples; return the frame at which they will be played."""
        with self._lock:
            at = max(self.position, self.end)
            self._parts.append((at, samples))
            self.end = at + len(samples)
        self._changed()
        return at

    def finish(self, trouble: str = "") -> None:
        """End of input; ``trouble`` is the reason for an early end."""
        with self._lock:
            self.complete, self.trouble = True, trouble
        self._changed()

    def read(self, frames: int) -> Samples:
        """Next ``frames`` samples."""
        taken = np.zeros(frames, np.int16)
        with self._lock:
            first, self.position = self.position, self.position + frames
            for at, samples in reversed(self._parts):
                if at + len(samples) <= first:
                    break
                begin, end = max(at, first), min(at + len(samples), self.position)
                if begin < end:
                    taken[begin - first : end - first] = samples[begin - at : end - at]
        return taken

    def rewind(self) -> None:
        """Restart from the beginning, if nothing was audible."""
        with self._lock:
            self.position = 0


class SoundCache:
    """Audio cache by text, limited in bytes: texts likely to be needed, and the latest."""

    def __init__(self, at_most_bytes: int) -> None:
        self._at_most_bytes = at_most_bytes
        self._sounds: OrderedDict[str, Samples] = OrderedDict()
        self._texts: frozenset[str] = frozenset()
        self.bytes = 0

    def want(self, texts: Sequence[str]) -> None:
        """Set the texts to retain; others are dropped when space is needed."""
        self._texts = frozenset(texts)

    def clear(self) -> None:
        self._sounds.clear()
        self.bytes = 0

    def get(self, text: str) -> Samples | None:
        if text in self._sounds:
            self._sounds.move_to_end(text)
        return self._sounds.get(text)

    def put(self, text: str, samples: Samples) -> bool:
        """Add audio; False if there is no space."""
        self._drop(text)
        for other in [each for each in self._sounds if each not in self._texts]:
            if self._fits(samples):
                break
            self._drop(other)
        if not self._fits(samples):
            return False
        self._sounds[text] = samples
        self.bytes += samples.nbytes
        return True

    def _fits(self, samples: Samples) -> bool:
        return self.bytes + samples.nbytes <= self._at_most_bytes

    def _drop(self, text: str) -> None:
        dropped = self._sounds.pop(text, None)
        if dropped is not None:
            self.bytes -= dropped.nbytes
