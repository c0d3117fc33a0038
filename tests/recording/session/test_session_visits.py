"""Identity of visits that was decided later, or revoked."""

import pytest

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
from caris_desktop.recording.session.session_visits import VisitEvent, visits_of

CAME = PersonAppeared(10, "p-new", 1, 7)
FOUND = PersonIdentified(12, "p-new", "p-ada", "console", 0.97)


def seen(*events: VisitEvent) -> list[tuple[str, int, int, int]]:
    visits = visits_of(events, started_ns=0, ended_ns=100)
    return [(visit.person_id, visit.number, visit.start_ns, visit.end_ns) for visit in visits]


@pytest.mark.parametrize(
    ("events", "expected"),
    [
        ((CAME, FOUND, PersonLeft(20, "p-ada", 1)), [("p-ada", 7, 10, 20)]),
        ((CAME, FOUND), [("p-ada", 7, 10, 100)]),
        (
            (PersonAppeared(2, "p-ada", 1, 3), PersonLeft(5, "p-ada", 1), CAME, FOUND, PersonLeft(20, "p-ada", 1)),
            [("p-ada", 3, 2, 5), ("p-ada", 3, 10, 20)],
        ),
        ((CAME, FOUND, PersonRejected(14, "p-new", "p-ada"), PersonLeft(20, "p-new", 1)), [("p-new", 7, 10, 20)]),
        (
            (CAME, FOUND, PeopleUndone(14, "p-new", "identified", "p-ada"), PersonLeft(20, "p-new", 1)),
            [("p-new", 7, 10, 20)],
        ),
        (
            (CAME, PersonAppeared(11, "p-b", 2, 8), PeopleMerged(13, "p-b", "p-new"), PersonLeft(20, "p-new", 1)),
            [("p-new", 7, 10, 20), ("p-new", 7, 11, 20)],
        ),
        (
            (CAME, FOUND, PersonSplit(14, "p-new", "p-ada"), PersonLeft(20, "p-new", 1)),
            [("p-new", 7, 10, 20)],
        ),
        ((CAME, FOUND, PersonForgotten(15, "p-ada"), PersonAppeared(15, "p-c", 1, 8)), [
            ("p-ada", 7, 10, 15), ("p-c", 8, 15, 100),
        ]),
        ((PersonLeft(20, "p-ada", 1),), [("p-ada", 0, 0, 20)]),
        ((CAME, PeopleMerged(12, "p-new", "p-b"), PeopleMerged(13, "p-b", "p-new"), PersonLeft(20, "p-b", 1)), [
            ("p-new", 7, 10, 20),
        ]),
    ],
    ids=["found", "still here", "found again", "not her", "undone", "merged", "split", "forgotten", "before", "circle"],
)  # fmt: skip
def test_a_visit_is_whose_it_turned_out_to_be(
    events: tuple[VisitEvent, ...], expected: list[tuple[str, int, int, int]]
) -> None:
    assert seen(*events) == expected


def test_when_a_person_was_seen_last_is_apart_from_when_they_counted_as_gone() -> None:
    events = [PersonAppeared(10, "p-1", 1, number=1), PersonLeft(60, "p-1", 1, last_seen_ns=40),
        PersonAppeared(70, "p-2", 2, number=2), PersonLeft(90, "p-2", 2), PersonAppeared(95, "p-3", 3)]  # fmt: skip
    visits = visits_of(events, started_ns=0, ended_ns=100)
    assert [(visit.start_ns, visit.last_seen_ns, visit.end_ns) for visit in visits] == [
        (10, 40, 60), (70, None, 90), (95, None, 100),
    ]  # fmt: skip
