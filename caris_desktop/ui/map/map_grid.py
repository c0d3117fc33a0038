"""Occupancy grid of the map: an image item of halved levels, updated in bands of rows where cells changed."""

import time
from typing import Any

import numpy as np
import pyqtgraph
from numpy.typing import NDArray
from PySide6.QtCore import QPointF, QRect, QRectF, QTimer, Signal
from PySide6.QtGui import QColor, QImage, QPainter, QTransform

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import OccupancyGrid
from caris_desktop.domain.translation import tr
from caris_desktop.ui.theme import Theme

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
