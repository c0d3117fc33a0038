"""Who was there, and when: one value for each time that somebody came, put together from the events that report it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from caris_desktop.domain.events import PersonAppeared, PersonLeft

TOGETHER_NS = 2_000_000_000
"""Somebody whom the tracker loses and finds again stands there twice for a moment, under two identities."""


@dataclass(frozen=True, slots=True)
class Visit:
    """An identity was there. ``number`` is that of "Person 3" on the screen, 0 where the record does not tell it.

    One person who was lost and found again may have several identities.
    """

    person_id: str
    number: int
    start_ns: int
    end_ns: int


def visits_of(
    events: Iterable[PersonAppeared | PersonLeft],
    *,
    started_ns: int,
    ended_ns: int,
    pauses: Sequence[tuple[int, int]] = (),
) -> tuple[Visit, ...]:
    """In the order in which they began. Whoever left without having appeared was there before the recording.

    A pause ends all of them: a recording that goes on tells who is there.
    """
    numbers: dict[str, int] = {}
    since: dict[str, int] = {}
    seen: set[str] = set()
    visits: list[Visit] = []

    def leave(person_id: str, start_ns: int, end_ns: int) -> None:
        visits.append(Visit(person_id, numbers.get(person_id, 0), start_ns, max(start_ns, end_ns)))

    waiting = sorted(begin_ns for begin_ns, _ in pauses)
    for event in sorted(events, key=lambda event: event.stamp_ns):
        while waiting and waiting[0] < event.stamp_ns:
            begin_ns = waiting.pop(0)
            for person_id, start_ns in since.items():
                leave(person_id, start_ns, begin_ns)
            since.clear()
        if isinstance(event, PersonAppeared):
            numbers[event.person_id] = event.number or numbers.get(event.person_id, 0)
            since.setdefault(event.person_id, event.stamp_ns)
        elif event.person_id in since:
            leave(event.person_id, since.pop(event.person_id), event.stamp_ns)
        elif event.person_id not in seen:
            leave(event.person_id, started_ns, event.stamp_ns)
        seen.add(event.person_id)
    for person_id, start_ns in since.items():
        leave(person_id, start_ns, min([*waiting, ended_ns]))
    return tuple(sorted(visits, key=lambda visit: visit.start_ns))


def most_at_once(visits: Sequence[Visit]) -> int:
    """The most people who were there together, as the screen counted them, for ``TOGETHER_NS`` or longer."""
    together = (
        sum(other.start_ns <= visit.start_ns and other.end_ns >= visit.start_ns + TOGETHER_NS for other in visits)
        for visit in visits
    )
    return max(together, default=0) or min(1, len(visits))
