"""Draws everything that has a place in the map, and turns the pointer into places and headings on it."""

import math
import time
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QPoint, QPointF, QRectF, QSize, QSizeF, Qt, QTimer, Signal
from PySide6.QtGui import (
    QFontMetricsF,
    QImage,
    QKeyEvent,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPen,
    QPolygonF,
    QResizeEvent,
    QTransform,
    QWheelEvent,
)
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.events import GoalChanged
from caris_desktop.domain.geometry import Pose2D, wrap_angle
from caris_desktop.domain.sensing import LaserScan, OccupancyGrid, PersonPlace, RobotPose
from caris_desktop.scenario.model import Place
from caris_desktop.ui import tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.panel import Panel, draw_card_edge
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.map_layers import (
    Trail,
    distinct_dots,
    draw_arrow,
    draw_pin,
    outline_in_map,
    polygon,
    scan_points_in_map,
    thinned,
)
from caris_desktop.ui.widgets.map_raster import GridRaster
from caris_desktop.ui.widgets.painted_once import PaintedOnce

REPAINT_MS = 80
"""What the robot sends is painted at most so often: a map does not need the rate of a video."""

OCCUPIED = 65
"""Cells from this value on are obstacles, as in ROS' map_server."""

_MIN_SCALE, _MAX_SCALE = 2.0, 400.0  # pixels per metre
_DRAG_PX = 6
_AIM_PX = 12
_SMOOTH_AREA_PX = 700_000
_CHIP_COLORS = {"warning": "amber", "good": "green", "bad": "red", "hint": "text"}
_CHIP_ICONS = {"warning": "warning", "good": "check", "bad": "warning-octagon", "hint": ""}

Tool = Literal["look", "goal", "pose", "place"]


@dataclass(frozen=True, slots=True)
class Aim:
    """A place on the map that is being chosen, and the heading there as far as it is chosen."""

    at: QPointF  # metres in the map
    heading_rad: float | None
    anchored: bool  # the place was chosen before; only the heading is still open


class MapView(QWidget):
    """The map. Metres scale to pixels; up is north, or where the robot looks.

    With the tool ``look`` a drag moves the map and a click only says where it was (``ground_clicked``,
    ``place_clicked``). With another tool a press and a drag say a place and a heading (``aimed``), once; Esc or the
    right button give it up. Nothing here moves the robot.
    """

    follow_changed = Signal(bool)
    rotate_changed = Signal(bool)
    tool_changed = Signal(str)
    place_clicked = Signal(str, QPointF)
    ground_clicked = Signal(QPointF, QPointF)  # metres in the map, pixels in the view
    aimed = Signal(str, object, bool)  # tool, Pose2D, whether the heading was chosen
    moved = Signal()  # what lies under a point of the view is another place now

    def __init__(self, theme: Theme, panel: Panel, places: tuple[Place, ...] = ()) -> None:
        super().__init__(panel)
        self._theme = theme
        self._panel = panel
        self._places = places
        self._grid: OccupancyGrid | None = None
        self._raster: GridRaster | None = None  # on show
        self._rendering: GridRaster | None = None  # being made, or gone over
        self._shown_grid: OccupancyGrid | None = None
        self._grid_picture: QImage | None = None
        self._grid_key: object = None
        self._raster_version = 0
        self._pose: Pose2D | None = None
        self._pose_freshness = "none"
        self._scan_points_m: NDArray[np.float64] | None = None
        self._scan_freshness = "none"
        self._path_m: NDArray[np.float64] | None = None
        self._people: tuple[tuple[PersonPlace, str, bool], ...] = ()
        self._people_freshness = "none"
        self._outline_m: tuple[tuple[float, float], ...] = ()
        self._guard: tuple[str, float | None] = ("absent", None)
        self._goal: GoalChanged | None = None
        self._chips: list[tuple[str, str]] = []
        self._hint = ""
        self._mark: QPointF | None = None
        self._waiting = "Waiting for the map"
        self.trail = Trail()
        self.show_trail = True
        self._center = QPointF(0.0, 0.0)  # metres in the map
        self._scale = 40.0
        self._turn_rad = 0.0  # the map is drawn turned by this, counter-clockwise
        self._fitted = False
        self._viewed_by_hand = False
        self.follow = False
        self.rotate = False
        self._tool: Tool = "look"
        self._aim: Aim | None = None
        self._press: QPointF | None = None
        self._pan_from: QPointF | None = None
        self._pan_button = Qt.MouseButton.NoButton
        self._dragged = False
        self._pointer: QPointF | None = None
        self._place_rects: dict[str, QRectF] = {}
        self._hovered: str | None = None
        self._soon = QTimer(self, singleShot=True, interval=REPAINT_MS)
        self._soon.timeout.connect(self.update)
        self.left_px = 0  # covered by tools; the whole map is fitted beside them
        self.slowest_band_ms = 0.0
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setMouseTracking(True)
        self.setAccessibleName("Map with the robot's position")
        # Everything is painted, corners included: nothing that lies below is painted first.
        self.setAttribute(Qt.WidgetAttribute.WA_OpaquePaintEvent)
        self._painted = PaintedOnce()
        theme.changed.connect(self._on_theme_changed)

    # ---- what is shown

    def show_map(self, grid: OccupancyGrid | None) -> None:
        self._grid = grid
        if grid is None:
            self._raster = self._rendering = self._shown_grid = self._grid_picture = None
            self.update()
        elif self._rendering is None:
            self._begin_rendering(grid)
        # Else a map is being made; the newest one is begun when that is done.

    def show_pose(self, pose: RobotPose | None) -> None:
        self._pose = None if pose is None else pose.pose_in_map
        if self._pose is not None:
            self.trail.add(self._pose)
            if self._press is None and self._pan_from is None and self._aim is None:
                self._keep_up_with(self._pose)
        self._update_soon()

    def show_scan(self, scan: LaserScan | None) -> None:
        # Points are placed with the pose of their own moment, so they do not swim when only the pose moves on.
        here = self._pose
        self._scan_points_m = None if scan is None or here is None else scan_points_in_map(scan, here)
        self._update_soon()

    def show_path(self, points_in_map: NDArray[np.float32] | None) -> None:
        self._path_m = None if points_in_map is None or len(points_in_map) < 2 else thinned(points_in_map)
        self._update_soon()

    def show_people(self, people: tuple[tuple[PersonPlace, str, bool], ...], freshness: str) -> None:
        """Where people are, what they are called, and whether that is a name that the wizard gave."""
        self._people, self._people_freshness = people, freshness
        self._update_soon()

    def show_robot(self, outline_m: tuple[tuple[float, float], ...]) -> None:
        self._outline_m = outline_m
        self.update()

    def show_guard(self, state: str, distance_m: float | None) -> None:
        if (state, distance_m) != self._guard:
            self._guard = (state, distance_m)
            self._update_soon()

    def show_places(self, places: tuple[Place, ...]) -> None:
        self._places = places
        self.update()

    def show_goal(self, goal: GoalChanged | None) -> None:
        self._goal = goal
        self._update_soon()

    def show_chips(self, chips: list[tuple[str, str]]) -> None:
        """Lines of (words, role) at the upper edge; a role is warning, good, bad or hint."""
        if chips != self._chips:
            self._chips = chips
            self.update()

    @property
    def chips(self) -> list[tuple[str, str]]:
        return self._chips

    def show_mark(self, at: QPointF | None) -> None:
        """A ring around the point of the map that a card asks about."""
        if at != self._mark:
            self._mark = at
            self.update()

    def show_hint(self, hint: str) -> None:
        if hint != self._hint:
            self._hint = hint
            self.update()

    @property
    def hint(self) -> str:
        return self._hint

    def show_waiting(self, words: str) -> None:
        if words != self._waiting:
            self._waiting = words
            self.update()

    def show_freshness(self, *, pose: str, scan: str) -> None:
        if (pose, scan) != (self._pose_freshness, self._scan_freshness):
            self._pose_freshness, self._scan_freshness = pose, scan
            self.update()

    def clear_trail(self) -> None:
        self.trail.clear()
        self.update()

    def set_trail_shown(self, shown: bool) -> None:
        self.show_trail = shown
        self.update()

    def _update_soon(self) -> None:
        if not self._soon.isActive():
            self._soon.start()

    # ---- where the view is

    def set_follow(self, follow: bool) -> None:
        if follow != self.follow:
            self.follow = follow
            if follow:
                self._scale = max(self._scale, 45.0)
                if self._pose is not None:
                    self._center = QPointF(self._pose.x_m, self._pose.y_m)
            self.follow_changed.emit(follow)
            self.update()

    def set_rotate(self, rotate: bool) -> None:
        """Turn the map so that up is where the robot looks; north again without."""
        if rotate != self.rotate:
            self.rotate = rotate
            self._turn_rad = 0.0
            if rotate and self._pose is not None:
                self._turn_rad = wrap_angle(math.pi / 2 - self._pose.heading_rad)
            self.rotate_changed.emit(rotate)
            self.moved.emit()
            self.update()

    def _keep_up_with(self, pose: Pose2D) -> None:
        if self.follow:
            self._center = QPointF(pose.x_m, pose.y_m)
        if self.rotate:
            self._turn_rad = wrap_angle(math.pi / 2 - pose.heading_rad)
        if self.follow or self.rotate:
            self.moved.emit()

    def fit(self) -> None:
        """Show the known part of the map, the places and the robot."""
        points = [QPointF(place.pose_in_map.x_m, place.pose_in_map.y_m) for place in self._places]
        if self._pose is not None:
            points.append(QPointF(self._pose.x_m, self._pose.y_m))
        cos, sin = math.cos(self._turn_rad), math.sin(self._turn_rad)

        def turned(x_m: float, y_m: float) -> QPointF:
            return QPointF(cos * x_m - sin * y_m, sin * x_m + cos * y_m)

        bounds = QRectF()
        if points:
            bounds = QPolygonF([turned(point.x(), point.y()) for point in points]).boundingRect()
            bounds = bounds.adjusted(-1.2, -1.2, 1.2, 1.2)
        if self._raster is not None:
            known = self._raster.bounds_in_grid()
            if not known.isEmpty():
                corner = self._raster.grid.origin_in_map
                corners = [
                    corner @ Pose2D(x_m, y_m, 0.0)
                    for x_m in (known.left(), known.right())
                    for y_m in (known.top(), known.bottom())
                ]
                bounds = bounds.united(QPolygonF([turned(at.x_m, at.y_m) for at in corners]).boundingRect())
        if bounds.isEmpty() or self.width() < 20:
            return
        self._scale = min(
            max(min((self.width() - self.left_px - 24) / bounds.width(), (self.height() - 24) / bounds.height()),
                _MIN_SCALE),
            _MAX_SCALE,
        )  # fmt: skip
        middle = bounds.center() - QPointF(self.left_px / 2 / self._scale, 0.0)
        self._center = QPointF(cos * middle.x() + sin * middle.y(), -sin * middle.x() + cos * middle.y())
        self._fitted, self._viewed_by_hand = True, False
        self.moved.emit()
        self.update()

    def zoom(self, factor: float, about: QPointF | None = None) -> None:
        """Show more or less, with the point ``about`` of the view staying where it is."""
        point = about if about is not None and not self.follow else QPointF(self.width() / 2, self.height() / 2)
        before = self.to_map(point)
        self._scale = min(max(self._scale * factor, _MIN_SCALE), _MAX_SCALE)
        self._center += before - self.to_map(point)
        self._viewed_by_hand = True
        self.moved.emit()
        self.update()

    def place_position(self, name: str) -> QPoint | None:
        """Where a place is in this widget, for pointing at it."""
        place = next((place for place in self._places if place.name == name), None)
        return None if place is None else self.to_view(place.pose_in_map.x_m, place.pose_in_map.y_m).toPoint()

    def view_transform(self) -> QTransform:
        """From metres in the map to pixels in the view."""
        transform = QTransform()
        transform.translate(self.width() / 2, self.height() / 2)
        transform.scale(self._scale, -self._scale)
        transform.rotateRadians(self._turn_rad)
        transform.translate(-self._center.x(), -self._center.y())
        return transform

    def to_view(self, x_m: float, y_m: float) -> QPointF:
        return self.view_transform().map(QPointF(x_m, y_m))

    def to_map(self, point: QPointF) -> QPointF:
        inverted, _possible = self.view_transform().inverted()
        return inverted.map(point)

    def occupancy_at(self, at: QPointF) -> int | None:
        """0..100 at a point of the map, None where the map knows nothing."""
        return None if self._raster is None else self._raster.value_at(at.x(), at.y())

    # ---- the grid, some rows at a time

    def _on_theme_changed(self) -> None:
        for raster in (self._raster, self._rendering):
            if raster is not None:
                raster.color(self._theme)
        self._grid_key = None
        self._painted.clear()
        self.update()

    def _begin_rendering(self, grid: OccupancyGrid) -> None:
        if self._raster is not None and self._raster.fits(grid):
            self._rendering = self._raster
            self._rendering.begin(grid)
        else:
            self._rendering = GridRaster(grid)
            self._rendering.color(self._theme)
        self._render_more()

    def _render_more(self) -> None:
        rendering = self._rendering
        if rendering is None:
            return
        began_s = time.perf_counter()
        rendering.render_band()
        self.slowest_band_ms = max(self.slowest_band_ms, (time.perf_counter() - began_s) * 1e3)
        if not rendering.done:
            QTimer.singleShot(0, self, self._render_more)
            return
        self._rendering = None
        first = self._raster is None
        self._raster = rendering
        self._shown_grid = rendering.grid
        if rendering.rows_changed:
            self._raster_version += 1
        if first or not self._fitted:
            self.fit()
        self.update()
        if self._grid is not None and self._grid is not rendering.grid:
            self._begin_rendering(self._grid)

    # ---- painting

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self._raster is None:
            painter.fillRect(self.rect(), self._theme.color("map_unknown"))
        self._paint_grid(painter)
        self._paint_trail(painter)
        self._paint_scan(painter)
        self._paint_goal(painter)
        self._paint_places(painter)
        self._paint_people(painter)
        if self._pose is not None and self._pose_freshness != "none":
            self._paint_robot(painter, self._pose)
        if self._grid is None:
            self._paint_waiting(painter)
        self._paint_aim(painter)
        self._paint_scale_bar(painter)
        self._paint_chips(painter)
        draw_card_edge(painter, self._theme, QRectF(self.rect()), self._painted, active=self._panel.active)

    def _paint_waiting(self, painter: QPainter) -> None:
        painter.setFont(self._theme.font())
        painter.setPen(self._theme.color("dim"))
        where = QRectF(self.rect())
        if self._pose is not None:
            where = QRectF(0, where.height() - 40, where.width(), 30)
        painter.drawText(where, Qt.AlignmentFlag.AlignCenter, self._waiting)

    def _paint_grid(self, painter: QPainter) -> None:
        raster = self._raster
        if raster is None:
            return
        ratio = self.devicePixelRatioF()
        key = (
            id(raster), self._raster_version, self.size(), ratio,
            self._scale, self._turn_rad, self._center.x(), self._center.y(),
        )  # fmt: skip
        if key != self._grid_key or self._grid_picture is None:
            size = QSize(round(self.width() * ratio), round(self.height() * ratio))
            if self._grid_picture is None or self._grid_picture.size() != size:
                self._grid_picture = QImage(size, QImage.Format.Format_RGB32)
            self._grid_picture.setDevicePixelRatio(ratio)
            self._grid_picture.fill(self._theme.color("map_unknown"))
            onto = QPainter(self._grid_picture)
            corner = raster.grid.origin_in_map
            level = raster.level_for(raster.grid.resolution_m * self._scale * ratio)
            cell_m = raster.grid.resolution_m * 2**level
            transform = QTransform()
            transform.translate(corner.x_m, corner.y_m)
            transform.rotateRadians(corner.heading_rad)
            transform.scale(cell_m, cell_m)
            to_view = transform * self.view_transform()
            onto.setTransform(to_view)
            small = size.width() * size.height() <= _SMOOTH_AREA_PX
            smooth = small and cell_m * self._scale < 3.0
            onto.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform, smooth)
            # Qt draws bytes with a colour table at a quarter of the speed; what is in view is few cells.
            seen = to_view.inverted()[0].mapRect(QRectF(self.rect())).toAlignedRect().adjusted(-1, -1, 1, 1)
            seen = seen.intersected(raster.images[level].rect())
            if not seen.isEmpty():
                cells = raster.images[level].copy(seen).convertToFormat(QImage.Format.Format_RGB32)
                onto.drawImage(QPointF(seen.topLeft()), cells)
            onto.end()
            self._grid_key = key
        painter.drawImage(QPointF(0, 0), self._grid_picture)

    def _paint_trail(self, painter: QPainter) -> None:
        if not self.show_trail or len(self.trail) < 2:
            return
        to_view = self.view_transform()
        color = self._theme.color("blue")
        painter.setRenderHint(QPainter.RenderHint.Antialiasing, False)
        for strength, points_m in self.trail.pieces():
            color.setAlpha(round(30 + 110 * strength))
            painter.setPen(QPen(color, 2))
            painter.drawPolyline(polygon(thinned(points_m.astype(np.float32), 160), to_view))
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)

    def _paint_scan(self, painter: QPainter) -> None:
        points_m = self._scan_points_m
        if points_m is None or self._scan_freshness not in ("fresh", "stale"):
            return
        to_view = self.view_transform()
        matrix = np.array([[to_view.m11(), to_view.m12()], [to_view.m21(), to_view.m22()]])
        points_px = points_m @ matrix + (to_view.dx(), to_view.dy())
        dots = distinct_dots(points_px, self.width(), self.height())
        dot = self._painted.picture(painter, QSizeF(3, 3), ("dot", self._scan_freshness), self._paint_dot)
        # Copied dot by dot in less than a third of the time that Qt takes for points with a pen of this width.
        for x, y in dots.tolist():
            painter.drawPixmap(x - 1, y - 1, dot)

    def _paint_dot(self, onto: QPainter) -> None:
        color = self._theme.color("blue")
        color.setAlpha(230 if self._scan_freshness == "fresh" else 80)
        onto.setPen(Qt.PenStyle.NoPen)
        onto.setBrush(color)
        onto.drawEllipse(QRectF(0, 0, 3, 3))

    def _paint_goal(self, painter: QPainter) -> None:
        if self._goal is None:
            return
        goal, color = self._goal.target_in_map, self._theme.color("green")
        target = self.to_view(goal.x_m, goal.y_m)
        painter.setBrush(Qt.BrushStyle.NoBrush)
        if self._path_m is not None:
            painter.setPen(QPen(color, 2.5, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
            painter.drawPolyline(polygon(self._path_m, self.view_transform()))
        elif self._pose is not None:
            # Not how it will drive, only where to: dashed, until the robot tells its path.
            pen = QPen(color, 2.5)
            pen.setDashPattern([4, 3])
            painter.setPen(pen)
            painter.drawLine(self.to_view(self._pose.x_m, self._pose.y_m), target)
        draw_arrow(painter, target, goal.heading_rad + self._turn_rad, color=color, length_px=30)

    def _paint_places(self, painter: QPainter) -> None:
        font = self._theme.font(tokens.STATUS_PX, tokens.WEIGHT_MEDIUM)
        metrics = QFontMetricsF(font)
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
            self._painted.draw(
                painter, at - QPointF(10, 10), QSizeF(20, 20), ("flag", going), partial(self._paint_flag, going)
            )
            if label is not None:
                taken.append(label)
                hit = hit.united(label)
                self._paint_label(painter, label, name, color="green" if going else "text", weight=tokens.WEIGHT_MEDIUM)
            self._place_rects[name] = hit

    def _paint_flag(self, going: bool, onto: QPainter) -> None:
        onto.setPen(QPen(self._theme.color("green" if going else "line_strong"), 1.5))
        onto.setBrush(self._theme.color("panel"))
        onto.drawEllipse(QPointF(10, 10), 9, 9)
        draw_icon(onto, QRectF(3.5, 3.5, 13, 13), "flag", self._theme.color("green" if going else "text"))

    def _paint_label(self, painter: QPainter, label: QRectF, name: str, *, color: str, weight: int) -> None:
        """A name on a ground that the map shines through; a picture kept for as long as it says the same."""

        def paint(onto: QPainter) -> None:
            whole, ground = QRectF(QPointF(0, 0), label.size()), self._theme.color("panel")
            ground.setAlpha(220)
            onto.setPen(Qt.PenStyle.NoPen)
            onto.setBrush(ground)
            onto.drawRoundedRect(whole, 5, 5)
            onto.setFont(self._theme.font(tokens.STATUS_PX, weight))
            onto.setPen(self._theme.color(color))
            onto.drawText(whole, Qt.AlignmentFlag.AlignCenter, name)

        self._painted.draw(painter, label.topLeft(), label.size(), ("label", name, color, weight), paint)

    def _free_room(self, at: QPointF, width: float, taken: list[QRectF]) -> QRectF | None:
        """Room for a label right of, left of, above or below its flag that covers nothing."""
        room = QRectF(self.rect()).adjusted(2, 2, -2, -2)
        for left, top in ((11, -10), (-11 - width, -10), (-width / 2, -31), (-width / 2, 11)):
            label = QRectF(at.x() + left, at.y() + top, width, 20)
            if room.contains(label) and not any(label.intersects(other) for other in taken):
                return label
        return None

    def _paint_people(self, painter: QPainter) -> None:
        if self._people_freshness not in ("fresh", "stale"):
            return
        font = self._theme.font(tokens.STATUS_PX, tokens.WEIGHT_SEMIBOLD)
        metrics = QFontMetricsF(font)
        painter.save()
        if self._people_freshness == "stale":
            painter.setOpacity(0.45)
        for person, name, named in self._people:
            at = self.to_view(person.x_m, person.y_m)
            color = self._theme.color("green" if named else "text")
            ring = max(9.0, person.spread_m * self._scale)
            pen = QPen(color, 1.5)
            pen.setDashPattern([3, 3])
            painter.setPen(pen)
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawEllipse(at, ring, ring)
            # As in the list of people: filled with a name, an outline without.
            painter.setPen(QPen(self._theme.color("panel") if named else color, 1.5))
            painter.setBrush(color if named else self._theme.color("panel"))
            painter.drawEllipse(at, 6, 6)
            label = QRectF(at.x() + 10, at.y() - 10, metrics.horizontalAdvance(name) + 10, 20)
            role = "green" if named else "text"
            self._paint_label(painter, label, name, color=role, weight=tokens.WEIGHT_SEMIBOLD)
        painter.restore()

    def _paint_robot(self, painter: QPainter, pose: Pose2D) -> None:
        tip = self.to_view(pose.x_m, pose.y_m)
        stale = self._pose_freshness in ("stale", "lost")
        color = self._theme.color("dim" if stale else "blue")
        if self._outline_m:
            outline = polygon(outline_in_map(self._outline_m, pose), self.view_transform())
            ground = self._theme.color("blue")
            ground.setAlpha(0 if stale else 40)
            pen = QPen(color, 1.5, Qt.PenStyle.DashLine if stale else Qt.PenStyle.SolidLine)
            painter.setPen(pen)
            painter.setBrush(ground)
            painter.drawPolygon(outline)
        state, distance_m = self._guard
        if not stale and state in ("slowing", "blocked") and distance_m is not None:
            # How much room is left in front of the footprint, whichever way it drives.
            reach_m = max((math.hypot(x, y) for x, y in self._outline_m), default=0.25) + distance_m
            radius = reach_m * self._scale
            role = "red" if state == "blocked" else "amber"
            painter.setPen(QPen(self._theme.color(role), 2, Qt.PenStyle.DotLine))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawEllipse(tip, radius, radius)
        draw_pin(
            painter, tip, pose.heading_rad + self._turn_rad, color=color, ground=self._theme.color("panel"),
            beam_px=max(34.0, min(70.0, self._scale * 0.9)), hollow=stale,
        )  # fmt: skip

    def _paint_aim(self, painter: QPainter) -> None:
        aim = self._aim
        if self._tool == "look":
            if self._mark is not None:
                painter.setPen(QPen(self._theme.color("amber" if self.refusal_at(self._mark) else "green"), 2.5))
                painter.setBrush(Qt.BrushStyle.NoBrush)
                painter.drawEllipse(self.to_view(self._mark.x(), self._mark.y()), 9, 9)
            return
        at = aim.at if aim is not None else (self.to_map(self._pointer) if self._pointer is not None else None)
        if at is None:
            return
        heading_rad = aim.heading_rad if aim is not None else None
        color = self._theme.color("amber" if self.refusal_at(at) else "green" if self._tool == "goal" else "blue")
        point = self.to_view(at.x(), at.y())
        if heading_rad is not None:
            draw_arrow(painter, point, heading_rad + self._turn_rad, color=color, length_px=46)
            return
        pen = QPen(color, 2)
        pen.setDashPattern([3, 2])
        painter.setPen(pen)
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.drawEllipse(point, 9, 9)

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
        if self.rotate:
            north = self._turn_rad + math.pi / 2
            at = QPointF(self.width() - 30.0, bottom - 50)
            out = QPointF(math.cos(north), -math.sin(north))
            side = QPointF(-out.y(), out.x())
            painter.drawText(QRectF(at.x() - 9, at.y() - 9, 18, 18), Qt.AlignmentFlag.AlignCenter, "N")
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(self._theme.color("dim"))
            painter.drawPolygon(QPolygonF([at + out * 19, at + out * 11 + side * 5, at + out * 11 - side * 5]))

    def _paint_chips(self, painter: QPainter) -> None:
        font = self._theme.font(tokens.STATUS_PX, tokens.WEIGHT_MEDIUM)
        metrics = QFontMetricsF(font)
        painter.setFont(font)
        top = 8.0
        left_room = 48.0  # the tools are there
        for text, role in self._chips:
            self._paint_chip(painter, metrics, text, role, left_room=left_room, top=top)
            top += 28
        if self._hint:
            self._paint_chip(painter, metrics, self._hint, "hint", left_room=left_room, top=self.height() - 34.0)

    def _paint_chip(
        self, painter: QPainter, metrics: QFontMetricsF, text: str, role: str, *, left_room: float, top: float
    ) -> None:
        icon = _CHIP_ICONS.get(role, "")
        extra = 38.0 if icon else 20.0
        shown = metrics.elidedText(text, Qt.TextElideMode.ElideRight, max(40.0, self.width() - left_room - 12 - extra))
        width = metrics.horizontalAdvance(shown) + extra
        middle = left_room + (self.width() - left_room - 12) / 2
        chip = QRectF(middle - width / 2, top, width, 24)
        color = self._theme.color(_CHIP_COLORS.get(role, "text"))
        painter.setPen(QPen(color if role != "hint" else self._theme.color("line_strong"), 1))
        painter.setBrush(self._theme.color("panel"))
        painter.drawRoundedRect(chip.adjusted(0.5, 0.5, -0.5, -0.5), 8, 8)
        if icon:
            draw_icon(painter, QRectF(chip.left() + 9, chip.top() + 4, 16, 16), icon, color)
            chip.adjust(18, 0, 0, 0)
        painter.setPen(color)
        painter.drawText(chip, Qt.AlignmentFlag.AlignCenter, shown)

    # ---- pointer and keys

    @property
    def tool(self) -> Tool:
        return self._tool

    @property
    def aim(self) -> Aim | None:
        return self._aim

    def set_tool(self, tool: Tool, *, at: QPointF | None = None) -> None:
        """Take a tool. With ``at`` the place is chosen already, and the next click says the heading."""
        changed = tool != self._tool
        self._tool = tool
        self._aim = Aim(at, None, anchored=True) if tool != "look" and at is not None else None
        self._press = None
        self.setCursor(Qt.CursorShape.ArrowCursor if tool == "look" else Qt.CursorShape.CrossCursor)
        if changed or at is not None:
            self.tool_changed.emit(tool)
        self.update()

    def give_up(self) -> None:
        """Esc: whatever was begun on the map is forgotten."""
        self._press = self._pan_from = None
        if self._tool != "look":
            self.set_tool("look")

    def refusal_at(self, at: QPointF) -> str:
        """Why the robot cannot be there; empty where it can."""
        value = self.occupancy_at(at)
        if value is not None and value >= OCCUPIED:
            return "There is an obstacle: choose free ground"
        return ""

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        if self._raster is not None and not self.follow and not self._viewed_by_hand:
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
                self.set_rotate(not self.rotate)
            case _:
                super().keyPressEvent(event)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        self.setFocus(Qt.FocusReason.MouseFocusReason)
        point, button = event.position(), event.button()
        if button == Qt.MouseButton.LeftButton and self._tool != "look":
            self._press = point
            if self._aim is None or not self._aim.anchored:
                self._aim = Aim(self.to_map(point), None, anchored=False)
            else:
                self._turn_aim_to(point)
            self.update()
        elif button == Qt.MouseButton.RightButton and self._tool != "look":
            self.give_up()
        elif self._pan_from is None:
            self._pan_from, self._pan_button, self._dragged = point, button, False
        event.accept()

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        point = event.position()
        self._pointer = point
        if self._pan_from is not None:
            moved = point - self._pan_from
            if self._dragged or moved.manhattanLength() > _DRAG_PX:
                self._dragged = True
                self.set_follow(False)
                self._center += self.to_map(self._pan_from) - self.to_map(point)
                self._pan_from = point
                self._viewed_by_hand = True
                self.setCursor(Qt.CursorShape.ClosedHandCursor)
                self.moved.emit()
                self.update()
            return
        if self._tool != "look":
            if self._aim is not None and (self._press is not None or self._aim.anchored):
                self._turn_aim_to(point)
            self.update()
            return
        over = self._place_at(point)
        self.setCursor(Qt.CursorShape.ArrowCursor if over is None else Qt.CursorShape.PointingHandCursor)
        if over != self._hovered:
            self._hovered = over
            self.update()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        point = event.position()
        if self._pan_from is not None and event.button() == self._pan_button:
            dragged, self._pan_from = self._dragged, None
            self.setCursor(Qt.CursorShape.ArrowCursor if self._tool == "look" else Qt.CursorShape.CrossCursor)
            if not dragged and self._tool == "look" and self._pan_button != Qt.MouseButton.MiddleButton:
                name = self._place_at(point)
                if name is not None:
                    self.place_clicked.emit(name, point)
                else:
                    self.ground_clicked.emit(self.to_map(point), point)
        elif self._press is not None and event.button() == Qt.MouseButton.LeftButton:
            self._finish_aim()
        event.accept()

    def leaveEvent(self, event: object) -> None:
        self._pointer = None
        self.update()

    def _turn_aim_to(self, point: QPointF) -> None:
        aim = self._aim
        if aim is None:
            return
        away = point - self.to_view(aim.at.x(), aim.at.y())
        heading_rad = None
        if math.hypot(away.x(), away.y()) >= _AIM_PX:
            heading_rad = wrap_angle(math.atan2(-away.y(), away.x()) - self._turn_rad)
        self._aim = Aim(aim.at, heading_rad, aim.anchored)

    def _finish_aim(self) -> None:
        aim, tool = self._aim, self._tool
        self._press = None
        if aim is None:
            return
        if self.refusal_at(aim.at):
            # The tool stays, so that another place can be chosen at once.
            self._aim = None
            self.show_hint(self.refusal_at(aim.at))
            return
        heading_rad = aim.heading_rad if aim.heading_rad is not None else self.heading_towards(aim.at)
        self.set_tool("look")
        self.aimed.emit(tool, Pose2D(aim.at.x(), aim.at.y(), heading_rad), aim.heading_rad is not None)

    def heading_towards(self, at: QPointF) -> float:
        """Direction of travel from the robot to a point; the robot's own heading where it stands there already."""
        if self._pose is None:
            return 0.0
        right, up = at.x() - self._pose.x_m, at.y() - self._pose.y_m
        return math.atan2(up, right) if math.hypot(right, up) > 0.1 else self._pose.heading_rad

    def _place_at(self, point: QPointF) -> str | None:
        return next((name for name, rect in self._place_rects.items() if rect.contains(point)), None)
