"""Presence of people in a session: one record per visit, from its events."""

import logging
from collections.abc import Iterable, Sequence
from typing import get_args

from caris_desktop.domain.events import (
    PeopleMerged,
    PeopleUndone,
    PersonAppeared,
    PersonForgotten,
    PersonIdentified,
    PersonLeft,
    PersonRejected,
    PersonSplit,
)
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session.session_reader import Session

_log = logging.getLogger(__name__)
VisitEvent = (
    PersonAppeared
    | PersonLeft
    | PersonForgotten
    | PersonIdentified
    | PersonRejected
    | PeopleMerged
    | PersonSplit
    | PeopleUndone
)
VISIT_EVENTS: tuple[type[VisitEvent], ...] = get_args(VisitEvent)


class Visit(Value):
    """Visit of an identity. ``number`` is that of "Person 3" on screen, 0 if not recorded.

    A person lost and found again may have several identities. ``end_ns``: when the person counted as absent, some
    seconds after ``last_seen_ns``, which is None if not recorded, or if a pause or the end of the recording came first.
    """

    person_id: str
    number: int
    start_ns: int
    end_ns: int
    last_seen_ns: int | None = None

    @property
    def person_number(self) -> int | None:
        return self.number or None

    @property
    def duration_s(self) -> float:
        return (self.end_ns - self.start_ns) / 1e9

    @property
    def seen_s(self) -> float | None:
        return None if self.last_seen_ns is None else (self.last_seen_ns - self.start_ns) / 1e9


def visits_of(
    events: Iterable[VisitEvent], *, started_ns: int, ended_ns: int, pauses: Sequence[tuple[int, int]] = ()
) -> tuple[Visit, ...]:
    """Visits in order of their start. A person who left without an arrival was present before the recording.

    A pause ends all visits: a resumed recording lists those present. A later identification applies to the whole visit.
    """
    numbers: dict[str, int] = {}
    since: dict[str, int] = {}  # by the first id of the visit
    seen: set[str] = set()
    spans: list[tuple[str, int, int, int | None]] = []
    links = _Links()

    def leave(began_as: str, start_ns: int, end_ns: int, seen_ns: int | None = None) -> None:
        end_ns = max(start_ns, end_ns)
        spans.append((began_as, start_ns, end_ns, None if seen_ns is None else min(max(start_ns, seen_ns), end_ns)))

    waiting = sorted(begin_ns for begin_ns, _ in pauses)
    for event in sorted(events, key=lambda event: event.stamp_ns):
        while waiting and waiting[0] < event.stamp_ns:
            begin_ns = waiting.pop(0)
            for began_as, start_ns in since.items():
                leave(began_as, start_ns, begin_ns)
            since.clear()
        if isinstance(event, PersonAppeared):
            numbers[event.person_id] = event.number or numbers.get(event.person_id, 0)
            since.setdefault(event.person_id, event.stamp_ns)
            seen.add(event.person_id)
        elif isinstance(event, PersonLeft | PersonForgotten):
            here = [began_as for began_as in since if links.of(began_as) == links.of(event.person_id)]
            seen_ns = event.last_seen_ns if isinstance(event, PersonLeft) else None
            for began_as in here:
                leave(began_as, since.pop(began_as), event.stamp_ns, seen_ns)
            if not here and isinstance(event, PersonLeft) and links.of(event.person_id) not in map(links.of, seen):
                leave(event.person_id, started_ns, event.stamp_ns, seen_ns)
            seen.add(event.person_id)
        else:
            links.take(event)
    for began_as, start_ns in since.items():
        leave(began_as, start_ns, min([*waiting, ended_ns]))
    visits = (
        Visit(
            links.of(began_as), numbers.get(links.of(began_as)) or numbers.get(began_as, 0), start_ns, end_ns, seen_ns
        )
        for began_as, start_ns, end_ns, seen_ns in spans
    )
    return tuple(sorted(visits, key=lambda visit: visit.start_ns))


def seen_throughout(session: Session) -> tuple[Visit, ...]:
    """People present throughout, who are only in ``people.json``."""
    try:
        people = parse_json((session.folder / "people.json").read_text(encoding="utf-8"))["people"]
        return tuple(
            Visit(
                str(row["person_id"]),
                0,
                session.started_ns + round(row["first_seen_s"] * 1e9),
                session.started_ns + round(row["last_seen_s"] * 1e9),
            )
            for row in people
        )
    except FileNotFoundError:
        return ()
    except (OSError, ValueError, KeyError, TypeError) as error:
        _log.warning("%s: people.json is left out: %r", session.folder, error)
        return ()


class _Links:
    """Identity links in the order of the record."""

    def __init__(self) -> None:
        self._is: dict[str, str] = {}

    def take(self, event: PersonIdentified | PersonRejected | PeopleMerged | PersonSplit | PeopleUndone) -> None:
        match event:
            case PersonIdentified(person_id=person_id, is_person_id=root):
                self._link(person_id, root)
            case PeopleMerged(person_id=person_id, into_person_id=root):
                self._link(person_id, root)
            case PersonRejected(person_id=person_id, is_person_id=root):
                if self.of(person_id) == self.of(root):
                    self._is.pop(person_id, None)
            case PersonSplit(person_id=person_id) | PeopleUndone(person_id=person_id, decision="identified" | "merged"):
                self._is.pop(person_id, None)
            case PeopleUndone(person_id=person_id, is_person_id=root, decision="split"):
                self._link(person_id, root)
            case _:
                pass

    def of(self, person_id: str) -> str:
        """Resolve an id to the linked identity."""
        while person_id in self._is:
            person_id = self._is[person_id]
        return person_id

    def _link(self, person_id: str, root: str) -> None:
        if self.of(root) == person_id:
            self._is.pop(root, None)  # the later link counts, which avoids cycles
        if self.of(root) != person_id:
            self._is[person_id] = root
