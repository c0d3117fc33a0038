"""Thumbnail of a photo just taken, shown briefly in the corner of the picture."""

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QEvent, QObject, QRectF, Qt, QTimer
from PySide6.QtGui import QAccessible, QFontMetrics, QImage, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QWidget

from caris_desktop.ui import tokens
from caris_desktop.ui.theme import Theme, draw_icon

SHOWN_MS = 4000
_PICTURE_PX = 168
_LINE_PX = 26
_EDGE_PX = 8


def thumbnail_of(image_bgr: NDArray[np.uint8]) -> QImage:
    """Thumbnail of ``image_bgr``, uint8 of shape (height, width, 3)."""
    height, width = image_bgr.shape[:2]
    image = QImage(image_bgr.data, width, height, 3 * width, QImage.Format.Format_BGR888)
    return image.scaledToWidth(_PICTURE_PX, Qt.TransformationMode.FastTransformation)


class PhotoThumbnail(QWidget):
    """Thumbnail over the lower right of ``over``, or so far below its upper edge; transparent to the mouse."""

    accessible_role = QAccessible.Role.Graphic

    def __init__(self, theme: Theme, over: QWidget, *, top_px: int | None = None) -> None:
        super().__init__(over)
        self.setObjectName("photo_thumbnail")
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self._theme = theme
        self._over = over
        self._top_px = top_px
        self._image: QImage | None = None
        self._line = ""
        self._going = QTimer(self, singleShot=True, interval=SHOWN_MS)
        self._going.timeout.connect(self.hide)
        over.installEventFilter(self)
        self.hide()

    @property
    def image(self) -> QImage | None:
        return self._image

    def show_photo(self, image: QImage | None, line: str, file_name: str) -> None:
        """Show the thumbnail; only the text if ``image`` is None."""
        self._image, self._line = image, line
        self.setAccessibleName(f"{line}: {file_name}")
        self._place()
        self.show()
        self.raise_()
        self.update()
        self._going.start()

    def _place(self) -> None:
        picture_px = self._image.height() if self._image is not None else 0
        metrics = QFontMetrics(self._theme.font(tokens.STATUS_PX))
        width = max(_PICTURE_PX, metrics.horizontalAdvance(self._line) + 30) + 2 * _EDGE_PX
        height = picture_px + _LINE_PX + _EDGE_PX + (_EDGE_PX if not picture_px else 0)
        top = self._over.height() - height - 12 if self._top_px is None else self._top_px
        self.setGeometry(self._over.width() - width - 12, top, width, height)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if event.type() == QEvent.Type.Resize and self.isVisible():
            self._place()
        return super().eventFilter(watched, event)

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme = self._theme
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(QPen(theme.color("video_line"), 1))
        painter.setBrush(theme.color("video_chip"))
        painter.drawRoundedRect(
            QRectF(self.rect()).adjusted(0.5, 0.5, -0.5, -0.5), tokens.CONTROL_RADIUS_PX, tokens.CONTROL_RADIUS_PX
        )
        top = _EDGE_PX
        if self._image is not None:
            painter.drawImage((self.width() - self._image.width()) // 2, top, self._image)
            top += self._image.height()
        line = QRectF(_EDGE_PX, top, self.width() - 2 * _EDGE_PX, _LINE_PX)
        draw_icon(painter, QRectF(line.left() + 2, line.center().y() - 8, 16, 16), "check", theme.color("box_named"))
        painter.setFont(theme.font(tokens.STATUS_PX))
        painter.setPen(theme.color("video_text"))
        painter.drawText(line.adjusted(24, 0, 0, 0), int(Qt.AlignmentFlag.AlignVCenter), self._line)
