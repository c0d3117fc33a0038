"""A round mark for a person: initials where named, a figure where not."""

from PySide6.QtCore import QRectF, QSize, Qt
from PySide6.QtGui import QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QSizePolicy, QWidget

from caris_desktop.ui import tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.theme import Theme

_SIZE_PX = 38


class Avatar(QWidget):
    """Solid line for a person with a name, dashed without, hollow for one who left."""

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self._theme = theme
        self._name = ""
        self._known = False
        self._here = True
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Fixed)
        theme.changed.connect(self.update)

    def show_person(self, name: str, *, known: bool, here: bool) -> None:
        self._name, self._known, self._here = name, known, here
        self.update()

    def sizeHint(self) -> QSize:
        return QSize(_SIZE_PX, _SIZE_PX)

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme = self._theme
        role = "dim" if not self._here else ("green" if self._known else "blue")
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        pen = QPen(theme.color(role), 1.6)
        if not self._known:
            pen.setDashPattern([3, 2.4])
        painter.setPen(pen)
        painter.setBrush(theme.color(f"{role}_soft") if self._here else Qt.BrushStyle.NoBrush)
        rect = QRectF(self.rect()).adjusted(1, 1, -1, -1)
        painter.drawEllipse(rect)
        if self._known:
            initials = "".join(word[0] for word in self._name.split()[:2]).upper()
            painter.setFont(theme.font(tokens.STATUS_PX + 1, tokens.WEIGHT_SEMIBOLD))
            painter.setPen(theme.color(role))
            painter.drawText(rect, Qt.AlignmentFlag.AlignCenter, initials)
        else:
            draw_icon(painter, rect.adjusted(9, 9, -9, -9), "user", theme.color(role))
