"""Rendered camera image: people in place, occlusion by walls, and detection."""

import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.simulator.characters import Appearance
from caris_desktop.simulator.floor_plan import PLACES, START
from caris_desktop.simulator.picture import Painter, person_sprites
from caris_desktop.simulator.robot_simulation import FOCAL_PX, HEIGHT_PX, ROBOT_FROM_CAMERA, WIDTH_PX, View, sees
from caris_desktop.simulator.simulated_people import Seen

CAMERA = START @ ROBOT_FROM_CAMERA


@pytest.fixture(scope="module")
def painter() -> Painter:
    return Painter()


def before(camera: Pose2D, distance_m: float, bearing_rad: float = 0.0, looks: int = 0) -> Seen:
    angle = camera.heading_rad + bearing_rad
    x, y = camera.x_m + distance_m * math.cos(angle), camera.y_m + distance_m * math.sin(angle)
    return Seen(x, y, 1.76, looks, False, 0.0)


def figure(camera: Pose2D, person: int, turned_rad: float) -> Seen:
    """One of the twenty people at two or four metres, in one of two sets of clothes."""
    there = before(camera, 2.2 if person % 2 else 4.0, 0.1)
    appearance = Appearance(person, person // 2 % 2)
    heading_rad = camera.heading_rad + 0.1 + math.pi + turned_rad
    return replace(there, walking=person % 3 == 0, stride_rad=1.5, heading_rad=heading_rad, appearance=appearance)


def changed(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return (np.abs(one.astype(int) - other.astype(int)) > 12).any(axis=2)


def test_the_picture_has_the_size_and_content_of_a_room(painter: Painter) -> None:
    for place in PLACES:
        picture = painter.paint(View(place.pose @ ROBOT_FROM_CAMERA, ()))
        assert picture.shape == (HEIGHT_PX, WIDTH_PX, 3)
        assert picture.dtype == np.uint8
        assert picture.std() > 8, place.name


@pytest.mark.parametrize("distance_m", [1.5, 2.0, 3.0])
def test_a_person_stands_where_the_pinhole_says(painter: Painter, distance_m: float) -> None:
    empty = painter.paint(View(CAMERA, ()))
    rows, columns = np.nonzero(changed(empty, painter.paint(View(CAMERA, (before(CAMERA, distance_m),)))))
    height_px = FOCAL_PX * 1.76 / distance_m
    head = HEIGHT_PX / 2 + FOCAL_PX * 1.1 / distance_m - height_px
    assert rows.min() == pytest.approx(max(0.0, head), abs=0.05 * height_px)
    assert columns.mean() == pytest.approx(WIDTH_PX / 2, abs=0.1 * height_px)


def test_a_wall_hides_a_person(painter: Painter) -> None:
    corridor = Pose2D(5.0, 5.0, 0.0)
    behind = Seen(8.0, 3.0, 1.76, 0, False, 0.0)
    assert not sees(corridor, behind.x_m, behind.y_m)
    assert not changed(painter.paint(View(corridor, ())), painter.paint(View(corridor, (behind,)))).any()


def test_the_nearer_person_hides_the_farther(painter: Painter) -> None:
    near, far = before(CAMERA, 1.5, looks=0), before(CAMERA, 2.6, looks=1)
    both = painter.paint(View(CAMERA, (near, far)))
    assert np.array_equal(both, painter.paint(View(CAMERA, (far, near))))
    only_near = painter.paint(View(CAMERA, (near,)))
    differing = changed(both, only_near)[:, WIDTH_PX // 2 - 10 : WIDTH_PX // 2 + 10]
    assert differing[150:300].mean() < 0.02


def test_the_same_view_is_the_same_picture(painter: Painter) -> None:
    view = View(CAMERA, (before(CAMERA, 2.0),))
    assert np.array_equal(painter.paint(view), painter.paint(view))


@pytest.mark.long
def test_standing_anywhere_and_looking_anywhere_draws_something(painter: Painter) -> None:
    chance = np.random.default_rng(4)
    for _ in range(60):
        camera = Pose2D(chance.uniform(-0.5, 16.5), chance.uniform(-1.5, 10.5), chance.uniform(-4, 4))
        person = before(camera, chance.uniform(0.05, 6.0), chance.uniform(-1, 1), int(chance.integers(0, 3)))
        assert painter.paint(View(camera, (person,))).shape == (HEIGHT_PX, WIDTH_PX, 3)


def test_the_sprites_have_premultiplied_alpha_and_a_person_in_them() -> None:
    for picture in person_sprites():
        alpha = picture[:, :, 3]
        assert (picture[:, :, :3] <= alpha[:, :, None]).all()
        assert 0.2 < (alpha > 128).mean() < 0.8


MODELS = Path(os.environ.get("CARIS_MODELS_DIR", Path(__file__).parents[3] / "shared" / "models"))
DETECTOR = MODELS / "yolov8n_int8.tflite"


@pytest.mark.skipif(not DETECTOR.is_file(), reason=f"needs the weights {DETECTOR.name} in CARIS_MODELS_DIR")
@pytest.mark.long
def test_an_unmodified_detector_finds_the_people_and_nobody_else(painter: Painter, tmp_path: Path) -> None:
    # in a separate process: the detector changes process-wide state, such as the number of threads of OpenCV
    views = [View(place.pose @ ROBOT_FROM_CAMERA, ()) for place in PLACES]
    peopled = [
        View(camera, (before(camera, distance_m, 0.1, looks),))
        for camera in (CAMERA, Pose2D(2.0, 5.0, 0.0))
        for looks in range(3)
        for distance_m in (1.2, 2.0, 3.2)
    ] + [
        View(CAMERA, (figure(CAMERA, person, turned_rad),))
        for person in range(0, 20, 5)
        for turned_rad in (0.0, 1.6, 3.1)
    ]
    pictures = np.stack([painter.paint(view) for view in views + peopled])
    np.save(tmp_path / "pictures.npy", pictures)
    found = subprocess.run(
        [sys.executable, str(Path(__file__).with_name("count_people.py")), str(DETECTOR), str(tmp_path)],
        check=True,
        capture_output=True,
        text=True,
    )
    counts = [int(word) for word in found.stdout.split()[-len(pictures) :]]
    assert counts[: len(views)] == [0] * len(views)
    assert sum(count == 1 for count in counts[len(views) :]) >= len(peopled) - 1
