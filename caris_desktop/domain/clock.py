"""The one monotonic clock of a session.

``time.monotonic_ns`` counts from the same origin in every process of a machine, so values stamped in
different child processes can be compared without translation.
"""

import time

from caris_desktop.domain.value_class import dataclass

now_ns = time.monotonic_ns


MOST_DELAY_S = 5.0
"""A stamp that is further back than this when its message arrives is of another clock than the one the robot tells: a
network that holds messages for so long holds the pings too, and the link counts as lost before that."""
_MOST_AHEAD_S = 0.5  # a driver may stamp the end of a sweep, and the clocks of a robot's computers differ a little
_BASELINE_S = 15.0
# What is known no better says less of a moment than the arrival does.
_USEFUL_UNCERTAINTY_NS = 100_000_000


@dataclass(frozen=True, slots=True)
class ClockAnchor:
    """One reading of both clocks, which maps session time to UTC."""

    monotonic_ns: int
    utc_ns: int

    @classmethod
    def take(cls) -> "ClockAnchor":
        return cls(monotonic_ns=time.monotonic_ns(), utc_ns=time.time_ns())

    def utc_ns_at(self, monotonic_ns: int) -> int:
        return self.utc_ns + (monotonic_ns - self.monotonic_ns)


def measured_ns(robot_stamp_ns: int | None, *, arrival_ns: int, offset_ns: int, uncertainty_ns: int) -> int | None:
    """When the robot measured what arrived at ``arrival_ns``, on our clock; None where its stamp does not tell.

    ``offset_ns`` is the robot's clock minus ours, right to within ``uncertainty_ns``; so is the moment then.
    """
    if robot_stamp_ns is None or uncertainty_ns > _USEFUL_UNCERTAINTY_NS:
        return None
    at_ns = robot_stamp_ns - offset_ns
    if not arrival_ns - MOST_DELAY_S * 1e9 <= at_ns <= arrival_ns + uncertainty_ns:
        return None
    return min(at_ns, arrival_ns)


class StampAge:
    """How long the values of one stream were under way: one rule for camera, LIDAR and guard.

    With the robot's clock known, a stamp tells it; one that is beyond belief (more than :data:`MOST_DELAY_S` back or
    half a second ahead) tells nothing, and the age is not known. What is known without that clock is how much longer a
    value was under way than the quickest one of the last 15 to 30 s.
    """

    def __init__(self) -> None:
        self._least_ns: list[
            int
        ] = []  # arrival minus stamp of the quickest, in this part of a minute and the one before
        self._began_ns = 0
        self._arrival_ns = 0
        self._stamp_ns: int | None = None
        self._excess_s = 0.0

    def add(self, robot_stamp_ns: int | None, *, arrival_ns: int) -> None:
        """A value has arrived."""
        self._arrival_ns, self._stamp_ns, self._excess_s = arrival_ns, robot_stamp_ns, 0.0
        if robot_stamp_ns is None:
            return
        way_ns = arrival_ns - robot_stamp_ns
        if self._least_ns and abs(way_ns - min(self._least_ns)) > MOST_DELAY_S * 1e9:
            self._least_ns = []  # its clock was set
        if not self._least_ns or not 0 <= arrival_ns - self._began_ns < _BASELINE_S * 1e9:
            self._least_ns = [way_ns, *self._least_ns[:1]]
            self._began_ns = arrival_ns
        self._least_ns[0] = min(self._least_ns[0], way_ns)
        self._excess_s = (way_ns - min(self._least_ns)) / 1e9

    def delay_s(self, offset_ns: float | None, uncertainty_ns: float = 0.0) -> float:
        """How long the newest value was under way at least. ``offset_ns``: the robot's clock minus ours, if known."""
        told_s = self._told_s(offset_ns)
        if told_s is None or not -_MOST_AHEAD_S <= told_s <= MOST_DELAY_S:
            return self._excess_s
        return max(0.0, told_s - uncertainty_ns / 1e9)

    def is_known(self, offset_ns: float | None, uncertainty_ns: float = 0.0) -> bool:
        """False where the newest stamp is beyond belief."""
        told_s = self._told_s(offset_ns)
        margin_s = uncertainty_ns / 1e9
        return told_s is None or -_MOST_AHEAD_S - margin_s <= told_s <= MOST_DELAY_S + margin_s

    def _told_s(self, offset_ns: float | None) -> float | None:
        if offset_ns is None or self._stamp_ns is None:
            return None
        return (self._arrival_ns - self._stamp_ns + offset_ns) / 1e9
