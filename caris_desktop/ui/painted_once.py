"""Small things that are painted again and again look the same each time: they are painted once, and then copied.

Text and round corners are what a frame of a video over which boxes, names and chips lie would cost most: with each
frame of the robot's camera they are painted anew.
"""

from collections import OrderedDict
from collections.abc import Callable, Hashable

from PySide6.QtCore import QPointF, QSize, QSizeF, Qt
from PySide6.QtGui import QPaintEngine, QPainter, QPixmap

AT_MOST = 96
"""Pictures kept, the ones used last; a label is a few kilobytes."""


class PaintedOnce:
    """Pictures by key, for one widget or for all of a kind. GUI thread only."""

    def __init__(self, at_most: int = AT_MOST) -> None:
        self._at_most = at_most
        self._kept: OrderedDict[Hashable, QPixmap] = OrderedDict()

    def clear(self) -> None:
        """What they were painted with, as the theme, is another one now."""
        self._kept.clear()

    def draw(
        self,
        painter: QPainter,
        at: QPointF,
        size: QSizeF,
        key: Hashable,
        paint: Callable[[QPainter], None],
    ) -> None:
        """Copy the picture to ``at``; the rest as for :meth:`picture`."""
        if size.isEmpty():
            return
        engine = painter.paintEngine()
        if engine is not None and engine.type() is not QPaintEngine.Type.Raster:
            # A drawing that keeps its texts, as a test looks at one, keeps these too.
            painter.save()
            painter.translate(at)
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            paint(painter)
            painter.restore()
            return
        ratio = _ratio_of(painter)
        # On whole pixels a copy stays sharp.
        where = QPointF(round(at.x() * ratio) / ratio, round(at.y() * ratio) / ratio)
        painter.drawPixmap(where, self.picture(painter, size, key, paint))

    def picture(self, painter: QPainter, size: QSizeF, key: Hashable, paint: Callable[[QPainter], None]) -> QPixmap:
        """The picture of this ``key``; if there is none yet ``paint`` makes it, from (0, 0) to ``size``.

        ``key`` holds whatever the picture depends on but its size and the scale of the screen of ``painter``.
        """
        ratio = _ratio_of(painter)
        whole = (key, size.width(), size.height(), ratio)
        picture = self._kept.get(whole)
        if picture is None:
            picture = QPixmap((size * ratio).toSize().expandedTo(QSize(1, 1)))
            picture.setDevicePixelRatio(ratio)
            picture.fill(Qt.GlobalColor.transparent)
            onto = QPainter(picture)
            onto.setRenderHint(QPainter.RenderHint.Antialiasing)
            paint(onto)
            onto.end()
            self._kept[whole] = picture
            if len(self._kept) > self._at_most:
                self._kept.popitem(last=False)
        else:
            self._kept.move_to_end(whole)
        return picture


def _ratio_of(painter: QPainter) -> float:
    device = painter.device()
    return device.devicePixelRatioF() if device is not None else 1.0
