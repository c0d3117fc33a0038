"""Blur of people: the remaining detail, and the covered part of a box."""

import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.domain.sensing import PersonBox
from caris_desktop.perception import blur
from caris_desktop.perception.blur import Corners, What

PICTURE = np.random.default_rng(3).integers(0, 256, (480, 640, 3), np.uint8)


def box(left: float, top: float, width: float, height: float) -> PersonBox:
    return PersonBox(1, "", left, top, width, height, 0.9)


def blocks_across(image: NDArray[np.uint8]) -> int:
    """Maximum number of differently coloured parts in a row."""
    return int((np.diff(image.astype(int), axis=1) != 0).any(axis=2).sum(axis=1).max()) + 1


def covered(parts: list[Corners], what: What = "persons") -> NDArray[np.uint8]:
    image = PICTURE.copy()
    blur.cover(image, parts, what)
    return image


@pytest.mark.parametrize(("what", "most"), [("faces", 6), ("persons", 10)])
@pytest.mark.parametrize("width_px", [30, 100, 333])
def test_a_part_becomes_a_few_blocks_of_few_shades(what: What, most: int, width_px: int) -> None:
    part = np.s_[60:400, 100 : 100 + width_px]
    image = covered([(100.0, 60.0, 100.0 + width_px, 400.0)], what)
    assert blocks_across(image[part]) <= most
    assert len(np.unique(image[part])) <= 16
    outside = np.ones(PICTURE.shape[:2], bool)
    outside[part] = False
    assert np.array_equal(image[outside], PICTURE[outside])


def test_at_the_edge_blocks_are_no_finer_than_within() -> None:
    image = covered([(-240.0, 60.0, 60.0, 400.0)])
    assert blocks_across(image[60:400, :60]) <= 2
    beyond = covered([(-50.0, 60.0, -1.0, 400.0), (700.0, 0.0, 800.0, 90.0), (5.0, 5.0, 5.0, 50.0)])
    assert np.array_equal(beyond, PICTURE)


def test_a_whole_picture_keeps_no_face() -> None:
    image = PICTURE.copy()
    blur.cover_all(image)
    assert blocks_across(image[:, :213]) <= 6, "of a face that fills a third of it"
    tiny = np.full((1, 1, 3), 77, np.uint8)
    blur.cover_all(tiny)
    assert tiny.shape == (1, 1, 3)


@pytest.mark.parametrize(
    ("person", "head"),
    [
        (box(200, 50, 100, 300), (225, 50, 275, 100)),  # standing
        (box(200, 50, 150, 180), (240, 50, 310, 125)),  # cut off at the waist
        (box(100, 200, 300, 100), (100, 200, 160, 290)),  # lying
    ],
)
def test_the_head_is_within_what_is_covered_of_a_person(person: PersonBox, head: Corners) -> None:
    left, top, right, bottom = blur.part_to_cover(person, "faces")
    assert left <= head[0] and top <= head[1] and right >= head[2] and bottom >= head[3]
    whole = blur.part_to_cover(person, "persons")
    assert whole == (
        person.left_px, person.top_px, person.left_px + person.width_px, person.top_px + person.height_px
    )  # fmt: skip


def test_a_head_is_where_nose_eyes_and_ears_are() -> None:
    points = np.zeros((17, 3))
    points[:5] = [(150, 300, 0.9), (154, 296, 0.9), (146, 296, 0.9), (165, 298, 0.9), (135, 298, 0.1)]
    left, top, right, bottom = blur.head_of(points, 200.0) or (0.0, 0.0, 0.0, 0.0)
    assert left < 140 and right > 172 and top < 285 and bottom > 312
    points[:5, 2] = (0.9, 0.1, 0.1, 0.1, 0.1)
    assert blur.head_of(points, 200.0) is None
