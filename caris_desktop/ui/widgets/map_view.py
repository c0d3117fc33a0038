"""Map view: displays map state and converts mouse input to points and headings."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QPoint, QPointF, QRectF, Qt, QTimer, Signal
from PySide6.QtGui import (
    QAccessible,
    QKeyEvent,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPolygonF,
    QResizeEvent,
    QWheelEvent,
)
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.events import GoalChanged
from caris_desktop.domain.geometry import Pose2D, wrap_angle
from caris_desktop.domain.sensing import LaserScan, OccupancyGrid, PersonPlace, RobotPose
from caris_desktop.domain.translation import tr
from caris_desktop.scenario.scenario_model import Place
from caris_desktop.ui.panel import Panel, draw_card_edge
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.map_drawing import Aim, MapDrawing, Tool
from caris_desktop.ui.widgets.map_grid import GridLayer
from caris_desktop.ui.widgets.map_layers import scan_points_in_map, thinned
from caris_desktop.ui.widgets.map_viewport import MapViewport

REPAINT_MS = 80
"""Minimum interval between repaints in ms: a map does not need video rate."""

_DRAG_PX = 6
_AIM_PX = 12


class MapView(QWidget):
    """Map view; up is north, or the robot's heading.

    With the tool ``look`` a drag pans the map and a click reports its point (``ground_clicked``, ``place_clicked``).
    With another tool a press and drag set a point and heading (``aimed``), once; Esc or the right button cancels. The
    view never moves the robot.
    """

    accessible_role = QAccessible.Role.Graphic

    follow_changed = Signal(bool)
    rotate_changed = Signal(bool)
    tool_changed = Signal(str)
    place_clicked = Signal(str, QPointF)
    ground_clicked = Signal(QPointF, QPointF)  # metres in the map, pixels in the view
    aimed = Signal(str, object, bool)  # tool, Pose2D, whether a heading was set
    moved = Signal()  # pan or zoom changed

    def __init__(self, theme: Theme, panel: Panel, places: tuple[Place, ...] = ()) -> None:
        super().__init__(panel)
        self._theme = theme
        self._panel = panel
        self.grid = GridLayer(theme, self)
        self.viewport = MapViewport(self)
        self._drawing = MapDrawing(theme, self, self.viewport, self.grid)
        self.map_state = self._drawing.map_state
        self.map_state.places = places
        self._fitted = False
        self._viewed_by_hand = False
        self.follow = False
        self._press: QPointF | None = None
        self._pan_from: QPointF | None = None
        self._pan_button = Qt.MouseButton.NoButton
        self._dragged = False
        self._soon = QTimer(self, singleShot=True, interval=REPAINT_MS)
        self._soon.timeout.connect(self.update)
        self.left_px = 0  # covered by tools; fit() leaves it free
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setMouseTracking(True)
        self.setAccessibleName(tr("Map with the robot's position"))
        # Every pixel is painted, so Qt need not paint what lies below.
        self.setAttribute(Qt.WidgetAttribute.WA_OpaquePaintEvent)
        self.grid.rendered.connect(self._on_rendered)
        theme.changed.connect(self._on_theme_changed)

    # ---- display

    def show_map(self, grid: OccupancyGrid | None) -> None:
        self.grid.show(grid)
        if grid is None:
            self.update()

    def _on_rendered(self, first: bool) -> None:
        if first or not self._fitted:
            if self.follow:
                self._fitted = True  # following implies a close view
            else:
                self.fit()
        self.update()

    def _on_theme_changed(self) -> None:
        self.grid.color()
        self._drawing.painted.clear()
        self.update()

    def show_pose(self, pose: RobotPose | None) -> None:
        self.map_state.pose = None if pose is None else pose.pose_in_map
        if self.map_state.pose is not None:
            self.map_state.trail.add(self.map_state.pose)
            if self._press is None and self._pan_from is None and self.map_state.aim is None:
                self._follow_pose(self.map_state.pose)
        self._update_soon()

    def show_scan(self, scan: LaserScan | None) -> None:
        # Scan points are placed with the pose at scan time, so that they do not swim with later poses.
        here = self.map_state.pose
        self.map_state.scan_points_m = None if scan is None or here is None else scan_points_in_map(scan, here)
        self._update_soon()

    def show_path(self, points_in_map: NDArray[np.float32] | None) -> None:
        self.map_state.path_m = None if points_in_map is None or len(points_in_map) < 2 else thinned(points_in_map)
        self._update_soon()

    def show_people(
        self, people: tuple[tuple[PersonPlace, str, bool], ...], freshness: str, *, selected: str = ""
    ) -> None:
        """Set positions and labels of people, and whether each is a given name.

        ``selected``: id of the selected person.
        """
        self.map_state.people, self.map_state.people_freshness, self.map_state.meant = people, freshness, selected
        self._update_soon()

    def show_robot(self, outline_m: tuple[tuple[float, float], ...]) -> None:
        self.map_state.outline_m = outline_m
        self.update()

    def show_guard(self, state: str, distance_m: float | None) -> None:
        if (state, distance_m) != self.map_state.guard:
            self.map_state.guard = (state, distance_m)
            self._update_soon()

    def show_places(self, places: tuple[Place, ...]) -> None:
        self.map_state.places = places
        self.update()

    def show_goal(self, goal: GoalChanged | None) -> None:
        self.map_state.goal = goal
        self._update_soon()

    def show_chips(self, chips: list[tuple[str, str]]) -> None:
        """Set lines of (text, role) at the upper edge; roles: warning, good, bad, hint."""
        if chips != self.map_state.chips:
            self.map_state.chips = chips
            self.update()

    @property
    def chips(self) -> list[tuple[str, str]]:
        return self.map_state.chips

    def show_mark(self, at: QPointF | None) -> None:
        """Set the marker of the point that a popup asks about."""
        if at != self.map_state.mark:
            self.map_state.mark = at
            self.update()

    def show_hint(self, hint: str) -> None:
        if hint != self.map_state.hint:
            self.map_state.hint = hint
            self.update()

    @property
    def hint(self) -> str:
        return self.map_state.hint

    def show_waiting(self, words: str) -> None:
        if words != self.map_state.waiting:
            self.map_state.waiting = words
            self.update()

    def show_freshness(self, *, pose: str, scan: str) -> None:
        if (pose, scan) != (self.map_state.pose_freshness, self.map_state.scan_freshness):
            self.map_state.pose_freshness, self.map_state.scan_freshness = pose, scan
            self.update()

    def clear_trail(self) -> None:
        self.map_state.trail.clear()
        self.update()

    def set_trail_shown(self, shown: bool) -> None:
        self.map_state.show_trail = shown
        self.update()

    def _update_soon(self) -> None:
        if not self._soon.isActive():
            self._soon.start()

    # ---- viewport

    def set_follow(self, follow: bool) -> None:
        if follow != self.follow:
            self.follow = follow
            if follow:
                self.viewport.come_near()
                if self.map_state.pose is not None:
                    self.viewport.center = QPointF(self.map_state.pose.x_m, self.map_state.pose.y_m)
            self.follow_changed.emit(follow)
            self.update()

    def set_rotate(self, rotate: bool) -> None:
        """Rotate the map with the robot's heading up, or north up."""
        pose = self.map_state.pose
        if rotate != self.map_state.rotate:
            self.map_state.rotate = rotate
            self.viewport.turn_up(pose.heading_rad if rotate and pose is not None else None)
            self.rotate_changed.emit(rotate)
            self.moved.emit()
            self.update()

    def _follow_pose(self, pose: Pose2D) -> None:
        if self.follow:
            self.viewport.center = QPointF(pose.x_m, pose.y_m)
        if self.map_state.rotate:
            self.viewport.turn_up(pose.heading_rad)
        if self.follow or self.map_state.rotate:
            self.moved.emit()

    def fit(self) -> None:
        """Fit the known part of the map, the places and the robot."""
        poses = [place.pose_in_map for place in self.map_state.places]
        if self.map_state.pose is not None:
            poses.append(self.map_state.pose)
        bounds = QRectF()
        if poses:
            bounds = self._bounds_of(poses).adjusted(-1.2, -1.2, 1.2, 1.2)
        corners = self.grid.corners_in_map()
        if corners:
            bounds = bounds.united(self._bounds_of(corners))
        if bounds.isEmpty() or self.width() < 20:
            return
        self.viewport.show(bounds, left_px=self.left_px)
        self._fitted, self._viewed_by_hand = True, False
        self.moved.emit()
        self.update()

    def _bounds_of(self, poses: Sequence[Pose2D]) -> QRectF:
        return QPolygonF([self.viewport.turned(pose.x_m, pose.y_m) for pose in poses]).boundingRect()

    def zoom(self, factor: float, about: QPointF | None = None) -> None:
        """Zoom around the point ``about`` of the view."""
        point = about if about is not None and not self.follow else QPointF(self.width() / 2, self.height() / 2)
        self.viewport.zoom(factor, point)
        self._viewed_by_hand = True
        self.moved.emit()
        self.update()

    def place_position(self, name: str) -> QPoint | None:
        """Position of a place in the widget."""
        place = next((place for place in self.map_state.places if place.name == name), None)
        return None if place is None else self.to_view(place.pose_in_map.x_m, place.pose_in_map.y_m).toPoint()

    def to_view(self, x_m: float, y_m: float) -> QPointF:
        return self.viewport.to_view(x_m, y_m)

    def to_map(self, point: QPointF) -> QPointF:
        return self.viewport.to_map(point)

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        self.grid.paint(painter, self, self.viewport)
        self._drawing.paint(painter)
        draw_card_edge(painter, self._theme, QRectF(self.rect()), self._drawing.painted, active=self._panel.active)

    # ---- mouse and keyboard

    def set_tool(self, tool: Tool, *, at: QPointF | None = None) -> None:
        """Select a tool. With ``at`` the point is set, and the next click sets the heading."""
        changed = tool != self.map_state.tool
        self.map_state.tool = tool
        self.map_state.aim = Aim(at, None, anchored=True) if tool != "look" and at is not None else None
        self._press = None
        self.setCursor(Qt.CursorShape.ArrowCursor if tool == "look" else Qt.CursorShape.CrossCursor)
        if changed or at is not None:
            self.tool_changed.emit(tool)
        self.update()

    def give_up(self) -> None:
        """Esc: cancel the current operation."""
        self._press = self._pan_from = None
        if self.map_state.tool != "look":
            self.set_tool("look")

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        if self.grid.raster is not None and not self.follow and not self._viewed_by_hand:
            self.fit()

    def wheelEvent(self, event: QWheelEvent) -> None:
        self.zoom(1.0015 ** event.angleDelta().y(), event.position())
        event.accept()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.modifiers() & ~(Qt.KeyboardModifier.ShiftModifier | Qt.KeyboardModifier.KeypadModifier):
            super().keyPressEvent(event)
            return
        match event.key():
            case Qt.Key.Key_Plus | Qt.Key.Key_Equal:
                self.zoom(1.25)
            case Qt.Key.Key_Minus:
                self.zoom(0.8)
            case Qt.Key.Key_Home:
                self.set_follow(False)
                self.fit()
            case Qt.Key.Key_F:
                self.set_follow(not self.follow)
            case Qt.Key.Key_R:
                self.set_rotate(not self.map_state.rotate)
            case _:
                super().keyPressEvent(event)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        self.setFocus(Qt.FocusReason.MouseFocusReason)
        point, button = event.position(), event.button()
        if button == Qt.MouseButton.LeftButton and self.map_state.tool != "look":
            self._press = point
            if self.map_state.aim is None or not self.map_state.aim.anchored:
                self.map_state.aim = Aim(self.to_map(point), None, anchored=False)
            else:
                self._turn_aim_to(point)
            self.update()
        elif button == Qt.MouseButton.RightButton and self.map_state.tool != "look":
            self.give_up()
        elif self._pan_from is None:
            self._pan_from, self._pan_button, self._dragged = point, button, False
        event.accept()

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        point = event.position()
        self.map_state.pointer = point
        if self._pan_from is not None:
            moved = point - self._pan_from
            if self._dragged or moved.manhattanLength() > _DRAG_PX:
                self._dragged = True
                self.set_follow(False)
                self.viewport.drag(self._pan_from, point)
                self._pan_from = point
                self._viewed_by_hand = True
                self.setCursor(Qt.CursorShape.ClosedHandCursor)
                self.moved.emit()
                self.update()
            return
        if self.map_state.tool != "look":
            if self.map_state.aim is not None and (self._press is not None or self.map_state.aim.anchored):
                self._turn_aim_to(point)
            self.update()
            return
        over = self._place_at(point)
        self.setCursor(Qt.CursorShape.ArrowCursor if over is None else Qt.CursorShape.PointingHandCursor)
        if over != self.map_state.hovered:
            self.map_state.hovered = over
            self.update()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        point = event.position()
        if self._pan_from is not None and event.button() == self._pan_button:
            dragged, self._pan_from = self._dragged, None
            self.setCursor(Qt.CursorShape.ArrowCursor if self.map_state.tool == "look" else Qt.CursorShape.CrossCursor)
            if not dragged and self.map_state.tool == "look" and self._pan_button != Qt.MouseButton.MiddleButton:
                name = self._place_at(point)
                if name is not None:
                    self.place_clicked.emit(name, point)
                else:
                    self.ground_clicked.emit(self.to_map(point), point)
        elif self._press is not None and event.button() == Qt.MouseButton.LeftButton:
            self._finish_aim()
        event.accept()

    def leaveEvent(self, event: object) -> None:
        self.map_state.pointer = None
        self.update()

    def _turn_aim_to(self, point: QPointF) -> None:
        aim = self.map_state.aim
        if aim is None:
            return
        away = point - self.to_view(aim.at.x(), aim.at.y())
        heading_rad = None
        if math.hypot(away.x(), away.y()) >= _AIM_PX:
            heading_rad = wrap_angle(math.atan2(-away.y(), away.x()) - self.viewport.turn_rad)
        self.map_state.aim = Aim(aim.at, heading_rad, aim.anchored)

    def _finish_aim(self) -> None:
        aim, tool = self.map_state.aim, self.map_state.tool
        self._press = None
        if aim is None:
            return
        if self.grid.refusal_at(aim.at):
            # The tool stays active for another try.
            self.map_state.aim = None
            self.show_hint(self.grid.refusal_at(aim.at))
            return
        heading_rad = aim.heading_rad if aim.heading_rad is not None else self.heading_towards(aim.at)
        self.set_tool("look")
        self.aimed.emit(tool, Pose2D(aim.at.x(), aim.at.y(), heading_rad), aim.heading_rad is not None)

    def heading_towards(self, at: QPointF) -> float:
        """Direction from the robot to a point; the robot's heading if it is already there."""
        if self.map_state.pose is None:
            return 0.0
        right, up = at.x() - self.map_state.pose.x_m, at.y() - self.map_state.pose.y_m
        return math.atan2(up, right) if math.hypot(right, up) > 0.1 else self.map_state.pose.heading_rad

    def _place_at(self, point: QPointF) -> str | None:
        return next((name for name, rect in self._drawing.place_rects.items() if rect.contains(point)), None)
