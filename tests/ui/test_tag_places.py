"""Name tags in the image for people who stand close together."""

import itertools

from hypothesis import given
from hypothesis import strategies as st
from PySide6.QtCore import QPointF, QRectF, QSizeF

from caris_desktop.ui.widgets.frame_view import tag_places

PICTURE = QRectF(0, 0, 640, 480)
TAG = (80.0, 21.0)


def rects(boxes: list[QRectF], tags: list[tuple[float, float]]) -> list[QRectF]:
    places = tag_places(boxes, tags, PICTURE)
    return [QRectF(place, QSizeF(*tag)) for place, tag in zip(places, tags, strict=True) if place is not None]


def test_one_alone_stands_on_its_box_or_within_it_where_the_picture_ends() -> None:
    assert rects([QRectF(100, 100, 50, 200)], [TAG]) == [QRectF(99, 79, *TAG)]
    assert rects([QRectF(100, 10, 50, 200)], [TAG]) == [QRectF(99, 11, *TAG)]


def test_of_two_side_by_side_the_nearer_keeps_its_place_and_the_other_is_lifted() -> None:
    far, near = QRectF(100, 100, 50, 150), QRectF(130, 100, 60, 220)
    of_far, of_near = rects([far, near], [TAG, TAG])
    assert of_near == QRectF(129, 79, *TAG)
    assert of_far.bottom() < of_near.top() and of_far.left() == 99


def test_four_in_a_group_can_all_be_read() -> None:
    found = rects([QRectF(100 + 15 * number, 120, 60, 200) for number in range(4)], [TAG] * 4)
    assert not any(one.intersects(other) for one, other in itertools.combinations(found, 2))


def test_a_tag_is_not_put_below_the_words_over_the_picture() -> None:
    chips = [QRectF(12, 434, 200, 34), QRectF(12, 394, 200, 34)]
    low = QRectF(40, 450, 50, 30)
    (found,) = tag_places([low], [TAG], PICTURE, chips)
    assert found == QPointF(39, 450 - 21 - 3 * 22)
    assert tag_places([low], [TAG], PICTURE) == [QPointF(39, 429)]


BOX = st.builds(QRectF, st.integers(0, 600), st.integers(0, 440), st.integers(1, 300), st.integers(1, 300))


@given(st.lists(BOX, max_size=8), st.lists(BOX, max_size=2))
def test_every_tag_that_is_shown_can_be_read_and_begins_at_its_box(boxes: list[QRectF], chips: list[QRectF]) -> None:
    places = tag_places(boxes, [TAG] * len(boxes), PICTURE, chips)
    tags = {number: QRectF(place, QSizeF(*TAG)) for number, place in enumerate(places) if place is not None}
    for number, tag in tags.items():
        at_edge = tag.left() == PICTURE.left() or tag.right() == PICTURE.right()
        assert tag.left() == boxes[number].left() - 1 or at_edge
        assert PICTURE.contains(tag), "whole, also at the sides"
    for one, other in itertools.combinations([*tags.values(), *chips], 2):
        assert not one.intersects(other) or (one in chips and other in chips)
