"""Synthesis worker: a thread that renders requested text first, and likely text in advance."""

import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from caris_desktop.conversation.voices.utterance_sound import (
    RenderingStoppedError,
    Samples,
    SoundCache,
    Stop,
    StreamingBuffer,
    Voice,
    trimmed,
    words_of,
)

KEPT_AT_MOST_BYTES = 24_000_000
"""Nine minutes of a usual voice."""

Told = Callable[[int, Samples], None]


class _Making:
    """One text in synthesis. A listener may join when parts are ready.

    ``is_draft``: it is still being typed.
    """

    def __init__(self, text: str, *, is_draft: bool = False) -> None:
        self.text = text
        self.is_draft = is_draft
        self.stop = Stop()
        self.parts: list[Samples] = []
        self._telling = threading.Lock()
        self._listener: tuple[StreamingBuffer, Told] | None = None

    @property
    def is_heard(self) -> bool:
        return self._listener is not None

    def hear(self, sound: StreamingBuffer, on_part: Told) -> None:
        """Send the ready parts at once, and others as they come. Before `finish`."""
        with self._telling:
            for part in self.parts:
                on_part(sound.append(part), part)
            self._listener = sound, on_part

    def add(self, part: Samples) -> None:
        with self._telling:
            self.parts.append(part)
            if self._listener is not None:
                sound, on_part = self._listener
                on_part(sound.append(part), part)

    def finish(self, trouble: str) -> None:
        if self._listener is not None:
            self._listener[0].finish(trouble)


class Rendering:
    """One voice with its cached audio. ``run`` is the thread function; other methods are for other threads."""

    def __init__(self, voice: Voice, *, kept_at_most_bytes: int = KEPT_AT_MOST_BYTES) -> None:
        self._voice = voice
        self._kept = SoundCache(kept_at_most_bytes)
        self._changed = threading.Condition()
        self._wanted: _Making | None = None
        self._making: _Making | None = None
        self._draft = ""
        self._ahead: deque[str] = deque()
        self._prepared: tuple[str, ...] = ()
        self._tuned: tuple[float, float] | None = None
        self._ended = False

    def say(self, text: str, sound: StreamingBuffer, on_part: Told) -> None:
        """Render now into ``sound``; ``told(frame, samples)`` is called with each part as it is ready.

        Advance rendering pauses until this is complete; if it is rendering this text, it is continued.
        """
        with self._changed:
            making = self._making
            if making is not None and making.text == text and not (making.is_heard or making.stop.is_set):
                making.hear(sound, on_part)
                return
            self._wanted = _Making(text)
            self._wanted.hear(sound, on_part)
            if making is not None:
                making.stop.set()
            self._changed.notify()

    def stop(self) -> None:
        """Cancel the requested text."""
        with self._changed:
            self._wanted = None
            if self._making is not None and self._making.is_heard:
                self._making.stop.set()

    def draft(self, text: str) -> None:
        """Render this before all other texts in advance, as it may be requested at any time. Empty:
        nothing is typed.
        """
        with self._changed:
            self._draft = "" if self._kept.get(text) is not None else text
            making = self._making
            if making is not None and not making.is_heard and making.text != text and (self._draft or making.is_draft):
                making.stop.set()
            self._changed.notify()

    def prepare(self, texts: Sequence[str]) -> None:
        """Texts to render in advance, in order; replaces earlier ones."""
        with self._changed:
            self._kept.want(texts)
            self._prepared = tuple(texts)
            self._ahead = deque(texts)
            self._changed.notify()

    def tune(self, rate: float, volume: float) -> None:
        """Settings from the next utterance on; cached audio is rendered again."""
        with self._changed:
            self._tuned = (rate, volume)
            self._changed.notify()

    def end(self) -> None:
        with self._changed:
            self._ended = True
            if self._making is not None:
                self._making.stop.set()
            self._changed.notify()

    def run(self) -> None:
        while True:
            with self._changed:
                while not (self._wanted or self._draft or self._ahead or self._tuned or self._ended):
                    self._changed.wait()
                if self._ended:
                    return
                if self._tuned is not None:
                    self._voice.tune(*self._tuned)
                    self._tuned = None
                    self._kept.clear()
                    self._ahead = deque(self._prepared)
                    continue
                making = self._next()
                kept = self._kept.get(making.text)
                if kept is not None and not making.is_heard:
                    continue
                self._making = making
            begun_s = time.monotonic()
            self._make(making, kept)
            if not (making.is_draft or making.is_heard):
                # Not urgent: leave half of the processor time to others.
                with self._changed:
                    if not (self._ended or self._wanted or self._draft):
                        self._changed.wait(time.monotonic() - begun_s)

    def _next(self) -> _Making:
        if self._wanted is not None:
            wanted, self._wanted = self._wanted, None
            return wanted
        if self._draft:
            draft, self._draft = self._draft, ""
            return _Making(draft, is_draft=True)
        return _Making(self._ahead.popleft())

    def _make(self, making: _Making, kept: Samples | None) -> None:
        trouble = ""
        try:
            parts = trimmed(self._voice.parts(making.text, making.stop), self._voice.rate_hz, self._voice.least_heard)
            for part in parts if kept is None else [kept]:
                making.stop.check()
                making.add(part)
        except RenderingStoppedError:
            trouble = "it was interrupted"
        except Exception as error:
            traceback.print_exc()
            trouble = words_of(error)
        with self._changed:
            self._making = None
            if making.stop.is_set and making.text in self._prepared:
                self._ahead.appendleft(making.text)
            elif not trouble and making.parts:
                self._kept.put(making.text, np.concatenate(making.parts))
        making.finish(trouble or ("" if making.parts else "the voice produced no audio"))
