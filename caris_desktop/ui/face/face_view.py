"""Face widget, scaled to the space available."""

from typing import Any, assert_never

import numpy as np
from PySide6.QtCore import QPointF, QRectF, QSize, Qt
from PySide6.QtGui import QAccessible, QColor, QFont, QImage, QPainter, QPainterPath, QPaintEvent, QPen
from PySide6.QtWidgets import QWidget

from caris_desktop.conversation.face.drawing import Box, Drawing, Lips, Words
from caris_desktop.domain.translation import tr
from caris_desktop.ui.widgets.pictures import image_of


class FaceView(QWidget):
    """Displays a face drawing, a text or a picture."""

    accessible_role = QAccessible.Role.Graphic

    def __init__(self) -> None:
        super().__init__()
        self._drawing: Drawing | None = None
        self._picture: QImage | None = None
        self.setAccessibleName(tr("The robot's face"))

    def sizeHint(self) -> QSize:
        return QSize(320, 240)

    def show_drawing(self, drawing: Drawing | None) -> None:
        if drawing != self._drawing or self._picture is not None:
            self._drawing, self._picture = drawing, None
            self.update()

    def show_picture(self, picture: QImage) -> None:
        self._picture = picture
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
        if self._picture is not None:
            painter.fillRect(self.rect(), QColor("black"))
            size = self._picture.size().scaled(self.size(), Qt.AspectRatioMode.KeepAspectRatio)
            left, top = (self.width() - size.width()) / 2, (self.height() - size.height()) / 2
            painter.drawImage(QRectF(left, top, size.width(), size.height()), self._picture)
            return
        drawing = self._drawing
        painter.fillRect(self.rect(), QColor(drawing.background if drawing is not None else "black"))
        if drawing is None:
            return
        unit = min(self.width(), self.height()) / 100
        painter.translate(self.width() / 2, self.height() / 2)
        for shape in drawing.shapes:
            draw_shape(painter, shape, unit)


def draw_shape(painter: QPainter, shape: Box | Lips | Words, unit: float) -> None:
    """Draw a shape around the painter's origin; ``unit``: pixels per hundredth of the shorter side."""
    ink = QColor(shape.ink)
    match shape:
        case Box():
            painter.save()
            painter.translate(shape.x * unit, shape.y * unit)
            painter.rotate(shape.turn_deg)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(ink)
            width, height, radius = shape.width * unit, shape.height * unit, shape.radius * unit
            painter.drawRoundedRect(QRectF(-width / 2, -height / 2, width, height), radius, radius)
            painter.restore()
        case Lips():
            path = QPainterPath(QPointF(shape.left * unit, shape.y * unit))
            middle = (shape.left + shape.right) / 2 * unit
            path.quadTo(middle, _through(shape.y, shape.upper) * unit, shape.right * unit, shape.y * unit)
            path.quadTo(middle, _through(shape.y, shape.lower) * unit, shape.left * unit, shape.y * unit)
            pen = QPen(ink, shape.stroke * unit, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap)
            pen.setJoinStyle(Qt.PenJoinStyle.RoundJoin)
            painter.setPen(pen)
            painter.setBrush(ink)
            painter.drawPath(path)
        case Words():
            font = QFont(painter.font())
            font.setPixelSize(max(1, round(shape.size * unit)))
            painter.setFont(font)
            painter.setPen(ink)
            width = shape.width * unit
            box = QRectF(-width / 2, shape.y * unit, width, 100 * unit)
            flags = Qt.AlignmentFlag.AlignHCenter | Qt.AlignmentFlag.AlignTop
            painter.drawText(box, int(flags) | int(Qt.TextFlag.TextWordWrap), shape.text)
        case _:
            assert_never(shape)


def _through(y: float, middle: float) -> float:
    """Control point of a curve whose midpoint is ``middle``."""
    return 2 * middle - y


def show_on(view: FaceView, contents: Any) -> None:
    """Show a drawing, an image array or JPEG data, or nothing."""
    if isinstance(contents, bytes):
        view.show_picture(image_of(contents))
    elif isinstance(contents, np.ndarray):
        height, width = contents.shape[:2]
        # The array may be freed before the widget paints.
        view.show_picture(QImage(contents.data, width, height, 3 * width, QImage.Format.Format_BGR888).copy())
    else:
        view.show_drawing(contents if isinstance(contents, Drawing) else None)
