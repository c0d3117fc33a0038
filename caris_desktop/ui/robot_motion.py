"""Motion of the robot in words: still, moving, not following its commands, or unknown; obstacle distance from the LIDAR
scan, and whether the camera faces that direction.
"""

import math
from collections.abc import Mapping
from typing import Literal

import numpy as np
from PySide6.QtCore import QObject, Signal

from caris_desktop.domain.events import GoalChanged
from caris_desktop.domain.geometry import moves
from caris_desktop.domain.sensing import FrameRef, HeadState, LaserScan, Odometry
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import DriveStatus
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.ui.text_formatting import UNDER_WAY, drive_line

Lit = Literal["on", "half", "off"]


class Sign(Value):
    """Filled icon for on, outline for off; a dashed outline for in between or unknown."""

    lit: Lit
    icon: str
    word: str


MOTION_SIGNS: Mapping[str, Sign] = {
    "yes": Sign("on", "arrow-fat-up", QT_TR_NOOP("Moving")),
    "no": Sign("off", "anchor-simple", QT_TR_NOOP("Still")),
    "others": Sign("on", "warning", QT_TR_NOOP("Moving")),
    "held": Sign("half", "warning", QT_TR_NOOP("Not driving")),
    "unknown": Sign("half", "question", QT_TR_NOOP("Unknown")),
    "unlinked": Sign("half", "question", QT_TR_NOOP("No link")),
}


class RobotMotion(QObject):
    """Motion as odometry reports it, not as commanded. ``changed``: ``text`` has another sign."""

    changed = Signal()

    def __init__(self, state: LiveState, parent: QObject) -> None:
        super().__init__(parent)
        self._state = state
        self._odometry_has_speed = False
        self._kind = "unlinked"
        state.odometry.changed.connect(self._on_odometry)
        state.odometry.freshness_changed.connect(self._on_changed)
        state.robot.changed.connect(self._on_robot)
        for value in (state.link, state.drive, state.goal):
            value.changed.connect(self._on_changed)
        self._on_changed()

    @property
    def sign(self) -> Sign:
        return MOTION_SIGNS[self._kind]

    @property
    def text(self) -> str:
        """The word, with the speed, or what is wrong."""
        word, drive = tr(self.sign.word), self._state.drive.value
        if self._kind == "yes" and self._state.odometry.freshness == "fresh":
            twist = self._state.odometry.value.twist
            speed = f"{math.hypot(twist.forward_mps, twist.left_mps):.2f} m/s"
            return f"{word} · {speed} · {abs(math.degrees(twist.turn_radps)):.0f}°/s"
        if self._kind == "others":
            return tr("Moving without a console command")
        if self._kind == "held":
            return f"{word} · {drive_line(drive)}"
        return tr("Motion unknown") if self._kind == "unknown" else word

    @property
    def role(self) -> str:
        """Colour role of a chip with the text."""
        known = {"yes": "moving", "no": "still", "others": "warning", "held": "warning"}
        return known.get(self._kind, "unknown")

    def _on_robot(self, _robot: object) -> None:
        self._odometry_has_speed = False
        self._on_changed()

    def _on_odometry(self, odometry: Odometry) -> None:
        self._odometry_has_speed = self._odometry_has_speed or odometry.twist.moving
        self._on_changed()

    def _on_changed(self, _value: object = None) -> None:
        kind = self._kind_now()
        if kind != self._kind:
            self._kind = kind
            self.changed.emit()

    def _kind_now(self) -> str:
        movement, moves_now = self._state.drive.value.movement, self._moves_now()
        if self._state.link.value.state not in ("connected", "trouble"):
            return "unlinked"
        if moves_now is None:
            return "unknown"
        if movement in ("uncommanded", "not_following"):
            return "others" if movement == "uncommanded" else "held"
        return "yes" if moves_now else "no"

    def _moves_now(self) -> bool | None:
        """Motion from odometry; None if that is lost. Without any odometry a commanded robot counts as moving, else as
        unknown.
        """
        drive: DriveStatus = self._state.drive.value
        odometry: Odometry | None = self._state.odometry.value
        if odometry is not None and self._state.odometry.freshness in ("fresh", "stale"):
            # Some robots leave the velocities empty; the control link then derives motion from their poses.
            return moves(odometry.twist) or (drive.movement == "moving" and not self._odometry_has_speed)
        goal: GoalChanged | None = self._state.goal.value
        commanded = drive.target_forward_mps or drive.target_left_mps or drive.target_turn_radps
        commanded = bool(commanded) or (goal is not None and goal.state in UNDER_WAY)
        return True if commanded and odometry is None else None


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
