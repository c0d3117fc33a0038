"""Track identities improved with knowledge of all frames."""

import numpy as np
import pytest

from caris_desktop.perception.offline_smoothing import NOBODY_FOUND, linked, looked_back
from caris_desktop.perception.tracker import TrackedBox

LOOKS = np.eye(4)


def box(number: int, x: float, *, looks: int | None = None) -> TrackedBox:
    return TrackedBox(number, x, 100.0, 40.0, 100.0, 0.8, 0, 0.8, None if looks is None else LOOKS[looks])


def test_a_path_that_continues_under_another_number_is_one_persons() -> None:
    stamps_s = [0.1 * step for step in range(14)]
    pictures = [[box(1 if step < 6 else 2, 10.0 * step)] if not 5 < step < 8 else [] for step in range(14)]
    assert linked(pictures, stamps_s) == {1: 1, 2: 1}
    elsewhere = [[box(1 if step < 6 else 2, 10.0 if step < 6 else 400.0)] for step in range(14)]
    assert linked(elsewhere, stamps_s) == {1: 1, 2: 2}


def test_a_returning_person_is_joined_by_appearance_and_to_no_one_in_the_picture() -> None:
    pictures = [
        [box(1, 10.0, looks=0), box(2, 300.0, looks=1)],
        [],
        [box(3, 500.0, looks=1), box(4, 50.0, looks=2)],
        [box(3, 500.0), box(5, 250.0, looks=1)],
    ]
    assert linked(pictures, [0.0, 5.0, 20.0, 20.1]) == {1: 1, 2: 2, 3: 2, 4: 4, 5: 5}


def test_a_path_does_not_continue_with_another_appearance() -> None:
    pictures = [[box(1, 10.0, looks=0)], [box(1, 12.0)], [box(2, 14.0, looks=1)]]
    assert linked(pictures, [0.0, 0.1, 0.2]) == {1: 1, 2: 2}


def test_short_gaps_are_filled_on_the_straight_line_and_long_ones_are_not() -> None:
    pictures = [[box(1, 0.0)], [], [], [box(1, 60.0)], [], [box(1, 80.0)]]
    filled = looked_back(pictures, [0.0, 0.1, 0.2, 0.4, 2.0, 4.0])
    assert [[round(each.left_px) for each in boxes] for boxes in filled] == [[0], [15], [30], [60], [], [80]]
    assert [boxes[0].confidence for boxes in filled if boxes] == [0.8, NOBODY_FOUND, NOBODY_FOUND, 0.8, 0.8]
    assert filled[1][0].width_px == pytest.approx(40.0)
