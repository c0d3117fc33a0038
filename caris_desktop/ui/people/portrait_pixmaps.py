"""The pictures of people, decoded once and kept small."""

import math
import time
from collections.abc import Callable

from PySide6.QtCore import QRect, QSize, Qt
from PySide6.QtGui import QImage, QPainter, QPainterPath, QPixmap

from caris_desktop.ui.widgets.foreign_picture import image_of

_KEPT = 600
_DETAIL = 2
"""A portrait is kept with so many pixels for each one shown, so that it is sharp on a fine screen too."""
EVERY_WHEN_BUSY_S = 1.0


class PortraitPixmaps:
    """``jpeg_of`` gives the picture of a key, None where there is none (yet). While the machine is ``busy`` those that
    may wait are decoded one at a time.
    """

    def __init__(self, jpeg_of: Callable[[str], bytes | None], busy: Callable[[], bool] = lambda: False) -> None:
        self._jpeg_of = jpeg_of
        self._busy = busy
        self._decoded_s = -math.inf
        self.put_off = False
        """Something was not drawn that can be drawn in a second."""
        self._kept: dict[tuple[str, int], QPixmap] = {}

    def pixmap(self, key: str, size_px: int, *, may_wait: bool = False) -> QPixmap | None:
        """The picture under this key as a square; None where there is none, it cannot be read or has to wait."""
        if not key:
            return None
        kept = self._kept.pop((key, size_px), None)
        if kept is None:
            jpeg = self._jpeg_of(key)
            if jpeg is None:
                return None
            now_s = time.monotonic()
            if may_wait and self._busy() and now_s - self._decoded_s < EVERY_WHEN_BUSY_S:
                self.put_off = True
                return None
            self._decoded_s = now_s
            kept = _square(image_of(jpeg), size_px * _DETAIL)
            while len(self._kept) >= _KEPT:
                del self._kept[next(iter(self._kept))]
        # The one that was used last goes last.
        self._kept[(key, size_px)] = kept
        return None if kept.isNull() else kept

    def draw(self, painter: QPainter, place: QRect, key: str, *, may_wait: bool = False) -> bool:
        """Draw the picture round; False where there is none."""
        pixmap = self.pixmap(key, place.width(), may_wait=may_wait)
        if pixmap is None:
            return False
        painter.save()
        painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
        outline = QPainterPath()
        outline.addEllipse(place.toRectF().adjusted(1, 1, -1, -1))
        painter.setClipPath(outline)
        painter.drawPixmap(place, pixmap)
        painter.restore()
        return True


def _square(image: QImage, size_px: int) -> QPixmap:
    """The upper middle of the picture, where the head is."""
    if image.isNull():
        return QPixmap()
    side = min(image.width(), image.height())
    cut = image.copy((image.width() - side) // 2, 0, side, side)
    scaled = cut.scaled(
        QSize(size_px, size_px), Qt.AspectRatioMode.IgnoreAspectRatio, Qt.TransformationMode.SmoothTransformation
    )
    return QPixmap.fromImage(scaled)
