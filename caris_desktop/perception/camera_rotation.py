"""Camera rotation compensation: a robot camera's direction over time, from odometry and head angles."""

import bisect
import math
from collections import deque

from caris_desktop.domain.sensing import HeadState, Odometry

_HISTORY = 100
_NOT_OLDER_NS = 500_000_000


class CameraTurning:
    """Buffers the last seconds. ``take`` from any thread, the rest from one."""

    def __init__(self) -> None:
        self._headings: deque[tuple[int, float]] = deque(maxlen=_HISTORY)
        self._pans: deque[tuple[int, float]] = deque(maxlen=_HISTORY)
        self._tilts: deque[tuple[int, float]] = deque(maxlen=_HISTORY)

    def add(self, value: Odometry | HeadState) -> None:
        if isinstance(value, HeadState):
            self._pans.append((value.stamp_ns, value.pan_rad))
            self._tilts.append((value.stamp_ns, value.tilt_rad))
            return
        heading = value.pose_in_odom.heading_rad
        if self._headings:
            # Unwrap the angle.
            before = self._headings[-1][1]
            heading = before + math.remainder(heading - before, math.tau)
        self._headings.append((value.stamp_ns, heading))

    def forget(self) -> None:
        """Clear everything for another robot."""
        for readings in (self._headings, self._pans, self._tilts):
            readings.clear()

    def direction(self, stamp_ns: int, *, on_head: bool) -> tuple[float, float] | None:
        """Heading in the odometry frame (left positive, not wrapped) and tilt (down positive) at that time, in radians;
        None if unknown.
        """
        heading = _at(tuple(self._headings), stamp_ns)
        if heading is None:
            return None
        if not on_head:
            return heading, 0.0
        pan, tilt = _at(tuple(self._pans), stamp_ns), _at(tuple(self._tilts), stamp_ns)
        return heading + (pan or 0.0), tilt or 0.0


def _at(readings: tuple[tuple[int, float], ...], stamp_ns: int) -> float | None:
    """Interpolated value at that time, or the last one."""
    place = bisect.bisect_left(readings, (stamp_ns, -math.inf))
    if place == 0 or place == len(readings):
        if not readings:
            return None
        nearest_ns, value = readings[0] if place == 0 else readings[-1]
        return value if abs(nearest_ns - stamp_ns) <= _NOT_OLDER_NS else None
    (before_ns, before), (after_ns, after) = readings[place - 1], readings[place]
    return before + (after - before) * (stamp_ns - before_ns) / (after_ns - before_ns)
