"""Positions of people in the map: bearing from the camera; distance from depth, LIDAR, or the feet on the floor."""

import math
from collections import deque
from collections.abc import Sequence
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import (
    DepthGrid,
    HeadState,
    LaserScan,
    People,
    PeopleInMap,
    PersonBox,
    PersonPlace,
    RobotPose,
)

WIDEST_PERSON_M = 1.0
FARTHEST_M = 10.0
EVIDENCE_AGE_NS = 400_000_000
_GAP_M = 0.35  # returns farther apart belong to different objects
_BEARING_ERROR_RAD = 0.03
_HALF_A_BODY_M = 0.12  # the LIDAR sees the front of the legs
_EDGE = 0.05  # fraction of the height: a box that ends this close to the lower edge may be clipped
_DEEPEST_M = 8.0
_DEPTH_ERROR = 0.02  # per metre, for a stereo baseline of 7.5 cm: the error grows with the square of the distance
_FLOOR_ERROR = 0.08  # fraction of the distance: how precisely a box ends at the feet


def _placed(
    people: People,
    camera: CameraModel,
    map_from_base: Pose2D,
    points_in_base: NDArray[np.float64],
    *,
    by_floor: bool,
    depth: DepthGrid | None = None,
) -> tuple[PersonPlace, ...]:
    """Position in the map for each person with a known distance, or with a person-sized LIDAR return in their
    direction.

    Of several returns, the one that best agrees with the feet in the image is used, or the nearest if the feet are not
    visible.

    Parameters
    ----------
    camera
        At the time of the image.
    map_from_base
        Pose of the camera's base: the robot, or a fixed place.
    points_in_base
        Centres of the objects hit by the LIDAR's beams, shape (beams, 2).
    by_floor
        Accept the feet alone where the LIDAR saw no person. Not on a robot, whose camera shakes and is low: there, no
        position is better than that one.
    """
    camera = camera.scaled_to(people.frame_width_px, people.frame_height_px)
    seen_from_camera = points_in_base - (camera.x_m, camera.y_m)
    bearings = np.arctan2(seen_from_camera[:, 1], seen_from_camera[:, 0])
    distances = np.hypot(seen_from_camera[:, 0], seen_from_camera[:, 1])
    places = []
    for box in people.boxes:
        left = camera.bearing_rad(box.left_px + 0.15 * box.width_px)
        right = camera.bearing_rad(box.left_px + 0.85 * box.width_px)
        middle, half = (left + right) / 2.0, max(abs(left - right) / 2.0, 0.01)
        off = np.abs(np.remainder(bearings - middle + math.pi, 2.0 * math.pi) - math.pi)
        inside = np.flatnonzero((off <= half) & (distances <= FARTHEST_M))
        source: Literal["lidar", "depth", "floor"] = "lidar"
        distance_m = None if depth is None else _distance_in_depth(box, people, camera, depth)
        if distance_m is not None:
            source, spread_m = "depth", math.hypot(0.05, _DEPTH_ERROR * distance_m**2)
        elif (distance_m := _distance_of(box, distances[inside], people, camera)) is not None:
            spread_m = math.hypot(0.1, distance_m * _BEARING_ERROR_RAD)
        elif by_floor:
            source, distance_m = "floor", _distance_on_floor(box, people, camera)
            spread_m = math.hypot(0.15, _FLOOR_ERROR * (distance_m or 0.0))
        if distance_m is None:
            continue
        in_map = map_from_base @ Pose2D(
            camera.x_m + distance_m * math.cos(middle), camera.y_m + distance_m * math.sin(middle), 0.0
        )
        places.append(PersonPlace(box.person_id, in_map.x_m, in_map.y_m, spread_m, source, box.track))
    return tuple(places)


def _distance_in_depth(box: PersonBox, people: People, camera: CameraModel, depth: DepthGrid) -> float | None:
    """Distance along the floor from the depth image, at the trunk, where the least background is visible."""
    u_px, v_px = box.left_px + box.width_px / 2.0, box.top_px + 0.4 * box.height_px
    along_axis_m = depth.median_m(
        (u_px - box.width_px / 4.0) / people.frame_width_px,
        (v_px - box.height_px / 5.0) / people.frame_height_px,
        (u_px + box.width_px / 4.0) / people.frame_width_px,
        (v_px + box.height_px / 5.0) / people.frame_height_px,
    )
    if along_axis_m is None or along_axis_m > _DEEPEST_M:
        return None
    forward, left, _up = camera.ray(u_px, v_px)
    return along_axis_m * math.hypot(forward, left) + _HALF_A_BODY_M


def _distance_on_floor(box: PersonBox, people: People, camera: CameraModel) -> float | None:
    """Distance of the feet; None if they are outside the image or too far away."""
    feet_px = box.top_px + box.height_px
    if feet_px >= people.frame_height_px * (1.0 - _EDGE):
        return None
    feet = camera.floor_point(box.left_px + box.width_px / 2.0, feet_px)
    if feet is None:
        return None
    distance_m = math.hypot(feet[0] - camera.x_m, feet[1] - camera.y_m)
    return distance_m if distance_m <= FARTHEST_M else None


def _distance_of(box: PersonBox, distances: NDArray[np.float64], people: People, camera: CameraModel) -> float | None:
    things = _things(distances)
    if not things:
        return None
    feet_px = min(box.top_px + box.height_px, people.frame_height_px - 1.0)
    feet = camera.floor_point(box.left_px + box.width_px / 2.0, feet_px)
    if feet is None:
        return things[0]
    expected_m = math.hypot(feet[0] - camera.x_m, feet[1] - camera.y_m)
    if feet_px >= people.frame_height_px * (1.0 - _EDGE):
        # The feet are below the image: the person is nearer than the floor at its lower edge.
        return things[0] if things[0] < 1.3 * expected_m else None
    best = min(things, key=lambda thing: abs(math.log(thing / expected_m)))
    # A return far from the feet is not this person: better no position than a wrong one.
    return best if 0.5 < best / expected_m < 2.0 else None


def _things(distances: NDArray[np.float64]) -> list[float]:
    """Distance to each group of adjacent returns, nearest first; single returns are noise."""
    ordered = np.sort(distances[distances > 0.05])
    if not len(ordered):
        return []
    groups = np.split(ordered, np.flatnonzero(np.diff(ordered) > _GAP_M) + 1)
    return [float(np.median(group[group <= group[0] + WIDEST_PERSON_M / 2.0])) for group in groups if len(group) >= 2]


def _points_in_robot(scan: LaserScan, map_from_robot: Pose2D) -> NDArray[np.float64]:
    """Centres of the objects hit by the beams, relative to the robot's pose at the time of the image.

    The LIDAR sees the side of the legs facing the robot, whichever side the camera sees.
    """
    laser = scan.robot_from_laser
    if scan.map_from_laser is not None:
        laser = map_from_robot.inverse() @ scan.map_from_laser
    if laser is None:
        return np.zeros((0, 2))
    return scan.points(laser, behind_m=_HALF_A_BODY_M)


def _moved(points: NDArray[np.float64], by: Pose2D) -> NDArray[np.float64]:
    cos, sin = math.cos(by.heading_rad), math.sin(by.heading_rad)
    moved: NDArray[np.float64] = points @ np.array([(cos, sin), (-sin, cos)]) + (by.x_m, by.y_m)
    return moved


_S = TypeVar("_S", LaserScan, RobotPose, HeadState, DepthGrid)


class PeopleLocator:
    """Buffers the last second of scans, poses and head angles to match them with images by time.

    ``take`` may be called from any thread, ``locate`` from one.
    """

    def __init__(self) -> None:
        self._scans: deque[LaserScan] = deque(maxlen=20)
        self._poses: deque[RobotPose] = deque(maxlen=40)
        self._heads: deque[HeadState] = deque(maxlen=40)
        self._depths: dict[str, deque[DepthGrid]] = {}

    def add(self, value: LaserScan | RobotPose | HeadState | DepthGrid) -> None:
        if isinstance(value, DepthGrid):
            self._depths.setdefault(value.camera, deque(maxlen=20)).append(value)
        elif isinstance(value, LaserScan):
            self._scans.append(value)
        elif isinstance(value, RobotPose):
            self._poses.append(value)
        else:
            self._heads.append(value)

    def pose_at(self, stamp_ns: int) -> RobotPose | None:
        """Pose of the robot at that time; None if unknown."""
        return _nearest(tuple(self._poses), stamp_ns)

    def locate(self, people: People, camera: CameraModel) -> PeopleInMap | None:
        """Positions in the map; None without a scan or pose of that time, which stationary cameras do not need."""
        scan = _nearest(tuple(self._scans), people.stamp_ns)
        pose = self.pose_at(people.stamp_ns)
        depth = _nearest(tuple(self._depths.get(people.camera, ())), people.stamp_ns)
        points = np.zeros((0, 2))
        if scan is not None and pose is not None:
            points = _points_in_robot(scan, pose.pose_in_map)
        base = camera.stands_in_map
        if base is not None:
            # The robot's LIDAR helps where it covers the same area.
            points = points if pose is None else _moved(points, base.inverse() @ pose.pose_in_map)
            places = _placed(people, camera, base, points, by_floor=True, depth=depth)
        elif pose is None or (scan is None and depth is None):
            return None
        else:
            head = _nearest(tuple(self._heads), people.stamp_ns)
            if head is not None:
                camera = camera.with_head_at(pan_rad=head.pan_rad, tilt_rad=head.tilt_rad)
            places = _placed(people, camera, pose.pose_in_map, points, by_floor=False, depth=depth)
        return PeopleInMap(people.stamp_ns, places, people.camera)


def _nearest(values: Sequence[_S], stamp_ns: int) -> _S | None:
    best = min(values, key=lambda value: abs(value.stamp_ns - stamp_ns), default=None)
    return best if best is not None and abs(best.stamp_ns - stamp_ns) <= EVIDENCE_AGE_NS else None
