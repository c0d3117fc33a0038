"""Current and past visits of people, each with its tracks, and their portraits."""

import threading
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import field

from caris_desktop.domain.value_class import dataclass
from caris_desktop.people.identities import UNDECIDED, Judgement

MOST_LEFT = 200
"""Number of ended visits in memory, the newest ones."""

Track = tuple[str, int]  # camera and track number
Spot = tuple[float, float]  # x_m, y_m in the map


@dataclass(slots=True, eq=False)
class Visit:
    """Visit of a person. ``visit_id`` is its initial id, ``person_id`` the identified person."""

    visit_id: str
    person_id: str
    camera: str
    track: int
    since_ns: int
    last_seen_ns: int
    from_utc_ns: int = 0
    here: bool = True
    embedding_count: int = 0
    settled: bool = False
    by_hand: bool = False
    forgotten: bool = False  # erased on request: no embedding is learned or stored any more
    judgement: Judgement = UNDECIDED
    suggested_id: str = ""
    resembles_somebody: bool = False  # it is open whether they are the same
    confidence: float = 0.0
    portrait_quality: float = 0.0
    portraits: int = 0
    distance_m: float | None = None
    bearing_rad: float | None = None
    placed_ns: int = 0
    spot: Spot | None = None  # last position
    posture: str = ""
    hand_raised: bool | None = None
    facing: bool | None = None
    summary: str = ""
    tracks: set[Track] = field(default_factory=set)
    seen_by_camera_ns: int = 0  # last detection by ``camera``, as ``track``

    def leave_to_wizard(self) -> None:
        """Restrict the console to suggestions for this visit."""
        self.by_hand = True

    @property
    def identified(self) -> bool:
        return self.person_id != self.visit_id


class VisitLog:
    """Visit log, bounded to the newest :data:`MOST_LEFT` ended visits."""

    def __init__(self) -> None:
        self._visits: dict[str, Visit] = {}
        self._of_track: dict[Track, Visit] = {}
        self._numbers: dict[str, int] = {}
        self._numbered = 0

    def __iter__(self) -> Iterator[Visit]:
        return iter(tuple(self._visits.values()))

    def __len__(self) -> int:
        return len(self._visits)

    def begin(self, visit: Visit, track: Track) -> None:
        self._visits[visit.visit_id] = visit
        self.attach(visit, track)
        self.number_of(visit.person_id)

    def attach(self, visit: Visit, track: Track) -> None:
        """Assign the track to the visit."""
        before = self._of_track.get(track)
        if before is not None:
            before.tracks.discard(track)
        self._of_track[track] = visit
        visit.tracks.add(track)

    def detach(self, track: Track) -> None:
        """Detach the track, whose person is unknown."""
        visit = self._of_track.pop(track, None)
        if visit is not None:
            visit.tracks.discard(track)

    def of_track(self, track: Track) -> Visit | None:
        return self._of_track.get(track)

    def here(self) -> list[Visit]:
        return [visit for visit in self._visits.values() if visit.here]

    def find(self, person_id: str) -> Visit | None:
        """Visit with that person or visit id, preferring those present, then the newest."""
        found = [visit for visit in self._visits.values() if person_id in (visit.visit_id, visit.person_id)]
        return max(found, key=lambda visit: (visit.here, visit.since_ns), default=None)

    def of_person(self, person_id: str) -> list[Visit]:
        return [visit for visit in self._visits.values() if visit.person_id == person_id]

    def number_of(self, person_id: str) -> int:
        """Number N of "Person N"."""
        if person_id not in self._numbers:
            self._numbered += 1
            self._numbers[person_id] = self._numbered
        return self._numbers[person_id]

    def forget_tracks(self) -> None:
        """Clear all tracks, whose numbers are no longer valid."""
        self._of_track.clear()
        for visit in self._visits.values():
            visit.tracks.clear()

    def drop(self, visit: Visit) -> None:
        self._visits.pop(visit.visit_id, None)
        for track in visit.tracks:
            self._of_track.pop(track, None)
        if not self.of_person(visit.person_id):
            self._numbers.pop(visit.person_id, None)
        self._numbers.pop(visit.visit_id, None)

    def too_many(self) -> list[Visit]:
        """Ended visits beyond the limit, oldest first."""
        left = sorted((visit for visit in self._visits.values() if not visit.here), key=lambda each: each.last_seen_ns)
        return left[: max(0, len(left) - MOST_LEFT)]


MAX_PORTRAITS = 200


class Portraits:
    """Bounded portrait cache by key, so that signals need not carry images. Any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._jpegs: OrderedDict[str, bytes] = OrderedDict()

    def put(self, key: str, jpeg: bytes) -> None:
        with self._lock:
            self._jpegs[key] = jpeg
            self._jpegs.move_to_end(key)
            while len(self._jpegs) > MAX_PORTRAITS:
                self._jpegs.popitem(last=False)

    def get(self, key: str) -> bytes | None:
        """Image of ``PersonRow.portrait``; None if it is no longer cached."""
        with self._lock:
            if key in self._jpegs:
                self._jpegs.move_to_end(key)
            return self._jpegs.get(key)

    def drop(self, key: str) -> None:
        with self._lock:
            self._jpegs.pop(key, None)

    def drop_all_of(self, person_id: str) -> None:
        """Drop all images whose key begins with that id."""
        with self._lock:
            for key in [key for key in self._jpegs if key.startswith(f"{person_id}/")]:
                del self._jpegs[key]

    def __len__(self) -> int:
        return len(self._jpegs)
