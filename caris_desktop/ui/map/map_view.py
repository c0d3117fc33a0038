"""Map view: displays map state and converts mouse input to points and headings."""

import math
from typing import Any

import pyqtgraph
from PySide6.QtCore import QEvent, QPoint, QPointF, QRectF, Qt, QTimer, Signal
from PySide6.QtGui import QAccessible, QKeyEvent, QPolygonF
from PySide6.QtWidgets import QGraphicsScene

from caris_desktop.domain.geometry import Pose2D, wrap_angle
from caris_desktop.domain.sensing import LaserScan, OccupancyGrid, RobotPose
from caris_desktop.domain.translation import tr
from caris_desktop.scenario.scenario_model import Place
from caris_desktop.ui.map.map_items import GridItem, MapItems
from caris_desktop.ui.map.map_state import Aim, Layer, MapState, Tool, length_in_words, scan_points_in_map
from caris_desktop.ui.panel import Panel
from caris_desktop.ui.theme import Theme

REPAINT_MS = 80
"""Minimum interval between repaints in ms: a map does not need video rate."""

_MIN_SCALE, _MAX_SCALE = 2.0, 400.0  # pixels per metre
_FOLLOWING_SCALE = 45.0
_AIM_PX = 12
_MARGIN = 0.04  # share of the view around the whole map

# pyqtgraph drops mouse moves that come within 10 ms: a quick drag would be a click.
pyqtgraph.setConfigOption("mouseRateLimit", -1)


class _MapBox(pyqtgraph.ViewBox):  # type: ignore[misc]  # pyqtgraph has no types
    """View box that reports the mouse: a drag with any button pans, and the tools have it first."""

    dragged = Signal(object)
    clicked = Signal(object)
    turned = Signal(float, QPointF)  # angle of the wheel in eighths of a degree

    def __init__(self) -> None:
        super().__init__(lockAspect=True, enableMenu=False)
        self.disableAutoRange()

    def mouseDragEvent(self, event: Any, axis: int | None = None) -> None:
        event.accept()
        self.dragged.emit(event)

    def mouseClickEvent(self, event: Any) -> None:
        event.accept()
        self.clicked.emit(event)

    def wheelEvent(self, event: Any, axis: int | None = None) -> None:
        event.accept()
        self.turned.emit(event.delta(), event.pos())


class MapView(pyqtgraph.GraphicsView):  # type: ignore[misc]  # pyqtgraph has no types
    """Map view; up is north, or the robot's heading.

    With the tool ``look`` a drag pans the map and a click reports its point (``ground_clicked``, ``place_clicked``).
    With another tool a press and drag set a point and heading (``aimed``), once, or measure; Esc or the right button
    cancels. The view never moves the robot.
    """

    accessible_role = QAccessible.Role.Graphic

    follow_changed = Signal(bool)
    rotate_changed = Signal(bool)
    tool_changed = Signal(str)
    place_clicked = Signal(str, QPointF)
    ground_clicked = Signal(QPointF, QPointF)  # metres in the map, pixels in the view
    aimed = Signal(str, object, bool)  # tool, Pose2D, whether a heading was set
    moved = Signal()  # pan or zoom changed
    refreshed = Signal()

    def __init__(self, theme: Theme, panel: Panel, places: tuple[Place, ...] = ()) -> None:
        super().__init__(panel)
        self._theme = theme
        self.map_state = MapState(places=places)
        self.grid = GridItem(theme)
        self._box = _MapBox()
        self.setCentralItem(self._box)
        self.map_items = MapItems(theme, self._box, self.map_state, self.grid)
        self._fitted = False
        self._dragging = ""  # "", "pan" or "aim"
        self.follow = False
        self._to_follow = self._dirty = False
        self._soon = QTimer(self, singleShot=True)
        self._soon.timeout.connect(self.refresh)
        self.viewport().setMouseTracking(True)
        self.viewport().setFocusPolicy(Qt.FocusPolicy.NoFocus)  # for screen readers the view is one graphic
        self.setAntialiasing(True)
        self.setViewportUpdateMode(self.ViewportUpdateMode.FullViewportUpdate)  # LIDAR is all over it
        self.setCacheMode(self.CacheModeFlag.CacheNone)
        self.scene().setItemIndexMethod(QGraphicsScene.ItemIndexMethod.NoIndex)  # all items move
        self.setAccessibleName(tr("Map with the robot's position"))
        self._box.dragged.connect(self._on_dragged)
        self._box.clicked.connect(self._on_clicked)
        self._box.turned.connect(lambda delta, at: self.zoom(1.0015**delta, at))
        self._box.sigRangeChanged.connect(self._on_range_changed)
        self.scene().sigMouseMoved.connect(self._on_mouse_moved)
        self.scene().sigPrepareForPaint.connect(self.refresh)
        self.grid.rendered.connect(self._on_rendered)
        theme.restyle_on_change(self._use_theme)

    def _use_theme(self) -> None:
        self.setBackground(self._theme.color("map_unknown"))
        self.grid.use_theme()
        self.map_items.use_theme()
        self._touch(0)

    # ---- display

    def show_map(self, grid: OccupancyGrid | None) -> None:
        self.grid.show_grid(grid)
        self._touch(0)

    def _on_rendered(self, first: bool) -> None:
        if first or not self._fitted:
            if self.follow:
                self._fitted = True  # following implies a close view
            else:
                self.fit()
        self._touch(0)

    def show_pose(self, pose: RobotPose | None) -> None:
        self.map_state.pose = None if pose is None else pose.pose_in_map
        if self.map_state.pose is not None:
            self.map_state.trail.add(self.map_state.pose)
            self._to_follow = self.follow or self.map_state.rotate
        self._touch()

    def show_scan(self, scan: LaserScan | None) -> None:
        # Scan points are placed with the pose at scan time, so that they do not swim with later poses.
        here = self.map_state.pose
        self.map_state.scan_points_m = None if scan is None or here is None else scan_points_in_map(scan, here)
        self._touch()

    def update_state(self, **changes: Any) -> None:
        """Set these fields of the map state."""
        for name, value in changes.items():
            before = getattr(self.map_state, name)
            if value is not before and not (isinstance(value, str | tuple | list) and value == before):
                setattr(self.map_state, name, value)
                self._touch()

    def show_layer(self, layer: Layer, shown: bool) -> None:
        (self.map_state.hidden.discard if shown else self.map_state.hidden.add)(layer)
        self._touch()

    def clear_trail(self) -> None:
        self.map_state.trail.clear()
        self._touch()

    def _touch(self, after_ms: int = REPAINT_MS) -> None:
        """Refresh the items after a change: once for all changes of this time."""
        self._dirty = True
        if not self._soon.isActive() or after_ms < self._soon.remainingTime():
            self._soon.start(after_ms)

    def refresh(self) -> None:
        """Show the present state now, if it has changed."""
        self._follow_pose()
        if not self._dirty:
            return
        self._dirty = False
        self._soon.stop()
        self._box.updateMatrix()
        self.map_items.refresh()
        self.refreshed.emit()

    # ---- view

    @property
    def px_per_m(self) -> float:
        return self.map_items.px_per_m

    def _on_range_changed(self) -> None:
        # The items follow before the view is painted, so that it is painted once.
        self._dirty = True
        self.refresh()
        self.moved.emit()

    def _follow_pose(self) -> None:
        pose = self.map_state.pose
        aims = self.map_state.aim is not None and self.map_state.tool != "measure"
        if not self._to_follow or pose is None or self._dragging or aims:
            return
        self._to_follow = False
        middle = QPointF(pose.x_m, pose.y_m) if self.follow else self.to_map(QPointF(self._box.rect().center()))
        if self.map_state.rotate:
            self._turn_up(pose.heading_rad)
        self._center_on(middle)

    def _center_on(self, at: QPointF) -> None:
        """Move this map point to the middle of the view."""
        shown: QRectF = self._box.viewRect()
        shown.moveCenter(self.map_items.world.mapToParent(at))
        self._box.setRange(shown, padding=0)

    def _turn_up(self, heading_rad: float | None) -> None:
        """Rotate this map direction up; north if None."""
        turn_rad = 0.0 if heading_rad is None else wrap_angle(math.pi / 2 - heading_rad)
        self.map_items.world.setRotation(math.degrees(turn_rad))
        self.moved.emit()

    def set_follow(self, follow: bool) -> None:
        if follow != self.follow:
            self.follow = follow
            if follow:
                self.zoom(max(1.0, _FOLLOWING_SCALE / self.px_per_m))
                self._to_follow = True
                self._touch(0)
                self._follow_pose()
            self.follow_changed.emit(follow)

    def set_rotate(self, rotate: bool) -> None:
        """Rotate the map with the robot's heading up, or north up."""
        pose = self.map_state.pose
        if rotate != self.map_state.rotate:
            self.map_state.rotate = rotate
            middle = self.to_map(QPointF(self._box.rect().center()))
            self._turn_up(pose.heading_rad if rotate and pose is not None else None)
            self._center_on(middle)
            self.rotate_changed.emit(rotate)
            self._touch(0)

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
        if bounds.isEmpty():
            return
        self._fitted = True
        self._box.setRange(bounds, padding=_MARGIN)

    def _bounds_of(self, poses: list[Pose2D]) -> QRectF:
        points = QPolygonF([QPointF(pose.x_m, pose.y_m) for pose in poses])
        return QRectF(self.map_items.world.mapToParent(points).boundingRect())

    def zoom(self, factor: float, about: QPointF | None = None) -> None:
        """Zoom around the point ``about`` of the view."""
        scale = self.px_per_m
        if scale > 0 and factor != 1.0:
            by = scale / min(max(scale * factor, min(_MIN_SCALE, scale)), _MAX_SCALE)
            center = self._box.mapToView(about) if about is not None and not self.follow else None
            self._box.scaleBy((by, by), center)

    def place_position(self, name: str) -> QPoint | None:
        """Position of a place in the widget."""
        place = next((place for place in self.map_state.places if place.name == name), None)
        return None if place is None else self.to_view(place.pose_in_map.x_m, place.pose_in_map.y_m).toPoint()

    def to_view(self, x_m: float, y_m: float) -> QPointF:
        self._follow_pose()
        self._box.updateMatrix()
        return self.map_items.to_view(x_m, y_m)

    def to_map(self, point: QPointF) -> QPointF:
        self._box.updateMatrix()
        return QPointF(self.map_items.world.mapFromItem(self._box, QPointF(point)))

    # ---- mouse and keyboard

    def set_tool(self, tool: Tool, *, at: QPointF | None = None) -> None:
        """Select a tool. With ``at`` the point is set, and the next click sets the heading."""
        changed = tool != self.map_state.tool
        self.map_state.tool = tool
        self.map_state.aim = Aim(at, None, anchored=True) if tool != "look" and at is not None else None
        self._dragging = ""
        self.setCursor(Qt.CursorShape.ArrowCursor if tool == "look" else Qt.CursorShape.CrossCursor)
        if changed or at is not None:
            self.tool_changed.emit(tool)
        self._touch(0)

    def give_up(self) -> None:
        """Esc: cancel the current operation."""
        self._dragging = ""
        if self.map_state.tool != "look":
            self.set_tool("look")

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.modifiers() & ~(Qt.KeyboardModifier.ShiftModifier | Qt.KeyboardModifier.KeypadModifier):
            event.ignore()
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
                event.ignore()

    def leaveEvent(self, event: QEvent) -> None:
        super().leaveEvent(event)
        self.map_state.pointer = None
        self._touch(0)

    def _on_dragged(self, event: Any) -> None:
        """Pan, or aim with a tool; after Esc the rest of a drag does nothing."""
        start, point = QPointF(event.buttonDownPos()), QPointF(event.pos())
        aims = self.map_state.tool != "look" and event.button() == Qt.MouseButton.LeftButton
        if event.isStart():
            if self.map_state.tool != "look" and event.button() == Qt.MouseButton.RightButton:
                self.give_up()
                return
            self._dragging = "aim" if aims else "pan"
            if aims and (self.map_state.aim is None or not self.map_state.aim.anchored):
                self.map_state.aim = Aim(self.to_map(start), None, anchored=False)
        if self._dragging == "aim":
            self._aim_at(point)
        elif self._dragging == "pan":
            self.set_follow(False)
            moved = self._box.mapToView(QPointF(event.lastPos())) - self._box.mapToView(point)
            self._box.setRange(self._box.viewRect().translated(moved), padding=0)
            self.setCursor(Qt.CursorShape.ClosedHandCursor)
        if event.isFinish():
            dragged, self._dragging = self._dragging, ""
            if dragged == "aim":
                self._finish_aim()
            self._show_cursor(point)

    def _on_clicked(self, event: Any) -> None:
        point, button, tool = QPointF(event.pos()), event.button(), self.map_state.tool
        if tool == "look" and button != Qt.MouseButton.MiddleButton:
            name = self._place_at(point)
            if name is not None:
                self.place_clicked.emit(name, point)
            else:
                self.ground_clicked.emit(self.to_map(point), point)
        elif tool != "look" and button == Qt.MouseButton.RightButton:
            self.give_up()
        elif tool != "look" and button == Qt.MouseButton.LeftButton:
            if self.map_state.aim is not None and self.map_state.aim.anchored:
                self._aim_at(point)
                self._finish_aim()
            else:
                self.map_state.aim = Aim(self.to_map(point), None, anchored=tool == "measure")
                if tool != "measure":
                    self._finish_aim()
            self._touch(0)

    def _on_mouse_moved(self, point: QPointF) -> None:
        self.map_state.pointer = point
        if self._dragging:
            return
        aim = self.map_state.aim
        if aim is not None and aim.anchored:
            self._aim_at(point)
        self._show_cursor(point)

    def _show_cursor(self, point: QPointF) -> None:
        looks = self.map_state.tool == "look"
        over = self._place_at(point) if looks else None
        shapes = Qt.CursorShape
        self.setCursor(
            shapes.CrossCursor if not looks else shapes.ArrowCursor if over is None else shapes.PointingHandCursor
        )
        if over != self.map_state.hovered or not looks:
            self.map_state.hovered = over
            self._touch(0)

    def _aim_at(self, point: QPointF) -> None:
        """Set the heading of the chosen point towards ``point`` of the view, or the end of what is measured."""
        aim = self.map_state.aim
        if aim is None:
            return
        if self.map_state.tool == "measure":
            end = self.to_map(point)
            self.map_state.aim = Aim(aim.at, None, aim.anchored, end)
            self.update_state(hint=tr("{length} · Esc ends measuring").format(length=length_in_words(aim.at, end)))
        else:
            away = point - self.to_view(aim.at.x(), aim.at.y())
            heading_rad = None
            if math.hypot(away.x(), away.y()) >= _AIM_PX:
                heading_rad = wrap_angle(math.atan2(-away.y(), away.x()) - self.map_items.turn_rad)
            self.map_state.aim = Aim(aim.at, heading_rad, aim.anchored)
        self._touch(0)

    def _finish_aim(self) -> None:
        aim, tool = self.map_state.aim, self.map_state.tool
        if aim is None:
            return
        if tool == "measure":
            # The line stays until the next one begins.
            self.map_state.aim = Aim(aim.at, None, False, aim.end)
            return
        if self.grid.refusal_at(aim.at):
            # The tool stays active for another try.
            self.map_state.aim = None
            self.update_state(hint=self.grid.refusal_at(aim.at))
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
        self.refresh()
        return next((name for name, rect in self.map_items.place_rects.items() if rect.contains(point)), None)
