"""Icon in a colour of the theme."""

from PySide6.QtCore import QRectF
from PySide6.QtGui import QPainter, QPaintEvent
from PySide6.QtWidgets import QWidget

from caris_desktop.ui.theme import Theme, draw_icon


class IconLabel(QWidget):
    """Icon of a fixed size beside the text that says what it means."""

    def __init__(self, theme: Theme, name: str = "", role: str = "dim", *, size_px: int = 18) -> None:
        super().__init__()
        self._theme, self._name, self._role = theme, name, role
        self.setFixedSize(size_px, size_px)
        theme.changed.connect(self.update)

    def show_icon(self, name: str, role: str) -> None:
        self._name, self._role = name, role
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        if self._name:
            painter = QPainter(self)
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            draw_icon(painter, QRectF(self.rect()), self._name, self._theme.color(self._role))
