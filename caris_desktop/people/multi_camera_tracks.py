"""Visits of people seen by several cameras: joined for the same person, split for different ones."""

import math
from bisect import bisect_left
from collections import deque
from dataclasses import field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.events import Event
from caris_desktop.domain.person_values import PersonLooks
from caris_desktop.domain.sensing import PeopleInMap
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.people.decisions import Decisions
from caris_desktop.people.known import KnownPeople
from caris_desktop.people.visit_log import Track, Visit, VisitLog

_IN_VIEW_NS = 1_500_000_000
"""Whom a camera saw so lately it still sees, as that track and no other."""


Verdict = Literal["same", "different", "unknown"]

_MAX_SPOTS = 20
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
_ALIKE_ALONE, _ALIKE_ALONE_FROM = 0.85, 3
_UNALIKE = 0.4
_ALIKE_WEIGHT = 4.0


class Spot(Value):
    """Position in the map at a time; ``spread_m`` is one standard deviation."""

    stamp_ns: int
    x_m: float
    y_m: float
    spread_m: float


@dataclass(slots=True)
class Sighting:
    """Recent detections of one track. ``embeddings`` sums unit vectors by network."""

    camera: str
    spots: deque[Spot] = field(default_factory=lambda: deque(maxlen=_MAX_SPOTS))
    embeddings: dict[str, tuple[NDArray[np.float64], int]] = field(default_factory=dict)
    last_ns: int = 0


class Likeness(Value):
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
        by_appearance = 0.0 if self.alike is None else _ALIKE_WEIGHT * self.alike
        return by_appearance - (self.apart if self.pairs else 0.0)


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
        self._sightings: dict[Track, Sighting] = {}

    def see(self, track: Track, now_ns: int) -> None:
        """Note that the track is in its camera's image now."""
        self._sightings.setdefault(track, Sighting(track[0])).last_ns = now_ns
        for expired in [
            each for each, sighting in self._sightings.items() if now_ns - sighting.last_ns > _FORGET_AFTER_NS
        ]:
            del self._sightings[expired]

    def add_spot(self, track: Track, spot: Spot) -> None:
        sighting = self._sightings.get(track)
        if sighting is not None:
            sighting.spots.append(spot)

    def add_embeddings(self, embedding: PersonLooks) -> None:
        sighting = self._sightings.get((embedding.camera, embedding.track))
        if sighting is None or embedding.kind != "clothing":
            return
        total, count = sighting.embeddings.get(embedding.model, (np.zeros(len(embedding.vector)), 0))
        sighting.embeddings[embedding.model] = (total + embedding.vector, count + 1)

    def seen_ns(self, track: Track) -> int:
        """Last detection of the track; long ago if unknown."""
        sighting = self._sightings.get(track)
        return -_FORGET_AFTER_NS if sighting is None else sighting.last_ns

    def forget(self) -> None:
        """Clear all tracks after a restart of the trackers."""
        self._sightings.clear()

    def verdict(self, one: Track, other: Track) -> Verdict:
        """:func:`same_person` for two tracks."""
        if one[0] == other[0]:
            return "different"
        first, second = self._sightings.get(one), self._sightings.get(other)
        return "unknown" if first is None or second is None else same_person(compared(first, second))

    def partners(self, track: Track) -> tuple[Track, ...]:
        """Tracks of other cameras that are the same person: at most one per camera, and none if ambiguous."""
        cameras = dict.fromkeys(camera for camera, _ in self._sightings if camera != track[0])
        found = (self._partner(track, camera) for camera in cameras)
        return tuple(partner for partner in found if partner is not None)

    def _partner(self, track: Track, camera: str) -> Track | None:
        best = self._clearly_best(track, camera)
        # The match must be mutual: another person may be closer to that track.
        return best if best is not None and self._clearly_best(best, track[0]) == track else None

    def _clearly_best(self, track: Track, camera: str) -> Track | None:
        mine = self._sightings.get(track)
        if mine is None:
            return None
        rated = []
        for other, sighting in self._sightings.items():
            if other[0] == camera:
                likeness = compared(mine, sighting)
                if same_person(likeness) != "different":
                    rated.append((likeness.score, other, likeness))
        rated.sort(key=lambda each: -each[0])
        if not rated or same_person(rated[0][2]) != "same":
            return None
        # A track without a position may be anywhere.
        rivals = [score for score, _, likeness in rated[1:] if likeness.pairs or not rated[0][2].pairs]
        return rated[0][1] if not rivals or rated[0][0] - rivals[0] >= _CLEARLY else None


class MultiCameraTracks(CrossCameraMatcher):
    """Matcher that applies its results to the visits."""

    def __init__(self, visits: VisitLog, decisions: Decisions, known: KnownPeople) -> None:
        self._visits = visits
        self._decisions = decisions
        self._known = known
        super().__init__()

    def add_places(self, places: PeopleInMap) -> None:
        for place in places.people:
            if place.track >= 0:
                spot = Spot(places.stamp_ns, place.x_m, place.y_m, place.spread_m)
                self.add_spot((places.camera, place.track), spot)

    def seen_by_another(self, track: Track) -> Visit | None:
        """Visit of this track's person, who is already seen by another camera."""
        for partner in self.partners(track):
            visit = self._visits.of_track(partner)
            # A person whom this camera sees as another track is a different one.
            if visit is not None and visit.here and not self._in_view_of(visit, track[0]):
                return visit
        return None

    def join_and_part(self, now_ns: int) -> list[Event]:
        """Join visits of one person, and split off tracks of different people."""
        events: list[Event] = []
        here = self._visits.here()
        for visit in here:
            if len(visit.tracks) > 1:
                self._part(visit)
        if len({visit.camera for visit in here}) < 2:
            return events
        for visit in sorted(here, key=lambda each: each.since_ns, reverse=True):
            other = self.seen_by_another((visit.camera, visit.track))
            if other is None or other.person_id == visit.person_id or self._never(visit, other):
                continue
            newer, older = (other, visit) if self._is_decided(visit) else (visit, other)
            if self._is_decided(newer):
                continue  # two known people: only the wizard may decide that
            events += self._decisions.identify(newer, older.person_id, now_ns, both_here=True)
        return events

    def _in_view_of(self, visit: Visit, camera: str) -> bool:
        times_ns = (self.seen_ns(track) for track in visit.tracks if track[0] == camera)
        return any(visit.last_seen_ns - at_ns <= _IN_VIEW_NS for at_ns in times_ns)

    def _is_decided(self, visit: Visit) -> bool:
        return visit.identified or self._known.is_known(visit.person_id)

    def _never(self, one: Visit, other: Visit) -> bool:
        """True if the wizard said that these are two people."""
        return (
            other.person_id in self._known.rejected_for(one.visit_id)
            or one.person_id in self._known.rejected_for(other.visit_id)
        )  # fmt: skip

    def _part(self, visit: Visit) -> None:
        """Detach tracks with a different position, which become candidates again."""
        main_track = (visit.camera, visit.track)
        for track in tuple(visit.tracks - {main_track}):
            if track[0] != visit.camera and self.verdict(main_track, track) == "different":
                self._visits.detach(track)


def _alike(one: Sighting, other: Sighting) -> float | None:
    """Cosine similarity of the mean embeddings, by a network with enough of both."""
    for model, (total, count) in one.embeddings.items():
        their_total, their_count = other.embeddings.get(model, (total, 0))
        if min(count, their_count) >= _ALIKE_ALONE_FROM:
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
