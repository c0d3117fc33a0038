"""Obstacle distance ahead of the base from the LIDAR scan, and whether the camera faces that direction."""

import math

import numpy as np

from caris_desktop.domain.sensing import FrameRef, HeadState, LaserScan
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.robot.profile_model import RobotProfile

CLOSE_M = 0.6
_AHEAD_RAD = math.radians(20.0)
_LOOKS_AWAY_RAD = math.radians(15.0)
_LOOKS_BACK_RAD = math.radians(120.0)
_NEXT_BEAM_RAD = math.radians(2.0)


class Ahead(Value):
    """Clearance within 20 degrees of the base's forward direction: distance to the nearest return, None without one,
    and the share of that sector that the LIDAR covers, 0 to 1.
    """

    distance_m: float | None
    covered: float


def ahead_of(scan: LaserScan) -> Ahead:
    """Clearance ahead from a scan; no distance and no coverage if the pose of the laser is unknown."""
    if scan.robot_from_laser is None:
        return Ahead(None, 0.0)
    ranges = scan.ranges_m
    angles = (
        scan.angle_min_rad
        + scan.angle_increment_rad * np.arange(ranges.size, dtype=np.float32)
        + scan.robot_from_laser.heading_rad
    )
    angles = np.remainder(angles + math.pi, 2 * math.pi) - math.pi
    with np.errstate(invalid="ignore"):
        # A beam without a return reads inf, 0 or out of range; a masked beam reads nan or a negative value.
        active = ranges >= 0.0
        returned = scan.returned() & (np.abs(angles) <= _AHEAD_RAD)
    near = float(ranges[returned].min()) + scan.robot_from_laser.x_m if bool(returned.any()) else None
    # Directions half a degree apart, each covered if an active beam is next to it.
    directions = np.linspace(-_AHEAD_RAD, _AHEAD_RAD, 81)
    beams = np.sort(angles[active])
    if not beams.size:
        return Ahead(near, 0.0)
    after = np.searchsorted(beams, directions)
    apart = np.minimum(
        np.abs(directions - beams[np.clip(after - 1, 0, beams.size - 1)]),
        np.abs(directions - beams[np.clip(after, 0, beams.size - 1)]),
    )
    return Ahead(near, float(np.mean(apart <= max(_NEXT_BEAM_RAD, abs(scan.angle_increment_rad)))))


def ahead_words(ahead: Ahead, gaze_is_away: str = "") -> tuple[str, bool]:
    """Text for the clearance, and whether it is a warning. ``gaze_is_away`` says where the camera faces instead."""
    close = False
    if ahead.distance_m is not None:
        close = ahead.distance_m < CLOSE_M
        if close:
            line = (
                tr("Close! Obstacle {distance} m ahead")
                if not gaze_is_away
                else tr("Close! Obstacle {distance} m ahead of the base")
            )
        else:
            line = tr("Obstacle {distance} m ahead of the base") if gaze_is_away else tr("Obstacle {distance} m ahead")
        line = line.format(distance=f"{ahead.distance_m:.1f}")
    elif ahead.covered < 0.1:
        line = tr("No LIDAR coverage ahead of the base") if gaze_is_away else tr("No LIDAR coverage ahead")
    elif ahead.covered < 0.9 and gaze_is_away:
        line = tr("Nothing detected ahead of the base; LIDAR coverage is partial")
    elif ahead.covered < 0.9:
        line = tr("Nothing detected ahead; LIDAR coverage is partial")
    else:
        line = tr("Nothing within range ahead of the base") if gaze_is_away else tr("Nothing within range ahead")
    return " · ".join(filter(None, (line, gaze_is_away))), close


_SIDES = (
    QT_TR_NOOP("Nearest obstacle {distance} m ahead"),
    QT_TR_NOOP("Nearest obstacle {distance} m ahead on the left"),
    QT_TR_NOOP("Nearest obstacle {distance} m to the left"),
    QT_TR_NOOP("Nearest obstacle {distance} m behind on the left"),
    QT_TR_NOOP("Nearest obstacle {distance} m behind"),
    QT_TR_NOOP("Nearest obstacle {distance} m behind on the right"),
    QT_TR_NOOP("Nearest obstacle {distance} m to the right"),
    QT_TR_NOOP("Nearest obstacle {distance} m ahead on the right"),
)


def nearest_of(scan: LaserScan) -> tuple[float, float] | None:
    """Distance in metres and bearing in radians, counter-clockwise from forward, of the return nearest to the robot's
    centre; None without a return, or if the pose of the laser is unknown.
    """
    if scan.robot_from_laser is None:
        return None
    points = scan.points(scan.robot_from_laser)
    if not len(points):
        return None
    x_m, y_m = points[np.argmin(np.hypot(points[:, 0], points[:, 1]))]
    return math.hypot(x_m, y_m), math.atan2(y_m, x_m)


def nearest_words(scan: LaserScan) -> str:
    """Nearest return as text, to a tenth of a metre and an eighth of a turn."""
    if scan.robot_from_laser is None:
        return tr("The direction of the LIDAR is unknown")
    nearest = nearest_of(scan)
    if nearest is None:
        return tr("No obstacle within LIDAR range")
    distance_m, bearing_rad = nearest
    side = round(bearing_rad / (math.pi / 4)) % len(_SIDES)
    return tr(_SIDES[side]).format(distance=f"{distance_m:.1f}")


def gaze_is_away(robot: RobotProfile | None, frame: FrameRef | None, head: HeadState | None) -> str:
    """Camera direction as text if it does not face ahead; empty if it does, or if the camera pose is unknown."""
    cameras = robot.cameras if robot is not None and frame is not None else ()
    model = next((camera.model for camera in cameras if frame is not None and camera.name == frame.camera), None)
    if model is None:
        return ""
    if model.on_head and head is None:
        return tr("the head may be turned")
    if head is not None:
        model = model.with_head_at(pan_rad=head.pan_rad, tilt_rad=head.tilt_rad)
    heading_rad = math.remainder(model.heading_rad, 2 * math.pi)
    if abs(heading_rad) <= _LOOKS_AWAY_RAD:
        return ""
    if abs(heading_rad) >= _LOOKS_BACK_RAD:
        return tr("the camera faces backward")
    return tr("the camera faces left") if heading_rad > 0 else tr("the camera faces right")
