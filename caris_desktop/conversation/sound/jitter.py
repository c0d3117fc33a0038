"""Jitter buffer: regular playback of irregular audio, preferring gaps to delay."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

_AHEAD_S = 0.08
_QUIET = 400
"""Level below which nobody speaks, of 32768."""


class JitterBuffer:
    """Single-channel buffer. Playback begins with ``_AHEAD_S`` buffered; beyond ``most_s`` the oldest samples are
    dropped, so that the delay does not grow. An initial backlog is reduced by shortening quiet passages.
    """

    def __init__(self, rate_hz: int, most_s: float = 0.25) -> None:
        self._ahead = round(_AHEAD_S * rate_hz)
        self._most = round(most_s * rate_hz)
        self._pieces: deque[NDArray[np.int16]] = deque()
        self._waiting = 0
        self._playing = False
        self._ending = False
        self.dropped = 0

    @property
    def waiting(self) -> int:
        """Number of buffered samples."""
        return self._waiting

    def push(self, samples: NDArray[np.int16]) -> None:
        """Add samples, shape (n,)."""
        self._ending = False
        if self._waiting > 2 * self._ahead and max(int(samples.max(initial=0)), -int(samples.min(initial=0))) < _QUIET:
            self.dropped += 1
            return
        self._pieces.append(samples)
        self._waiting += len(samples)
        if self._waiting > self._most:
            self._take(self._waiting - self._ahead)
            self.dropped += 1

    def finish(self) -> None:
        """End of input: the rest is played, however short."""
        self._ending = True

    def pull(self, count: int) -> tuple[NDArray[np.int16], int]:
        """Samples to play now, shape (count,), padded with silence, and the number of real ones."""
        out = np.zeros(count, np.int16)
        if not self._playing and (self._waiting >= self._ahead or (self._ending and self._waiting)):
            self._playing = True
        if not self._playing:
            return out, 0
        sound = self._take(count)
        out[: len(sound)] = sound
        # After running empty, buffer again before playing.
        self._playing = self._waiting > 0
        return out, len(sound)

    def _take(self, count: int) -> NDArray[np.int16]:
        taken: list[NDArray[np.int16]] = []
        missing = min(count, self._waiting)
        self._waiting -= missing
        while missing:
            piece = self._pieces.popleft()
            if len(piece) > missing:
                self._pieces.appendleft(piece[missing:])
                piece = piece[:missing]
            missing -= len(piece)
            taken.append(piece)
        return np.concatenate(taken) if taken else np.zeros(0, np.int16)
