"""Which velocity commands may still lie unhandled at the robot. Pure logic, time comes in as an argument.

A rosbridge that was stopped goes on acknowledging bytes, because its system does that for it; all of them are read and
obeyed when it wakes up. Only its own answer tells that it handles them: behind each command goes a question (see
:mod:`caris_desktop.robot.handled`).
"""

import math
from collections import deque

MOST_UNREAD = 4
READ_WITHIN_S = 0.15
# The shortest round trip of this long, and of this long before, is what the network usually takes.
_USUAL_OVER_S = 1.0
# Stamps are taken back from differences of floats.
_SAME_MOMENT_S = 1e-6


class UnreadCommands:
    """Counts what has been sent and not been handled, on one connection after another.

    At most ``MOST_UNREAD`` commands are unhandled beyond what a slow network has under way; and none is sent to a robot
    that has not answered for ``READ_WITHIN_S`` longer than it usually takes.
    """

    def __init__(self, *, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._sent_s: deque[float] = deque()
        self._handling = _Least()
        self._network = _Least()
        # Whoever drove before this process began may have left the robot moving.
        self._settled = False
        self._zero_s: float | None = None

    @property
    def settled(self) -> bool:
        """Whether the robot is known to have read a zero after the last velocity."""
        return self._settled

    def sent(self, now_s: float, *, moving: bool) -> None:
        """A command went out, and a question behind it."""
        self._sent_s.append(now_s)
        if moving:
            self._settled, self._zero_s = False, None
        elif self._zero_s is None:
            self._zero_s = now_s

    def answered(self, round_trip_s: float, now_s: float) -> None:
        """An answer came, whether or not its question went behind a command."""
        self._handling.add(round_trip_s, now_s)
        read_to_s = now_s - round_trip_s + _SAME_MOMENT_S
        while self._sent_s and self._sent_s[0] <= read_to_s:
            self._sent_s.popleft()
        if self._zero_s is not None and self._zero_s <= read_to_s:
            self._settled = True

    def read(self, round_trip_s: float, now_s: float) -> None:
        """A ping came back: so long the network takes, whatever is handled."""
        self._network.add(round_trip_s, now_s)

    def full(self, now_s: float) -> bool:
        """Whether another command would only lie behind others."""
        # Over a slow network so many are always under way.
        most = max(MOST_UNREAD, int(self._network.least_s * self._rate_hz) + 2)
        return len(self._sent_s) >= most or self.late(now_s)

    def late(self, now_s: float) -> bool:
        """Whether the robot should have read by now."""
        return now_s >= self.late_from_s() - _SAME_MOMENT_S

    def late_from_s(self) -> float:
        """From when on :meth:`late` is true; ``inf`` while everything was read."""
        return self._sent_s[0] + READ_WITHIN_S + self._handling.least_s if self._sent_s else math.inf

    def forget(self) -> None:
        """The connection is over: nothing of it is answered any more."""
        self._sent_s.clear()
        self._zero_s = None
        self._handling, self._network = _Least(), _Least()


class _Least:
    """The shortest of the times of the last moment, and of the moment before."""

    def __init__(self) -> None:
        self._now_s = self._before_s = math.inf
        self._since_s = -math.inf

    @property
    def least_s(self) -> float:
        """Zero where there is none."""
        least_s = min(self._now_s, self._before_s)
        return least_s if math.isfinite(least_s) else 0.0

    def add(self, took_s: float, now_s: float) -> None:
        if now_s - self._since_s >= _USUAL_OVER_S:
            self._before_s, self._now_s, self._since_s = self._now_s, math.inf, now_s
        self._now_s = min(self._now_s, took_s)
