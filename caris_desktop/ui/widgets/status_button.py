"""Status bar button that opens a list; reachable by Tab."""

from PySide6.QtCore import QRectF, QSize, Qt, Signal
from PySide6.QtGui import QFontMetricsF, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QAbstractButton, QSizePolicy

from caris_desktop.ui import tokens
from caris_desktop.ui.theme import Theme, draw_icon

_ANY_PX = 16_777_215


class StatusButton(QAbstractButton):
    """Icon and coloured text; hidden while the text is empty."""

    words_changed = Signal()

    def __init__(self, theme: Theme, name: str, tip: str) -> None:
        super().__init__()
        self.setObjectName(name)
        self._theme = theme
        self._icon, self._role = "", "dim"
        self._most_px = _ANY_PX
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setCursor(Qt.CursorShape.PointingHandCursor)
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Expanding)
        self.setToolTip(tip)
        theme.changed.connect(self.update)

    @property
    def role(self) -> str:
        return self._role

    def show_words(self, text: str, icon: str, role: str, *, spoken: str) -> None:
        """Set the text; ``spoken``: its accessible name."""
        if not text:
            self.hide()
            self.words_changed.emit()
        elif self.parentWidget() is not None:
            self.show()
        if (text, icon, role) == (self.text(), self._icon, self._role):
            return
        self._icon, self._role = icon, role
        self.setText(text)
        self.setAccessibleName(spoken)
        self.updateGeometry()
        self.update()
        self.words_changed.emit()

    def use_room(self, width_px: int) -> None:
        """Limit the width; the text is elided."""
        if width_px != self._most_px:
            self._most_px = width_px
            self.updateGeometry()
            self.update()

    @property
    def full_px(self) -> int:
        """Width in px with its whole text."""
        return round(QFontMetricsF(self._theme.font(tokens.STATUS_PX)).horizontalAdvance(self.text())) + 24

    def sizeHint(self) -> QSize:
        return QSize(min(self.full_px, self._most_px), 24)

    def minimumSizeHint(self) -> QSize:
        return self.sizeHint()

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter, theme = QPainter(self), self._theme
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self.hasFocus():
            painter.setPen(QPen(theme.color("blue"), 1.4))
            painter.drawRoundedRect(QRectF(self.rect()).adjusted(0.7, 4.7, -0.7, -4.7), 6, 6)
        role = "dim" if self._role == "green" and not self.underMouse() else self._role
        draw_icon(painter, QRectF(2, self.height() / 2 - 7.5, 15, 15), self._icon, theme.color(self._role))
        painter.setFont(theme.font(tokens.STATUS_PX))
        painter.setPen(theme.color("text" if self.underMouse() else role))
        rect = QRectF(22, 0, self.width() - 22, self.height())
        text = self.text()
        if self.full_px > self._most_px:
            text = painter.fontMetrics().elidedText(text, Qt.TextElideMode.ElideRight, round(rect.width()))
        painter.drawText(rect, int(Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignLeft), text)
