"""Grid layer of the map view: rendered in bands of rows, painted from an image of the visible part."""

import time

from PySide6.QtCore import QObject, QPointF, QRectF, QSize, QTimer, Signal
from PySide6.QtGui import QImage, QPainter, QTransform
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import OccupancyGrid
from caris_desktop.domain.translation import tr
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.map_raster import GridRaster
from caris_desktop.ui.widgets.map_viewport import MapViewport

OCCUPIED = 65
"""Occupancy from which a cell is an obstacle, as in ROS map_server."""

_SMOOTH_AREA_PX = 700_000


class GridLayer(QObject):
    """Grid layer. ``newest``: latest grid received; ``shown``: the painted one, rendered as ``raster``."""

    rendered = Signal(bool)  # whether it is the first one

    def __init__(self, theme: Theme, parent: QObject) -> None:
        super().__init__(parent)
        self._theme = theme
        self.newest: OccupancyGrid | None = None
        self.shown: OccupancyGrid | None = None
        self.raster: GridRaster | None = None
        self.slowest_band_ms = 0.0
        self._rendering: GridRaster | None = None  # being rendered or updated
        self._picture: QImage | None = None
        self._key: object = None
        self._version = 0

    def show(self, grid: OccupancyGrid | None) -> None:
        self.newest = grid
        if grid is None:
            self.raster = self._rendering = self.shown = self._picture = None
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
        self.shown = rendering.grid
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
            seen = to_view.inverted()[0].mapRect(QRectF(view.rect())).toAlignedRect().adjusted(-1, -1, 1, 1)
            seen = seen.intersected(raster.images[level].rect())
            if not seen.isEmpty():
                cells = raster.images[level].copy(seen).convertToFormat(QImage.Format.Format_RGB32)
                onto.drawImage(QPointF(seen.topLeft()), cells)
            onto.end()
            self._key = key
        painter.drawImage(QPointF(0, 0), self._picture)
