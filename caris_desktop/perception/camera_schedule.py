"""Camera schedule: several cameras share the detection rate of one."""

import bisect
import math
from collections import deque

from caris_desktop.domain.sensing import FrameRef, HeadState, Odometry

OTHERS_EVERY_NS = 300_000_000
"""How often a camera that is not on show is looked at: often enough to follow people who walk."""

TO_COVER_EVERY_NS = 150_000_000
"""The same where people have to be covered in what every camera records: looks further apart say too little."""

SILENT_AFTER_NS = 600_000_000
"""Longest wait for the displayed camera."""


_RATE_OVER_NS = 4_000_000_000
_MAX_COUNTED = 400


class CameraSchedule:
    """Newest frame per camera. The displayed camera leads: a detection on another one replaces one on it, so that
    more cameras add no load. For one thread, or under a lock.
    """

    def __init__(self) -> None:
        self._newest: dict[str, FrameRef] = {}
        self._detected_ns: dict[str, int] = {}
        self._camera = ""
        self._first = ""
        self._last = ""
        self._lead_came_ns: int | None = None
        self.others_every_ns = OTHERS_EVERY_NS

    def show(self, camera: str) -> None:
        """Set the displayed camera."""
        self._camera = camera
        self._lead_came_ns = None

    def forget(self) -> None:
        """Clear everything for other cameras."""
        self._newest.clear()
        self._detected_ns.clear()
        self._camera = self._first = self._last = ""
        self._lead_came_ns = None

    def offer(self, ref: FrameRef, *, now_ns: int) -> bool:
        """Replace the camera's frame. True if this makes a detection due."""
        self._first = self._first or ref.camera
        is_new = ref.camera not in self._newest
        self._newest[ref.camera] = ref
        if ref.camera != self._lead:
            return False
        self._lead_came_ns = now_ns
        return is_new

    def pop(self, *, now_ns: int) -> FrameRef | None:
        """Frame to process now; None if no frame is due."""
        lead_silent = self._lead_came_ns is None or now_ns - self._lead_came_ns >= SILENT_AFTER_NS
        if self._lead not in self._newest and not lead_silent:
            return None
        every_ns = self.others_every_ns
        due = [
            camera
            for camera in self._newest
            if camera != self._lead and now_ns - self._detected_ns.get(camera, -every_ns) >= every_ns
        ]
        camera = min(due, key=lambda other: self._detected_ns.get(other, -every_ns), default=self._lead)
        if self._last not in ("", self._lead) and self._lead in self._newest:
            camera = self._lead  # a slow detector alternates
        ref = self._newest.pop(camera, None)
        # Its detection went to the other camera.
        self._newest.pop(self._lead, None)
        if ref is not None:
            self._detected_ns[camera], self._last = now_ns, camera
        return ref

    @property
    def _lead(self) -> str:
        return self._camera or self._first


class DetectionRate:
    """Recent detection rate of each camera."""

    def __init__(self) -> None:
        self._detected_ns: dict[str, deque[int]] = {}

    def note(self, camera: str, *, now_ns: int) -> None:
        """Note a result for this camera."""
        self._detected_ns.setdefault(camera, deque(maxlen=_MAX_COUNTED)).append(now_ns)

    def forget(self) -> None:
        """Clear everything for other cameras."""
        self._detected_ns.clear()

    def per_second(self, *, now_ns: int) -> dict[str, float]:
        """Detections per second of each camera over the last seconds, highest first."""
        rates = {
            camera: sum(now_ns - at_ns < _RATE_OVER_NS for at_ns in looked_ns) / (_RATE_OVER_NS / 1e9)
            for camera, looked_ns in self._detected_ns.items()
        }
        return dict(sorted(rates.items(), key=lambda rate: -rate[1]))


# Camera rotation compensation: a robot camera's direction over time, from odometry and head angles.

_HISTORY = 100
_NOT_OLDER_NS = 500_000_000


class CameraRotation:
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
