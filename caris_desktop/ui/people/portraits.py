"""Portraits of people: decoded, cached, as a widget, and as an avatar without a picture."""

import math
import time
from collections.abc import Callable

from PySide6.QtCore import QRect, QRectF, QSize, Qt
from PySide6.QtGui import QPainter, QPainterPath, QPen, QPixmap
from PySide6.QtWidgets import QLabel

from caris_desktop.domain.translation import tr
from caris_desktop.people.presence import PersonRow
from caris_desktop.ui import text_formatting, tokens
from caris_desktop.ui.theme import Theme, draw_icon
from caris_desktop.ui.widgets.pictures import image_of

AVATAR_PX = 38


def draw_avatar(painter: QPainter, theme: Theme, place: QRectF, name: str, *, known: bool, here: bool) -> None:
    """Draw an avatar: solid outline for a named person, dashed without a name, hollow for one who left."""
    role = "dim" if not here else ("green" if known else "blue")
    painter.save()
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    pen = QPen(theme.color(role), 1.6)
    if not known:
        pen.setDashPattern([3, 2.4])
    painter.setPen(pen)
    painter.setBrush(theme.color(f"{role}_soft") if here else Qt.BrushStyle.NoBrush)
    rect = place.adjusted(1, 1, -1, -1)
    painter.drawEllipse(rect)
    if known:
        initials = "".join(word[0] for word in name.split()[:2]).upper()
        painter.setFont(theme.font(tokens.STATUS_PX + 1, tokens.WEIGHT_SEMIBOLD))
        painter.setPen(theme.color(role))
        painter.drawText(rect, Qt.AlignmentFlag.AlignCenter, initials)
    else:
        draw_icon(painter, rect.adjusted(9, 9, -9, -9), "user", theme.color(role))
    painter.restore()


_AT_MOST = 600
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
        pixmap = self._cache.pop((key, size_px), None)
        if pixmap is None:
            jpeg = self._jpeg_of(key) if key else None
            if jpeg is None:
                return None
            now_s = time.monotonic()
            if may_wait and self._busy() and now_s - self._decoded_s < EVERY_WHEN_BUSY_S:
                self.put_off = True
                return None
            self._decoded_s = now_s
            pixmap = _square(jpeg, size_px * _DETAIL)
            while len(self._cache) >= _AT_MOST:
                del self._cache[next(iter(self._cache))]
        # Least recently used first out.
        self._cache[(key, size_px)] = pixmap
        return None if pixmap.isNull() else pixmap

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


def _square(jpeg: bytes, size_px: int) -> QPixmap:
    """Upper middle of the image, where the head is."""
    image = image_of(jpeg)
    if image.isNull():
        return QPixmap()
    side = min(image.width(), image.height())
    cut = image.copy((image.width() - side) // 2, 0, side, side)
    size = QSize(size_px, size_px)
    return QPixmap.fromImage(
        cut.scaled(size, Qt.AspectRatioMode.IgnoreAspectRatio, Qt.TransformationMode.SmoothTransformation)
    )


class PortraitView(QLabel):
    """Portrait of one person, or the avatar without one."""

    def __init__(self, theme: Theme, portraits: PortraitPixmaps, size_px: int) -> None:
        super().__init__()
        self._theme = theme
        self._portraits = portraits
        self._person: PersonRow | None = None
        self.setFixedSize(size_px, size_px)
        theme.changed.connect(self._draw)

    def show_person(self, person: PersonRow) -> None:
        if person != self._person:
            self._person = person
            self.setAccessibleName(tr("Portrait of {name}").format(name=text_formatting.person_name(person)))
            self._draw()

    def _draw(self) -> None:
        person = self._person
        if person is None:
            return
        pixmap = QPixmap(self.size() * _DETAIL)
        pixmap.setDevicePixelRatio(_DETAIL)
        pixmap.fill(Qt.GlobalColor.transparent)
        painter = QPainter(pixmap)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if not self._portraits.draw(painter, self.rect(), person.portrait):
            named = text_formatting.has_given_name(person)
            draw_avatar(painter, self._theme, QRectF(self.rect()), person.name, known=named, here=person.here)
        painter.end()
        self.setPixmap(pixmap)
