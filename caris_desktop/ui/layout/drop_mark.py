"""Drag feedback: drop target highlight, and a description at the pointer."""

from PySide6.QtCore import QPoint, QRect, QRectF, Qt
from PySide6.QtGui import QColor, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QLabel, QWidget

from caris_desktop.ui.tokens import PANEL_RADIUS_PX

_BESIDE_POINTER = QPoint(16, 18)
_GROUND_ALPHA = 70


class DropMark(QWidget):
    """Highlight of the drop target, transparent to the mouse."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.setObjectName("drop_mark")
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)

    def paintEvent(self, _event: QPaintEvent) -> None:
        """Translucent: the content below helps to aim."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        ground = QColor(self.palette().highlight().color())
        painter.setPen(QPen(ground, 3))
        ground.setAlpha(_GROUND_ALPHA)
        painter.setBrush(ground)
        painter.drawRoundedRect(QRectF(self.rect()).adjusted(2, 2, -2, -2), PANEL_RADIUS_PX, PANEL_RADIUS_PX)

    def show_at(self, over: QWidget, rect: QRect) -> None:
        if self.parentWidget() is not over:
            self.setParent(over)
        self.setGeometry(rect)
        self.raise_()
        self.show()


class DragWords(QLabel):
    """Label that follows the pointer."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent, Qt.WindowType.ToolTip)
        self.setObjectName("drag_words")
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.setAttribute(Qt.WidgetAttribute.WA_ShowWithoutActivating)

    def show_at(self, at: QPoint, text: str) -> None:
        self.setText(text)
        self.adjustSize()
        self.move(at + _BESIDE_POINTER)
        self.show()
