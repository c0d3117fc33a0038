"""Graphics items of the map: occupancy grid, layers in metres, and marks and labels in pixels over them."""

import math
import time
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import pyqtgraph
from numpy.typing import NDArray
from PySide6.QtCore import QPointF, QRect, QRectF, Qt, QTimer, Signal
from PySide6.QtGui import QColor, QFont, QFontMetricsF, QImage, QPainter, QPainterPath, QPen, QPolygonF, QTransform
from PySide6.QtWidgets import (
    QGraphicsEllipseItem,
    QGraphicsItem,
    QGraphicsPathItem,
    QGraphicsPixmapItem,
    QGraphicsPolygonItem,
    QGraphicsSimpleTextItem,
)

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import OccupancyGrid
from caris_desktop.domain.translation import tr
from caris_desktop.ui import tokens
from caris_desktop.ui.map.map_state import TRAIL_SHADES, MapState, length_in_words
from caris_desktop.ui.theme import Theme, icon

OCCUPIED = 65
"""Occupancy from which a cell is an obstacle, as in ROS map_server."""

CELLS_AT_ONCE = 500_000
"""Cells per band: a millisecond of work, five on a busy machine."""

_SMALLEST_LEVEL = 256
# Smoothing a larger view costs more than the rest of the map.
_SMOOTH_AREA_PX = 700_000


class GridItem(pyqtgraph.ImageItem):  # type: ignore[misc]  # pyqtgraph has no types
    """Image of the grid. ``newest``: latest grid received; ``displayed_grid``: the painted one, as ``raster``."""

    rendered = Signal(bool)  # whether it is the first one

    def __init__(self, theme: Theme) -> None:
        super().__init__(axisOrder="row-major")
        self.setFlag(self.GraphicsItemFlag.ItemUsesExtendedStyleOption)  # paint() gets the exposed rectangle
        self._theme = theme
        self.newest: OccupancyGrid | None = None
        self.displayed_grid: OccupancyGrid | None = None
        self.raster: GridRaster | None = None
        self.slowest_band_ms = 0.0
        self._rendering: GridRaster | None = None  # being rendered or updated
        self.qimage: Any = None
        self._px_per_m = 1.0
        self._level = -1
        self._visible = QRect()
        self._cells: QImage | None = None  # the visible ones in colour
        self.use_theme()

    def show_grid(self, grid: OccupancyGrid | None) -> None:
        self.newest = grid
        if grid is None:
            self.raster = self._rendering = self.displayed_grid = self.qimage = self._cells = None
            self.clear()
        elif self._rendering is None:
            self._begin(grid)
        # Otherwise the newest grid is rendered after the current one.

    def use_theme(self) -> None:
        """Use the theme's colours: a table of 256, whatever the size of the map."""
        self.setLookupTable(_color_table(self._theme))

    def show_scale(self, px_per_m: float) -> None:
        """Show the level that fits this scale in device pixels per metre."""
        self._px_per_m = px_per_m
        self._show_level()

    def value_at(self, at: QPointF) -> int | None:
        """Occupancy 0..100 at a map point; None if unknown."""
        return None if self.raster is None else self.raster.value_at(at.x(), at.y())

    def refusal_at(self, at: QPointF) -> str:
        """Reason why the robot cannot be at this point; empty if it can."""
        value = self.value_at(at)
        if value is not None and value >= OCCUPIED:
            return tr("Obstacle here: choose a free spot")
        return ""

    def corners_in_map(self) -> list[Pose2D]:
        """Corners of the known area; empty if nothing is known."""
        known = QRectF() if self.raster is None else self.raster.bounds_in_grid()
        if self.raster is None or known.isEmpty():
            return []
        corner = self.raster.grid.origin_in_map
        return [
            corner @ Pose2D(x_m, y_m, 0.0)
            for x_m in (known.left(), known.right())
            for y_m in (known.top(), known.bottom())
        ]

    def _begin(self, grid: OccupancyGrid) -> None:
        if self.raster is not None and self.raster.fits(grid):
            self._rendering = self.raster
            self._rendering.begin(grid)
        else:
            self._rendering = GridRaster(grid)
        self._render_more()

    def _render_more(self) -> None:
        rendering = self._rendering
        if rendering is None:
            return
        began_s = time.perf_counter()
        rendering.render_rows()
        self.slowest_band_ms = max(self.slowest_band_ms, (time.perf_counter() - began_s) * 1e3)
        if not rendering.done:
            QTimer.singleShot(0, self, self._render_more)
            return
        self._rendering = None
        first = self.raster is None
        if rendering is not self.raster:
            self.raster, self._level = rendering, -1
            self._show_level()
        elif rendering.rows_changed:
            self._cells = None
            self.update()  # the image shares the memory of its level
        self.displayed_grid = rendering.grid
        self.rendered.emit(first)
        if self.newest is not None and self.newest is not rendering.grid:
            self._begin(self.newest)

    def _show_level(self) -> None:
        raster = self.raster
        if raster is None:
            return
        level = raster.level_for(raster.grid.resolution_m * self._px_per_m)
        if level == self._level:
            return
        self._level = level
        corner, cell_m = raster.grid.origin_in_map, raster.grid.resolution_m * 2**level
        self.setTransform(
            QTransform().translate(corner.x_m, corner.y_m).rotateRadians(corner.heading_rad).scale(cell_m, cell_m)
        )
        self.setImage(raster.levels[level], autoLevels=False)  # one byte a cell, neither copied nor scaled

    def paint(self, painter: QPainter, option: Any, _widget: Any = None) -> None:
        """Paint the exposed cells. Qt paints an indexed image at a fifth of the speed of a converted one: 11 instead of
        2 ms for 1920x1080 pixels.
        """
        if self.raster is None:
            return
        if self._renderRequired:
            self.render()
            self._cells = None
        visible = option.exposedRect.toAlignedRect().adjusted(-1, -1, 1, 1).intersected(self.qimage.rect())
        device = painter.device()
        small = device is not None and device.width() * device.height() <= _SMOOTH_AREA_PX
        smooth = small and self.raster.grid.resolution_m * 2**self._level * self._px_per_m < 3.0
        painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform, smooth)
        if self._cells is None or visible != self._visible:
            self._cells = self.qimage.copy(visible).convertToFormat(QImage.Format.Format_RGB32)
            self._visible = visible
        painter.drawImage(QPointF(visible.topLeft()), self._cells)


class GridRaster:
    """Occupancy grid with halved levels as arrays of one byte per cell, rendered in bands.

    A byte is 0 for unknown, else 1 + occupancy. A level keeps the maximum of four cells, so that a one-cell wall
    remains visible when a whole building is in view; known cells override unknown ones.
    """

    def __init__(self, grid: OccupancyGrid) -> None:
        self.grid = grid
        height, width = grid.cells.shape
        self.levels: list[NDArray[np.uint8]] = [np.zeros((height, width), np.uint8)]
        while max(self.levels[-1].shape) > _SMALLEST_LEVEL:
            rows, columns = self.levels[-1].shape
            self.levels.append(np.zeros(((rows + 1) // 2, (columns + 1) // 2), np.uint8))
        self._known_rows = np.zeros(height, bool)
        self._known_columns = np.zeros(width, bool)
        # Multiple of the coarsest level's block, so that no level needs rows of the next band.
        self._block = 1 << (len(self.levels) - 1)
        self._rows_per_band = max(self._block, CELLS_AT_ONCE // max(1, width) // self._block * self._block)
        self._next_row = 0
        self._fresh = True
        self.rows_changed = 0

    @property
    def done(self) -> bool:
        return bool(self._next_row >= len(self.grid.cells))

    def fits(self, grid: OccupancyGrid) -> bool:
        """Whether ``grid`` is an update of the same map, so that only changes need work."""
        mine = self.grid
        if grid.cells.shape != mine.cells.shape or grid.resolution_m != mine.resolution_m:
            return False
        return grid.origin_in_map == mine.origin_in_map

    def begin(self, grid: OccupancyGrid) -> None:
        """Start an update of the same map, applied by :meth:`render_rows`."""
        self.grid = grid
        self._next_row = 0
        self._fresh = False
        self.rows_changed = 0

    def render_rows(self) -> None:
        """Render the next band of rows."""
        first = self._next_row
        # int8 viewed as uint8: -1 is 255, and 255 + 1 wraps to 0.
        band = self.grid.cells[first : first + self._rows_per_band].view(np.uint8) + np.uint8(1)
        last = first + len(band)
        self._next_row = last
        mine = self.levels[0][first:last]
        if not self._fresh:
            changed = np.flatnonzero((mine != band).any(axis=1))
            if not changed.size:
                return
            from_row = int(changed[0]) // self._block * self._block
            band = band[from_row : int(changed[-1]) + 1]
            first, last = first + from_row, first + from_row + len(band)
            mine = self.levels[0][first:last]
        self.rows_changed += last - first
        mine[:] = band
        known = band > 0
        self._known_rows[first:last] = known.any(axis=1)
        self._known_columns |= known.any(axis=0)
        for finer, coarser in zip(self.levels, self.levels[1:], strict=False):
            first, last = first // 2, (last + 1) // 2
            _halve(finer[2 * first : 2 * last], coarser[first:last])

    def level_for(self, cell_px: float) -> int:
        """Coarsest level whose cells cover at most 1.5 px in the view."""
        level = 0
        while level + 1 < len(self.levels) and cell_px * 2 ** (level + 1) <= 1.5:
            level += 1
        return level

    def value_at(self, x_m: float, y_m: float) -> int | None:
        """Occupancy 0..100 at a map point; None if unknown or outside."""
        grid = self.grid
        at = grid.origin_in_map.inverse() @ Pose2D(x_m, y_m, 0.0)
        column, row = int(at.x_m // grid.resolution_m), int(at.y_m // grid.resolution_m)
        rows, columns = grid.cells.shape
        if not (0 <= row < rows and 0 <= column < columns):
            return None
        value = int(grid.cells[row, column])
        return value if value >= 0 else None

    def bounds_in_grid(self) -> QRectF:
        """Known area in metres from the grid's corner, along its axes; empty if nothing is known."""
        rows, columns = np.flatnonzero(self._known_rows), np.flatnonzero(self._known_columns)
        if not rows.size or not columns.size:
            return QRectF()
        cell_m = self.grid.resolution_m
        return QRectF(
            float(columns[0]) * cell_m, float(rows[0]) * cell_m,
            float(columns[-1] - columns[0] + 1) * cell_m, float(rows[-1] - rows[0] + 1) * cell_m,
        )  # fmt: skip


def _halve(finer: NDArray[np.uint8], coarser: NDArray[np.uint8]) -> None:
    """Maximum of each block of two by two cells; an odd last row or column stays alone."""
    rows = len(finer) // 2
    pairs = np.maximum(finer[0 : 2 * rows : 2], finer[1 : 2 * rows : 2])
    if len(finer) % 2:
        pairs = np.concatenate((pairs, finer[-1:]))
    columns = pairs.shape[1] // 2
    np.maximum(pairs[:, 0 : 2 * columns : 2], pairs[:, 1 : 2 * columns : 2], out=coarser[:, :columns])
    if pairs.shape[1] % 2:
        coarser[:, -1] = pairs[:, -1]


def _color_table(theme: Theme) -> NDArray[np.uint8]:
    """Colours of the bytes of a raster: shades from free to wall above an occupancy of 25."""
    free, wall = (_channels(theme.color(role)) for role in ("map_free", "map_wall"))
    share = np.clip((np.arange(255) - 25) / 40, 0.0, 1.0)[:, None]
    shades = np.round(free + (wall - free) * share).astype(np.uint8)
    return np.vstack((_channels(theme.color("map_unknown")).astype(np.uint8), shades))


def _channels(color: QColor) -> NDArray[np.float64]:
    return np.array([color.red(), color.green(), color.blue()], np.float64)


_CHIP_ROLES = {"warning": ("amber", "warning"), "good": ("green", "check"), "bad": ("red", "warning-octagon")}
_MARK_PX = 9.0

# Candidate label positions: px from mark to left edge, share of the width to subtract, px to the top.
_BESIDE_A_FLAG = (
    (11.0, 0.0, -10.0), (-11.0, 1.0, -10.0), (0.0, 0.5, -31.0), (0.0, 0.5, 11.0),
    (-9.0, 0.0, -31.0), (9.0, 1.0, -31.0), (-9.0, 0.0, 11.0), (9.0, 1.0, 11.0),
)  # fmt: skip
_BESIDE_THE_ROBOT = ((18.0, 0.0, -10.0), (-18.0, 1.0, -10.0), (0.0, 0.5, -38.0), (0.0, 0.5, 18.0))
_BESIDE_A_PERSON = ((10.0, 0.0, -10.0), (-10.0, 1.0, -10.0), (10.0, 0.0, 11.0), (10.0, 0.0, -31.0), (-10.0, 1.0, 11.0))


class _Dots(pyqtgraph.GraphicsObject):  # type: ignore[misc]  # pyqtgraph has no types
    """Points of a scan. A ScatterPlotItem takes 3 ms for 720 points, most of it for a style for each of them."""

    def __init__(self) -> None:
        super().__init__()
        self._points = QPolygonF()
        self._bounds = QRectF()
        self.color = QColor()

    def show_points(self, points_m: NDArray[np.float64]) -> None:
        self.prepareGeometryChange()
        # An empty array cannot be written by pyqtgraph.
        self._points = pyqtgraph.functions.arrayToQPolygonF(*points_m.T) if len(points_m) else QPolygonF()
        self._bounds = self._points.boundingRect().adjusted(-1, -1, 1, 1)

    def boundingRect(self) -> QRectF:
        return self._bounds

    def paint(self, painter: QPainter, _option: Any, _widget: Any = None) -> None:
        painter.setPen(_cosmetic(self.color, 3))
        painter.setRenderHint(QPainter.RenderHint.Antialiasing, False)
        painter.drawPoints(self._points)


class _Label(QGraphicsPathItem):
    """Text on a rounded ground, after an icon."""

    def __init__(self, parent: QGraphicsItem) -> None:
        super().__init__(parent)
        self.rect = QRectF()
        self._look: tuple[object, ...] = ()
        self._icon = QGraphicsPixmapItem(self)
        self._text = QGraphicsSimpleTextItem(self)
        self.hide()

    @property
    def text(self) -> str:
        return self._text.text()

    def show_text(
        self, rect: QRectF, text: str, font: QFont, color: QColor, ground: QColor, *, line: QColor | None = None,
        icon_name: str = "",
    ) -> None:  # fmt: skip
        self.rect = rect
        self.setPos(rect.topLeft())
        look = (rect.size(), text, font, color, ground, line, icon_name)
        if look != self._look:
            self._look = look
            path = QPainterPath()
            room = QRectF(QPointF(0, 0), rect.size())
            path.addRoundedRect(room, 5, 5)
            self.setPath(path)
            self.setPen(Qt.PenStyle.NoPen if line is None else QPen(line, 1))
            self.setBrush(ground)
            self._icon.setVisible(bool(icon_name))
            if icon_name:
                self._icon.setPixmap(icon(icon_name, color, 16).pixmap(16))
                self._icon.setPos(9, (room.height() - 16) / 2)
                room.adjust(18, 0, 0, 0)
            self._text.setText(text)
            self._text.setFont(font)
            self._text.setBrush(color)
            words = self._text.boundingRect()
            self._text.setPos(room.center() - words.center())
        self.show()


class _Mark(QGraphicsEllipseItem):
    """Round mark of a place or a person, with a ring around it and a label beside it."""

    def __init__(self, layer: QGraphicsItem) -> None:
        super().__init__(layer)
        self.ring = _circle(self)
        self.ring.setFlag(self.GraphicsItemFlag.ItemStacksBehindParent)
        self.outer = _circle(self)
        self.flag = QGraphicsPixmapItem(self)
        self.flag.setPos(-6.5, -6.5)
        self._icon_color = ""
        self.label = _Label(layer)

    def show_flag(self, color: QColor) -> None:
        if color.name() != self._icon_color:
            self._icon_color = color.name()
            self.flag.setPixmap(icon("flag", color, 13).pixmap(13))

    def stack(self, z: float) -> None:
        self.setZValue(z)
        self.label.setZValue(z + 0.5)

    def set_shown(self, shown: bool) -> None:
        self.setVisible(shown)
        if not shown:
            self.label.hide()


class _Arrow(QGraphicsPathItem):
    """Arrow with a ring at its base; it points right before it is rotated."""

    def __init__(self, layer: QGraphicsItem, length_px: float) -> None:
        super().__init__(layer)
        path = QPainterPath()
        path.addEllipse(QPointF(0, 0), _MARK_PX, _MARK_PX)
        path.moveTo(_MARK_PX, 0)
        path.lineTo(length_px - 8, 0)
        self.setPath(path)
        tip = [QPointF(length_px, 0), QPointF(length_px - 12, 7), QPointF(length_px - 12, -7)]
        self._head = QGraphicsPolygonItem(QPolygonF(tip), self)
        self._head.setPen(Qt.PenStyle.NoPen)

    def show_at(self, at: QPointF, heading_rad: float, color: QColor) -> None:
        self.setPos(at)
        self.setRotation(-math.degrees(heading_rad))
        self.setPen(QPen(color, 3, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
        self._head.setBrush(color)
        self.show()


class MapItems:
    """Items that show ``state`` over the grid. ``place_rects`` has the clickable rectangle of each place, in px."""

    def __init__(self, theme: Theme, box: pyqtgraph.ViewBox, state: MapState, grid: GridItem) -> None:
        self._theme = theme
        self._box = box
        self._state = state
        self._grid = grid
        self.place_rects: dict[str, QRectF] = {}
        # In metres; rotated about the map's origin.
        self.world = pyqtgraph.ItemGroup()
        box.addItem(self.world, ignoreBounds=True)
        self.world.addItem(grid)
        # A PlotCurveItem computes its bounds in Python, several times a repaint.
        self._trail = [QGraphicsPathItem(self.world) for _ in range(TRAIL_SHADES)]
        self._scan = _Dots()
        self.world.addItem(self._scan)
        self._path = QGraphicsPathItem(self.world)
        self._robot = QGraphicsPolygonItem(self.world)
        self._reach = _circle(self.world)
        # In px of the view.
        self._over = pyqtgraph.ItemGroup(box)
        self._over.setZValue(10)
        self._goal = _Arrow(self._over, 30)
        self._places = [_Mark(self._over)]
        self._people = [_Mark(self._over)]
        self._pin = pyqtgraph.ItemGroup(self._over)
        nose = [QPointF(19, 0), QPointF(5, -8), QPointF(5, 8)]
        self._pin_parts = (QGraphicsPolygonItem(QPolygonF(nose), self._pin), _circle(self._pin, _MARK_PX))
        self._aim = _circle(self._over, _MARK_PX)
        self._aim_arrow = _Arrow(self._over, 46)
        self._measured = QGraphicsPathItem(self._over)
        self._length = _Label(self._over)
        self._waiting = QGraphicsSimpleTextItem(self._over)
        self._scale_bar = QGraphicsPathItem(self._over)
        self._scale_words = QGraphicsSimpleTextItem(self._over)
        self._north = QGraphicsPolygonItem(QPolygonF([QPointF(0, -19), QPointF(-5, -11), QPointF(5, -11)]), self._over)
        self._north_word = QGraphicsSimpleTextItem("N", self._over)
        self._chips = [_Label(self._over)]
        # People move, and take precedence over permanent items.
        for z, item in enumerate((self._pin, self._aim, self._aim_arrow, self._measured, self._length), start=3):
            item.setZValue(z)
        self._shown_scan: object = None
        self._shown_trail = -1
        self._shown_outline: object = None
        self.use_theme()

    # ---- geometry

    @property
    def px_per_m(self) -> float:
        return float(self._box.width() / self._box.viewRect().width())

    @property
    def turn_rad(self) -> float:
        """Rotation of the map, counter-clockwise."""
        return math.radians(self.world.rotation())

    def to_view(self, x_m: float, y_m: float) -> QPointF:
        return QPointF(self.world.mapToItem(self._box, QPointF(x_m, y_m)))

    def labels(self) -> dict[str, QRectF]:
        """Rectangles of the visible names of places and people."""
        labels = (mark.label for mark in (*self._places, *self._people))
        return {label.text: label.rect for label in labels if label.isVisible()}

    # ---- display

    def use_theme(self) -> None:
        color, small = self._theme.color, self._theme.font(tokens.STATUS_PX - 1)
        trail = color("blue")
        for shade, curve in enumerate(self._trail, start=1):
            trail.setAlpha(round(30 + 110 * shade / TRAIL_SHADES))
            curve.setPen(_cosmetic(trail, 2))
        self._scan.color = color("lidar")
        self._scale_bar.setPen(QPen(color("dim"), 1.5))
        self._north.setPen(Qt.PenStyle.NoPen)
        self._north.setBrush(color("dim"))
        for words in (self._scale_words, self._north_word, self._waiting):
            words.setFont(self._theme.font() if words is self._waiting else small)
            words.setBrush(color("dim"))

    def refresh(self) -> None:
        """Show the present state in the present view."""
        views = self._box.scene().views()
        self._grid.show_scale(self.px_per_m * (views[0].devicePixelRatioF() if views else 1.0))
        self._show_trail()
        self._show_scan()
        self._show_goal()
        people = self._people_rects()
        self._show_places(people)
        self._show_people(people)
        self._show_robot()
        self._show_aim()
        self._show_scale_bar()
        self._show_words()

    def _show_trail(self) -> None:
        state, trail = self._state, self._state.trail
        shown = "trail" not in state.hidden and len(trail) > 1
        if shown and trail.version != self._shown_trail:
            self._shown_trail = trail.version
            pieces = [points for _strength, points in trail.pieces()]
            pieces = [np.zeros((0, 2))] * (TRAIL_SHADES - len(pieces)) + pieces
            for curve, points in zip(self._trail, pieces, strict=True):
                curve.setPath(_path_of(points))
        for curve in self._trail:
            curve.setVisible(shown)

    def _show_scan(self) -> None:
        state = self._state
        points_m, freshness = state.scan_points_m, state.scan_freshness
        self._scan.setOpacity(0.9 if freshness == "fresh" else 0.3)
        self._scan.setVisible(freshness in ("fresh", "stale") and "lidar" not in state.hidden)
        if points_m is not self._shown_scan:
            self._shown_scan = points_m
            self._scan.show_points(np.zeros((0, 2)) if points_m is None else points_m)

    def _show_goal(self) -> None:
        state = self._state
        goal, path_m = state.goal, state.path_m
        self._goal.setVisible(goal is not None)
        self._path.setVisible(goal is not None)
        if goal is None:
            return
        # Dashed straight line to the goal until the robot reports its path.
        target, from_pose = goal.target_in_map, state.pose or goal.target_in_map
        straight = np.array([(from_pose.x_m, from_pose.y_m), (target.x_m, target.y_m)])
        self._path.setPath(_path_of(straight if path_m is None else path_m))
        style = Qt.PenStyle.DashLine if path_m is None else Qt.PenStyle.SolidLine
        self._path.setPen(_cosmetic(self._theme.color("green"), 2.5, style))
        at = self.to_view(target.x_m, target.y_m)
        self._goal.show_at(at, target.heading_rad + self.turn_rad, self._theme.color("green"))

    def _show_places(self, people: Sequence[tuple[QPointF, QRectF | None]]) -> None:
        theme, state = self._theme, self._state
        font = theme.font(tokens.STATUS_PX - 1, tokens.WEIGHT_MEDIUM)
        metrics = QFontMetricsF(font)
        ground = theme.color("panel")
        label_ground = theme.color("panel")
        label_ground.setAlpha(220)
        self.place_rects.clear()
        places = () if "places" in state.hidden else state.places
        at = {place.name: self.to_view(place.pose_in_map.x_m, place.pose_in_map.y_m) for place in places}
        taken = [_around(point, _MARK_PX) for point in at.values()]
        width_of = {name: metrics.horizontalAdvance(name) + 8 for name in at}
        robot = self._robot_rect()
        taken += robot
        for point, label in people:
            taken += [_around(point, 7)] if label is None else [_around(point, 7), label]
        going_to = state.goal.place if state.goal is not None else None
        under_robot = {name for name, point in at.items() if robot and robot[0].contains(point)}
        # Goal and hovered place are labelled first, then long names; a place without room keeps its flag. The robot's
        # place comes last: its name beside the flag of another would be read as that one's.
        order = sorted(
            at, key=lambda name: (name != going_to, name != state.hovered, name in under_robot, -width_of[name])
        )
        for name, mark in zip(order, _pool(self._places, len(order), self._over), strict=True):
            point, width = at[name], width_of[name]
            going = name == going_to
            mark.setPos(point)
            mark.stack(1)
            mark.setRect(_around(QPointF(0, 0), _MARK_PX))
            mark.setPen(QPen(theme.color("green" if going else "line_strong"), 1.5))
            mark.setBrush(ground)
            mark.show_flag(theme.color("green" if going else "text"))
            mark.ring.hide()
            mark.outer.hide()
            if name in under_robot:
                room = self._free_room(robot[0].center(), width, taken, _BESIDE_THE_ROBOT)
            else:
                room = self._free_room(point, width, taken, _BESIDE_A_FLAG)
            if room is None and (going or name == state.hovered):
                left = min(max(4.0, point.x() - width / 2), self._box.width() - width - 4)
                room = QRectF(left, point.y() - 32, width, 20)
            hit = _around(point, 11)
            if room is None:
                mark.label.hide()
            else:
                taken.append(room)
                hit = hit.united(room)
                mark.label.show_text(room, name, font, theme.color("green" if going else "text"), label_ground)
            self.place_rects[name] = hit

    def _free_room(
        self, at: QPointF, width: float, taken: list[QRectF], sides: tuple[tuple[float, float, float], ...]
    ) -> QRectF | None:
        """First free label rectangle at one of these sides of a mark in view."""
        room = QRectF(self._box.rect()).adjusted(2, 2, -2, -2)
        for left_px, share_of_width, top_px in sides if room.contains(at) else ():
            left = at.x() + left_px - share_of_width * width
            label = QRectF(max(room.left(), min(left, room.right() - width)), at.y() + top_px, width, 20)
            if room.contains(label) and not any(label.intersects(other) for other in taken):
                return label
        return None

    def _robot_rect(self) -> list[QRectF]:
        """Rectangle of the robot's marker, if there is a pose."""
        pose = self._state.pose
        return [] if pose is None else [_around(self.to_view(pose.x_m, pose.y_m), 13)]

    def _people_rects(self) -> list[tuple[QPointF, QRectF | None]]:
        """Points and labels of people; in a crowd some have no room for a label."""
        state = self._state
        if state.people_freshness not in ("fresh", "stale") or "people" in state.hidden:
            return []
        metrics = QFontMetricsF(self._theme.font(tokens.STATUS_PX, tokens.WEIGHT_SEMIBOLD))
        points = [self.to_view(person.x_m, person.y_m) for person, _, _ in state.people]
        taken, labels = [*self._robot_rect(), *(_around(point, 7) for point in points)], []
        places = () if "places" in state.hidden else [place.pose_in_map for place in state.places]
        flags = [_around(self.to_view(place.x_m, place.y_m), _MARK_PX) for place in places]
        for (_person, name, _named), at in zip(state.people, points, strict=True):
            find = partial(self._free_room, at, metrics.horizontalAdvance(name) + 10, sides=_BESIDE_A_PERSON)
            label = find(taken=[*taken, *flags]) or find(taken=taken)
            labels.append(label)
            taken += [label] if label is not None else []
        return list(zip(points, labels, strict=True))

    def _show_people(self, rects: Sequence[tuple[QPointF, QRectF | None]]) -> None:
        """Show people with a dashed ring of uncertainty; filled if named, as in the People panel."""
        theme, state = self._theme, self._state
        font = theme.font(tokens.STATUS_PX, tokens.WEIGHT_SEMIBOLD)
        ground, label_ground = theme.color("panel"), theme.color("panel")
        label_ground.setAlpha(220)
        marks = _pool(self._people, len(rects), self._over)
        for (person, name, named), (at, label), mark in zip(state.people if rects else (), rects, marks, strict=True):
            color = theme.color("green" if named else "text")
            opacity = 0.45 if state.people_freshness == "stale" else 1.0
            mark.setPos(at)
            mark.stack(2)
            mark.setOpacity(opacity)
            mark.label.setOpacity(opacity)
            mark.setRect(_around(QPointF(0, 0), 6))
            mark.setPen(QPen(ground if named else color, 1.5))
            mark.setBrush(color if named else ground)
            dashed = _dashed(QPen(color, 1.5), 3, 3)
            # Rounded to px: position uncertainty varies slightly with each detection.
            mark.ring.setRect(_around(QPointF(0, 0), max(9, round(person.spread_m * self.px_per_m))))
            mark.ring.setPen(dashed)
            mark.outer.setVisible(bool(state.selected) and person.person_id == state.selected)
            mark.outer.setRect(_around(QPointF(0, 0), 10))
            mark.outer.setPen(QPen(theme.color("text"), 2.5))
            if label is None:
                mark.label.hide()
            else:
                mark.label.show_text(label, name, font, color, label_ground)

    def _show_robot(self) -> None:
        theme, state, pose = self._theme, self._state, self._state.pose
        shown = pose is not None and state.pose_freshness != "none"
        distance_m = state.guard[1]
        stale = state.pose_freshness in ("stale", "lost")
        near = shown and not stale and state.guard[0] in ("slowing", "blocked") and distance_m is not None
        self._robot.setVisible(shown and bool(state.outline_m))
        self._reach.setVisible(near)
        self._pin.setVisible(shown)
        if pose is None or not shown:
            return
        doubtful = stale or state.unconfirmed
        color = theme.color("dim" if stale else "amber" if state.unconfirmed else "blue")
        if state.outline_m is not self._shown_outline:
            self._shown_outline = state.outline_m
            self._robot.setPolygon(QPolygonF([QPointF(x, y) for x, y in state.outline_m]))
        self._robot.setPos(pose.x_m, pose.y_m)
        self._robot.setRotation(math.degrees(pose.heading_rad))
        self._robot.setPen(_cosmetic(color, 1.5, Qt.PenStyle.DashLine if doubtful else Qt.PenStyle.SolidLine))
        ground = theme.color("blue")
        ground.setAlpha(0 if doubtful else 40)
        self._robot.setBrush(ground)
        if near and distance_m is not None:
            # Remaining clearance around the footprint, in any direction of motion.
            reach_m = max((math.hypot(x, y) for x, y in state.outline_m), default=0.25) + distance_m
            self._reach.setRect(_around(QPointF(pose.x_m, pose.y_m), reach_m))
            role = "red" if state.guard[0] == "blocked" else "amber"
            self._reach.setPen(_cosmetic(theme.color(role), 2, Qt.PenStyle.DotLine))
        panel = theme.color("panel")
        pen = _dashed(QPen(color, 2), 3, 2) if doubtful else QPen(panel, 1.5)
        self._pin.setPos(self.to_view(pose.x_m, pose.y_m))
        self._pin.setRotation(-math.degrees(pose.heading_rad + self.turn_rad))
        for part in self._pin_parts:
            part.setPen(pen)
            part.setBrush(panel if doubtful else color)

    def _show_aim(self) -> None:
        state, aim, theme = self._state, self._state.aim, self._theme
        for item in (self._aim, self._aim_arrow, self._measured, self._length):
            item.hide()
        pointer = None if state.pointer is None else QPointF(self.world.mapFromItem(self._box, state.pointer))
        at = state.mark if state.tool == "look" else aim.at if aim is not None else pointer
        if at is None:
            return
        refused = state.tool != "measure" and bool(self._grid.refusal_at(at))
        role = "amber" if refused else "green" if state.tool in ("look", "goal") else "blue"
        color, point = theme.color(role), self.to_view(at.x(), at.y())
        if aim is not None and aim.heading_rad is not None:
            self._aim_arrow.show_at(point, aim.heading_rad + self.turn_rad, color)
            return
        if aim is not None and aim.end is not None:
            self._show_measured(point, self.to_view(aim.end.x(), aim.end.y()), length_in_words(aim.at, aim.end))
            return
        self._aim.setPos(point)
        self._aim.setPen(QPen(color, 2.5) if state.tool == "look" else _dashed(QPen(color, 2), 3, 2))
        self._aim.show()

    def _show_measured(self, start: QPointF, end: QPointF, words: str) -> None:
        path = QPainterPath(start)
        path.lineTo(end)
        for point in (start, end):
            path.addEllipse(point, 3, 3)
        self._measured.setPath(path)
        self._measured.setPen(QPen(self._theme.color("blue"), 2))
        self._measured.show()
        font = self._theme.font(tokens.STATUS_PX, tokens.WEIGHT_SEMIBOLD)
        width = QFontMetricsF(font).horizontalAdvance(words) + 12
        middle = (start + end) / 2
        room = QRectF(middle.x() - width / 2, middle.y() - 26, width, 20)
        self._length.show_text(room, words, font, self._theme.color("text"), self._theme.color("panel"))

    def _show_scale_bar(self) -> None:
        state = self._state
        shown = self._grid.newest is not None or state.pose is not None
        self._scale_bar.setVisible(shown)
        self._scale_words.setVisible(shown)
        self._north.setVisible(shown and state.rotate)
        self._north_word.setVisible(shown and state.rotate)
        scale = self.px_per_m
        metres = next((length for length in (0.5, 1, 2, 5, 10, 20, 50) if length * scale >= 44), 100)
        right, bottom = self._box.width() - 14.0, self._box.height() - 10.0
        left = right - metres * scale
        path = QPainterPath(QPointF(left, bottom - 4))
        for x, y in ((left, bottom), (right, bottom), (right, bottom - 4)):
            path.lineTo(x, y)
        self._scale_bar.setPath(path)
        self._scale_words.setText(f"{metres:g} m")
        words = self._scale_words.boundingRect()
        self._scale_words.setPos((left + right - words.width()) / 2, bottom - 4 - words.height())
        at = QPointF(self._box.width() - 30.0, bottom - 50)
        self._north.setPos(at)
        self._north.setRotation(-math.degrees(self.turn_rad))
        self._north_word.setPos(at - self._north_word.boundingRect().center())

    def _show_words(self) -> None:
        """Show what is awaited, the chips at the upper edge, and the hint at the lower one."""
        state, theme = self._state, self._theme
        width, height = self._box.width(), self._box.height()
        self._waiting.setVisible(self._grid.newest is None)
        self._waiting.setText(state.waiting)
        words = self._waiting.boundingRect()
        beside_others = state.pose is not None or state.places
        middle = height - 25 if beside_others else height / 2
        self._waiting.setPos(QPointF(width / 2, middle) - words.center())
        font = theme.font(tokens.STATUS_PX, tokens.WEIGHT_MEDIUM)
        metrics = QFontMetricsF(font)
        lines = [(text, role, 8.0 + 28 * number) for number, (text, role) in enumerate(state.chips)]
        if state.hint:
            lines.append((state.hint, "hint", height - 34.0))
        for (text, role, top), chip in zip(lines, _pool(self._chips, len(lines), self._over), strict=True):
            color_role, icon_name = _CHIP_ROLES.get(role, ("text", ""))
            extra = 38.0 if icon_name else 20.0
            room = max(40.0, width - 8 - extra)
            parts = text.split(" · ") if text == state.hint and metrics.horizontalAdvance(text) > room else [text]
            parts = [metrics.elidedText(part, Qt.TextElideMode.ElideRight, room) for part in parts]
            chip_width = max(map(metrics.horizontalAdvance, parts)) + extra
            more_px = (len(parts) - 1) * metrics.lineSpacing()  # above: the hint lies at the lower edge
            color = theme.color(color_role)
            line = color if role != "hint" else theme.color("line_strong")
            chip.setZValue(10)
            rect = QRectF(round((width - chip_width) / 2) + 0.5, top + 0.5 - more_px, chip_width - 1, 23 + more_px)
            chip.show_text(rect, "\n".join(parts), font, color, theme.color("panel"), line=line, icon_name=icon_name)


def _path_of(points_m: NDArray[Any]) -> QPainterPath:
    path: QPainterPath = pyqtgraph.functions.arrayToQPath(points_m[:, 0], points_m[:, 1], connect="finite")
    return path


def _pool(items: list[Any], count: int, layer: QGraphicsItem) -> Iterator[Any]:
    """The first ``count`` items, made as needed; the others are hidden."""
    while len(items) < count:
        items.append(type(items[0])(layer))
    for number, item in enumerate(items):
        set_shown = getattr(item, "set_shown", item.setVisible)
        set_shown(number < count)
    return iter(items[:count])


def _circle(parent: QGraphicsItem, radius: float = 1.0) -> QGraphicsEllipseItem:
    circle = QGraphicsEllipseItem(parent)
    circle.setRect(_around(QPointF(0, 0), radius))
    return circle


def _around(at: QPointF, reach: float) -> QRectF:
    return QRectF(at.x() - reach, at.y() - reach, 2 * reach, 2 * reach)


def _dashed(pen: QPen, dash: float, gap: float) -> QPen:
    pen.setDashPattern([dash, gap])
    return pen


def _cosmetic(color: QColor, width_px: float, style: Qt.PenStyle = Qt.PenStyle.SolidLine) -> QPen:
    """Pen of this width in px at any scale."""
    pen = QPen(color, width_px, style)
    pen.setCosmetic(True)
    return pen
