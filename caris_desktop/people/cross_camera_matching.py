"""Cross-camera matching: tracks of two cameras are one person by position in the map and appearance.

Two tracks of one camera are two people. Tracks of two cameras are one person if their positions agree for a moment and
no other track is close; without positions only if they look very similar. Ambiguous tracks stay separate: a superfluous
row is noticed at once, two people in one row are not.
"""

import math
from bisect import bisect_left
from collections import deque
from dataclasses import field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.person_values import PersonLooks
from caris_desktop.domain.value_class import dataclass
from caris_desktop.people.visit_log import Track

Verdict = Literal["same", "different", "unknown"]

_PLACES_KEPT = 20
_FORGET_AFTER_NS = 4_000_000_000
_COMPARED_NS = 3_000_000_000
"""Of places as long ago as this nothing is concluded any more: people meet and part."""

_BETWEEN_NS, _BESIDE_NS = 1_500_000_000, 250_000_000
_WALK_MPS = 1.3
_CAMERA_ERROR_M = 0.2  # accuracy of the camera's pose
_SAME_PAIRS, _DIFFERENT_PAIRS = 2, 3
_SAME_WITHIN, _SAME_WITHIN_M = 2.0, 0.9
_DIFFERENT_FROM, _DIFFERENT_FROM_M = 3.5, 1.0
_CLEARLY = 0.7  # required margin to the second best
_ALIKE_ALONE, _ALIKE_ALONE_LOOKS = 0.85, 3
_UNALIKE = 0.4
_ALIKE_WEIGHT = 4.0


@dataclass(frozen=True, slots=True)
class Spot:
    """Position in the map at a time; ``spread_m`` is one standard deviation."""

    stamp_ns: int
    x_m: float
    y_m: float
    spread_m: float


@dataclass(slots=True)
class Sighting:
    """Recent detections of one track. ``looks`` sums unit vectors by network."""

    camera: str
    spots: deque[Spot] = field(default_factory=lambda: deque(maxlen=_PLACES_KEPT))
    looks: dict[str, tuple[NDArray[np.float64], int]] = field(default_factory=dict)
    last_ns: int = 0


@dataclass(frozen=True, slots=True)
class Likeness:
    """Comparison of two tracks. ``apart`` is their distance in standard deviations, the median of ``pairs`` times;
    ``alike`` is the cosine similarity, None if unknown.
    """

    pairs: int = 0
    apart: float = math.inf
    apart_m: float = math.inf
    alike: float | None = None

    @property
    def score(self) -> float:
        """Ranking score, comparable only between candidates for the same person."""
        by_looks = 0.0 if self.alike is None else _ALIKE_WEIGHT * self.alike
        return by_looks - (self.apart if self.pairs else 0.0)


def compared(one: Sighting, other: Sighting) -> Likeness:
    """Compare two tracks of two cameras."""
    alike = _alike(one, other)
    newest_ns = max((each.spots[-1].stamp_ns for each in (one, other) if each.spots), default=0)
    apart: list[tuple[float, float]] = []
    for spot in one.spots:
        if newest_ns - spot.stamp_ns > _COMPARED_NS:
            continue
        there = _at(other.spots, spot.stamp_ns)
        if there is not None:
            distance_m = math.hypot(spot.x_m - there.x_m, spot.y_m - there.y_m)
            apart.append((distance_m / math.hypot(spot.spread_m, there.spread_m, _CAMERA_ERROR_M), distance_m))
    if not apart:
        return Likeness(alike=alike)
    middle = sorted(apart)[len(apart) // 2]
    return Likeness(len(apart), *middle, alike)


def same_person(likeness: Likeness) -> Verdict:
    """Decide whether two tracks of two cameras are one person, considering only these two."""
    if not likeness.pairs:
        alone = likeness.alike is not None and likeness.alike >= _ALIKE_ALONE
        return "same" if alone else "unknown"
    if likeness.pairs >= _DIFFERENT_PAIRS and likeness.apart >= _DIFFERENT_FROM:
        return "different" if likeness.apart_m >= _DIFFERENT_FROM_M else "unknown"
    if likeness.pairs < _SAME_PAIRS or likeness.apart > _SAME_WITHIN or likeness.apart_m > _SAME_WITHIN_M:
        return "unknown"
    return "unknown" if likeness.alike is not None and likeness.alike < _UNALIKE else "same"


class CrossCameraMatcher:
    """Recent detections of all cameras, and which tracks are one person. Time is injected."""

    def __init__(self) -> None:
        self._seen: dict[Track, Sighting] = {}

    def see(self, track: Track, now_ns: int) -> None:
        """Note that the track is in its camera's image now."""
        self._seen.setdefault(track, Sighting(track[0])).last_ns = now_ns
        for gone in [each for each, seen in self._seen.items() if now_ns - seen.last_ns > _FORGET_AFTER_NS]:
            del self._seen[gone]

    def take_spot(self, track: Track, spot: Spot) -> None:
        seen = self._seen.get(track)
        if seen is not None:
            seen.spots.append(spot)

    def add_embeddings(self, looks: PersonLooks) -> None:
        seen = self._seen.get((looks.camera, looks.track))
        if seen is None or looks.kind != "clothing":
            return
        total, count = seen.looks.get(looks.model, (np.zeros(len(looks.vector)), 0))
        seen.looks[looks.model] = (total + looks.vector, count + 1)

    def seen_ns(self, track: Track) -> int:
        """Last detection of the track; long ago if unknown."""
        seen = self._seen.get(track)
        return -_FORGET_AFTER_NS if seen is None else seen.last_ns

    def forget(self) -> None:
        """Clear all tracks after a restart of the trackers."""
        self._seen.clear()

    def verdict(self, one: Track, other: Track) -> Verdict:
        """:func:`same_person` for two tracks."""
        if one[0] == other[0]:
            return "different"
        first, second = self._seen.get(one), self._seen.get(other)
        return "unknown" if first is None or second is None else same_person(compared(first, second))

    def partners(self, track: Track) -> tuple[Track, ...]:
        """Tracks of other cameras that are the same person: at most one per camera, and none if ambiguous."""
        cameras = dict.fromkeys(camera for camera, _ in self._seen if camera != track[0])
        found = (self._partner(track, camera) for camera in cameras)
        return tuple(partner for partner in found if partner is not None)

    def _partner(self, track: Track, camera: str) -> Track | None:
        best = self._clearly_best(track, camera)
        # The match must be mutual: another person may be closer to that track.
        return best if best is not None and self._clearly_best(best, track[0]) == track else None

    def _clearly_best(self, track: Track, camera: str) -> Track | None:
        mine = self._seen.get(track)
        if mine is None:
            return None
        rated = []
        for other, seen in self._seen.items():
            if other[0] == camera:
                likeness = compared(mine, seen)
                if same_person(likeness) != "different":
                    rated.append((likeness.score, other, likeness))
        rated.sort(key=lambda each: -each[0])
        if not rated or same_person(rated[0][2]) != "same":
            return None
        # A track without a position may be anywhere.
        rivals = [score for score, _, likeness in rated[1:] if likeness.pairs or not rated[0][2].pairs]
        return rated[0][1] if not rivals or rated[0][0] - rivals[0] >= _CLEARLY else None


def _alike(one: Sighting, other: Sighting) -> float | None:
    """Cosine similarity of the mean embeddings, by a network with enough of both."""
    for model, (total, count) in one.looks.items():
        their_total, their_count = other.looks.get(model, (total, 0))
        if min(count, their_count) >= _ALIKE_ALONE_LOOKS:
            lengths = float(np.linalg.norm(total) * np.linalg.norm(their_total))
            return float(total @ their_total) / lengths if lengths else None
    return None


def _at(spots: deque[Spot], stamp_ns: int) -> Spot | None:
    """Position at that time, interpolated, or the nearest within a moment."""
    stamps = [spot.stamp_ns for spot in spots]
    after = bisect_left(stamps, stamp_ns)
    if 0 < after < len(spots) and stamps[after] - stamps[after - 1] <= _BETWEEN_NS:
        before, behind = spots[after - 1], spots[after]
        share = (stamp_ns - before.stamp_ns) / max(1, behind.stamp_ns - before.stamp_ns)
        return Spot(
            stamp_ns,
            before.x_m + share * (behind.x_m - before.x_m),
            before.y_m + share * (behind.y_m - before.y_m),
            max(before.spread_m, behind.spread_m),
        )
    near = [spots[index] for index in (after - 1, after) if 0 <= index < len(spots)]
    nearest = min(near, key=lambda spot: abs(spot.stamp_ns - stamp_ns), default=None)
    if nearest is None or abs(nearest.stamp_ns - stamp_ns) > _BESIDE_NS:
        return None
    moved_m = _WALK_MPS * abs(nearest.stamp_ns - stamp_ns) / 1e9
    return Spot(stamp_ns, nearest.x_m, nearest.y_m, math.hypot(nearest.spread_m, moved_m))
