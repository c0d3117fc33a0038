"""Map: floor plan, LIDAR, places, goal, and the robot as a pin that shows where it looks."""

import math

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QPoint, QPointF, QRectF, QSize, Qt, QTimer, Signal
from PySide6.QtGui import (
    QFontMetricsF,
    QImage,
    QMouseEvent,
    QPainter,
    QPainterPath,
    QPaintEvent,
    QPen,
    QPolygonF,
    QResizeEvent,
    QTransform,
    QWheelEvent,
)
from PySide6.QtWidgets import QHBoxLayout, QMenu, QVBoxLayout, QWidget

from caris_desktop.domain.events import GoalChanged
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import LaserScan, OccupancyGrid, RobotPose
from caris_desktop.scenario.model import Place
from caris_desktop.ui import tokens, words
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.panel import Panel, PanelContext
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton

CELLS_AT_ONCE = 400_000
REPAINT_MS = 80
"""What the robot sends is painted at most so often: a map does not need the rate of a video."""

_MIN_SCALE, _MAX_SCALE = 4.0, 400.0  # pixels per metre
_DOT_PX = 2


def scan_points_in_map(scan: LaserScan, map_from_robot: Pose2D) -> NDArray[np.float64]:
    """Where the beams ended, float64 of shape (returns, 2), metres in the map."""
    ranges = scan.ranges_m
    valid = np.isfinite(ranges) & (ranges >= scan.range_min_m) & (ranges <= scan.range_max_m)
    laser = map_from_robot @ scan.robot_from_laser
    angles = scan.angle_min_rad + scan.angle_increment_rad * np.flatnonzero(valid) + laser.heading_rad
    distances = ranges[valid].astype(np.float64)
    return np.column_stack((laser.x_m + distances * np.cos(angles), laser.y_m + distances * np.sin(angles)))


def distinct_dots(points_px: NDArray[np.float64], width_px: int, height_px: int) -> NDArray[np.int64]:
    """The points inside a view, each spot of two by two pixels once: int64 of shape (spots, 2), pixels.

    Most beams of a scan end on the same few pixels of a map that shows a whole building.
    """
    inside = ((points_px >= 0) & (points_px < (width_px, height_px))).all(axis=1)
    cells = points_px[inside].astype(np.int64) // _DOT_PX
    columns = width_px // _DOT_PX + 1
    numbers = np.unique(cells[:, 1] * columns + cells[:, 0])
    return np.column_stack((numbers % columns, numbers // columns)) * _DOT_PX + _DOT_PX // 2


class MapPanel(Panel):
    """The map, with a menu of places and the running goal."""

    title = "Map"
    drives = True

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("map_panel")
        scenario = self.console.scenario
        self._may_go = scenario.permissions.driving
        self.view = MapView(self.theme, self, scenario.places)
        self.view.setObjectName("map_view")
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.view)
        self._go_menu = QMenu(self)
        self._go_menu.setObjectName("map_go_menu")
        for place in scenario.places:
            action = self._go_menu.addAction(place.name)
            action.triggered.connect(lambda _checked=False, name=place.name: self._go_to(name))
        self._go = ActionButton(self.theme, "Go to", icon="navigation-arrow", height_px=30, menu_arrow=True)
        self._go.setObjectName("map_go_button")
        self._go.clicked.connect(self._open_go_menu)
        self._cancel = ActionButton(self.theme, "Cancel", icon="x", height_px=30)
        self._cancel.setObjectName("goal_cancel")
        self._cancel.setToolTip("Do not go there any more")
        self._cancel.clicked.connect(self.console.cancel_goal)
        self._follow = ActionButton(self.theme, "", icon="crosshair", height_px=30)
        self._follow.setObjectName("map_follow_button")
        self._follow.setAccessibleName("Follow the robot")
        self._follow.setToolTip("Follow the robot")
        self._follow.setCheckable(True)
        self._follow.toggled.connect(self.view.set_follow)
        self._fit = ActionButton(self.theme, "", icon="corners-out", height_px=30)
        self._fit.setObjectName("map_fit_button")
        self._fit.setAccessibleName("Show the whole map")
        self._fit.setToolTip("Show the whole map")
        self._fit.clicked.connect(self._on_fit_clicked)
        self.view.follow_changed.connect(self._follow.setChecked)
        self.view.place_clicked.connect(self._on_place_clicked)
        self._popover = _PlacePopover(self.theme, self.view)
        self._popover.go.clicked.connect(self._on_popover_go)
        state = self.state
        state.map.changed.connect(self.view.show_map)
        state.pose.changed.connect(self._on_pose_changed)
        state.scan.changed.connect(self.view.show_scan)
        state.goal.changed.connect(self._on_goal_changed)
        for stream in (state.map, state.pose, state.scan):
            stream.freshness_changed.connect(self._on_freshness_changed)
        self._facts = QTimer(self, interval=500)
        self._facts.timeout.connect(self._refresh)
        self._facts.start()
        if state.map.value is not None:
            self.view.show_map(state.map.value)
        if state.pose.value is not None:
            self.view.show_pose(state.pose.value)
        if state.scan.value is not None:
            self.view.show_scan(state.scan.value)
        self._on_goal_changed(state.goal.value)
        self._on_freshness_changed()
        self.hold.escape_pressed.connect(self._popover.hide)

    def title_widgets(self) -> list[QWidget]:
        shown: list[QWidget] = [self._follow, self._fit]
        return [self._go, self._cancel, *shown] if self._may_go and self.console.scenario.places else shown

    def focus_target(self) -> QWidget:
        return self.view

    def sizeHint(self) -> QSize:
        return QSize(420, 300)

    def minimumSizeHint(self) -> QSize:
        return QSize(240, 96)

    def _go_to(self, place: str) -> None:
        self._popover.hide()
        self.console.go_to_place(place)

    def _open_go_menu(self) -> None:
        self._go_menu.popup(self._go.mapToGlobal(QPoint(0, self._go.height() + 4)))

    def _on_fit_clicked(self) -> None:
        self._follow.setChecked(False)
        self.view.fit()

    def _on_place_clicked(self, name: str, where: QPointF) -> None:
        if self._may_go:
            self._popover.open_at(name, where)

    def _on_popover_go(self) -> None:
        self._go_to(self._popover.place)

    def _on_pose_changed(self, pose: RobotPose) -> None:
        self.view.show_pose(pose)

    def _on_goal_changed(self, goal: GoalChanged | None) -> None:
        self.view.show_goal(goal if goal is not None and goal.state in words.UNDER_WAY else None)
        going = goal is not None and goal.state in words.UNDER_WAY
        self._cancel.setVisible(going)
        self._go.setVisible(not going)
        self._refresh()

    def _on_freshness_changed(self, _freshness: str = "") -> None:
        state = self.state
        if state.map.freshness == "none":
            self.view.show_map(None)
        if state.pose.freshness == "none":
            self.view.show_pose(None)
        self.view.show_freshness(pose=state.pose.freshness, scan=state.scan.freshness)
        self._refresh()

    def _refresh(self) -> None:
        state = self.state
        scan_age_s = state.scan.age_s()
        match state.scan.freshness:
            case "fresh":
                text, role = f"LIDAR {words.age(scan_age_s or 0.0)}", "dim"
            case "stale" | "lost":
                text, role = f"LIDAR silent for {words.age(scan_age_s or 0.0)}", "amber"
            case _:
                text, role = "no LIDAR yet", "dim"
        goal = state.goal.value
        if goal is not None and goal.state in words.UNDER_WAY:
            left = f" · {goal.distance_left_m:.1f} m left" if goal.distance_left_m is not None else ""
            text, role = f"going to {goal.place or 'a point'}{left}", "green"
        elif self.view.follow:
            text += " · follows robot"
        self.set_fact(text, role)


class MapView(QWidget):
    """Draws everything that has a place in the map. North is up, metres scale to pixels."""

    follow_changed = Signal(bool)
    place_clicked = Signal(str, QPointF)

    def __init__(self, theme: Theme, panel: Panel, places: tuple[Place, ...]) -> None:
        super().__init__(panel)
        self._theme = theme
        self._panel = panel
        self._places = places
        self._grid: OccupancyGrid | None = None
        self._rendering: _GridRendering | None = None
        self._shown_grid: OccupancyGrid | None = None
        self._grid_image: QImage | None = None
        self._grid_bounds = QRectF()
        self._pose: Pose2D | None = None
        self._pose_freshness = "none"
        self._scan_points_m: NDArray[np.float64] | None = None
        self._scan_freshness = "none"
        self._goal: GoalChanged | None = None
        self._center = QPointF(0.0, 0.0)  # metres in the map
        self._scale = 40.0
        self._fitted = False
        self.follow = False
        self._drag_from: QPointF | None = None
        self._dragged = False
        self._place_rects: dict[str, QRectF] = {}
        self._hovered: str | None = None
        self._soon = QTimer(self, singleShot=True, interval=REPAINT_MS)
        self._soon.timeout.connect(self.update)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setMouseTracking(True)
        self.setAccessibleName("Map with the robot's position")
        theme.changed.connect(self._on_theme_changed)

    def show_map(self, grid: OccupancyGrid | None) -> None:
        self._grid = grid
        self._render_grid()
        self.update()

    def show_pose(self, pose: RobotPose | None) -> None:
        self._pose = None if pose is None else pose.pose_in_map
        if self._pose is not None and self.follow and self._drag_from is None:
            self._center = QPointF(self._pose.x_m, self._pose.y_m)
        self._update_soon()

    def show_scan(self, scan: LaserScan) -> None:
        # Points are placed with the pose of their own moment, so they do not swim when only the pose moves on.
        self._scan_points_m = None if self._pose is None else scan_points_in_map(scan, self._pose)
        self._update_soon()

    def _update_soon(self) -> None:
        if not self._soon.isActive():
            self._soon.start()

    def show_goal(self, goal: GoalChanged | None) -> None:
        self._goal = goal
        self.update()

    def show_freshness(self, *, pose: str, scan: str) -> None:
        self._pose_freshness, self._scan_freshness = pose, scan
        self.update()

    def set_follow(self, follow: bool) -> None:
        if follow != self.follow:
            self.follow = follow
            if follow:
                self._scale = max(self._scale, 45.0)
                if self._pose is not None:
                    self._center = QPointF(self._pose.x_m, self._pose.y_m)
            self.follow_changed.emit(follow)
            self.update()

    def fit(self) -> None:
        """Show the known part of the map, the places and the robot."""
        points = [QPointF(place.pose_in_map.x_m, place.pose_in_map.y_m) for place in self._places]
        if self._pose is not None:
            points.append(QPointF(self._pose.x_m, self._pose.y_m))
        bounds = QPolygonF(points).boundingRect().adjusted(-1.2, -1.2, 1.2, 1.2) if points else QRectF()
        bounds = bounds.united(self._grid_bounds) if not self._grid_bounds.isEmpty() else bounds
        if bounds.isEmpty() or self.width() < 20:
            return
        self._center = bounds.center()
        self._scale = min(
            max(min((self.width() - 24) / bounds.width(), (self.height() - 24) / bounds.height()), _MIN_SCALE),
            _MAX_SCALE,
        )
        self._fitted = True
        self.update()

    def place_position(self, name: str) -> QPoint | None:
        """Where a place is in this widget, for pointing at it."""
        place = next((place for place in self._places if place.name == name), None)
        return None if place is None else self.to_view(place.pose_in_map.x_m, place.pose_in_map.y_m).toPoint()

    def to_view(self, x_m: float, y_m: float) -> QPointF:
        return QPointF(
            self.width() / 2 + (x_m - self._center.x()) * self._scale,
            self.height() / 2 - (y_m - self._center.y()) * self._scale,
        )

    def to_map(self, point: QPointF) -> QPointF:
        return QPointF(
            self._center.x() + (point.x() - self.width() / 2) / self._scale,
            self._center.y() - (point.y() - self.height() / 2) / self._scale,
        )

    def _on_theme_changed(self) -> None:
        self._render_grid()
        self.update()

    def _render_grid(self) -> None:
        if self._grid is None:
            self._rendering = None
            self._grid_image, self._grid_bounds = None, QRectF()
        elif self._rendering is None or self._grid.cells.size <= CELLS_AT_ONCE:
            self._rendering = _GridRendering(self._grid, self._theme)
            self._render_more()
        # Else a large map is on its way; the newest one is begun when that is done.

    def _render_more(self) -> None:
        rendering = self._rendering
        if rendering is None:
            return
        rendering.render_band()
        if not rendering.done:
            QTimer.singleShot(0, self, self._render_more)
            return
        self._rendering = None
        first = self._grid_image is None
        self._grid_image, self._grid_bounds = rendering.image, rendering.bounds_in_map()
        self._shown_grid = rendering.grid
        if first or not self._fitted:
            self.fit()
        self.update()
        if self._grid is not None and self._grid is not rendering.grid:
            self._render_grid()

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        path = self._panel.card_path().translated(-QPointF(self.pos()))
        painter.fillPath(path, self._theme.color("map_unknown"))
        painter.setClipPath(path)
        self._paint_grid(painter)
        self._paint_scan(painter)
        self._paint_goal(painter)
        self._paint_places(painter)
        if self._pose is not None and self._pose_freshness != "none":
            self._paint_robot(painter, self._pose)
        elif self._grid is None:
            self._paint_words(painter)
        self._paint_scale_bar(painter)
        painter.setClipping(False)
        painter.setPen(QPen(self._theme.color("blue" if self._panel.active else "line"), 1))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.drawPath(path)

    def _paint_words(self, painter: QPainter) -> None:
        painter.setFont(self._theme.font())
        painter.setPen(self._theme.color("dim"))
        painter.drawText(self.rect(), Qt.AlignmentFlag.AlignCenter, "Waiting for the map")

    def _paint_grid(self, painter: QPainter) -> None:
        grid = self._shown_grid
        if grid is None or self._grid_image is None:
            return
        corner = grid.origin_in_map
        transform = QTransform()
        at = self.to_view(corner.x_m, corner.y_m)
        transform.translate(at.x(), at.y())
        transform.rotate(-math.degrees(corner.heading_rad))
        transform.scale(grid.resolution_m * self._scale, -grid.resolution_m * self._scale)
        painter.save()
        painter.setTransform(transform, True)
        painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform, grid.resolution_m * self._scale < 3.0)
        painter.drawImage(QPointF(0, 0), self._grid_image)
        painter.restore()

    def _paint_scan(self, painter: QPainter) -> None:
        points_m = self._scan_points_m
        if points_m is None or self._scan_freshness not in ("fresh", "stale"):
            return
        center, scale = self._center, self._scale
        points_px = (points_m - (center.x(), center.y())) * (scale, -scale) + (self.width() / 2, self.height() / 2)
        dots = distinct_dots(points_px, self.width(), self.height())
        color = self._theme.color("blue")
        color.setAlpha(230 if self._scan_freshness == "fresh" else 80)
        painter.setPen(QPen(color, 3, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
        painter.drawPoints([QPoint(x, y) for x, y in dots.tolist()])

    def _paint_goal(self, painter: QPainter) -> None:
        if self._goal is None:
            return
        target = self.to_view(self._goal.target_in_map.x_m, self._goal.target_in_map.y_m)
        pen = QPen(self._theme.color("green"), 2.5)
        pen.setDashPattern([4, 3])
        painter.setPen(pen)
        painter.setBrush(Qt.BrushStyle.NoBrush)
        if self._pose is not None:
            painter.drawLine(self.to_view(self._pose.x_m, self._pose.y_m), target)
        painter.setPen(QPen(self._theme.color("green"), 2.5))
        painter.drawEllipse(target, 9, 9)

    def _paint_places(self, painter: QPainter) -> None:
        font = self._theme.font(tokens.STATUS_PX, tokens.WEIGHT_MEDIUM)
        metrics = QFontMetricsF(font)
        painter.setFont(font)
        self._place_rects.clear()
        marks = {place.name: self.to_view(place.pose_in_map.x_m, place.pose_in_map.y_m) for place in self._places}
        taken = [QRectF(at.x() - 9, at.y() - 9, 18, 18) for at in marks.values()]
        if self._pose is not None:
            robot = self.to_view(self._pose.x_m, self._pose.y_m)
            taken.append(QRectF(robot.x() - 13, robot.y() - 38, 26, 44))
        goal_place = self._goal.place if self._goal is not None else None
        # The goal and the place under the pointer get their words first; what finds no room keeps its flag.
        order = sorted(marks, key=lambda name: (name != goal_place, name != self._hovered))
        for name in order:
            at, width = marks[name], metrics.horizontalAdvance(name) + 12
            going = name == goal_place
            hit = QRectF(at.x() - 11, at.y() - 11, 22, 22)
            label = self._free_room(at, width, taken)
            if label is None and (going or name == self._hovered):
                label = QRectF(min(max(4.0, at.x() - width / 2), self.width() - width - 4), at.y() - 32, width, 20)
            ground = self._theme.color("panel")
            painter.setPen(QPen(self._theme.color("green" if going else "line_strong"), 1.5))
            painter.setBrush(ground)
            painter.drawEllipse(at, 9, 9)
            flag = QRectF(at.x() - 6.5, at.y() - 6.5, 13, 13)
            draw_icon(painter, flag, "flag", self._theme.color("green" if going else "text"))
            if label is not None:
                taken.append(label)
                hit = hit.united(label)
                ground.setAlpha(220)
                painter.setPen(Qt.PenStyle.NoPen)
                painter.setBrush(ground)
                painter.drawRoundedRect(label, 5, 5)
                painter.setPen(self._theme.color("green" if going else "text"))
                painter.drawText(label, Qt.AlignmentFlag.AlignCenter, name)
            self._place_rects[name] = hit

    def _free_room(self, at: QPointF, width: float, taken: list[QRectF]) -> QRectF | None:
        """Room for a label right of, left of, above or below its flag that covers nothing."""
        room = QRectF(self.rect()).adjusted(2, 2, -2, -2)
        for left, top in ((11, -10), (-11 - width, -10), (-width / 2, -31), (-width / 2, 11)):
            label = QRectF(at.x() + left, at.y() + top, width, 20)
            if room.contains(label) and not any(label.intersects(other) for other in taken):
                return label
        return None

    def _paint_robot(self, painter: QPainter, pose: Pose2D) -> None:
        tip = self.to_view(pose.x_m, pose.y_m)
        painter.save()
        if self._pose_freshness in ("stale", "lost"):
            painter.setOpacity(0.45)
        color = self._theme.color("blue")
        beam = self._theme.color("blue")
        beam.setAlpha(60)
        reach = max(34.0, min(70.0, self._scale * 0.9))
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(beam)
        # Qt counts angles counter-clockwise from east in sixteenths of a degree, as headings in the map do.
        painter.drawPie(
            QRectF(tip.x() - reach, tip.y() - reach, 2 * reach, 2 * reach),
            round((math.degrees(pose.heading_rad) - 27) * 16), 54 * 16,
        )  # fmt: skip
        painter.setBrush(color)
        heading = QPointF(math.cos(pose.heading_rad), -math.sin(pose.heading_rad))
        side = QPointF(-heading.y(), heading.x())
        nose = tip + heading * 19
        painter.drawPolygon(QPolygonF([nose, tip + heading * 9 + side * 6, tip + heading * 9 - side * 6]))
        painter.setPen(QPen(self._theme.color("panel"), 1.5))
        painter.drawEllipse(tip, 4, 4)
        painter.drawPath(_pin(tip))
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(self._theme.color("panel"))
        painter.drawEllipse(QPointF(tip.x(), tip.y() - 24), 5, 5)
        painter.restore()

    def _paint_scale_bar(self, painter: QPainter) -> None:
        if self._grid is None and self._pose is None:
            return
        metres = next((length for length in (0.5, 1, 2, 5, 10, 20, 50) if length * self._scale >= 44), 100)
        right, bottom = self.width() - 14.0, self.height() - 12.0
        painter.setPen(QPen(self._theme.color("dim"), 1.5))
        left = right - metres * self._scale
        painter.drawPolyline(QPolygonF([
            QPointF(left, bottom - 4), QPointF(left, bottom), QPointF(right, bottom), QPointF(right, bottom - 4),
        ]))  # fmt: skip
        painter.setFont(self._theme.font(tokens.STATUS_PX - 1))
        painter.drawText(
            QRectF(left - 40, bottom - 20, right - left + 80, 16), Qt.AlignmentFlag.AlignCenter, f"{metres:g} m"
        )

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        if self._grid_image is not None and not self.follow:
            self.fit()

    def wheelEvent(self, event: QWheelEvent) -> None:
        factor = 1.0015 ** event.angleDelta().y()
        before = self.to_map(event.position())
        self._scale = min(max(self._scale * factor, _MIN_SCALE), _MAX_SCALE)
        if not self.follow:
            after = self.to_map(event.position())
            self._center += before - after
        self.update()
        event.accept()

    def mousePressEvent(self, event: QMouseEvent) -> None:
        self.setFocus(Qt.FocusReason.MouseFocusReason)
        if event.button() == Qt.MouseButton.LeftButton:
            self._drag_from, self._dragged = event.position(), False
        super().mousePressEvent(event)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        if self._drag_from is None:
            over = self._place_at(event.position())
            self.setCursor(Qt.CursorShape.ArrowCursor if over is None else Qt.CursorShape.PointingHandCursor)
            if over != self._hovered:
                self._hovered = over
                self.update()
            return
        moved = event.position() - self._drag_from
        if self._dragged or moved.manhattanLength() > 6:
            self._dragged = True
            self.set_follow(False)
            self._center += QPointF(-moved.x() / self._scale, moved.y() / self._scale)
            self._drag_from = event.position()
            self.update()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        if self._drag_from is not None and not self._dragged:
            name = self._place_at(event.position())
            if name is not None:
                self.place_clicked.emit(name, event.position())
        self._drag_from = None
        super().mouseReleaseEvent(event)

    def _place_at(self, point: QPointF) -> str | None:
        return next((name for name, rect in self._place_rects.items() if rect.contains(point)), None)


class _GridRendering:
    """Turns a map into a picture, some rows at a time, so that a large one never holds up the keys."""

    def __init__(self, grid: OccupancyGrid, theme: Theme) -> None:
        self.grid = grid
        # int8 seen as uint8: -1 (unknown) is 255, 0..100 is how sure the map is of an obstacle.
        self._cells = np.ascontiguousarray(grid.cells).view(np.uint8)
        height, width = self._cells.shape
        self.image = QImage(width, height, QImage.Format.Format_ARGB32_Premultiplied)
        self._rows_per_band = max(1, CELLS_AT_ONCE // max(1, width))
        self._next_row = 0
        self._known_rows: list[int] = []
        self._known_columns = np.zeros(width, bool)
        free, wall = theme.color("map_free"), theme.color("map_wall")
        self._colors = []
        for value in range(256):
            share = min(1.0, max(0.0, (value - 25) / 40))
            red, green, blue = (
                round(one + (other - one) * share)
                for one, other in (
                    (free.red(), wall.red()), (free.green(), wall.green()), (free.blue(), wall.blue()),
                )
            )  # fmt: skip
            self._colors.append(0xFF000000 | red << 16 | green << 8 | blue if value <= 100 else 0)

    @property
    def done(self) -> bool:
        return self._next_row >= len(self._cells)

    def render_band(self) -> None:
        first = self._next_row
        band = self._cells[first : first + self._rows_per_band]
        rows, width = band.shape
        picture = QImage(band.data, width, rows, width, QImage.Format.Format_Indexed8)
        picture.setColorTable(self._colors)
        painter = QPainter(self.image)
        painter.setCompositionMode(QPainter.CompositionMode.CompositionMode_Source)
        painter.drawImage(0, first, picture)
        painter.end()
        known = band <= 100
        self._known_rows.extend((np.flatnonzero(known.any(axis=1)) + first)[[0, -1]] if known.any() else ())
        self._known_columns |= known.any(axis=0)
        self._next_row = first + rows

    def bounds_in_map(self) -> QRectF:
        """What the map knows of, in metres; empty for nothing."""
        if not self._known_rows:
            return QRectF()
        columns, resolution_m = np.flatnonzero(self._known_columns), self.grid.resolution_m
        corner = self.grid.origin_in_map
        first_row, last_row = self._known_rows[0], self._known_rows[-1]
        return QRectF(
            corner.x_m + float(columns[0]) * resolution_m, corner.y_m + float(first_row) * resolution_m,
            float(columns[-1] - columns[0] + 1) * resolution_m, float(last_row - first_row + 1) * resolution_m,
        )  # fmt: skip


def _pin(tip: QPointF) -> QPainterPath:
    """The drop of a map pin, its point at ``tip``."""
    x, y = tip.x(), tip.y()
    path = QPainterPath(tip)
    path.cubicTo(x - 4, y - 9, x - 13, y - 14, x - 13, y - 24)
    path.cubicTo(x - 13, y - 41, x + 13, y - 41, x + 13, y - 24)
    path.cubicTo(x + 13, y - 14, x + 4, y - 9, x, y)
    path.closeSubpath()
    return path


class _Floating(QWidget):
    """A small card over the map."""

    def __init__(self, theme: Theme, parent: QWidget) -> None:
        super().__init__(parent)
        self._theme = theme
        theme.changed.connect(self.update)

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(QPen(self._theme.color("line_strong"), 1))
        painter.setBrush(self._theme.color("panel"))
        painter.drawRoundedRect(QRectF(self.rect()).adjusted(0.5, 0.5, -0.5, -0.5), 10, 10)


class _PlacePopover(_Floating):
    """A place that was clicked, and the one thing to do with it."""

    def __init__(self, theme: Theme, parent: QWidget) -> None:
        super().__init__(theme, parent)
        self._room = parent
        self.place = ""
        self.go = ActionButton(theme, "Go there", icon="navigation-arrow", look="primary", height_px=30)
        self.go.setObjectName("map_popover_go")
        close = ActionButton(theme, "", icon="x", look="ghost", height_px=30)
        close.setAccessibleName("Close")
        close.clicked.connect(self.hide)
        row = QHBoxLayout(self)
        row.setContentsMargins(8, 8, 8, 8)
        row.setSpacing(4)
        row.addWidget(self.go)
        row.addWidget(close)
        self.hide()

    def open_at(self, place: str, where: QPointF) -> None:
        self.place = place
        self.go.set_label(f"Go to {place}")
        self.go.setObjectName(f"go_to_{place}")
        self.adjustSize()
        room = self._room.rect()
        left = min(max(6, round(where.x()) - self.width() // 2), room.width() - self.width() - 6)
        top = round(where.y()) + 16
        if top + self.height() > room.height() - 6:
            top = round(where.y()) - 16 - self.height()
        self.move(left, max(6, top))
        self.show()
        self.raise_()
