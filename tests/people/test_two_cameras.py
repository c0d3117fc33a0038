"""The robot's camera and a desk camera with the same people: one row per person."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.events import PersonAppeared, PersonIdentified, PersonLeft
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import LaserScan, People, PersonBox, RobotPose
from caris_desktop.people.location import PeopleLocator
from caris_desktop.people.presence import PersonRow, PresenceTracker
from caris_desktop.simulator.robot_simulation import Robot, sees
from caris_desktop.simulator.simulate_command import DESK_CAMERA_HEIGHT_M, DESK_CAMERA_IN_MAP, DESK_CAMERA_TILT_RAD
from caris_desktop.simulator.simulated_people import Visit as SimulatedVisit

MS, S = 1_000_000, 1_000_000_000
ROBOT = Pose2D(1.0, 2.0, 0.0)
FRONT = replace(
    CameraModel.from_field_of_view(width_px=640, height_px=480, horizontal_rad=math.radians(70)), x_m=0.15, z_m=1.1
)
# On a desk beside the path, perpendicular to the robot's view.
DESK = replace(FRONT, x_m=0.0, z_m=1.4, tilt_rad=0.2, stands_in_map=Pose2D(4.0, -1.8, math.pi / 2))
BEAMS = 720
Way = Callable[[float], tuple[float, float]]


def box_of(
    camera: CameraModel, at_m: tuple[float, float], track: int, rng: np.random.Generator, base: Pose2D
) -> PersonBox | None:
    """Detected box of a person at this place in the map, with an error of a few pixels; None outside the image.

    ``base`` is the pose of the camera's mount.
    """
    at = base.inverse() @ Pose2D(*at_m, 0.0)
    feet, head = camera.pixel_of(at.x_m, at.y_m, 0.0), camera.pixel_of(at.x_m, at.y_m, 1.72)
    if feet is None or head is None or not 20 < feet[0] < 620:
        return None
    top, bottom = max(0.0, head[1]), min(480.0, feet[1])
    half_px = 0.14 * (feet[1] - head[1])
    shake = rng.normal(0.0, 2.0, 4)
    return PersonBox(track, "", feet[0] - half_px + shake[0], top + shake[1], 2 * half_px, bottom - top + shake[3], 0.9)


def scan_of(people: list[tuple[float, float]], stamp_ns: int) -> LaserScan:
    angles = -math.pi + 2.0 * math.pi / BEAMS * np.arange(BEAMS)
    ranges = np.full(BEAMS, 9.0)
    for x_m, y_m in people:
        at = ROBOT.inverse() @ Pose2D(x_m, y_m, 0.0)
        along = at.x_m * np.cos(angles) + at.y_m * np.sin(angles)
        aside = np.abs(-at.x_m * np.sin(angles) + at.y_m * np.cos(angles))
        hit = (along > 0) & (aside < 0.15)
        ranges[hit] = np.minimum(ranges[hit], along[hit] - np.sqrt(0.15**2 - aside[hit] ** 2))
    return LaserScan(
        stamp_ns, None, "laser", -math.pi, 2.0 * math.pi / BEAMS, 0.05, 12.0, ranges.astype(np.float32),
        Pose2D(0.0, 0.0, 0.0),
    )  # fmt: skip


class Scene:
    """Detection with alternating cameras as in the console: the displayed one three times as often."""

    def __init__(self, presence: PresenceTracker, *ways: Way) -> None:
        self.presence = presence
        self.ways = ways
        self.locator = PeopleLocator()
        self.rng = np.random.default_rng(5)
        self.happened: list[object] = []
        self.places_from = {"front": 0, "desk": 0}
        self.step = 0

    def play(self, seconds: float, *, cameras: tuple[str, ...] = ("front", "desk")) -> tuple[PersonRow, ...]:
        for _ in range(round(seconds * 10)):
            self.step += 1
            stamp_ns = self.step * 100 * MS
            people = [way(self.step / 10.0) for way in self.ways]
            self.locator.add(scan_of(people, stamp_ns))
            self.locator.add(RobotPose(stamp_ns, None, ROBOT))
            name = "desk" if self.step % 3 == 0 else "front"
            if name in cameras:
                self._look(name, DESK if name == "desk" else FRONT, people, stamp_ns)
            self.happened += self.presence.tick(stamp_ns)
        return self.presence.persons()

    def _look(self, name: str, camera: CameraModel, people: list[tuple[float, float]], stamp_ns: int) -> None:
        # Reverse track numbers in the other camera.
        tracks = range(1, len(people) + 1) if name == "front" else range(len(people) + 20, 20, -1)
        base = ROBOT if camera.stands_in_map is None else camera.stands_in_map
        boxes = [box_of(camera, at, track, self.rng, base) for track, at in zip(tracks, people, strict=True)]
        seen = People(stamp_ns, name, self.step, 640, 480, tuple(box for box in boxes if box is not None), 9.0)
        told, events = self.presence.update(seen)
        self.happened += events
        placed = self.locator.locate(told, camera)
        assert placed is not None
        self.places_from[name] += len(placed.people)
        self.happened += self.presence.add_places(placed, ROBOT)

    def count(self, kind: type) -> int:
        return sum(isinstance(event, kind) for event in self.happened)


def standing(x_m: float, y_m: float) -> Way:
    return lambda _seconds: (x_m, y_m)


def test_a_person_whom_both_cameras_see_is_one_row() -> None:
    scene = Scene(PresenceTracker(), standing(4.0, 2.2))
    (row,) = scene.play(4.0)
    assert set(row.cameras) == {"front", "desk"}, "both are perceived"
    assert min(scene.places_from.values()) >= 10
    assert scene.count(PersonAppeared) == 1, "the second camera brings nobody new, not even for a moment"
    assert row.distance_m == pytest.approx(3.0, abs=0.3)
    rows = {scene.play(0.1)[0] for _ in range(10)}
    assert len({replace(each, last_seen_ns=0) for each in rows}) == 1, "the row stays as it is while cameras take turns"


def test_a_person_who_leaves_one_camera_stays_by_the_other_and_leaves_once() -> None:
    scene = Scene(PresenceTracker(), lambda seconds: (4.0, 1.6) if seconds < 4.0 else (0.2, 2.0))
    scene.play(3.5)
    (row,) = scene.play(0.4)
    (still,) = scene.play(1.0)
    assert still.person_id == row.person_id
    assert scene.play(6.0) == ()
    assert (scene.count(PersonAppeared), scene.count(PersonLeft)) == (1, 1)


def test_two_people_who_cross_are_two_rows_all_the_time() -> None:
    scene = Scene(
        PresenceTracker(),
        lambda seconds: (3.0 + 0.25 * min(seconds, 8.0), 1.6 + 0.15 * min(seconds, 8.0)),
        lambda seconds: (5.0 - 0.25 * min(seconds, 8.0), 2.9 - 0.15 * min(seconds, 8.0)),
    )
    for _ in range(10):
        rows = scene.play(1.0)
    assert len(rows) == 2
    assert {frozenset(row.cameras) for row in rows} == {frozenset(("front", "desk"))}
    of = scene.presence._visits
    assert of.of_track(("front", 1)).person_id == of.of_track(("desk", 22)).person_id
    assert of.of_track(("front", 2)).person_id == of.of_track(("desk", 21)).person_id


def test_two_people_without_places_become_one(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(PresenceTracker(), lambda seconds: (4.0, 2.2) if seconds < 5.0 else (3.0, 2.2))
    with monkeypatch.context() as blind:
        blind.setattr("caris_desktop.people.multi_camera_tracks.CrossCameraMatcher.add_spot", lambda *_: None)
        assert len(scene.play(3.0)) == 2
    (row,) = scene.play(2.0)
    assert set(row.cameras) == {"front", "desk"}
    (joined,) = [event for event in scene.happened if isinstance(event, PersonIdentified)]
    assert (joined.is_person_id, joined.by) == (row.person_id, "console")
    scene.play(2.5, cameras=("front",))
    (row,) = scene.play(0.5, cameras=("front",))
    assert row.distance_m == pytest.approx(2.0, abs=0.3), "whichever camera still sees them tells where they are"


def test_a_person_elsewhere_is_never_taken_for_them() -> None:
    scene = Scene(PresenceTracker(), standing(4.0, 2.2), standing(4.4, 0.9))
    for _ in range(5):
        rows = scene.play(1.0)
        assert len(rows) in (1, 2)
    assert len(rows) == 2
    assert scene.count(PersonAppeared) == 2


def test_visitors_of_the_simulated_robot_stand_where_both_cameras_say() -> None:
    """The LIDAR sees legs from the robot's side, the desk camera sees the same people from behind."""
    robot = Robot(1, visits=[SimulatedVisit(0, 0.5, 30.0), SimulatedVisit(6, 4.0, 30.0)])
    desk = replace(
        FRONT, x_m=0.0, z_m=DESK_CAMERA_HEIGHT_M, tilt_rad=DESK_CAMERA_TILT_RAD, stands_in_map=DESK_CAMERA_IN_MAP
    )
    locator, rng = PeopleLocator(), np.random.default_rng(2)
    errors_m: dict[str, list[float]] = {"front": [], "desk": []}
    for step in range(18 * 50):
        robot.step()
        if step % 10 or not robot.people:
            continue
        stamp_ns = round(robot.now_s * 1e9)
        locator.add(robot.scan(stamp_ns=stamp_ns))
        locator.add(RobotPose(stamp_ns, None, robot.pose_in_map))
        for name, camera, base in (("front", FRONT, robot.truth.pose_in_map), ("desk", desk, DESK_CAMERA_IN_MAP)):
            there = [(each.x_m, each.y_m) for each in robot.people]
            in_sight = [at for at in there if sees(base @ Pose2D(camera.x_m, camera.y_m, 0.0), *at)]
            boxes = [box_of(camera, at, track, rng, base) for track, at in enumerate(in_sight)]
            seen = People(stamp_ns, name, step, 640, 480, tuple(box for box in boxes if box is not None), 9.0)
            placed = locator.locate(seen, camera)
            assert placed is not None
            errors_m[name] += [math.dist((place.x_m, place.y_m), in_sight[place.track]) for place in placed.people]
    for name, wrong_m in errors_m.items():
        assert len(wrong_m) > 40, name
        assert np.quantile(wrong_m, 0.9) < 0.25, name
        assert np.mean(np.array(wrong_m) > 0.6) <= 0.02, name
