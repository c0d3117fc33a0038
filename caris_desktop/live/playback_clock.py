"""Replay clock: current position in the recorded session."""

import time
from collections.abc import Callable

LEAST_RATE, MOST_RATE = 0.1, 16.0


class PlaybackClock:
    """Clock from ``start_ns`` to ``end_ns`` of the session, running at ``rate`` times real time, or paused."""

    def __init__(self, start_ns: int, end_ns: int, *, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.start_ns = start_ns
        self.end_ns = max(start_ns, end_ns)
        self._now_ns = now_ns
        self._position_ns = start_ns
        self._since_ns: int | None = None
        self._rate = 1.0

    @property
    def playing(self) -> bool:
        return self._since_ns is not None

    @property
    def rate(self) -> float:
        return self._rate

    def position_ns(self) -> int:
        if self._since_ns is None:
            return self._position_ns
        elapsed_ns = round((self._now_ns() - self._since_ns) * self._rate)
        return min(self.end_ns, self._position_ns + elapsed_ns)

    def play(self) -> None:
        if self._since_ns is None:
            self._since_ns = self._now_ns()

    def pause(self) -> None:
        self._position_ns = self.position_ns()
        self._since_ns = None

    def set_rate(self, rate: float) -> None:
        self.seek(self.position_ns())
        self._rate = min(MOST_RATE, max(LEAST_RATE, rate))

    def seek(self, at_ns: int) -> None:
        self._position_ns = min(self.end_ns, max(self.start_ns, at_ns))
        if self._since_ns is not None:
            self._since_ns = self._now_ns()
