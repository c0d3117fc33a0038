"""Robot voice: audio from espeak-ng, one sentence at a time, interruptible."""

import asyncio
import contextlib
import io
import logging
import os
import queue
import shutil
import threading
import wave
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import Value

logger = logging.getLogger(__name__)

MAX_SENTENCE_CHARS = 2000
_RENDER_LIMIT_S = 15.0
_CHARS_PER_S = 14.0


class Spoken(Value):
    """Audio of one sentence: int16, shape (samples,); empty if only its duration is known."""

    samples: NDArray[np.int16]
    rate_hz: int
    duration_s: float


async def output_of(command: Sequence[str], text: str, limit_s: float) -> tuple[int | None, bytes]:
    """Exit status and output of a program that reads ``text``. Raises TimeoutError, and ends it, after ``limit_s``."""
    process = await asyncio.create_subprocess_exec(
        *command,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    try:
        content, _ = await asyncio.wait_for(process.communicate(text.encode("utf-8")), limit_s)
    finally:
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()
    return process.returncode, content


async def render(text: str) -> Spoken:
    """Audio of ``text`` from espeak-ng; without it an estimated duration."""
    program = shutil.which("espeak-ng")
    if program is None:
        return estimate(text)
    try:
        _, content = await output_of([program, "--stdin", "--stdout"], text, _RENDER_LIMIT_S)
    except TimeoutError:
        logger.warning("espeak-ng took over %.0f s; the robot only takes the time to speak", _RENDER_LIMIT_S)
        return estimate(text)
    return _from_wav(content) or estimate(text)


def estimate(text: str) -> Spoken:
    """Estimated duration of ``text``, without audio."""
    return Spoken(np.zeros(0, dtype=np.int16), 22050, 0.3 + len(text) / _CHARS_PER_S)


def _from_wav(content: bytes) -> Spoken | None:
    try:
        with wave.open(io.BytesIO(content)) as file:
            rate_hz = file.getframerate()
            # a stream's header lacks the true length, so read to the end
            samples = np.frombuffer(file.readframes(len(content)), dtype=np.int16)
    except (wave.Error, EOFError, ValueError):
        logger.exception("espeak-ng gave no readable audio")
        return None
    return Spoken(samples, rate_hz, len(samples) / rate_hz) if len(samples) else None


class Loudspeaker:
    """Plays through the default output, if any. In its own thread, as sound servers may hang."""

    def __init__(self, *, muted: bool = False) -> None:
        self._orders: queue.SimpleQueue[Spoken | None] = queue.SimpleQueue()
        self._muted = muted
        self._thread: threading.Thread | None = None

    def play(self, spoken: Spoken) -> None:
        """Start playing; returns at once."""
        if self._muted or not len(spoken.samples):
            return
        if self._thread is None:
            self._thread = threading.Thread(target=self._obey, name="loudspeaker", daemon=True)
            self._thread.start()
        self._order(spoken)

    def stop(self) -> None:
        """Stop playing; returns at once."""
        self._order(None)

    def _order(self, order: Spoken | None) -> None:
        # the thread ends without an output device, and then accepts no commands
        if self._thread is not None and self._thread.is_alive():
            self._orders.put(order)

    def _obey(self) -> None:
        device = _find_device()
        while device is not None:
            order = self._orders.get()
            try:
                if order is None:
                    _silence(device)
                else:
                    device.play(order.samples, order.rate_hz)
            except device.PortAudioError:
                logger.exception("The sound device failed; the robot goes on without sound")
                return


def _silence(device: Any) -> None:
    try:
        # discard the device's buffer as well
        device.get_stream().abort()
    except RuntimeError:
        return  # nothing was played yet
    device.stop()


def _find_device() -> Any:
    try:
        import sounddevice

        sounddevice.check_output_settings()
    except Exception as error:  # OSError without PortAudio, its own types without a device
        logger.info("No sound device here (%s); the robot speaks without sound", error)
        return None
    return sounddevice


class SpeechQueue(ABC):
    """Says sentences one after the other; ``speaking`` is the present one."""

    def __init__(self, *, most_waiting: int) -> None:
        self._most_waiting = most_waiting
        self._waiting: deque[tuple[str, float]] = deque()
        self._task: asyncio.Task[None] | None = None
        self.speaking: str | None = None

    def say(self, text: str, *, after_s: float = 0.0) -> bool:
        """Queue a sentence. False if it is empty or the queue is full."""
        text = text.strip()[:MAX_SENTENCE_CHARS]
        if not text or len(self._waiting) >= self._most_waiting:
            return False
        self._waiting.append((text, after_s))
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._say_all())
        return True

    def stop(self) -> None:
        """Interrupt the present sentence and clear the queue."""
        self._waiting.clear()
        if self._task is not None:
            self._task.cancel()
            self._task = None

    async def _say_all(self) -> None:
        while self._waiting:
            await self._say_one(*self._waiting.popleft())

    @abstractmethod
    async def _say_one(self, text: str, after_s: float) -> None:
        """Say a sentence, ``after_s`` after it was taken from the queue at the earliest."""


class Voice(SpeechQueue):
    """The robot's voice. ``on_speaking`` gets True at the start of a sentence and False at its end.

    ``on_sound`` gets the loudspeaker's audio from now on, None when it is cut off; ``on_spoken`` is called at its
    regular end.
    """

    def __init__(self, on_speaking: Callable[[bool], None], *, muted: bool = False) -> None:
        super().__init__(most_waiting=50)
        self._on_speaking = on_speaking
        self.on_sound: Callable[[Spoken | None], None] = lambda _spoken: None
        self.on_spoken: Callable[[], None] = lambda: None
        self._loudspeaker = Loudspeaker(muted=muted)
        if shutil.which("espeak-ng") is None:
            logger.warning("espeak-ng is not installed: the robot makes no sound and only takes the time to speak")

    async def _say_one(self, text: str, after_s: float) -> None:
        spoken = await render(text)
        try:
            self.speaking = text
            self._on_speaking(True)
            logger.info("Says (%.1f s): %s", spoken.duration_s, text)
            self._loudspeaker.play(spoken)
            self.on_sound(spoken)
            await asyncio.sleep(spoken.duration_s)
            self.on_spoken()
        except asyncio.CancelledError:
            self.on_sound(None)
            raise
        finally:
            self._loudspeaker.stop()
            self.speaking = None
            self._on_speaking(False)
