"""Simulated robot microphone: room noise, nearby speakers, and the robot's own voice."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import dataclass

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

    def __init__(self, seed: int = 1) -> None:
        self._random = np.random.default_rng(seed)
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

    @property
    def spoken_to(self) -> bool:
        """True while a person in front of the robot speaks."""
        return any(each.source == "participant" for each in self._sounds)

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
