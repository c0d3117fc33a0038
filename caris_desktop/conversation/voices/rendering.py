"""The thread that turns text into sound: what is wanted now goes first, what may be wanted is made ahead of time."""

import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from caris_desktop.conversation.voices.sound import (
    GrowingSound,
    KeptSounds,
    RenderingStoppedError,
    Samples,
    Stop,
    Voice,
    trimmed,
    words_of,
)

KEPT_AT_MOST_BYTES = 24_000_000
"""Nine minutes of a usual voice."""

Told = Callable[[int, Samples], None]


class Rendering:
    """One voice and what it has made. ``run`` is the body of its thread; the rest is for others."""

    def __init__(self, voice: Voice, *, kept_at_most_bytes: int = KEPT_AT_MOST_BYTES) -> None:
        self._voice = voice
        self._kept = KeptSounds(kept_at_most_bytes)
        self._changed = threading.Condition()
        self._wanted: tuple[str, GrowingSound, Told] | None = None
        self._ahead: deque[str] = deque()
        self._prepared: tuple[str, ...] = ()
        self._tuned: tuple[float, float] | None = None
        self._stop = Stop()
        self._ended = False

    def say(self, text: str, sound: GrowingSound, told: Told) -> None:
        """Now: ``sound`` grows, and ``told(frame, samples)`` gets each part of it as soon as it is there.

        What is made ahead of time waits from here on until it is complete.
        """
        with self._changed:
            self._stop.set()
            self._wanted = (text, sound, told)
            self._changed.notify()

    def stop(self) -> None:
        """Nobody wants any more what is being said."""
        with self._changed:
            self._wanted = None
            self._stop.set()

    def prepare(self, texts: Sequence[str]) -> None:
        """Make these ahead of time, the first ones first; others that were to be made no longer are."""
        with self._changed:
            self._kept.want(texts)
            self._prepared = tuple(texts)
            self._ahead = deque(texts)
            self._changed.notify()

    def tune(self, rate: float, volume: float) -> None:
        """Speak like this from the next utterance on; what was made for later is made again."""
        with self._changed:
            self._tuned = (rate, volume)
            self._changed.notify()

    def end(self) -> None:
        with self._changed:
            self._ended = True
            self._stop.set()
            self._changed.notify()

    def run(self) -> None:
        while True:
            with self._changed:
                while not (self._wanted or self._ahead or self._tuned or self._ended):
                    self._changed.wait()
                if self._ended:
                    return
                if self._tuned is not None:
                    self._voice.tune(*self._tuned)
                    self._tuned = None
                    self._kept.clear()
                    self._ahead = deque(self._prepared)
                    continue
                wanted, self._wanted = self._wanted, None
                ahead = "" if wanted is not None else self._ahead.popleft()
                kept = self._kept.get(ahead if wanted is None else wanted[0])
                self._stop = stop = Stop()
            if wanted is not None:
                self._make(*wanted, kept, stop)
            elif kept is None:
                self._make_ahead(ahead, stop)

    def _make(self, text: str, sound: GrowingSound, told: Told, kept: Samples | None, stop: Stop) -> None:
        try:
            made: list[Samples] = []
            parts = trimmed(self._voice.parts(text, stop), self._voice.rate_hz, self._voice.least_heard)
            for part in parts if kept is None else [kept]:
                stop.check()
                made.append(part)
                told(sound.append(part), part)
            if kept is None and made:
                self._keep(text, made)
            sound.finish("" if made else "the voice made no sound")
        except RenderingStoppedError:
            sound.finish("it was interrupted")
        except Exception as error:
            traceback.print_exc()
            sound.finish(words_of(error))

    def _make_ahead(self, text: str, stop: Stop) -> None:
        begun_s = time.monotonic()
        try:
            made = list(trimmed(self._voice.parts(text, stop), self._voice.rate_hz, self._voice.least_heard))
        except RenderingStoppedError:
            with self._changed:
                self._ahead.appendleft(text)
            return
        except Exception:
            traceback.print_exc()
            return
        if made:
            self._keep(text, made)
        # There is time: half of it is left to whatever else this computer does.
        with self._changed:
            if not self._ended and self._wanted is None:
                self._changed.wait(time.monotonic() - begun_s)

    def _keep(self, text: str, made: list[Samples]) -> None:
        with self._changed:
            self._kept.put(text, np.concatenate(made))
