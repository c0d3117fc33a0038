"""DeepSORT tracker: gating by motion, assignment by appearance, cascade by age."""

import itertools
from statistics import mean

import numpy as np
import pytest

from caris_desktop.perception.kalman_tracker import Floats
from caris_desktop.perception.tracker_plugins import DeepSort
from tests.perception.crowd import Picture, filmed, idf1


def box(x: float) -> Floats:
    return np.array([x, 200.0, x + 80.0, 400.0])


def seen(tracker: DeepSort, xs: list[float], who: list[int], stamp_s: float, *, looks: bool = True) -> list[int]:
    """Track of each box, 0 for none."""
    likenesses = np.eye(4)
    followed = tracker.follow(
        np.array([box(x) for x in xs]).reshape(-1, 4),
        np.full(len(xs), 0.9),
        stamp_s,
        appearance_of=(lambda rows: likenesses[[who[row] for row in rows]]) if looks else None,
    )
    numbers = {each.box: each.number for each in followed}
    return [numbers.get(row, 0) for row in range(len(xs))]


def deep_sort() -> DeepSort:
    return DeepSort(itertools.count(1).__next__)


def test_a_person_counts_from_the_third_picture_on_and_not_after_a_single_one() -> None:
    tracker = deep_sort()
    assert [seen(tracker, [10.0], [0], 0.1 * step) for step in range(4)] == [[0], [0], [1], [1]]
    seen(tracker, [10.0, 400.0], [0, 1], 0.4)
    seen(tracker, [10.0], [0], 0.5)
    assert seen(tracker, [10.0, 400.0], [0, 1], 0.6) == [1, 0], "the other began anew"


def test_two_who_cross_are_distinguished_by_their_appearance() -> None:
    tracker = deep_sort()
    for step in range(10):
        seen(tracker, [100.0 + 10 * step, 300.0 - 10 * step], [0, 1], 0.1 * step)
    assert seen(tracker, [200.0, 205.0], [1, 0], 1.0) == [2, 1]


def test_a_box_far_from_the_prediction_is_another_person_despite_its_embedding() -> None:
    tracker = deep_sort()
    for step in range(5):
        seen(tracker, [100.0], [0], 0.1 * step)
    assert seen(tracker, [500.0], [0], 0.5) == [0]


def test_without_embeddings_motion_decides() -> None:
    tracker = deep_sort()
    for step in range(5):
        seen(tracker, [100.0 + 10 * step, 400.0], [0, 1], 0.1 * step, looks=False)
    assert seen(tracker, [400.0, 150.0], [1, 0], 0.5, looks=False) == [2, 1]


@pytest.mark.long
def test_embeddings_help_in_a_crowd() -> None:
    def score(looks: bool) -> float:
        return mean(idf1(film, follow(film, looks=looks)) for film in map(filmed, range(2)))

    def follow(film: list[Picture], *, looks: bool) -> list[dict[int, int]]:
        tracker = deep_sort()
        answers = []
        for picture in film:
            followed = tracker.follow(
                picture.boxes,
                picture.confidences,
                picture.stamp_s,
                appearance_of=(lambda rows, picture=picture: picture.looks[list(rows)]) if looks else None,
            )
            answers.append({each.box: each.number for each in followed})
        return answers

    assert score(looks=True) > score(looks=False) + 3.0
