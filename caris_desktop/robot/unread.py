"""Unhandled velocity commands at the robot. Pure logic; time is an argument.

The system of a suspended rosbridge acknowledges bytes; all of them are read and executed when it resumes. Only its own
answer proves handling: each command is followed by a request (see :mod:`caris_desktop.robot.handled_operations`).
"""

import math
from collections import deque

MOST_UNREAD = 4
READ_WITHIN_S = 0.15
# The minimum round trip over one to two such intervals is the network's usual delay.
_USUAL_OVER_S = 1.0
# Stamps are recomputed from differences of floats.
_SAME_MOMENT_S = 1e-6


class UnreadCommands:
    """Counts commands sent and not handled, on one connection after another.

    At most ``MOST_UNREAD`` commands may be unhandled beyond those in transit on a slow network; and none is sent to a
    robot that has not answered for ``READ_WITHIN_S`` longer than usual.
    """

    def __init__(self, *, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._sent_s: deque[float] = deque()
        self._handling = _Least()
        self._network = _Least()
        # An earlier process may have left the robot moving.
        self._settled = False
        self._zero_s: float | None = None

    @property
    def acknowledged(self) -> bool:
        """True if the robot is known to have read a zero after the last velocity."""
        return self._settled

    def sent(self, now_s: float, *, moving: bool) -> None:
        """Note a command and its request."""
        self._sent_s.append(now_s)
        if moving:
            self._settled, self._zero_s = False, None
        elif self._zero_s is None:
            self._zero_s = now_s

    def answered(self, round_trip_s: float, now_s: float) -> None:
        """Note an answer, with or without a command before its request."""
        self._handling.add(round_trip_s, now_s)
        read_to_s = now_s - round_trip_s + _SAME_MOMENT_S
        while self._sent_s and self._sent_s[0] <= read_to_s:
            self._sent_s.popleft()
        if self._zero_s is not None and self._zero_s <= read_to_s:
            self._settled = True

    def read(self, round_trip_s: float, now_s: float) -> None:
        """Note a ping's round trip: the network's delay, independent of handling."""
        self._network.add(round_trip_s, now_s)

    def full(self, now_s: float) -> bool:
        """True if another command would only queue behind others."""
        # On a slow network this many are always in transit.
        most = max(MOST_UNREAD, int(self._network.least_s * self._rate_hz) + 2)
        return len(self._sent_s) >= most or self.late(now_s)

    def late(self, now_s: float) -> bool:
        """True if the robot should have read by now."""
        return now_s >= self.late_from_s() - _SAME_MOMENT_S

    def late_from_s(self) -> float:
        """Time from which :meth:`late` is true; ``inf`` while everything was read."""
        return self._sent_s[0] + READ_WITHIN_S + self._handling.least_s if self._sent_s else math.inf

    def forget(self) -> None:
        """Reset at the end of a connection."""
        self._sent_s.clear()
        self._zero_s = None
        self._handling, self._network = _Least(), _Least()


class _Least:
    """Minimum over the last one to two intervals."""

    def __init__(self) -> None:
        self._now_s = self._before_s = math.inf
        self._since_s = -math.inf

    @property
    def least_s(self) -> float:
        """Minimum, zero without values."""
        least_s = min(self._now_s, self._before_s)
        return least_s if math.isfinite(least_s) else 0.0

    def add(self, took_s: float, now_s: float) -> None:
        if now_s - self._since_s >= _USUAL_OVER_S:
            self._before_s, self._now_s, self._since_s = self._now_s, math.inf, now_s
        self._now_s = min(self._now_s, took_s)
