"""2D LIDAR with noise, 720 beams over 360 degrees by default; it measures walls, furniture and legs."""

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.geometry import Pose2D, Pose3D
from caris_desktop.domain.sensing import LaserScan
from caris_desktop.domain.value_class import Value
from caris_desktop.simulator.floor_plan import SOLID, Box

# Intersection of many horizontal rays with many boxes and circles at once.

Array = NDArray[np.floating]
_TINY = 1e-12


def corners_of(boxes: Iterable[Box]) -> Array:
    """float64, shape (boxes, 4): x0, y0, x1, y1."""
    return np.array([(box.x0_m, box.y0_m, box.x1_m, box.y1_m) for box in boxes], dtype=np.float64).reshape(-1, 4)


def entry_and_exit(
    x_m: float, y_m: float, cos: Array, sin: Array, corners: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Entry and exit distances of rays from (x, y) for each box.

    Parameters
    ----------
    cos, sin
        Direction of each ray, shape (rays,); their length is the unit of the distances.
    corners
        Shape (boxes, 4), from :func:`corners_of`.

    Returns
    -------
    entry, exit
        Distances, shape (boxes, rays); ``entry`` is ``inf`` where the ray misses.
    through_x
        Whether the ray enters through a side perpendicular to the x axis.
    """
    inverse_x = 1.0 / np.where(np.abs(cos) < _TINY, _TINY, cos)
    inverse_y = 1.0 / np.where(np.abs(sin) < _TINY, _TINY, sin)
    to_x0 = (corners[:, 0:1] - x_m) * inverse_x
    to_x1 = (corners[:, 2:3] - x_m) * inverse_x
    to_y0 = (corners[:, 1:2] - y_m) * inverse_y
    to_y1 = (corners[:, 3:4] - y_m) * inverse_y
    near_x, near_y = np.minimum(to_x0, to_x1), np.minimum(to_y0, to_y1)
    entry = np.maximum(near_x, near_y)
    leave = np.minimum(np.maximum(to_x0, to_x1), np.maximum(to_y0, to_y1))
    missed = (entry > leave) | (leave <= 0.0)
    through_x = near_x >= near_y
    return np.where(missed, np.inf, np.maximum(entry, 0.0)), leave, through_x


def circle_hits(x_m: float, y_m: float, cos: Array, sin: Array, circles: Array) -> Array:
    """Distance to each circle (x, y, radius; shape (circles, 3)) along each unit ray, ``inf`` if missed."""
    to_x, to_y = circles[:, 0:1] - x_m, circles[:, 1:2] - y_m
    along = to_x * cos + to_y * sin
    beside = to_y * cos - to_x * sin
    inside = circles[:, 2:3] ** 2 - beside**2
    distance = along - np.sqrt(np.maximum(inside, 0.0))
    return np.where((inside < 0.0) | (distance <= 0.0), np.inf, distance)


BEAMS = 720
RANGE_MIN_M, RANGE_MAX_M = 0.12, 12.0
NOISE_M = 0.01
ROBOT_FROM_LASER = Pose2D(0.12, 0.0, 0.0)
FRAME_ID = "laser"
ANGLE_MIN_RAD = -math.pi
ANGLE_INCREMENT_RAD = 2.0 * math.pi / BEAMS

_CORNERS = corners_of(SOLID)


class LidarModel(Value):
    """Measuring properties and mounting of a LIDAR.

    ``blind`` are beam ranges (end exclusive) that never measure and read ``blind_m``. Beyond the range it reads
    ``beyond_m``. It is mounted ``height_m`` above the floor, rolled (pi: upside down) and pitched.
    """

    beams: int = BEAMS
    angle_min_rad: float = ANGLE_MIN_RAD
    angle_increment_rad: float = ANGLE_INCREMENT_RAD
    range_min_m: float = RANGE_MIN_M
    range_max_m: float = RANGE_MAX_M
    robot_from_laser: Pose2D = ROBOT_FROM_LASER
    height_m: float = 0.25
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    blind: tuple[tuple[int, int], ...] = ()
    blind_m: float = -1.0
    beyond_m: float = math.inf

    @property
    def mount(self) -> Pose3D:
        """Mounting pose on the robot with full rotation: heading, then pitch, then roll (URDF order)."""
        heading_rad, roll, pitch = self.robot_from_laser.heading_rad, self.roll_rad / 2.0, self.pitch_rad / 2.0
        turned = Pose3D(self.robot_from_laser.x_m, self.robot_from_laser.y_m, self.height_m, 0.0, 0.0,
                        math.sin(heading_rad / 2.0), math.cos(heading_rad / 2.0))  # fmt: skip
        pitched = Pose3D(0.0, 0.0, 0.0, 0.0, math.sin(pitch), 0.0, math.cos(pitch))
        return turned @ pitched @ Pose3D(0.0, 0.0, 0.0, math.sin(roll), 0.0, 0.0, math.cos(roll))


ALL_AROUND = LidarModel()


def scan_from(
    map_from_robot: Pose2D,
    legs: NDArray[np.float64],
    noise: np.random.Generator,
    *,
    stamp_ns: int,
    model: LidarModel = ALL_AROUND,
    frame_id: str = FRAME_ID,
) -> LaserScan:
    """One scan. ``legs`` are circles (x, y, radius) in the map, shape (legs, 3)."""
    laser = Pose3D.on_floor(map_from_robot) @ model.mount
    angles = model.angle_min_rad + model.angle_increment_rad * np.arange(model.beams)
    # Projected to the floor, a beam of a tilted LIDAR is shorter than its measurement.
    ahead, aside = np.array(laser.rotated(1.0, 0.0, 0.0)), np.array(laser.rotated(0.0, 1.0, 0.0))
    cos, sin, up = np.outer(ahead, np.cos(angles)) + np.outer(aside, np.sin(angles))
    level = np.maximum(np.hypot(cos, sin), 1e-9)
    cos, sin = cos / level, sin / level
    entry, _, _ = entry_and_exit(laser.x_m, laser.y_m, cos, sin, _CORNERS)
    ranges = entry.min(axis=0)
    if len(legs):
        ranges = np.minimum(ranges, circle_hits(laser.x_m, laser.y_m, cos, sin, legs).min(axis=0))
    ranges = ranges / level
    floor = up < -1e-9
    ranges[floor] = np.minimum(ranges[floor], model.height_m / -up[floor])
    ranges = ranges + noise.normal(0.0, NOISE_M, model.beams)
    ranges[(ranges > model.range_max_m) | (ranges < model.range_min_m)] = model.beyond_m
    for first, end in model.blind:
        ranges[first:end] = model.blind_m
    return LaserScan(
        stamp_ns=stamp_ns,
        robot_stamp_ns=stamp_ns,
        frame_id=frame_id,
        angle_min_rad=model.angle_min_rad,
        angle_increment_rad=model.angle_increment_rad,
        range_min_m=model.range_min_m,
        range_max_m=model.range_max_m,
        ranges_m=ranges.astype(np.float32),
        robot_from_laser=model.robot_from_laser,
    )
