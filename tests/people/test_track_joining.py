"""Tracks of one person in one visit: joined by appearance, and by place after a camera rotation."""

import pytest

from caris_desktop.domain import intents
from caris_desktop.domain.events import PersonAppeared, PersonIdentified, PersonSplit
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import PeopleInMap, PersonPlace
from caris_desktop.people.presence import RecognitionSettings
from tests.people.crowd import FRAME_NS, Room

ADA, BO, CY = 1, 2, 3
HERE, THERE = (2.0, 1.0), (9.0, -4.0)


def see(room: Room, tracks: dict[int, int], spots: dict[int, tuple[float, float]], *, frames: int = 8) -> None:
    """Detect each person as the given track at the given place."""
    for _ in range(frames):
        room.see(tracks, frames=1)
        places = tuple(
            PersonPlace("", *spot, 0.2, "lidar", track=track) for track, spot in spots.items() if track in tracks
        )
        room.events += room.presence.add_places(PeopleInMap(room.now_ns, places, camera="front"), Pose2D(0, 0, 0))


def turn_away(room: Room, seconds: float) -> None:
    """Process frames without people."""
    for _ in range(round(seconds * 1e9 / FRAME_NS)):
        room.see({}, frames=1)


def rows(room: Room) -> list[str]:
    return [row.person_id for row in room.presence.persons(include_left=True)]


@pytest.mark.parametrize("away_s", [0.5, 1.0, 2.5, 6.0, 20.0])
def test_a_person_who_returns_to_view_is_in_the_same_visit(away_s: float) -> None:
    room = Room()
    see(room, {1: ADA}, {1: HERE})
    (ada,) = rows(room)
    for number in range(2, 8):
        turn_away(room, away_s)
        see(room, {number: ADA}, {number: HERE})
    assert rows(room) == [ada]
    assert {event.person_id for event in room.of(PersonAppeared)} == {ada}  # type: ignore[union-attr]
    assert room.of(PersonIdentified) == room.of(PersonSplit) == []


def test_a_name_stays_with_who_comes_into_view_again() -> None:
    room = Room()
    see(room, {1: ADA, 2: BO}, {1: HERE, 2: (3.0, 1.0)})
    for row in room.presence.persons():
        room.presence.do(intents.NamePerson(row.person_id, "Ada" if row.track == 1 else "Bo"), room.now_ns)
    turn_away(room, 5.0)
    see(room, {11: BO, 12: ADA}, {11: (3.0, 1.0), 12: HERE})
    assert {row.track: row.name for row in room.presence.persons()} == {11: "Bo", 12: "Ada"}


def test_another_person_at_the_same_place_is_a_person_new() -> None:
    room = Room()
    see(room, {1: ADA}, {1: HERE})
    turn_away(room, 2.0)
    see(room, {2: BO}, {2: HERE})
    assert len(rows(room)) == 2


def test_a_look_alike_out_of_walking_distance_is_not_joined() -> None:
    room = Room(settings=RecognitionSettings(confirm_at=1.0))
    see(room, {1: ADA}, {1: HERE})
    turn_away(room, 1.0)
    see(room, {2: ADA}, {2: THERE})
    assert len(rows(room)) == 2


def test_of_two_who_look_alike_and_are_gone_neither_is_taken() -> None:
    room = Room(stray=0.05, settings=RecognitionSettings(confirm_at=1.0))
    see(room, {1: ADA, 2: ADA}, {1: HERE, 2: (2.5, 1.0)})
    turn_away(room, 1.0)
    see(room, {3: ADA}, {3: (2.2, 1.0)})
    assert len(rows(room)) == 3


def test_a_person_in_view_is_not_taken_for_a_new_track() -> None:
    room = Room(settings=RecognitionSettings(confirm_at=1.0))
    see(room, {1: ADA}, {1: HERE})
    see(room, {1: ADA, 2: ADA}, {1: HERE, 2: (2.4, 1.0)})
    assert len(rows(room)) == 2


@pytest.mark.parametrize(("name", "joined"), [("", True), ("Ada", False)])
def test_by_the_place_alone_no_name_is_passed_on(name: str, joined: bool) -> None:
    """Without appearance embeddings."""
    room = Room(settings=RecognitionSettings("nobody"))
    # The place of a track is known from its second frame on.
    room.presence._confirm_frames = 2
    see(room, {1: ADA}, {1: HERE}, frames=3)
    if name:
        room.presence.do(intents.NamePerson(rows(room)[0], name), room.now_ns)
    turn_away(room, 1.0)
    see(room, {2: ADA}, {2: HERE}, frames=3)
    assert len(rows(room)) == 1, "for a moment only"
    turn_away(room, 10.0)
    see(room, {3: BO}, {3: (2.5, 1.2)}, frames=3)
    assert len(rows(room)) == (1 if joined else 2)
    turn_away(room, 10.0)
    see(room, {4: BO}, {4: (6.0, 1.2)}, frames=3)
    assert len(rows(room)) == (2 if joined else 3), "somewhere else"


def test_an_erased_person_is_not_recognised() -> None:
    room = Room()
    see(room, {1: ADA}, {1: HERE})
    (ada,) = rows(room)
    room.presence.do(intents.ForgetPerson(ada), room.now_ns)
    turn_away(room, 2.0)
    see(room, {2: ADA}, {2: HERE})
    assert ada not in rows(room)
