"""Presence of people, with an injected clock."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from caris_desktop.domain.events import Event, PersonAppeared, PersonLeft, PersonRenamed, Problem
from caris_desktop.domain.intents import NamePerson, NoteConsent
from caris_desktop.domain.person_values import PersonPortrait
from caris_desktop.domain.sensing import People, PersonBox
from caris_desktop.people.known import KnownPeople
from caris_desktop.people.people_store import About, PeopleStore, PeopleStoreError, StoredPerson
from caris_desktop.people.presence import PortraitsOf, PresenceTracker, RecognitionSettings

FRAME_NS = 100_000_000


def _seen(stamp_ns: int, *tracks: int) -> People:
    boxes = tuple(PersonBox(track, "", 10.0, 20.0, 30.0, 60.0, 0.9) for track in tracks)
    return People(stamp_ns, "front", stamp_ns // FRAME_NS, 640, 480, boxes, 8.0)


def _watch(presence: PresenceTracker, frames: list[list[int]], *, start: int = 0) -> list[Event]:
    """Process frames at 10 Hz with these tracks; returns all events."""
    events = []
    for index, tracks in enumerate(frames, start):
        events += presence.update(_seen(index * FRAME_NS, *tracks))[1]
    return events


@pytest.fixture
def store(tmp_path: Path) -> Iterator[PeopleStore]:
    store = PeopleStore(tmp_path / "people.db")
    yield store
    store.close()


def test_a_person_in_late_pictures_does_not_leave_before_the_next_one() -> None:
    """A slow detection on a busy machine must not end a presence before its result is known."""
    presence, events, late_ns = PresenceTracker(), list[object](), 1_800_000_000
    for index in range(12):
        taken_ns = index * 500_000_000
        events += presence.update(_seen(taken_ns, 1), taken_ns + late_ns)[1]
        events += presence.tick(taken_ns + late_ns + 450_000_000)
    assert [type(event) for event in events] == [PersonAppeared]
    assert [type(event) for event in presence.tick(taken_ns + late_ns + 1_700_000_000)] == [PersonLeft]


def test_a_track_becomes_a_person_in_its_third_frame(store: PeopleStore) -> None:
    presence = PresenceTracker(KnownPeople(store))
    assert _watch(presence, [[4], [4]]) == []
    assert presence.persons() == ()
    people, events = presence.update(_seen(2 * FRAME_NS, 4))
    (event,) = events
    assert isinstance(event, PersonAppeared)
    assert (event.stamp_ns, event.track) == (2 * FRAME_NS, 4)
    assert people.boxes[0].person_id == event.person_id
    assert [person.person_id for person in store.everybody()] == [event.person_id]
    (row,) = presence.persons()
    assert (row.person_id, row.track, row.name, row.here) == (event.person_id, 4, "Person 1", True)


def test_an_unconfirmed_box_has_no_person(store: PeopleStore) -> None:
    presence = PresenceTracker(KnownPeople(store))
    people, _ = presence.update(_seen(0, 4))
    assert people.boxes[0].person_id == ""
    assert store.everybody() == ()


def test_each_camera_has_people_of_its_own() -> None:
    presence = PresenceTracker()
    for index in range(6):
        camera = ("front", "rear")[index % 2]
        presence.update(replace(_seen(index * FRAME_NS, 1), camera=camera))
    assert [(row.camera, row.track, row.name) for row in presence.persons()] == [
        ("front", 1, "Person 1"),
        ("rear", 1, "Person 2"),
    ]


def test_a_flicker_is_nobody() -> None:
    presence = PresenceTracker()
    frames: list[list[int]] = [[1], *([[]] * 20), [1], *([[]] * 20), [1]]
    assert _watch(presence, frames) == []


def test_empty_frames_empty_the_panel_within_two_seconds() -> None:
    presence = PresenceTracker()
    _watch(presence, [[1, 2]] * 5)
    assert len(presence.persons()) == 2
    events = _watch(presence, [[]] * 20, start=5)
    assert presence.persons() == ()
    assert [type(event) for event in events] == [PersonLeft, PersonLeft]
    assert all(event.stamp_ns <= 4 * FRAME_NS + 2_000_000_000 for event in events)


def test_people_leave_also_when_no_frames_arrive() -> None:
    presence = PresenceTracker()
    _watch(presence, [[1]] * 3)
    last_seen_ns = 2 * FRAME_NS
    assert presence.tick(last_seen_ns + 1_400_000_000) == []
    (event,) = presence.tick(last_seen_ns + 1_600_000_000)
    assert isinstance(event, PersonLeft)
    assert presence.tick(last_seen_ns + 9_000_000_000) == []


def test_a_person_rarely_searched_does_not_come_and_go() -> None:
    """Camera processed every 1.7 s by a busy computer."""
    presence = PresenceTracker()
    events: list[Event] = []
    for index in range(10):
        now_ns = index * 1_700_000_000
        events += presence.update(_seen(now_ns, 1))[1]
        events += presence.tick(now_ns + 1_650_000_000)
    # Before the detection rate is known, a person may be dropped too early.
    assert [type(event) for event in events].count(PersonLeft) <= 1
    assert presence.persons()
    last_ns = 9 * 1_700_000_000
    assert presence.tick(last_ns + 4_000_000_000) == []
    (event,) = presence.tick(last_ns + 4_500_000_000)
    assert isinstance(event, PersonLeft)


def test_a_track_that_returns_soon_is_the_same_person_at_once(store: PeopleStore) -> None:
    presence = PresenceTracker(KnownPeople(store))
    _watch(presence, [[7]] * 3 + [[]] * 20)
    (row,) = presence.persons(include_left=True)
    assert not row.here
    people, events = presence.update(_seen(30 * FRAME_NS, 7))
    assert events == [PersonAppeared(30 * FRAME_NS, row.person_id, 7, 1)]
    assert people.boxes[0].person_id == row.person_id
    (again,) = presence.persons()
    assert again.since_ns == 30 * FRAME_NS
    assert len(store.everybody()) == 1


def test_a_track_that_returns_after_a_while_has_to_be_recognised_unless_nobody_is() -> None:
    """A tracker reuses a track for a similar person; an identity requires more similarity."""
    for recognise, people in (("clothing", 2), ("nobody", 1)):
        presence = PresenceTracker(settings=RecognitionSettings(recognise))  # type: ignore[arg-type]
        _watch(presence, [[7]] * 3 + [[]] * 20)
        presence.do(NamePerson(presence.persons(include_left=True)[0].person_id, "Ada"), 5)
        _watch(presence, [[7]] * 3, start=60)
        (row,) = presence.persons()
        assert (row.name == "Ada") == (people == 1)
        assert len(presence.persons(include_left=True)) == people


def test_after_a_restart_of_the_tracker_a_number_is_another_person() -> None:
    presence = PresenceTracker()
    _watch(presence, [[1]] * 3)
    (before,) = presence.persons()
    (event,) = presence.restart_tracks(3 * FRAME_NS)
    assert isinstance(event, PersonLeft)
    _watch(presence, [[1]] * 3, start=4)
    (after,) = presence.persons()
    assert after.person_id != before.person_id
    assert after.name == "Person 2"


def test_a_name_is_in_the_database_and_the_panel_but_not_in_the_event(store: PeopleStore) -> None:
    presence = PresenceTracker(KnownPeople(store))
    _watch(presence, [[1]] * 3)
    (row,) = presence.persons()
    events = presence.do(NamePerson(row.person_id, "  Ada   Lovelace "), 5)
    assert events == [PersonRenamed(5, row.person_id, "wizard")]
    assert presence.persons()[0].name == "Ada Lovelace"
    assert [person.name for person in store.everybody()] == ["Ada Lovelace"]
    presence.do(NamePerson(row.person_id, ""), 6)
    assert presence.persons()[0].name == "Person 1"


def test_naming_a_person_unknown_is_refused_in_words() -> None:
    (event,) = PresenceTracker().do(NamePerson("p-unknown", "Ada"), 5)
    assert isinstance(event, Problem)


class FullDisk(PeopleStore):
    """Database on a full disk."""

    def add(self) -> StoredPerson:
        raise PeopleStoreError("The disk is full.")

    def describe(self, person_id: str, about: About) -> None:
        raise PeopleStoreError("The disk is full.")

    def note_visit(self, person_id: str, *, from_utc_ns: int, to_utc_ns: int, session: str = "") -> None:
        raise PeopleStoreError("The disk is full.")


def test_a_database_that_fails_costs_no_person_and_is_reported_once(tmp_path: Path) -> None:
    presence = PresenceTracker(KnownPeople(FullDisk(tmp_path / "people.db")))
    events = _watch(presence, [[1, 2]] * 3)
    assert [type(event) for event in events] == [PersonAppeared, Problem, PersonAppeared]
    row, _ = presence.persons()
    assert presence.do(NamePerson(row.person_id, "Ada"), 5) == [PersonRenamed(5, row.person_id, "wizard")]
    assert presence.persons()[0].name == "Ada"
    assert [type(event) for event in _watch(presence, [[]] * 20, start=3)] == [PersonLeft, PersonLeft]
    presence.close()


@given(st.lists(st.sets(st.integers(1, 4)), max_size=60))
def test_everybody_who_left_had_appeared_and_nobody_appears_twice(frames: list[set[int]]) -> None:
    presence = PresenceTracker()
    here: set[str] = set()
    for index, tracks in enumerate(frames):
        people, events = presence.update(_seen(index * 5 * FRAME_NS, *tracks))
        for event in events:
            if isinstance(event, PersonAppeared):
                assert event.person_id not in here
                here.add(event.person_id)
            elif isinstance(event, PersonLeft):
                here.remove(event.person_id)
        assert {row.person_id for row in presence.persons()} == here
        assert {box.person_id for box in people.boxes} - {""} <= here


def test_a_portrait_of_a_track_that_is_no_person_yet_is_stored_with_the_person(store: PeopleStore) -> None:
    presence = PresenceTracker(KnownPeople(store))
    _watch(presence, [[1]])
    presence.add_portrait(PersonPortrait(0, "front", 1, b"jpeg", 0.9))
    assert not presence.persons()
    _watch(presence, [[1]] * 3)
    (person,) = presence.persons()
    assert person.portrait and store.portrait(person.person_id) == b"jpeg"


@pytest.mark.parametrize(("portraits", "kept"), [("everybody", [1, 2]), ("consenting", [1]), ("nobody", [])])
def test_of_whom_a_portrait_is_retained_follows_from_who_may_be_seen_in_pictures(
    store: PeopleStore, portraits: PortraitsOf, kept: list[int]
) -> None:
    presence = PresenceTracker(KnownPeople(store))
    presence.use_settings(RecognitionSettings(portraits=portraits), may_decide=True)
    _watch(presence, [[1, 2]] * 3)
    first, second = sorted(presence.persons(), key=lambda row: row.track)
    presence.do(NoteConsent(first.person_id, "photo", given=True), 5 * FRAME_NS)
    presence.do(NoteConsent(second.person_id, "video", given=True), 5 * FRAME_NS)
    for track in (1, 2):
        presence.add_portrait(PersonPortrait(5 * FRAME_NS, "front", track, b"jpeg", 0.9))
    assert [row.track for row in (first, second) if store.portrait(row.person_id)] == kept
    assert [row.track for row in presence.persons() if row.portrait] == kept
