"""DeepSORT tracker: gating by motion, assignment by appearance, cascade by age."""

from statistics import mean

import numpy as np
import pytest

from caris_desktop.perception.kalman_tracker import Floats
from caris_desktop.perception.tracker_plugins import DeepSortTracker, TrackerFrame
from tests.perception.crowd import Picture, filmed, idf1


def box(x: float) -> Floats:
    return np.array([x, 200.0, x + 80.0, 400.0])


_BLACK = np.zeros((480, 640, 3), np.uint8)


def seen(tracker: DeepSortTracker, xs: list[float], who: list[int], stamp_s: float) -> list[int]:
    """Track of each box, 0 for none."""
    likenesses = np.eye(4)
    frame = TrackerFrame(_BLACK, stamp_s, embedder=lambda rows: likenesses[[who[row] for row in rows]])
    followed = tracker.follow(np.array([box(x) for x in xs]).reshape(-1, 4), np.full(len(xs), 0.9), frame)
    numbers = {row: number for number, row in followed}
    return [numbers.get(row, 0) for row in range(len(xs))]


def deep_sort(*, looks: bool = True) -> DeepSortTracker:
    return DeepSortTracker(appearance=looks)


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
    tracker = deep_sort(looks=False)
    for step in range(5):
        seen(tracker, [100.0 + 10 * step, 400.0], [0, 1], 0.1 * step)
    assert seen(tracker, [400.0, 150.0], [1, 0], 0.5) == [2, 1]


@pytest.mark.long
def test_embeddings_help_in_a_crowd() -> None:
    def score(looks: bool) -> float:
        return mean(idf1(film, follow(film, looks=looks)) for film in map(filmed, range(2)))

    def follow(film: list[Picture], *, looks: bool) -> list[dict[int, int]]:
        tracker = deep_sort(looks=looks)
        answers = []
        for picture in film:
            embedder = lambda rows, picture=picture: picture.looks[list(rows)]  # noqa: E731
            frame = TrackerFrame(_BLACK, picture.stamp_s, embedder=embedder)
            answers.append({row: number for number, row in tracker.follow(picture.boxes, picture.confidences, frame)})
        return answers

    assert score(looks=True) > score(looks=False) + 3.0
