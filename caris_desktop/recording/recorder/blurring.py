"""Buffer that delays video frames until the people in them are known, and blurs those people.

Detection runs on some frames and reports with a delay. A frame waits for detections from before and after it, and a
little longer, since a tracker confirms a new person only with the second detection. Between two detections a person's
area is interpolated with a margin; a person missed once stays covered. If detections are too far apart or late, the
whole frame is covered: no pixel of a person is written because of a delay.
"""

from bisect import bisect_left, bisect_right, insort
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.sensing import FrameRef, People, PersonBox
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.recorder.recorder_messages import BlurDemand, BlurWhat, UseConsents

Corners = tuple[float, float, float, float]
"""Left, top, right, bottom in pixels."""

GAP_AT_MOST_NS = 350_000_000
"""Looks further apart than this say nothing of the frames between them."""
AHEAD_NS = 300_000_000
"""Minimum time from a frame to the newest detection: new people are reported with the second one."""
HOLD_NS = 600_000_000
"""How long somebody whom a look misses stays covered."""
NEAR_NS = HOLD_NS + GAP_AT_MOST_NS
"""Looks of how long before and after a frame say where people are in it."""
WAIT_AT_MOST_NS = 700_000_000
MAX_WAITING_FRAMES, MAX_WAITING_BYTES = 45, 128 * 1024 * 1024
_SILENT_AFTER_NS = 2_000_000_000
_MARGIN, _MARGIN_OF_WAY, _GROWTH_PER_S = 0.12, 0.35, 1.0
# In box widths: movement of an untracked person between detections. And the overlap above which two boxes are the same
# person.
_SAME_WITHIN = 1.5
_TWICE = 0.8
_KEPT_LOOKS = 60


class Covering(Protocol):
    """Blur operations on an image, implemented by ``perception.blur``."""

    def part_to_cover(self, box: PersonBox, what: BlurWhat) -> Corners: ...

    def cover(self, image_bgr: NDArray[np.uint8], parts: Sequence[Corners], what: BlurWhat) -> None: ...

    def cover_all(self, image_bgr: NDArray[np.uint8]) -> None: ...


class _Seen(Value):
    """Area to cover of one person in one detection."""

    stamp_ns: int
    corners: Corners


class _Waiting(Value):
    ref: FrameRef
    image_bgr: NDArray[np.uint8]
    since_ns: int
    then: Callable[[NDArray[np.uint8]], None]
    photo: bool


class Blurring:
    """Waiting frames of all cameras. One thread; ``now_ns`` is session time throughout.

    ``use_demand`` sets whom to cover, ``use_consents`` the exceptions.
    """

    def __init__(self, covering: Covering) -> None:
        self._covering = covering
        self._demand = BlurDemand()
        self._consents = UseConsents()
        self._lines: dict[str, _CameraQueue] = {}
        self._waiting_bytes = 0

    @property
    def demanded(self) -> bool:
        return self._demand.who != "nobody"

    @property
    def waits(self) -> bool:
        """True while any frame is waiting."""
        return self._waiting_bytes > 0

    def use_demand(self, demand: BlurDemand) -> None:
        """Set whom to cover; waiting frames use the previous demand."""
        if demand != self._demand:
            self.flush()
            self._demand = demand
            for line in self._lines.values():
                line.whole_since_ns = None

    def use_consents(self, consents: UseConsents) -> None:
        """Set the consents, also for waiting frames: a withdrawn consent applies at once."""
        self._consents = consents

    def add_detections(self, people: People, now_ns: int) -> None:
        """Add the detections of one frame, also while nobody is to be covered: that may begin with the next frame."""
        self._line(people.camera).add_detections(people, now_ns)
        self.go_on(now_ns)

    def add(
        self,
        ref: FrameRef,
        image_bgr: NDArray[np.uint8],
        now_ns: int,
        then: Callable[[NDArray[np.uint8]], None],
        *,
        photo: bool = False,
    ) -> None:
        """Queue a frame. ``then`` receives it blurred, in order per camera; ``image_bgr`` is modified."""
        if not self.demanded:
            then(image_bgr)
            return
        self._line(ref.camera).waiting.append(_Waiting(ref, image_bgr, now_ns, then, photo))
        self._waiting_bytes += image_bgr.nbytes
        self.go_on(now_ns)

    def go_on(self, now_ns: int) -> None:
        """Blur and pass on all frames that are due. Call at least ten times per second."""
        for line in self._lines.values():
            while line.waiting and (line.is_due(now_ns) or self._crowded(line)):
                self._pass_on(line)

    def flush(self) -> None:
        """Pass on all waiting frames now."""
        for line in self._lines.values():
            while line.waiting:
                self._pass_on(line)

    def covered_whole_s(self, now_ns: int) -> dict[str, float]:
        """Cameras whose frames are entirely covered, and for how long in seconds; only cameras that send frames."""
        return {
            camera: (now_ns - line.whole_since_ns) / 1e9
            for camera, line in self._lines.items()
            if line.whole_since_ns is not None and now_ns - line.whole_at_ns <= _SILENT_AFTER_NS
        }

    def _line(self, camera: str) -> "_CameraQueue":
        line = self._lines.get(camera)
        if line is None:
            line = self._lines[camera] = _CameraQueue()
        return line

    def _crowded(self, line: "_CameraQueue") -> bool:
        return len(line.waiting) > MAX_WAITING_FRAMES or self._waiting_bytes > MAX_WAITING_BYTES

    def _pass_on(self, line: "_CameraQueue") -> None:
        waiting = line.waiting.popleft()
        self._waiting_bytes -= waiting.image_bgr.nbytes
        near = detections_around(line.detections, waiting.ref.stamp_ns)
        agreed = self._consents.photos if waiting.photo else self._consents.video
        stamp_ns = waiting.ref.stamp_ns
        parts = None if near is None else parts_at(stamp_ns, near, self._demand, agreed, self._covering)
        if parts is None:
            self._covering.cover_all(waiting.image_bgr)
            line.whole_since_ns = waiting.since_ns if line.whole_since_ns is None else line.whole_since_ns
            line.whole_at_ns = waiting.since_ns
        else:
            self._covering.cover(waiting.image_bgr, parts, self._demand.what)
            line.whole_since_ns = None
        waiting.then(waiting.image_bgr)


class _CameraQueue:
    """Waiting frames of one camera in order, and its recent detections."""

    def __init__(self) -> None:
        self.waiting: deque[_Waiting] = deque()
        self.whole_since_ns: int | None = None
        self.whole_at_ns = 0
        self.detections: list[People] = []
        self._detected_ns: int | None = None

    def add_detections(self, people: People, now_ns: int) -> None:
        self._detected_ns = now_ns
        insort(self.detections, people, key=_stamp_of)
        del self.detections[:-_KEPT_LOOKS]

    def is_due(self, now_ns: int) -> bool:
        """True if the first frame has its detections, or has waited long enough."""
        first = self.waiting[0]
        newest_ns = self.detections[-1].stamp_ns if self.detections else 0
        silent = self._detected_ns is None or now_ns - self._detected_ns > _SILENT_AFTER_NS
        return silent or newest_ns >= first.ref.stamp_ns + AHEAD_NS or now_ns - first.since_ns >= WAIT_AT_MOST_NS


def detections_around(detections: Sequence[People], stamp_ns: int) -> list[People] | None:
    """Detections around this time, of those of one camera in order; None if they are missing or too far apart."""
    after = bisect_right(detections, stamp_ns, key=_stamp_of)
    if after == 0:
        return None
    before_ns = detections[after - 1].stamp_ns
    after_ns = before_ns if before_ns == stamp_ns else detections[after].stamp_ns if after < len(detections) else None
    if after_ns is None or after_ns - before_ns > GAP_AT_MOST_NS:
        return None
    first = bisect_left(detections, stamp_ns - NEAR_NS, key=_stamp_of)
    return list(detections[first : bisect_right(detections, stamp_ns + NEAR_NS, key=_stamp_of)])


def parts_at(
    stamp_ns: int, detections: Sequence[People], demand: BlurDemand, consenting: frozenset[str], covering: Covering
) -> list[Corners]:
    """Areas to cover at this time, from the detections around or before it. A consenting person must be identified in
    each of them, since a track may change its person.
    """
    spare = consenting if demand.who == "without_consent" else frozenset()
    ways: dict[int, list[_Seen]] = {}
    bare: dict[int, bool] = {}
    brief: list[list[_Seen]] = []
    for people in detections:
        for box in people.boxes:
            sighting = _Seen(people.stamp_ns, covering.part_to_cover(box, demand.what))
            ways.setdefault(box.track, []).append(sighting)
            bare[box.track] = bare.get(box.track, True) and box.person_id in spare
        consenting_boxes = [box for box in people.boxes if box.person_id in spare]
        unfollowed = [box for box in people.unfollowed if not any(_within(box, other) for other in consenting_boxes)]
        _link(brief, [_Seen(people.stamp_ns, covering.part_to_cover(box, demand.what)) for box in unfollowed])
    covered = [*brief, *(way for track, way in ways.items() if not bare[track])]
    # Older detections only give the direction of movement.
    return [
        _where(way, stamp_ns)
        for way in covered
        if min(abs(stamp_ns - sighting.stamp_ns) for sighting in way) <= HOLD_NS
    ]


def _link(ways: list[list[_Seen]], sightings: list[_Seen]) -> None:
    """Assign untracked detections to the nearest preceding one, or begin a new path."""
    open_ways = list(ways)
    for one in sightings:
        near = min(open_ways, key=lambda way: _distance_px(way[-1].corners, one.corners), default=None)
        if near is not None and _distance_px(near[-1].corners, one.corners) <= _SAME_WITHIN * _wide_px(one.corners):
            near.append(one)
            open_ways = [way for way in open_ways if way is not near]
        else:
            ways.append([one])


def _within(box: PersonBox, other: PersonBox) -> bool:
    """True if a box is most likely a duplicate detection of the other."""
    across = min(box.left_px + box.width_px, other.left_px + other.width_px) - max(box.left_px, other.left_px)
    down = min(box.top_px + box.height_px, other.top_px + other.height_px) - max(box.top_px, other.top_px)
    return max(0.0, across) * max(0.0, down) >= _TWICE * box.width_px * box.height_px


def _where(way: Sequence[_Seen], stamp_ns: int) -> Corners:
    """Area of a person at this time with a margin; ``way`` has the detections around it, oldest first."""
    after = bisect_right(way, stamp_ns, key=_stamp_of)
    if 0 < after < len(way):
        one, other = way[after - 1], way[after]
        at = _between(one, other, stamp_ns)
        moved_px = _distance_px(one.corners, other.corners)
        return _grown(at, _MARGIN * _wide_px(at) + _MARGIN_OF_WAY * moved_px)
    # Detected on one side only: last area plus its extrapolation, growing with time.
    nearest = way[after - 1] if after else way[0]
    away_s = abs(stamp_ns - nearest.stamp_ns) / 1e9
    wide_px = _wide_px(nearest.corners)
    corners = nearest.corners
    if len(way) > 1 and away_s > 0:
        one, other = (way[-2], way[-1]) if after else (way[0], way[1])
        corners = _combined(corners, _between(one, other, stamp_ns))
    return _grown(corners, (_MARGIN + _GROWTH_PER_S * away_s) * wide_px)


def _stamp_of(one: People | _Seen) -> int:
    return one.stamp_ns


def _between(one: _Seen, other: _Seen, stamp_ns: int) -> Corners:
    """Linear interpolation, or extrapolation."""
    share = (stamp_ns - one.stamp_ns) / (other.stamp_ns - one.stamp_ns)
    left, top, right, bottom = (a + share * (b - a) for a, b in zip(one.corners, other.corners, strict=True))
    return left, top, right, bottom


def _wide_px(corners: Corners) -> float:
    return corners[2] - corners[0]


def _distance_px(one: Corners, other: Corners) -> float:
    return max(abs(b - a) for a, b in zip(one, other, strict=True))


def _combined(one: Corners, other: Corners) -> Corners:
    return min(one[0], other[0]), min(one[1], other[1]), max(one[2], other[2]), max(one[3], other[3])


def _grown(corners: Corners, margin_px: float) -> Corners:
    left, top, right, bottom = corners
    return left - margin_px, top - margin_px, right + margin_px, bottom + margin_px
