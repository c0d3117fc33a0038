"""A 2D laser scanner: 720 beams all around, with noise; it sees walls, furniture and people's legs."""

import math

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import LaserScan
from caris_desktop.simulator.floor_plan import SOLID
from caris_desktop.simulator.ray_casting import circle_hits, corners_of, entry_and_exit

BEAMS = 720
RANGE_MIN_M, RANGE_MAX_M = 0.12, 12.0
NOISE_M = 0.01
ROBOT_FROM_LASER = Pose2D(0.12, 0.0, 0.0)
FRAME_ID = "laser"
ANGLE_MIN_RAD = -math.pi
ANGLE_INCREMENT_RAD = 2.0 * math.pi / BEAMS

_ANGLES = ANGLE_MIN_RAD + ANGLE_INCREMENT_RAD * np.arange(BEAMS)
_CORNERS = corners_of(SOLID)


def scan_from(
    map_from_robot: Pose2D, legs: NDArray[np.float64], noise: np.random.Generator, *, stamp_ns: int
) -> LaserScan:
    """One scan. ``legs`` are circles (x, y, radius) in the map, shape (legs, 3)."""
    laser = map_from_robot @ ROBOT_FROM_LASER
    cos, sin = np.cos(_ANGLES + laser.heading_rad), np.sin(_ANGLES + laser.heading_rad)
    entry, _, _ = entry_and_exit(laser.x_m, laser.y_m, cos, sin, _CORNERS)
    ranges = entry.min(axis=0)
    if len(legs):
        ranges = np.minimum(ranges, circle_hits(laser.x_m, laser.y_m, cos, sin, legs).min(axis=0))
    ranges = ranges + noise.normal(0.0, NOISE_M, BEAMS)
    ranges[(ranges > RANGE_MAX_M) | (ranges < RANGE_MIN_M)] = np.inf
    return LaserScan(
        stamp_ns=stamp_ns,
        robot_stamp_ns=stamp_ns,
        frame_id=FRAME_ID,
        angle_min_rad=ANGLE_MIN_RAD,
        angle_increment_rad=ANGLE_INCREMENT_RAD,
        range_min_m=RANGE_MIN_M,
        range_max_m=RANGE_MAX_M,
        ranges_m=ranges.astype(np.float32),
        robot_from_laser=ROBOT_FROM_LASER,
    )
