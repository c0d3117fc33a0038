"""Area to cover for a person: between detections, with a margin, and without detections."""

from pathlib import Path

import pytest

from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import PeopleMerged, PeopleUndone, PersonIdentified, PersonRejected, PersonSplit
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.forgetting.person_tracks import (
    WHOLE,
    Area,
    PersonTracks,
    _combine,
    everyone_who_is,
    links_in,
)
from caris_desktop.recording.recorder.event_log import EventLog

SECOND_NS = 1_000_000_000


def sightings(
    boxes: dict[float, tuple[float, float]], looks_s: list[float], *, person_id: str = "p-1", width: float = 0.1
) -> PersonTracks:
    """Boxes by time, at a position in the image; ``width`` wide and half as high."""
    made = [
        ("front", 7, round(at_s * SECOND_NS), person_id, Area(left, top, left + width, top + 0.5))
        for at_s, (left, top) in boxes.items()
    ]
    return _combine(made, {"front": [round(at_s * SECOND_NS) for at_s in looks_s]})


def covers(areas: tuple[Area, ...], left: float, top: float, right: float, bottom: float) -> bool:
    return any(a.left <= left and a.top <= top and a.right >= right and a.bottom >= bottom for a in areas)


def test_between_two_detections_the_place_between_is_blurred_and_the_rest_is_not() -> None:
    seen = sightings({1.0: (0.1, 0.2), 1.2: (0.3, 0.2)}, [1.0, 1.2])
    areas = seen.areas_at("front", round(1.1 * SECOND_NS))
    assert covers(areas, 0.2, 0.2, 0.3, 0.7)
    assert not covers(areas, 0.2, 0.2, 0.5, 0.7)
    assert WHOLE not in areas


def test_over_a_longer_pause_both_places_are_covered() -> None:
    seen = sightings({1.0: (0.1, 0.2), 3.5: (0.6, 0.2)}, [1.0, 3.5])
    assert covers(seen.areas_at("front", 2 * SECOND_NS), 0.1, 0.2, 0.7, 0.7)


def test_a_person_is_blurred_from_a_little_before_to_a_little_after() -> None:
    seen = sightings({10.0: (0.4, 0.2)}, [at / 5 for at in range(200)])
    for at_s, covered in ((9.0, True), (11.0, True), (8.0, False), (12.0, False)):
        assert bool(seen.areas_at("front", round(at_s * SECOND_NS))) == covered


def test_without_detections_after_the_last_one_everything_is_blurred() -> None:
    looks_s = [at / 5 for at in range(51)] + [60.0, 60.2]
    seen = sightings({9.8: (0.4, 0.2), 10.0: (0.4, 0.2)}, looks_s)
    assert seen.areas_at("front", 30 * SECOND_NS) == (WHOLE,)
    assert seen.areas_at("front", 70 * SECOND_NS) == ()
    elsewhere = sightings({2.0: (0.4, 0.2)}, looks_s)
    assert elsewhere.areas_at("front", 30 * SECOND_NS) == ()


def test_a_camera_that_was_never_looked_at_is_covered_while_they_were_here() -> None:
    seen = sightings({9.8: (0.4, 0.2), 10.0: (0.4, 0.2)}, [9.8, 10.0])
    assert seen.seen_by("desk")
    assert seen.areas_at("desk", 11 * SECOND_NS) == (WHOLE,)
    assert seen.areas_at("desk", 40 * SECOND_NS) == ()


def test_before_a_track_was_anybodys_it_was_theirs() -> None:
    area = Area(0.4, 0.2, 0.5, 0.7)
    boxes = [
        ("front", 7, SECOND_NS, "", area),
        ("front", 8, SECOND_NS, "", Area(0.8, 0.2, 0.9, 0.7)),
        ("front", 7, 2 * SECOND_NS, "p-1", area),
    ]
    seen = _combine(boxes, {"front": [SECOND_NS, 2 * SECOND_NS]})
    areas = seen.areas_at("front", SECOND_NS)
    assert covers(areas, *area)
    assert not covers(areas, 0.8, 0.2, 0.9, 0.7)


@pytest.mark.parametrize(
    ("links", "expected"),
    [
        ([(True, "p-3", "p-1"), (True, "p-4", "p-3")], {"p-1", "p-3", "p-4"}),
        ([(True, "p-3", "p-1"), (False, "p-3", "p-1")], {"p-1"}),
        ([(True, "p-1", "p-9")], {"p-1"}),
    ],
)
def test_an_identified_person_is_the_same_person(links: list[tuple[bool, str, str]], expected: set[str]) -> None:
    assert everyone_who_is(["p-1"], links) == expected


def test_mistaken_identities_are_read_from_the_record(tmp_path: Path) -> None:
    happened = (
        PersonIdentified(1, "p-3", "p-1", "wizard", 0.9),
        PersonIdentified(2, "p-4", "p-1", "console", 0.9),
        PersonRejected(3, "p-4", "p-1"),
        PeopleMerged(4, "p-5", "p-1"),
        PersonIdentified(5, "p-6", "p-1", "wizard", 0.9),
        PersonSplit(6, "p-6", "p-1"),
        PersonIdentified(7, "p-7", "p-1", "wizard", 0.9),
        PeopleUndone(8, "p-7", "identified", "p-1"),
    )
    path = tmp_path / "events.mcap"
    log = EventLog(DiskFile(path), anchor=ClockAnchor(0, 0), metadata={})
    for number, event in enumerate(happened):
        log.write(BY_TYPE[type(event)], event, number)
    log.close()
    # Each channel is an independent stream, in the order of the recording.
    assert everyone_who_is(["p-1"], links_in(path)) == {"p-1", "p-3", "p-5"}
