"""Motion of the robot in words: still, moving, not following its commands, or unknown."""

import math
from collections.abc import Mapping
from typing import Literal

from PySide6.QtCore import QObject, Signal

from caris_desktop.domain.events import GoalChanged
from caris_desktop.domain.geometry import moves
from caris_desktop.domain.sensing import Odometry
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import DriveStatus
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
