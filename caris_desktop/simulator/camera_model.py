"""Pinhole model of the simulated camera, and visibility of people."""

import math

from caris_desktop.domain.geometry import Pose2D, wrap_angle
from caris_desktop.simulator.path_planning import in_sight

WIDTH_PX, HEIGHT_PX = 640, 480
FOV_RAD = math.radians(70.0)
FOCAL_PX = WIDTH_PX / 2.0 / math.tan(FOV_RAD / 2.0)
MOUNT_HEIGHT_M = 1.1
RATE_HZ = 15.0
_FARTHEST_M = 9.0


def sees(map_from_camera: Pose2D, x_m: float, y_m: float) -> bool:
    """True if a person at (x, y) is fully within the image width and not behind a wall."""
    distance_m = math.hypot(x_m - map_from_camera.x_m, y_m - map_from_camera.y_m)
    if not 0.5 < distance_m < _FARTHEST_M:
        return False
    bearing = math.atan2(y_m - map_from_camera.y_m, x_m - map_from_camera.x_m)
    margin = math.atan2(0.3, distance_m)
    if abs(wrap_angle(bearing - map_from_camera.heading_rad)) > FOV_RAD / 2.0 - margin:
        return False
    return in_sight((map_from_camera.x_m, map_from_camera.y_m), (x_m, y_m))
