"""Grid layer of the map view: rendered in bands of rows, painted from an image of the visible part."""

import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QObject, QPointF, QRectF, QSize, QTimer, Signal
from PySide6.QtGui import QColor, QImage, QPainter, QTransform
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import OccupancyGrid
from caris_desktop.domain.translation import tr
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.map_viewport import MapViewport

OCCUPIED = 65
"""Occupancy from which a cell is an obstacle, as in ROS map_server."""

_SMOOTH_AREA_PX = 700_000


class GridLayer(QObject):
    """Grid layer. ``newest``: latest grid received; ``displayed_grid``: the painted one, rendered as ``raster``."""

    rendered = Signal(bool)  # whether it is the first one

    def __init__(self, theme: Theme, parent: QObject) -> None:
        super().__init__(parent)
        self._theme = theme
        self.newest: OccupancyGrid | None = None
        self.displayed_grid: OccupancyGrid | None = None
        self.raster: GridRaster | None = None
        self.slowest_band_ms = 0.0
        self._rendering: GridRaster | None = None  # being rendered or updated
        self._picture: QImage | None = None
        self._key: object = None
        self._version = 0

    def show(self, grid: OccupancyGrid | None) -> None:
        self.newest = grid
        if grid is None:
            self.raster = self._rendering = self.displayed_grid = self._picture = None
        elif self._rendering is None:
            self._begin(grid)
        # Otherwise the newest grid is rendered after the current one.

    def color(self) -> None:
        """Apply a changed theme."""
        for raster in (self.raster, self._rendering):
            if raster is not None:
                raster.color(self._theme)
        self._key = None

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
            self._rendering.color(self._theme)
        self._render_more()

    def _render_more(self) -> None:
        rendering = self._rendering
        if rendering is None:
            return
        began_s = time.perf_counter()
        rendering.render_stripe()
        self.slowest_band_ms = max(self.slowest_band_ms, (time.perf_counter() - began_s) * 1e3)
        if not rendering.done:
            QTimer.singleShot(0, self, self._render_more)
            return
        self._rendering = None
        first = self.raster is None
        self.raster = rendering
        self.displayed_grid = rendering.grid
        if rendering.rows_changed:
            self._version += 1
        self.rendered.emit(first)
        if self.newest is not None and self.newest is not rendering.grid:
            self._begin(self.newest)

    def paint(self, painter: QPainter, view: QWidget, viewport: MapViewport) -> None:
        raster = self.raster
        if raster is None:
            painter.fillRect(view.rect(), self._theme.color("map_unknown"))
            return
        ratio = view.devicePixelRatioF()
        key = (
            id(raster), self._version, view.size(), ratio,
            viewport.scale, viewport.turn_rad, viewport.center.x(), viewport.center.y(),
        )  # fmt: skip
        if key != self._key or self._picture is None:
            size = QSize(round(view.width() * ratio), round(view.height() * ratio))
            if self._picture is None or self._picture.size() != size:
                self._picture = QImage(size, QImage.Format.Format_RGB32)
            self._picture.setDevicePixelRatio(ratio)
            self._picture.fill(self._theme.color("map_unknown"))
            onto = QPainter(self._picture)
            corner = raster.grid.origin_in_map
            level = raster.level_for(raster.grid.resolution_m * viewport.scale * ratio)
            cell_m = raster.grid.resolution_m * 2**level
            transform = QTransform()
            transform.translate(corner.x_m, corner.y_m)
            transform.rotateRadians(corner.heading_rad)
            transform.scale(cell_m, cell_m)
            to_view = transform * viewport.transform()
            onto.setTransform(to_view)
            small = size.width() * size.height() <= _SMOOTH_AREA_PX
            smooth = small and cell_m * viewport.scale < 3.0
            onto.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform, smooth)
            # Qt draws indexed images at a quarter of the speed; the visible part has few cells.
            visible = to_view.inverted()[0].mapRect(QRectF(view.rect())).toAlignedRect().adjusted(-1, -1, 1, 1)
            visible = visible.intersected(raster.images[level].rect())
            if not visible.isEmpty():
                cells = raster.images[level].copy(visible).convertToFormat(QImage.Format.Format_RGB32)
                onto.drawImage(QPointF(visible.topLeft()), cells)
            onto.end()
            self._key = key
        painter.drawImage(QPointF(0, 0), self._picture)


CELLS_AT_ONCE = 500_000
"""Cells per band: a millisecond of work, five on a busy machine."""

_SMALLEST_LEVEL = 256


class GridRaster:
    """Rasterised occupancy grid: mipmap images, rendered in bands and updated only where cells changed.

    Grid with mipmap levels as images of one byte per cell.

    A byte is 0 for unknown, else 1 + occupancy. A level keeps the maximum of four cells, so that a one-cell wall
    remains visible when a whole building is in view; known cells override unknown ones.
    """

    def __init__(self, grid: OccupancyGrid) -> None:
        self.grid = grid
        height, width = grid.cells.shape
        # QImage rows are aligned to four bytes.
        self._levels: list[NDArray[np.uint8]] = [_blank(height, width)]
        while max(self._levels[-1].shape) > _SMALLEST_LEVEL:
            rows, columns = self._levels[-1].shape
            self._levels.append(_blank((rows + 1) // 2, (columns + 1) // 2))
        self.images = [_picture_of(level) for level in self._levels]
        self._known_rows = np.zeros(height, bool)
        self._known_columns = np.zeros(width, bool)
        # Multiple of the coarsest level's block, so that no level needs rows of the next band.
        block = 1 << (len(self._levels) - 1)
        self._rows_per_band = max(block, CELLS_AT_ONCE // max(1, width) // block * block)
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
        """Start an update of the same map, applied by :meth:`render_stripe`."""
        self.grid = grid
        self._next_row = 0
        self._fresh = False
        self.rows_changed = 0

    def render_stripe(self) -> None:
        """Render the next band of rows."""
        first = self._next_row
        # int8 viewed as uint8: -1 is 255, and 255 + 1 wraps to 0.
        band = self.grid.cells[first : first + self._rows_per_band].view(np.uint8) + np.uint8(1)
        last = first + len(band)
        self._next_row = last
        mine = self._levels[0][first:last]
        if not self._fresh:
            changed = np.flatnonzero((mine != band).any(axis=1))
            if not changed.size:
                return
            block = 1 << (len(self._levels) - 1)
            from_row = int(changed[0]) // block * block
            band = band[from_row : int(changed[-1]) + 1]
            first, last = first + from_row, first + from_row + len(band)
            mine = self._levels[0][first:last]
        self.rows_changed += last - first
        mine[:] = band
        known = band > 0
        self._known_rows[first:last] = known.any(axis=1)
        self._known_columns |= known.any(axis=0)
        for finer, coarser in zip(self._levels, self._levels[1:], strict=False):
            first, last = first // 2, (last + 1) // 2
            _halve(finer[2 * first : 2 * last], coarser[first:last])

    def level_for(self, cell_px: float) -> int:
        """Coarsest level whose cells cover at most 1.5 px in the view."""
        level = 0
        while level + 1 < len(self._levels) and cell_px * 2 ** (level + 1) <= 1.5:
            level += 1
        return level

    def color(self, theme: Theme) -> None:
        """Set the theme's colour table."""
        table = _color_table(theme)
        for image in self.images:
            image.setColorTable(table)

    def value_at(self, x_m: float, y_m: float) -> int | None:
        """Occupancy 0..100 at a map point; None if unknown or outside."""
        grid = self.grid
        inside = grid.origin_in_map.inverse()
        cos, sin = np.cos(inside.heading_rad), np.sin(inside.heading_rad)
        column = int(np.floor((inside.x_m + cos * x_m - sin * y_m) / grid.resolution_m))
        row = int(np.floor((inside.y_m + sin * x_m + cos * y_m) / grid.resolution_m))
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


def _blank(rows: int, columns: int) -> NDArray[np.uint8]:
    """Zeros with rows aligned to four bytes."""
    return np.zeros((rows, (columns + 3) // 4 * 4), np.uint8)[:, :columns]


def _picture_of(level: NDArray[np.uint8]) -> QImage:
    rows, columns = level.shape
    # The whole buffer with padding; the raster owns both array and image.
    buffer = level.base if isinstance(level.base, np.ndarray) else level
    return QImage(buffer.data, columns, rows, level.strides[0], QImage.Format.Format_Indexed8)


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


def _color_table(theme: Theme) -> list[int]:
    free, wall = theme.color("map_free"), theme.color("map_wall")
    table = [_packed(_channels(theme.color("map_unknown")))]
    for value in range(255):
        share = min(1.0, max(0.0, (value - 25) / 40))
        pairs = zip(_channels(free), _channels(wall), strict=True)
        table.append(_packed(tuple(round(one + (other - one) * share) for one, other in pairs)))
    return table


def _channels(color: QColor) -> tuple[int, int, int]:
    return color.red(), color.green(), color.blue()


def _packed(channels: Sequence[int]) -> int:
    """Opaque colour in Qt's packed format."""
    red, green, blue = channels
    return 0xFF000000 | red << 16 | green << 8 | blue
