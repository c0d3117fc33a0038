"""The twenty characters: from every side, distinct for a re-identification network, and detectable."""

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.simulator.characters import CHARACTERS, Appearance, draw
from caris_desktop.simulator.floor_plan import START
from caris_desktop.simulator.picture import Painter
from caris_desktop.simulator.robot_simulation import ROBOT_FROM_CAMERA, View
from caris_desktop.simulator.simulated_people import BadVisits, Crowd, Seen, Visit, read_visits, visits_by_chance
from tests.perception.shared_data import OSNET_WEIGHTS as OSNET
from tests.support.walkers import IN_THE_LOBBY, PEOPLE, crop_of, film

FRONT, LEFT, BACK, RIGHT = 0.0, math.pi / 2.0, math.pi, -math.pi / 2.0


def test_a_character_is_a_sprite_seen_from_the_requested_side() -> None:
    with_backpack = Appearance(2)
    front, left, back, right = (draw(with_backpack, facing)[0] for facing in (FRONT, LEFT, BACK, RIGHT))
    for picture in (front, left, back, right):
        assert picture.shape[0] == 400
        assert (picture[:, :, :3] <= picture[:, :, 3:]).all(), "colours are multiplied by alpha"
        rows = np.flatnonzero(picture[:, :, 3].any(axis=1))
        assert rows[0] < 8
        assert rows[-1] > 390
    # turned to their left, the backpack is on the image's left
    assert _reach(left)[0] > 1.5 * _reach(left)[1]
    assert _reach(right)[1] > 1.5 * _reach(right)[0]
    assert abs(_reach(front)[0] - _reach(front)[1]) < 4


def _reach(picture: NDArray[np.uint8]) -> tuple[int, int]:
    """Extent of the upper body to the left and the right of the centre."""
    columns = np.flatnonzero(picture[80:180, :, 3].any(axis=0)) - picture.shape[1] // 2
    return int(-columns[0]), int(columns[-1])


def test_the_camera_sees_the_side_that_is_turned_to_it() -> None:
    painter = Painter()
    x_m, y_m = (IN_THE_LOBBY @ Pose2D(2.0, 0.0, 0.0)).x_m, (IN_THE_LOBBY @ Pose2D(2.0, 0.0, 0.0)).y_m
    shirt = {}
    for turned_rad in (FRONT, BACK):
        heading_rad = IN_THE_LOBBY.heading_rad + math.pi + turned_rad
        person = Seen(x_m, y_m, 1.82, 0, False, 0.0, heading_rad, Appearance(0))
        shirt[turned_rad] = painter.paint(View(IN_THE_LOBBY, (person,)))[200:230, 316:324].mean(axis=(0, 1))
    assert shirt[FRONT].min() > 150, "the white shirt in the open jacket"
    assert shirt[BACK][0] > 2.0 * shirt[BACK][2], "the blue jacket from behind"


@pytest.mark.skipif(not OSNET.is_file(), reason=f"needs {OSNET.name} in CARIS_MODELS_DIR")
@pytest.mark.long
def test_a_network_for_real_people_reports_them_apart_in_the_same_clothes_only() -> None:
    chance = np.random.default_rng(3)
    looks = {
        (clothes, facing): _embeddings([crop_of(person, clothes, facing, chance) for person in range(PEOPLE)])
        for clothes, facing in ((0, FRONT), (0, LEFT), (0, BACK), (1, FRONT))
    }
    first = looks[0, FRONT]
    for facing in (LEFT, BACK):
        alike = first @ looks[0, facing].T
        same, others = np.diag(alike), alike[~np.eye(PEOPLE, dtype=bool)]
        assert (alike.argmax(axis=1) == np.arange(PEOPLE)).mean() >= 0.7, "rank 1 across views"
        assert same.mean() > others.mean() + 0.15
    changed = first @ looks[1, FRONT].T
    assert (changed.argmax(axis=1) == np.arange(PEOPLE)).mean() <= 0.2, "other clothes are somebody else's looks"
    assert np.diag(changed).mean() < np.diag(first @ looks[0, BACK].T).mean() - 0.15


def _embeddings(crops: list[NDArray[np.uint8]]) -> NDArray[np.float32]:
    import cv2
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    network = onnxruntime.InferenceSession(OSNET, options, providers=["CPUExecutionProvider"])
    pictures = np.stack([cv2.resize(crop, (128, 256))[:, :, ::-1] for crop in crops]) / 255.0
    pictures = (pictures - (0.485, 0.456, 0.406)) / (0.229, 0.224, 0.225)
    inputs = {network.get_inputs()[0].name: pictures.transpose(0, 3, 1, 2).astype(np.float32)}
    vectors = np.asarray(network.run(None, inputs)[0])
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_visitors_come_in_order_turn_before_the_robot_and_leave() -> None:
    visits = [Visit(7, 1.0, 12.0), Visit(3, 30.0, 4.0, clothes=1)]
    crowd = Crowd(1, visits)
    assert crowd.seen == ()
    assert crowd.bodies.shape == (0, 3)
    assert crowd.legs.shape == (0, 3)
    came: list[Appearance] = []
    sides, nearest_m = set(), math.inf
    for _ in range(round(75.0 / 0.1)):
        crowd.step(START, 0.1)
        for person in crowd.seen:
            assert person.appearance is not None
            if person.appearance not in came:
                came.append(person.appearance)
            distance_m = math.hypot(person.x_m - START.x_m, person.y_m - START.y_m)
            nearest_m = min(nearest_m, distance_m)
            if person.appearance.person == 7 and distance_m < 3.0 and not person.walking:
                to_robot = math.atan2(START.y_m - person.y_m, START.x_m - person.x_m)
                sides.add(round((person.heading_rad - to_robot) / (math.pi / 2.0)) % 4)
    assert came == [Appearance(7), Appearance(3, 1)]
    assert crowd.seen == (), "everybody has left"
    assert 1.0 < nearest_m < 2.6
    assert sides >= {0, 1, 2}


def test_visits_by_chance_bring_everybody_each_round_in_another_order() -> None:
    visits = visits_by_chance(20, seed=4, rounds=3)
    orders = [[visit.person for visit in visits[first : first + 20]] for first in (0, 20, 40)]
    assert [sorted(order) for order in orders] == [list(range(20))] * 3
    assert orders[0] != orders[1] != orders[2]
    assert visits == visits_by_chance(20, seed=4, rounds=3)
    assert [visit.comes_s for visit in visits] == sorted(visit.comes_s for visit in visits)


def test_a_table_of_visits_is_read_or_refused_with_the_reason(tmp_path: Path) -> None:
    table = tmp_path / "visits.csv"
    table.write_text("person,comes_s,stays_s,clothes\n5,40,10,2\n1,0,20.5,1\n", encoding="utf-8")
    assert read_visits(table) == [Visit(0, 0.0, 20.5), Visit(4, 40.0, 10.0, 1)]
    for content, reason in (
        ("person,comes_s\n1,0\n", "columns"),
        ("person,comes_s,stays_s,clothes\nx,0,1,1\n", "columns"),
        ("person,comes_s,stays_s,clothes\n21,0,1,1\n", "1 to 20"),
        ("person,comes_s,stays_s,clothes\n1,nan,1,1\n", "seconds"),
    ):
        table.write_text(content, encoding="utf-8")
        with pytest.raises(BadVisits, match=reason):
            read_visits(table)
    with pytest.raises(BadVisits, match="cannot be read"):
        read_visits(tmp_path / "none.csv")


@pytest.mark.long
def test_filmed_people_are_where_their_boxes_say() -> None:
    empty = Painter().paint(View(START @ ROBOT_FROM_CAMERA, ()))
    frames = list(film([Visit(8, 0.0, 3.0), Visit(12, 1.0, 3.0)], rate_hz=2.0))
    assert {box.person for frame in frames for box in frame.boxes} == {8, 12}
    for frame in frames:
        different = np.abs(frame.image_bgr.astype(int) - empty).max(axis=2) > 25
        inside = np.zeros(different.shape, dtype=bool)
        for box in frame.boxes:
            left, top = int(box.left_px), int(box.top_px)
            area = (slice(top, top + int(box.height_px)), slice(left, left + int(box.width_px)))
            inside[area] = True
            assert different[area].mean() > 0.25
            assert 0.0 <= box.visible_share <= 1.0
        assert (different & ~inside).mean() < 0.001
    again = list(film([Visit(8, 0.0, 3.0), Visit(12, 1.0, 3.0)], rate_hz=2.0))
    assert all(np.array_equal(a.image_bgr, b.image_bgr) for a, b in zip(frames, again, strict=True))
    assert len(CHARACTERS) == PEOPLE >= 20
