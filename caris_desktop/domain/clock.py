"""Session clock: one monotonic clock for all processes, and robot timestamps converted to it.

``time.monotonic_ns`` counts from the same origin in every process of a machine, so timestamps of different child
processes are comparable.
"""

import time

from caris_desktop.domain.value_class import Value

now_ns = time.monotonic_ns


MOST_DELAY_S = 5.0
"""Largest plausible age of a timestamp on arrival; an older one is from another clock than the robot's. A network with
such delays also delays the pings, and the link counts as lost before that."""
_MOST_AHEAD_S = 0.5  # A driver may stamp the end of a scan, and the clocks of a robot's computers differ slightly.
_BASELINE_S = 15.0
# With more uncertainty, the arrival time is the better estimate.
_USEFUL_UNCERTAINTY_NS = 100_000_000


class ClockAnchor(Value):
    """One reading of both clocks, which maps session time to UTC."""

    monotonic_ns: int
    utc_ns: int

    @classmethod
    def take(cls) -> "ClockAnchor":
        return cls(monotonic_ns=time.monotonic_ns(), utc_ns=time.time_ns())

    def utc_ns_at(self, monotonic_ns: int) -> int:
        return self.utc_ns + (monotonic_ns - self.monotonic_ns)


def measured_ns(robot_stamp_ns: int | None, *, arrival_ns: int, offset_ns: int, uncertainty_ns: int) -> int | None:
    """Measurement time on our clock of a value that arrived at ``arrival_ns``; None without a usable robot timestamp.

    ``offset_ns`` is the robot's clock minus ours, known to within ``uncertainty_ns``, and so is the result.
    """
    if robot_stamp_ns is None or uncertainty_ns > _USEFUL_UNCERTAINTY_NS:
        return None
    at_ns = robot_stamp_ns - offset_ns
    if not arrival_ns - MOST_DELAY_S * 1e9 <= at_ns <= arrival_ns + uncertainty_ns:
        return None
    return min(at_ns, arrival_ns)


class StampAge:
    """Age of the values of one stream on arrival: the same rule for camera, LIDAR and guard.

    With a known clock offset, the timestamp gives the age; an implausible one (more than :data:`MOST_DELAY_S` in the
    past or half a second in the future) makes the age unknown. Without the offset, only the excess over the fastest
    value of the last 15 to 30 s is known.
    """

    def __init__(self) -> None:
        self._least_ns: list[
            int
        ] = []  # Minimum of arrival minus timestamp, in this baseline period and the one before.
        self._began_ns = 0
        self._arrival_ns = 0
        self._stamp_ns: int | None = None
        self._excess_s = 0.0

    def add(self, robot_stamp_ns: int | None, *, arrival_ns: int) -> None:
        """Account for an arrived value."""
        self._arrival_ns, self._stamp_ns, self._excess_s = arrival_ns, robot_stamp_ns, 0.0
        if robot_stamp_ns is None:
            return
        way_ns = arrival_ns - robot_stamp_ns
        if self._least_ns and abs(way_ns - min(self._least_ns)) > MOST_DELAY_S * 1e9:
            self._least_ns = []  # the robot's clock was set
        if not self._least_ns or not 0 <= arrival_ns - self._began_ns < _BASELINE_S * 1e9:
            self._least_ns = [way_ns, *self._least_ns[:1]]
            self._began_ns = arrival_ns
        self._least_ns[0] = min(self._least_ns[0], way_ns)
        self._excess_s = (way_ns - min(self._least_ns)) / 1e9

    def delay_s(self, offset_ns: float | None, uncertainty_ns: float = 0.0) -> float:
        """Minimum age of the newest value on arrival. ``offset_ns``: the robot's clock minus ours, if known."""
        reported_s = self._reported_s(offset_ns)
        if reported_s is None or not -_MOST_AHEAD_S <= reported_s <= MOST_DELAY_S:
            return self._excess_s
        return max(0.0, reported_s - uncertainty_ns / 1e9)

    def is_known(self, offset_ns: float | None, uncertainty_ns: float = 0.0) -> bool:
        """False if the newest timestamp is implausible."""
        reported_s = self._reported_s(offset_ns)
        margin_s = uncertainty_ns / 1e9
        return reported_s is None or -_MOST_AHEAD_S - margin_s <= reported_s <= MOST_DELAY_S + margin_s

    def _reported_s(self, offset_ns: float | None) -> float | None:
        if offset_ns is None or self._stamp_ns is None:
            return None
        return (self._arrival_ns - self._stamp_ns + offset_ns) / 1e9
