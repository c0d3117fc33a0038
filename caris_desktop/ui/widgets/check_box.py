"""Check box with a painted mark: a style sheet would need image files."""

from typing import Any

from PySide6.QtCore import QRect, QRectF, QSize, Qt
from PySide6.QtGui import QFontMetricsF, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QCheckBox, QSizePolicy

from caris_desktop.ui.theme import Theme, draw_icon

BOX_PX = 18
TEXT_LEFT_PX = BOX_PX + 10
_LEAST_WRAPPED_PX = 200


class CheckBox(QCheckBox):
    """A click does not take the focus from typing or driving.

    With ``wraps`` the text wraps. ``qt``: properties and signals of Qt, such as objectName and toggled.
    """

    def __init__(self, theme: Theme, text: str = "", *, wraps: bool = False, **qt: Any) -> None:
        super().__init__(text, **qt)
        self._theme = theme
        self._wraps = wraps
        if wraps:
            policy = QSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Minimum)
            policy.setHeightForWidth(True)
            self.setSizePolicy(policy)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setMinimumHeight(BOX_PX + 6)
        theme.changed.connect(self.update)

    def sizeHint(self) -> QSize:
        width = QFontMetricsF(self.font()).horizontalAdvance(self.text())
        return QSize(round(TEXT_LEFT_PX + width + 4), max(BOX_PX + 6, self.fontMetrics().height() + 4))

    def minimumSizeHint(self) -> QSize:
        size = self.sizeHint()
        return QSize(min(size.width(), _LEAST_WRAPPED_PX), size.height()) if self._wraps else size

    def heightForWidth(self, width: int) -> int:
        if not self._wraps:
            return self.sizeHint().height()
        room = QRect(0, 0, max(1, width - TEXT_LEFT_PX), 2000)
        wrapped = self.fontMetrics().boundingRect(room, int(Qt.TextFlag.TextWordWrap), self.text())
        return max(BOX_PX + 6, wrapped.height() + 4)

    def hitButton(self, _pos: object) -> bool:
        return True  # the whole area

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme, checked = self._theme, self.isChecked()
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if not self.isEnabled():
            painter.setOpacity(0.6)
        box = QRectF(1.5, self.height() / 2 - BOX_PX / 2 + 0.5, BOX_PX - 1, BOX_PX - 1)
        painter.setPen(QPen(theme.color("blue" if checked or self.hasFocus() else "dim"), 1.4))
        painter.setBrush(theme.color("blue" if checked else "field"))
        painter.drawRoundedRect(box, 4, 4)
        if checked:
            draw_icon(painter, box.adjusted(2, 2, -2, -2), "check-bold", theme.color("on_blue"))
        if self.hasFocus():
            painter.setPen(QPen(theme.color("blue"), 1.4))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(box.adjusted(-1.5, -1.5, 1.5, 1.5), 5, 5)
        painter.setPen(theme.color("text"))
        painter.setFont(self.font())
        rect = QRectF(TEXT_LEFT_PX, 0, self.width() - TEXT_LEFT_PX, self.height())
        flags = int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft)
        painter.drawText(rect, flags | int(Qt.TextFlag.TextWordWrap) if self._wraps else flags, self.text())
