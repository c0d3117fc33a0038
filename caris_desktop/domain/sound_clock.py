"""Timestamps of sound that arrives in pieces over a network."""

from collections import deque

_LATE_NS = 60_000_000
_FOR_NS = 1_000_000_000
_SLEW = 0.01


class SoundClock:
    """Clock that gives the time of each piece's first sample.

    A network adds varying delay; the samples themselves keep time. So a piece follows the one before it, however late
    it arrives, until all pieces of a second were late: then samples are missing.
    """

    def __init__(self) -> None:
        self._due_ns: int | None = None
        self._late: deque[tuple[int, int]] = deque()

    def stamp(self, *, arrival_ns: int, length_ns: int) -> tuple[int, int]:
        """Time of the first sample of a piece of this length, and the missing time before it."""
        latest_ns = arrival_ns - length_ns  # it had ended when it was sent
        if self._due_ns is None:
            self._due_ns = latest_ns
        late_ns = latest_ns - self._due_ns
        missing_ns = self._missing_ns(arrival_ns, late_ns)
        # Two clocks always differ slightly, and the first piece may itself have been late.
        most_ns = round(length_ns * _SLEW)
        follow_ns = missing_ns or max(-most_ns, min(most_ns, *(late for _, late in self._late)))
        stamp_ns = self._due_ns + follow_ns
        self._due_ns = stamp_ns + length_ns
        if missing_ns:
            self._late.clear()
        return stamp_ns, missing_ns

    def _missing_ns(self, arrival_ns: int, late_ns: int) -> int:
        if late_ns <= 0:
            self._late.clear()
        self._late.append((arrival_ns, late_ns))
        if late_ns > _FOR_NS:
            return late_ns
        while len(self._late) > 2 and arrival_ns - self._late[1][0] >= _FOR_NS:
            self._late.popleft()
        least_ns = min(late for _, late in self._late)
        return least_ns if least_ns > _LATE_NS and arrival_ns - self._late[0][0] >= _FOR_NS else 0
