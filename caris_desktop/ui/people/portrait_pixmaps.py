"""Portrait cache: decoded and scaled pixmaps."""

import math
import time
from collections.abc import Callable

from PySide6.QtCore import QRect, QSize, Qt
from PySide6.QtGui import QImage, QPainter, QPainterPath, QPixmap

from caris_desktop.ui.widgets.foreign_picture import image_of

_KEPT = 600
_DETAIL = 2
"""Cached pixels per displayed pixel, for high-resolution screens."""
EVERY_WHEN_BUSY_S = 1.0


class PortraitPixmaps:
    """Portrait cache. ``jpeg_of`` returns the image of a key, or None. While the machine is ``busy``, deferrable images
    are decoded one at a time.
    """

    def __init__(self, jpeg_of: Callable[[str], bytes | None], busy: Callable[[], bool] = lambda: False) -> None:
        self._jpeg_of = jpeg_of
        self._busy = busy
        self._decoded_s = -math.inf
        self.put_off = False
        """Something was not drawn that can be drawn in a second."""
        self._cache: dict[tuple[str, int], QPixmap] = {}

    def pixmap(self, key: str, size_px: int, *, may_wait: bool = False) -> QPixmap | None:
        """Square pixmap of this key; None if missing, unreadable or deferred."""
        if not key:
            return None
        cached = self._cache.pop((key, size_px), None)
        if cached is None:
            jpeg = self._jpeg_of(key)
            if jpeg is None:
                return None
            now_s = time.monotonic()
            if may_wait and self._busy() and now_s - self._decoded_s < EVERY_WHEN_BUSY_S:
                self.put_off = True
                return None
            self._decoded_s = now_s
            cached = _square(image_of(jpeg), size_px * _DETAIL)
            while len(self._cache) >= _KEPT:
                del self._cache[next(iter(self._cache))]
        # Least recently used first out.
        self._cache[(key, size_px)] = cached
        return None if cached.isNull() else cached

    def draw(self, painter: QPainter, place: QRect, key: str, *, may_wait: bool = False) -> bool:
        """Paint the portrait as a circle; False if there is none."""
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
    """Upper middle of the image, where the head is."""
    if image.isNull():
        return QPixmap()
    side = min(image.width(), image.height())
    cut = image.copy((image.width() - side) // 2, 0, side, side)
    scaled = cut.scaled(
        QSize(size_px, size_px), Qt.AspectRatioMode.IgnoreAspectRatio, Qt.TransformationMode.SmoothTransformation
    )
    return QPixmap.fromImage(scaled)
