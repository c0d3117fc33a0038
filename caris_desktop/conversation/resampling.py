"""Streaming resampler: polyphase filter (windowed sinc, Kaiser), about -80 dB outside the passband."""

from functools import lru_cache
from math import gcd

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

_HALF_WIDTH = 24
"""Zero crossings of the sinc on each side."""
_KAISER_BETA = 9.0
_PASSBAND = 0.92


class Resampler:
    """Single-channel resampler without delay: first output and first input sample have the same time."""

    def __init__(self, from_hz: int, to_hz: int) -> None:
        divisor = gcd(from_hz, to_hz)
        self._step, self._phases = from_hz // divisor, to_hz // divisor
        self._half = 0
        self._kernels = np.ones((1, 1), np.float32)
        if from_hz != to_hz:
            self._half, self._kernels = _kernels(from_hz, to_hz, self._phases)
        # Silence before the first sample.
        self._buffered = np.zeros(self._half, np.float32)
        self._phase = 0

    def process(self, samples: NDArray[np.float32]) -> NDArray[np.float32]:
        """Add samples, shape (n,); return all final output samples."""
        available = np.concatenate((self._buffered, samples.astype(np.float32, copy=False)))
        width = self._kernels.shape[1]
        # Output i is at `phase + i * step` phases after the first fully retained sample.
        usable = (len(available) - width + 1) * self._phases - self._phase
        count = max(0, -(-usable // self._step))
        at = self._phase + np.arange(count, dtype=np.int64) * self._step
        first, phase = at // self._phases, at % self._phases
        if count == 0:
            self._buffered = available
            return np.zeros(0, np.float32)
        out: NDArray[np.float32] = np.einsum(
            "ij,ij->i", sliding_window_view(available, width)[first], self._kernels[phase]
        )
        after = self._phase + count * self._step
        self._buffered = available[after // self._phases :]
        self._phase = after % self._phases
        return out

    def rest(self) -> NDArray[np.float32]:
        """Rest at the end of the sound."""
        return self.process(np.zeros(self._half, np.float32))


def resampled(samples: NDArray[np.float32], from_hz: int, to_hz: int) -> NDArray[np.float32]:
    """Resample a whole sound, shape (n,)."""
    resampler = Resampler(from_hz, to_hz)
    return np.concatenate((resampler.process(samples), resampler.rest()))


@lru_cache(maxsize=8)
def _kernels(from_hz: int, to_hz: int, phases: int) -> tuple[int, NDArray[np.float32]]:
    """Half the filter width, and weights per phase, shape (phases, 2 * half + 1)."""
    cutoff = _PASSBAND * min(1.0, to_hz / from_hz)
    half = int(np.ceil(_HALF_WIDTH / cutoff))
    offsets = np.arange(-half, half + 1)[np.newaxis, :] - (np.arange(phases) / phases)[:, np.newaxis]
    window = np.i0(_KAISER_BETA * np.sqrt(np.clip(1.0 - (offsets / (half + 1)) ** 2, 0.0, None))) / np.i0(_KAISER_BETA)
    weights = cutoff * np.sinc(cutoff * offsets) * window
    return half, (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
