"""Tracking under a constant number: missing frames, camera rotation, occlusion and return."""

from collections.abc import Callable, Sequence
from statistics import mean

import numpy as np
import pytest

from caris_desktop.perception.kalman_tracker import LOST_S, SURE, CameraTracker, Floats, overlaps
from tests.perception.crowd import HEIGHT_PX, WIDTH_PX, Picture, filmed, idf1


def box(x: float, *, y: float = 200.0, height: float = 200.0) -> Floats:
    return np.array([x, y, x + 0.4 * height, y + height])


def numbers(
    follower: CameraTracker, boxes: list[Floats], stamp_s: float, *, confidence: float = 0.9, shift: float = 0.0
) -> dict[int, int]:
    corners = np.array(boxes).reshape(-1, 4)
    followed = follower.follow(corners, np.full(len(boxes), confidence), stamp_s, shift_px=(shift, 0.0))
    return {box: number for number, box in followed}


def follow_all(pictures: list[Picture], *, turns_known: bool = True, looks: bool = False) -> list[dict[int, int]]:
    follower = CameraTracker()
    answers = []
    for picture in pictures:
        followed = follower.follow(
            picture.boxes,
            picture.confidences,
            picture.stamp_s,
            shift_px=(picture.shift_px if turns_known else 0.0, 0.0),
            picture_px=(WIDTH_PX, HEIGHT_PX),
            appearance_of=(lambda rows, picture=picture: picture.looks[list(rows)]) if looks else None,
        )
        answers.append({box: number for number, box in followed})
    return answers


def score(film: Callable[[int], list[Picture]], *, turns_known: bool = True, looks: bool = False) -> float:
    films = [film(seed) for seed in range(2)]
    return mean(idf1(one, follow_all(one, turns_known=turns_known, looks=looks)) for one in films)


def test_a_person_who_walks_keeps_their_number_and_two_have_two() -> None:
    follower = CameraTracker()
    seen = [numbers(follower, [box(10.0 + 8 * step), box(400.0 - 8 * step)], 0.1 * step) for step in range(10)]
    assert seen[0] == {0: 1, 1: 2}
    assert all(each == seen[0] for each in seen)


def test_a_later_track_counts_from_the_second_picture_on() -> None:
    follower = CameraTracker()
    numbers(follower, [box(10.0)], 0.0)
    assert numbers(follower, [box(10.0), box(400.0)], 0.1) == {0: 1}
    assert numbers(follower, [box(10.0), box(402.0)], 0.2) == {0: 1, 1: 2}


@pytest.mark.parametrize("period_s", [0.7, 1.5, 2.5])
def test_rare_pictures_still_count_people(period_s: float) -> None:
    follower = CameraTracker()
    numbers(follower, [], 0.0)
    seen = [numbers(follower, [box(10.0 + 5 * step)], period_s * step) for step in range(1, 6)]
    assert seen == [{}, {0: 1}, {0: 1}, {0: 1}, {0: 1}]


def test_a_box_that_is_hardly_one_continues_a_person_and_begins_nobody() -> None:
    follower = CameraTracker()
    numbers(follower, [box(10.0)], 0.0)
    assert numbers(follower, [box(12.0)], 0.1, confidence=SURE - 0.2) == {0: 1}
    stranger = CameraTracker()
    numbers(stranger, [box(10.0)], 0.0, confidence=SURE - 0.3)
    assert all(numbers(stranger, [box(10.0)], 0.1 * step, confidence=SURE - 0.3) == {} for step in range(1, 30))


def test_poor_boxes_become_a_person_after_a_while_unless_another_covers_them() -> None:
    poor, person, legs = box(10.0), box(300.0), box(310.0, y=280.0, height=110.0)
    follower = CameraTracker()
    corners, confidences = np.array([poor, person, legs]), np.array([0.37, 0.9, 0.4])
    seen = [[box for _, box in follower.follow(corners, confidences, 0.1 * step)] for step in range(15)]
    assert seen[0] == [1]
    assert sorted(seen[-1]) == [0, 1]


@pytest.mark.parametrize("period_s", [0.04, 0.15, 0.4])
def test_a_person_hidden_for_a_second_continues_where_they_would_be(period_s: float) -> None:
    follower = CameraTracker()
    stamps = np.arange(0.0, 4.0, period_s)
    seen: list[dict[int, int]] = []
    for stamp_s in stamps.tolist():
        hidden = 1.5 < stamp_s < 2.4
        seen.append(numbers(follower, [] if hidden else [box(10.0 + 100.0 * stamp_s)], stamp_s))
    assert {number for each in seen for number in each.values()} == {1}


def test_after_too_long_a_person_without_embedding_is_new() -> None:
    follower = CameraTracker()
    numbers(follower, [box(10.0)], 0.0)
    for step in range(1, 10):
        numbers(follower, [], 0.1 * LOST_S * step)
    numbers(follower, [], LOST_S + 0.1)
    numbers(follower, [box(10.0)], LOST_S + 0.2)
    assert numbers(follower, [box(10.0)], LOST_S + 0.3) == {0: 2}


def test_a_person_in_the_same_place_after_a_pause_is_the_same() -> None:
    follower = CameraTracker()
    numbers(follower, [box(10.0)], 0.0)
    assert numbers(follower, [box(12.0)], 4.0) == {0: 1}


def test_a_person_who_returns_elsewhere_is_recognised_and_a_stranger_is_not() -> None:
    follower = CameraTracker()
    looks = np.eye(4)

    def look(boxes: list[Floats], who: list[int], stamp_s: float) -> list[int]:
        followed = follower.follow(
            np.array(boxes).reshape(-1, 4),
            np.full(len(boxes), 0.9),
            stamp_s,
            appearance_of=lambda rows: looks[[who[row] for row in rows]],
        )
        return [number for number, _ in followed]

    assert look([box(10.0), box(500.0)], [0, 1], 0.0) == [1, 2]
    look([], [], 5.0)
    look([box(300.0)], [1], 5.9)
    assert look([box(300.0)], [1], 6.0) == [2], "elsewhere, five seconds later"
    look([box(300.0), box(10.0)], [1, 3], 6.1)
    assert look([box(300.0), box(10.0)], [1, 3], 6.2) == [2, 3], "somebody else, where the first one was"


def test_two_who_were_taken_for_each_other_get_their_numbers_back_when_they_are_seen_well() -> None:
    follower = CameraTracker()
    likenesses = np.eye(2)

    def seen(xs: list[float], who: list[int], stamp_s: float) -> list[int]:
        corners = np.array([box(x) for x in xs])
        followed = follower.follow(
            corners, np.full(len(xs), 0.9), stamp_s, appearance_of=lambda rows: likenesses[[who[row] for row in rows]]
        )
        return [number for number, _ in sorted(followed, key=lambda pair: pair[1])]

    assert seen([10.0, 300.0], [0, 1], 0.0) == [1, 2]
    # Both exchanged their places; motion cannot tell, and appearance is unambiguous.
    assert seen([10.0, 300.0], [1, 0], 0.2) == [1, 2]
    later = [seen([10.0, 300.0], [1, 0], 0.2 * step) for step in range(2, 10)]
    assert later[2:] == [[2, 1]] * 6


def test_a_person_who_enters_where_another_left_is_a_new_track() -> None:
    follower = CameraTracker()
    likenesses = np.eye(2)

    def seen(x: float, who: int, stamp_s: float) -> list[int]:
        corners = np.array([[x, 100.0, min(WIDTH_PX, x + 80.0), 300.0]])
        followed = follower.follow(
            corners,
            np.array([0.9]),
            stamp_s,
            picture_px=(WIDTH_PX, HEIGHT_PX),
            appearance_of=lambda rows: likenesses[[who for _ in rows]],
        )
        return [number for number, _ in followed]

    for step in range(20):  # leaves to the right
        assert seen(500.0 + 7 * step, 0, 0.1 * step) == [1]
    came = [seen(633.0 - 7 * step, 1, 2.0 + 0.1 * step) for step in range(20)]
    assert came[-1] == [2]
    follower.follow(np.zeros((0, 4)), np.zeros(0), 5.0)
    back = [seen(300.0, 0, 9.0 + 0.1 * step) for step in range(3)]
    assert back[-1] == [1]


def test_embeddings_are_few_also_in_a_crowd() -> None:
    follower = CameraTracker()
    asked: list[int] = []

    def appearance_of(rows: Sequence[int]) -> Floats:
        asked.append(len(rows))
        return np.eye(12)[list(rows)]

    corners = np.array([box(50.0 * place) for place in range(12)])
    for step in range(50):
        follower.follow(corners, np.full(12, 0.9), 0.04 * step, appearance_of=appearance_of)
    assert max(asked) <= 6
    assert sum(asked) <= 6 + 20 * 2


def test_a_turn_of_the_camera_is_no_walk_of_everybody() -> None:
    follower = CameraTracker()
    people = [box(50.0), box(200.0), box(350.0)]
    numbers(follower, people, 0.0)
    turned = [each + np.array([150.0, 0.0, 150.0, 0.0]) for each in people]
    assert numbers(follower, turned, 0.1, shift=150.0) == {0: 1, 1: 2, 2: 3}


@pytest.mark.long
def test_few_pictures_and_lost_ones_cost_little() -> None:
    at_25 = score(lambda seed: filmed(seed), looks=True)
    at_7 = score(lambda seed: filmed(seed, fps=7.0, dropped=0.2), looks=True)
    assert at_25 > 75.0
    assert at_7 > at_25 - 5.0


@pytest.mark.long
def test_embeddings_and_known_rotation_help() -> None:
    turning = score(lambda seed: filmed(seed, fps=7.0, turning=True))
    assert turning > score(lambda seed: filmed(seed, fps=7.0, turning=True), turns_known=False) + 7.0
    assert score(lambda seed: filmed(seed, fps=7.0, turning=True), looks=True) > turning + 15.0


def test_overlaps_of_boxes() -> None:
    a, b = np.array([[0.0, 0.0, 10.0, 10.0]]), np.array([[5.0, 0.0, 15.0, 10.0], [20.0, 0.0, 30.0, 10.0]])
    assert overlaps(a, b).tolist() == [[pytest.approx(1 / 3), 0.0]]
    assert overlaps(a, b, buffer=0.5)[0, 1] == 0.0
    assert overlaps(a, b, buffer=0.75)[0, 1] > 0.0
