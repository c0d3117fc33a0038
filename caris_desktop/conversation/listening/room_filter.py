"""Room filter: transfer function from loudspeaker to microphone, learned during possible double talk.

For each frequency the microphone's sound is a weighted sum of the last played frames (convolutive transfer function).
The weights are the state of a Kalman filter with full covariance over the frames, whose observation noise is the
unexplained sound: bins with another speaker are not learned from. It converges within a few frames, where an adaptive
filter with a step size per bin needs seconds, and estimates its own uncertainty.
"""

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import Value

FRAME, HOP = 1024, 256
"""Samples of a frame at 16 kHz, and from one to the next; they overlap by three quarters, or else what is left of the
robot is four times as loud."""
TAPS = 19
"""Frames that a room holds: 0.3 s."""
BINS = FRAME // 2 + 1
_WINDOW = np.sqrt(np.hanning(FRAME + 1)[:FRAME]).astype(np.float32)
_SYNTHESIS = (_WINDOW / (_WINDOW**2).reshape(-1, HOP).sum(axis=0)[0]).astype(np.float32)
_EXPECTED = np.exp(-np.maximum(np.arange(TAPS) - 2.0, 0.0) / 3.75)
"""Decay of an echo's energy over the frames, assumed for any room: by two thirds in 60 ms."""
_EXPECTED /= _EXPECTED.sum()
_RETAINED = 0.5
"""Of what was learnt of a room, while it may be another."""
_CLOCKS_APART = 3.5e-4
"""Two sound devices do not count the seconds alike: by a ten-thousandth as a rule, always in one direction. That turns
high tones most from one frame to the next."""
_TURNED = ((2 * np.pi * np.arange(BINS) / FRAME * HOP * _CLOCKS_APART) ** 2).astype(np.float32)[:, np.newaxis]
_DIAGONAL = np.arange(TAPS)
_SMOOTHING = 0.5
_LEAST_NOISE = 1e-7 * FRAME
_SPREAD = np.array((0.25, 0.5, 0.25), np.float32)
_LEFT_OF_ROBOT = 0.02
"""Of the robot's energy stays what no such filter explains, as with loudspeakers that are overdriven."""
_LAST = 3
_TAIL_MARGIN = 2.0
_TAIL_LASTS = 0.85
"""Of what a room holds beyond the filter, from one frame to the next: 60 dB in 1.4 s at most."""


def spectrum(samples: NDArray[np.float32]) -> NDArray[np.complex64]:
    """Spectrum of one frame, shape (BINS,)."""
    return np.fft.rfft(samples * _WINDOW).astype(np.complex64)


def energy_of(samples: NDArray[np.float32]) -> float:
    """Energy of one frame, scaled as in its spectrum."""
    return float(((samples * _WINDOW) ** 2).sum()) * FRAME / 2


def part_of_sound(frame: NDArray[np.complex64]) -> NDArray[np.float32]:
    """Contribution of a frame to the sound, shape (FRAME,)."""
    sound: NDArray[np.float32] = np.fft.irfft(frame).astype(np.float32) * _SYNTHESIS
    return sound


class Split(Value, eq=False):
    """Separated frame. ``robot`` is to be subtracted; ``others_energy`` of ``microphone_energy`` is certainly not the
    robot's.
    """

    robot: NDArray[np.complex64]
    microphone_energy: float
    others_energy: float


class RoomFilter:
    """Filter of one room. Process each frame once, in order."""

    def __init__(self) -> None:
        self._weights = np.zeros((BINS, TAPS), np.complex64)
        self._covariance = np.zeros((BINS, TAPS, TAPS), np.complex64)
        self._noise = np.full(BINS, _LEAST_NOISE, np.float32)
        self._tail = np.zeros(BINS, np.float32)

    @property
    def weights(self) -> NDArray[np.complex64]:
        """Present weights, for ``reduce_step_size``."""
        return self._weights.copy()

    @property
    def loudness(self) -> float:
        """Energy of the robot at the microphone relative to the playback; 0 if unknown."""
        return float((np.abs(self._weights) ** 2).sum(axis=1).mean())

    def reduce_step_size(self, loudness: float, known: NDArray[np.complex64]) -> None:
        """Restart from the ``known`` room with large uncertainty; ``loudness`` is the expected relative energy."""
        self._weights = known * np.complex64(_RETAINED)
        self._covariance[:] = 0
        self._covariance[:, _DIAGONAL, _DIAGONAL] = loudness * _EXPECTED
        self._noise[:] = _LEAST_NOISE

    def process(self, microphone: NDArray[np.complex64], played: NDArray[np.complex64]) -> Split:
        """Process a frame; ``played`` has the last played frames, newest first, shape (BINS, TAPS)."""
        seen = np.matmul(self._covariance, np.conj(played)[:, :, np.newaxis])[:, :, 0]
        unsure = np.maximum(np.real((played * seen).sum(axis=1)), 0.0)
        error = microphone - (played * self._weights).sum(axis=1)
        others = np.convolve(np.maximum(np.abs(error) ** 2 - unsure, 0.0), _SPREAD, "same").astype(np.float32)
        self._noise = _SMOOTHING * self._noise + (1.0 - _SMOOTHING) * others
        noise = np.maximum(np.maximum(self._noise, others), _LEAST_NOISE)
        step = seen / (unsure + noise)[:, np.newaxis]
        self._weights += step * error[:, np.newaxis]
        self._covariance -= step[:, :, np.newaxis] * np.conj(seen)[:, np.newaxis, :]
        self._covariance[:, _DIAGONAL, _DIAGONAL] += _TURNED * np.abs(self._weights) ** 2
        echo = (played * self._weights).sum(axis=1)
        rest = microphone - echo
        rest2 = np.abs(rest) ** 2
        left = unsure * noise / (unsure + noise) + _LEFT_OF_ROBOT * np.abs(echo) ** 2 + self._beyond(played)
        mine = np.maximum(rest2 - left, 0.0)
        microphone_energy = float((np.abs(microphone) ** 2).sum())
        # The residual echo is removed by magnitude: spectral subtraction (Boll 1979).
        share = np.convolve(mine, _SPREAD, "same") / np.maximum(np.convolve(rest2, _SPREAD, "same"), 1e-12)
        return Split(microphone - np.sqrt(share) * rest, microphone_energy, float(mine.sum()))

    def _beyond(self, played: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Energy of reverberation beyond the filter's length."""
        last = np.abs(self._weights[:, -_LAST:] * played[:, -_LAST:]) ** 2
        self._tail = _TAIL_LASTS * (self._tail + last.mean(axis=1, dtype=np.float32))
        return _TAIL_MARGIN * self._tail
