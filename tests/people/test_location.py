"""Locations of people from an image and a scan, compared with a known scene."""

import math
from dataclasses import replace

import numpy as np
import pytest

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import DepthGrid, HeadState, LaserScan, People, PersonBox, PersonPlace, RobotPose
from caris_desktop.people.location import PeopleLocator, _placed, _points_in_robot

CAMERA = CameraModel.from_field_of_view(width_px=640, height_px=480, horizontal_rad=math.radians(70))
BEAMS = 720


def located(people: People, scan: LaserScan, camera: CameraModel, map_from_robot: Pose2D) -> tuple[PersonPlace, ...]:
    """Positions of people that a camera on the robot and the LIDAR both see."""
    return _placed(people, camera, map_from_robot, _points_in_robot(scan, map_from_robot), by_floor=False)


def scan_of(*people: tuple[float, float], walls_m: float = 6.0, stamp_ns: int = 0) -> LaserScan:
    """Scan of a round room with people at (x, y) in the robot frame, as cylinders of 0.15 m."""
    angles = -math.pi + 2.0 * math.pi / BEAMS * np.arange(BEAMS)
    ranges = np.full(BEAMS, walls_m)
    for x_m, y_m in people:
        along = x_m * np.cos(angles) + y_m * np.sin(angles)
        aside = np.abs(-x_m * np.sin(angles) + y_m * np.cos(angles))
        hit = (along > 0) & (aside < 0.15)
        ranges[hit] = np.minimum(ranges[hit], along[hit] - np.sqrt(0.15**2 - aside[hit] ** 2))
    return LaserScan(
        stamp_ns, None, "laser", -math.pi, 2.0 * math.pi / BEAMS, 0.05, 12.0, ranges.astype(np.float32),
        Pose2D(0.0, 0.0, 0.0),
    )  # fmt: skip


def seen(*people: tuple[float, float], camera: CameraModel = CAMERA, stamp_ns: int = 0) -> People:
    """Boxes of people of 1.7 m at these places."""
    boxes = []
    for track, (x_m, y_m) in enumerate(people, 1):
        feet, head = camera.pixel_of(x_m, y_m, 0.0), camera.pixel_of(x_m, y_m, 1.7)
        side = camera.pixel_of(x_m, y_m + 0.25, 0.8)
        assert feet and head and side
        half_px = abs(side[0] - feet[0])
        bottom = min(480.0, feet[1])
        top = max(0.0, head[1])
        boxes.append(PersonBox(track, f"p{track}", feet[0] - half_px, top, 2 * half_px, bottom - top, 0.9))
    return People(stamp_ns, "front", 1, 640, 480, tuple(boxes), 5.0)


@pytest.mark.parametrize("place", [(2.0, 0.0), (3.0, 0.8), (1.2, -0.3), (4.5, -1.5)])
def test_a_person_stands_where_picture_and_scan_agree(place: tuple[float, float]) -> None:
    (found,) = located(seen(place), scan_of(place), CAMERA, Pose2D(0.0, 0.0, 0.0))
    assert math.dist((found.x_m, found.y_m), place) < 0.2
    assert found.source == "lidar"
    assert found.person_id == "p1"


def test_places_are_reported_in_the_map() -> None:
    robot = Pose2D(5.0, 1.0, math.pi / 2)
    (found,) = located(seen((2.0, 0.0)), scan_of((2.0, 0.0)), CAMERA, robot)
    assert math.dist((found.x_m, found.y_m), (5.0, 3.0)) < 0.2


def test_of_two_people_in_one_direction_each_gets_the_own_distance() -> None:
    near, far = (1.8, -0.05), (4.0, 0.35)
    places = located(seen(near, far), scan_of(near, far), CAMERA, Pose2D(0.0, 0.0, 0.0))
    assert [round(math.hypot(place.x_m, place.y_m), 1) for place in places] == [1.8, 4.0]


def test_a_person_whom_only_the_camera_sees_gets_no_place() -> None:
    # The wall is far behind the feet: a person on a step, or on a poster.
    assert located(seen((1.8, 0.0)), scan_of(walls_m=6.0), CAMERA, Pose2D(0.0, 0.0, 0.0)) == ()


def test_a_scan_without_returns_places_nobody() -> None:
    assert located(seen((2.0, 0.0)), scan_of(walls_m=math.inf), CAMERA, Pose2D(0.0, 0.0, 0.0)) == ()


def test_a_picture_meets_the_pose_and_head_of_its_own_moment() -> None:
    locator = PeopleLocator()
    for step in range(10):
        stamp_ns = step * 50_000_000
        locator.add(scan_of((0.0, 2.0), stamp_ns=stamp_ns))
        locator.add(RobotPose(stamp_ns, None, Pose2D(float(step), 0.0, 0.0)))
        locator.add(HeadState(stamp_ns, None, math.pi / 2, 0.0))
    camera = CameraModel(**{**_fields(CAMERA), "on_head": True})
    looking_left = camera.with_head_at(pan_rad=math.pi / 2, tilt_rad=0.0)
    people = seen((0.0, 2.0), camera=looking_left, stamp_ns=4 * 50_000_000)
    placed = locator.locate(people, camera)
    assert placed is not None
    (found,) = placed.people
    assert math.dist((found.x_m, found.y_m), (4.0, 2.0)) < 0.2


def test_without_a_scan_of_that_moment_nothing_is_reported() -> None:
    locator = PeopleLocator()
    locator.add(scan_of((2.0, 0.0)))
    locator.add(RobotPose(0, None, Pose2D(0.0, 0.0, 0.0)))
    assert locator.locate(seen((2.0, 0.0), stamp_ns=1_000_000_000), CAMERA) is None


def _fields(camera: CameraModel) -> dict[str, float]:
    return {name: getattr(camera, name) for name in CameraModel.__slots__}


def test_a_scan_that_was_taken_before_the_robot_turned_still_shows_the_person() -> None:
    before, now = Pose2D(1.0, 1.0, 0.0), Pose2D(1.0, 1.0, 0.5)
    scan = replace(scan_of((2.0, 0.0)), map_from_laser=before)
    cos, sin = math.cos(-0.5), math.sin(-0.5)
    (found,) = located(seen((2.0 * cos, 2.0 * sin)), scan, CAMERA, now)
    assert math.dist((found.x_m, found.y_m), (3.0, 1.0)) < 0.2


def depth_of(people: People, camera: CameraModel, *depths_m: float, stamp_ns: int = 0) -> DepthGrid:
    """A wall at 6 m with these people in front, each at this depth along the camera's axis."""
    grid = np.full((45, 80), 6000, np.uint16)
    for box, depth_m in zip(people.boxes, depths_m, strict=True):
        across = slice(int(box.left_px / 8), int((box.left_px + box.width_px) / 8) + 1)
        down = slice(int(box.top_px * 45 / 480), int((box.top_px + box.height_px) * 45 / 480) + 1)
        grid[down, across] = round(depth_m * 1000)
    return DepthGrid(stamp_ns, "front", grid)


def test_a_camera_that_knows_depth_places_people_without_a_scan_and_before_one() -> None:
    near, far = (2.0, 0.6), (4.0, -0.9)
    people = seen(near, far)
    locator = PeopleLocator()
    locator.add(RobotPose(0, None, Pose2D(1.0, 0.0, 0.0)))
    assert locator.locate(people, CAMERA) is None
    # Distance from the camera to the front of a body, along its axis
    locator.add(depth_of(people, CAMERA, 2.0 - 0.12, 4.0 - 0.12))
    for scan in (None, scan_of((3.0, 0.9), (1.2, -0.27))):  # of other people in the same directions
        if scan is not None:
            locator.add(scan)
        places = locator.locate(people, CAMERA)
        assert places is not None
        assert [place.source for place in places.people] == ["depth", "depth"]
        for place, (x_m, y_m) in zip(places.people, (near, far), strict=True):
            assert math.dist((place.x_m, place.y_m), (x_m + 1.0, y_m)) < 0.15
        assert places.people[0].spread_m < places.people[1].spread_m


def test_depth_of_another_moment_or_camera_or_too_far_away_says_nothing() -> None:
    people = seen((2.0, 0.0), stamp_ns=2_000_000_000)
    locator = PeopleLocator()
    locator.add(RobotPose(2_000_000_000, None, Pose2D(0.0, 0.0, 0.0)))
    locator.add(depth_of(people, CAMERA, 2.0, stamp_ns=1_000_000_000))
    locator.add(replace(depth_of(people, CAMERA, 2.0, stamp_ns=2_000_000_000), camera="rear"))
    assert locator.locate(people, CAMERA) is None
    locator.add(depth_of(people, CAMERA, 9.0, stamp_ns=2_000_000_000))
    places = locator.locate(people, CAMERA)
    assert places is not None and places.people == ()


def test_a_box_cut_at_the_lower_edge_is_not_placed_behind() -> None:
    # A detector's box ends slightly above the edge, where the floor would be farther away than the person.
    near, behind = (1.2, 0.0), (3.0, 0.0)
    (box,) = seen(near).boxes
    people = replace(seen(near), boxes=(replace(box, height_px=460.0 - box.top_px),))
    (found,) = located(people, scan_of(near, behind, walls_m=3.1), CAMERA, Pose2D(0.0, 0.0, 0.0))
    assert math.dist((found.x_m, found.y_m), near) < 0.2
