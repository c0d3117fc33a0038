"""Speech for tests, synthesised with espeak-ng at the sample rate of the recogniser."""

import io
import subprocess
import wave

import numpy as np
from numpy.typing import NDArray

RATE_HZ = 16_000


def spoken(text: str, *, voice: str = "en-gb", words_a_minute: int = 145) -> NDArray[np.int16]:
    """``text`` as speech, mono at 16 kHz, without surrounding silence."""
    asked = ["espeak-ng", "-v", voice, "-s", str(words_a_minute), "--stdout", text]
    told = subprocess.run(asked, capture_output=True, check=True, timeout=30).stdout
    with wave.open(io.BytesIO(told)) as file:
        rate_hz = file.getframerate()
        sound = np.frombuffer(told[44:], "<i2").astype(np.float64)
    loud = np.flatnonzero(np.abs(sound) > 200)
    sound = sound[loud[0] : loud[-1] + 1]
    at = np.arange(round(len(sound) * RATE_HZ / rate_hz)) * rate_hz / RATE_HZ
    return np.interp(at, np.arange(len(sound)), sound).astype(np.int16)


def room(seconds: float, *, seed: int = 0) -> NDArray[np.int16]:
    """The noise of a quiet room."""
    return np.random.default_rng(seed).normal(0, 12, round(seconds * RATE_HZ)).astype(np.int16)
