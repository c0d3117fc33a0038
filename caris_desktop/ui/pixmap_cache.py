"""Pixmap cache for small items that are painted repeatedly.

Text and round corners are the most expensive part of a video frame with boxes, names and labels, and would be repainted
with each frame of the robot's camera.
"""

from collections import OrderedDict
from collections.abc import Callable, Hashable

from PySide6.QtCore import QPointF, QSize, QSizeF, Qt
from PySide6.QtGui import QPaintEngine, QPainter, QPixmap

AT_MOST = 96
"""Maximum number of cached pixmaps, least recently used first out; a label takes a few kilobytes."""


class PixmapCache:
    """Pixmap cache by key, for one widget or a class of widgets. GUI thread only."""

    def __init__(self, at_most: int = AT_MOST) -> None:
        self._at_most = at_most
        self._pixmaps: OrderedDict[Hashable, QPixmap] = OrderedDict()

    def clear(self) -> None:
        """Clear the cache, for example after a change of theme."""
        self._pixmaps.clear()

    def draw(
        self, painter: QPainter, at: QPointF, size: QSizeF, key: Hashable, paint: Callable[[QPainter], None]
    ) -> None:
        """Paint the cached pixmap at ``at``; other parameters as for :meth:`picture`."""
        if size.isEmpty():
            return
        engine = painter.paintEngine()
        if engine is not None and engine.type() is not QPaintEngine.Type.Raster:
            # A vector paint device, such as one that tests inspect, gets the drawing itself.
            painter.save()
            painter.translate(at)
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            paint(painter)
            painter.restore()
            return
        ratio = _ratio_of(painter)
        # Aligned to whole pixels, the copy stays sharp.
        where = QPointF(round(at.x() * ratio) / ratio, round(at.y() * ratio) / ratio)
        painter.drawPixmap(where, self.picture(painter, size, key, paint))

    def picture(self, painter: QPainter, size: QSizeF, key: Hashable, paint: Callable[[QPainter], None]) -> QPixmap:
        """Pixmap of this ``key``; on a cache miss ``paint`` draws it, from (0, 0) to ``size``.

        ``key`` must hold everything the pixmap depends on except its size and the screen scale of ``painter``.
        """
        ratio = _ratio_of(painter)
        full_key = (key, size.width(), size.height(), ratio)
        picture = self._pixmaps.get(full_key)
        if picture is None:
            picture = QPixmap((size * ratio).toSize().expandedTo(QSize(1, 1)))
            picture.setDevicePixelRatio(ratio)
            picture.fill(Qt.GlobalColor.transparent)
            onto = QPainter(picture)
            onto.setRenderHint(QPainter.RenderHint.Antialiasing)
            paint(onto)
            onto.end()
            self._pixmaps[full_key] = picture
            if len(self._pixmaps) > self._at_most:
                self._pixmaps.popitem(last=False)
        else:
            self._pixmaps.move_to_end(full_key)
        return picture


def _ratio_of(painter: QPainter) -> float:
    device = painter.device()
    return device.devicePixelRatioF() if device is not None else 1.0
