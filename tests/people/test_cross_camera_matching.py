"""Matching of one person in two cameras: by place and time, by appearance, and never by chance."""

import math

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.person_values import PersonLooks
from caris_desktop.people.multi_camera_tracks import CrossCameraMatcher, Likeness, Spot, same_person

MS = 1_000_000
FRONT, DESK = ("front", 1), ("desk", 1)


def walk(
    together: CrossCameraMatcher,
    track: tuple[str, int],
    *,
    from_m: tuple[float, float],
    mps: tuple[float, float] = (0.0, 0.0),
    every_ms: int = 150,
    begin_ms: int = 0,
    until_ms: int = 1500,
    spread_m: float = 0.15,
    off_m: float = 0.0,
) -> None:
    """Let a person walk in front of a camera that locates them with a constant error."""
    for at_ms in range(begin_ms, until_ms, every_ms):
        seconds = at_ms / 1000.0
        together.see(track, at_ms * MS)
        x_m, y_m = from_m[0] + mps[0] * seconds + off_m, from_m[1] + mps[1] * seconds
        together.add_spot(track, Spot(at_ms * MS, x_m, y_m, spread_m))


def looks(track: tuple[str, int], vector: NDArray[np.float32], *, model: str = "osnet") -> PersonLooks:
    unit = (vector / np.linalg.norm(vector)).astype(np.float32)
    return PersonLooks(0, track[0], track[1], "clothing", model, unit, 0.9)


def test_two_tracks_that_move_alike_are_one_person() -> None:
    together = CrossCameraMatcher()
    walk(together, FRONT, from_m=(2.0, 0.0), mps=(0.0, 1.2))
    walk(together, DESK, from_m=(2.0, 0.0), mps=(0.0, 1.2), every_ms=330, begin_ms=70, spread_m=0.3, off_m=0.25)
    assert together.verdict(FRONT, DESK) == "same"
    assert together.partners(FRONT) == (DESK,)
    assert together.partners(DESK) == (FRONT,)


def test_a_track_elsewhere_is_another_person() -> None:
    together = CrossCameraMatcher()
    walk(together, FRONT, from_m=(2.0, 0.0))
    walk(together, DESK, from_m=(4.0, 1.0), spread_m=0.3)
    assert together.verdict(FRONT, DESK) == "different"
    assert together.partners(FRONT) == ()


def test_two_of_one_camera_are_two_people_wherever_they_stand() -> None:
    together = CrossCameraMatcher()
    walk(together, FRONT, from_m=(2.0, 0.0))
    walk(together, ("front", 2), from_m=(2.1, 0.0))
    assert together.verdict(FRONT, ("front", 2)) == "different"


def test_two_people_side_by_side_are_paired_rightly_or_not_at_all() -> None:
    together = CrossCameraMatcher()
    for number, y_m in ((1, 0.0), (2, 0.9)):
        walk(together, ("front", number), from_m=(2.0, y_m))
        walk(together, ("desk", number), from_m=(2.0, y_m), spread_m=0.25, off_m=0.15)
    assert together.partners(("front", 1)) == (("desk", 1),)
    assert together.partners(("desk", 2)) == (("front", 2),)
    close = CrossCameraMatcher()
    for number, y_m in ((1, 0.0), (2, 0.25)):
        walk(close, ("front", number), from_m=(2.0, y_m))
    walk(close, DESK, from_m=(2.0, 0.13), spread_m=0.3)
    assert close.partners(DESK) == (), "it may be either"
    rng = np.random.default_rng(1)
    one, other = rng.normal(size=64), rng.normal(size=64)
    for _ in range(3):
        close.add_embeddings(looks(("front", 1), one))
        close.add_embeddings(looks(("front", 2), other))
        close.add_embeddings(looks(DESK, other + 0.3 * rng.normal(size=64)))
    assert close.partners(DESK) == (("front", 2),), "how they look tells"


def test_places_of_different_moments_decide_nothing() -> None:
    together = CrossCameraMatcher()
    walk(together, FRONT, from_m=(2.0, 0.0), until_ms=600)
    walk(together, DESK, from_m=(2.0, 0.0), begin_ms=1500, until_ms=2100)
    assert together.verdict(FRONT, DESK) == "unknown"
    assert together.verdict(FRONT, ("desk", 9)) == "unknown"


def test_two_tracks_that_met_and_parted_are_two_people() -> None:
    together = CrossCameraMatcher()
    walk(together, FRONT, from_m=(2.0, 0.0), until_ms=4000)
    walk(together, DESK, from_m=(2.0, 0.0), until_ms=1200)
    assert together.verdict(FRONT, DESK) != "different"
    walk(together, DESK, from_m=(2.0, 2.5), begin_ms=2000, until_ms=4000)
    assert together.verdict(FRONT, DESK) == "different"


def test_without_places_only_very_similar_embeddings_match_unless_another_does() -> None:
    rng = np.random.default_rng(2)
    coat = rng.normal(size=64)
    together = CrossCameraMatcher()
    for track in (FRONT, DESK):
        together.see(track, 0)
    together.add_embeddings(looks(FRONT, coat))
    together.add_embeddings(looks(DESK, coat))
    assert together.partners(DESK) == (), "one look is a chance"
    for _ in range(3):
        together.add_embeddings(looks(FRONT, coat + 0.2 * rng.normal(size=64)))
        together.add_embeddings(looks(DESK, coat + 0.2 * rng.normal(size=64)))
    assert together.partners(DESK) == (FRONT,)
    together.see(("front", 2), 0)
    for _ in range(3):
        together.add_embeddings(looks(("front", 2), coat + 0.2 * rng.normal(size=64)))
    assert together.partners(DESK) == (), "two in the same coat"
    foreign = CrossCameraMatcher()
    for track in (FRONT, DESK):
        foreign.see(track, 0)
        for _ in range(4):
            foreign.add_embeddings(looks(track, coat, model=track[0]))
    assert foreign.partners(DESK) == (), "vectors of two networks are never compared"


def test_clearly_other_clothes_in_the_same_place_are_not_joined() -> None:
    assert same_person(Likeness(5, 0.5, 0.2, None)) == "same"
    assert same_person(Likeness(5, 0.5, 0.2, 0.75)) == "same"
    assert same_person(Likeness(5, 0.5, 0.2, 0.2)) == "unknown"
    assert same_person(Likeness(1, 0.5, 0.2, None)) == "unknown"
    assert same_person(Likeness(5, 5.0, 0.6, None)) == "unknown", "sigmas alone may be too small"
    assert same_person(Likeness()) == "unknown"
    assert Likeness().apart == math.inf


def test_nothing_grows() -> None:
    together = CrossCameraMatcher()
    for number in range(500):
        walk(together, ("front", number), from_m=(0.0, 0.0), begin_ms=number * 400, until_ms=number * 400 + 300)
    assert together.verdict(("front", 0), ("desk", 0)) == "unknown"
    assert len(together._sightings) < 15
