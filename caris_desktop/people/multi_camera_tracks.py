"""Visits of people seen by several cameras: joined for the same person, split for different ones."""

from caris_desktop.domain.events import Event
from caris_desktop.domain.person_values import PersonLooks
from caris_desktop.domain.sensing import PeopleInMap
from caris_desktop.people.cross_camera_matching import CrossCameraMatcher, Spot
from caris_desktop.people.decisions import Decisions
from caris_desktop.people.known import KnownPeople
from caris_desktop.people.visit_log import Track, Visit, VisitLog

_IN_VIEW_NS = 1_500_000_000
"""Whom a camera saw so lately it still sees, as that track and no other."""


class MultiCameraTracks:
    """Feeds :class:`CrossCameraMatcher` with all cameras' detections, and applies its results."""

    def __init__(self, visits: VisitLog, decisions: Decisions, known: KnownPeople) -> None:
        self._visits = visits
        self._decisions = decisions
        self._known = known
        self._together = CrossCameraMatcher()

    def see(self, track: Track, now_ns: int) -> None:
        """Note that the track is in its camera's image now."""
        self._together.see(track, now_ns)

    def add_embeddings(self, looks: PersonLooks) -> None:
        self._together.add_embeddings(looks)

    def take_places(self, places: PeopleInMap) -> None:
        for place in places.people:
            if place.track >= 0:
                spot = Spot(places.stamp_ns, place.x_m, place.y_m, place.spread_m)
                self._together.take_spot((places.camera, place.track), spot)

    def forget(self) -> None:
        """Clear all tracks after a restart of the trackers."""
        self._together.forget()

    def seen_by_another(self, track: Track) -> Visit | None:
        """Visit of this track's person, who is already seen by another camera."""
        for partner in self._together.partners(track):
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
        seen = (self._together.seen_ns(track) for track in visit.tracks if track[0] == camera)
        return any(visit.last_seen_ns - at_ns <= _IN_VIEW_NS for at_ns in seen)

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
        its_own = (visit.camera, visit.track)
        for track in tuple(visit.tracks - {its_own}):
            if track[0] != visit.camera and self._together.verdict(its_own, track) == "different":
                self._visits.detach(track)
