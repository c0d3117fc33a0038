"""Popup that explains a refusal at the place where it occurred."""

from PySide6.QtCore import QRect, QRectF, Qt, QTimer
from PySide6.QtGui import QAccessible, QFontMetrics, QPaintEvent
from PySide6.QtWidgets import QWidget

from caris_desktop.ui import tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.theme import Theme

_SHOWN_MS = 7000
_WIDEST_PX = 420
_FLAGS = int(Qt.TextFlag.TextWordWrap | Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)


class WordsBubble(QWidget):
    """Popup over its parent that closes after a while or on the next command. Transparent to the mouse."""

    accessible_role = QAccessible.Role.HelpBalloon

    def __init__(self, theme: Theme, parent: QWidget) -> None:
        super().__init__(parent)
        self.setObjectName("words_bubble")
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self._theme = theme
        self._room = parent
        self._text = ""
        self._end = QTimer(self, singleShot=True, interval=_SHOWN_MS)
        self._end.timeout.connect(self.hide)
        self.hide()

    @property
    def text(self) -> str:
        """Text on display; empty if none."""
        return self._text if self.isVisible() else ""

    def say(self, text: str, near: QRectF) -> None:
        """Show below ``near``, or above if there is no room."""
        self._text = text
        self.setAccessibleName(text)
        widest = min(_WIDEST_PX, self._room.width() - 16)
        metrics = QFontMetrics(self._theme.font(tokens.STATUS_PX))
        words = metrics.boundingRect(QRect(0, 0, widest - 48, 1000), _FLAGS, text)
        self.resize(words.width() + 48, words.height() + 16)
        left = min(max(8, round(near.left())), self._room.width() - self.width() - 8)
        top = round(near.bottom()) + 6
        if top + self.height() > self._room.height() - 4:
            top = round(near.top()) - 6 - self.height()
        self.move(left, max(4, top))
        self.show()
        self.raise_()
        self.update()
        self._end.start()

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme = self._theme
        painter = theme.paint_box(self, ground="amber_soft", line="amber", radius_px=8)
        draw_icon(painter, QRectF(10, self.height() / 2 - 8, 16, 16), "warning", theme.color("amber"))
        painter.setFont(theme.font(tokens.STATUS_PX))
        painter.setPen(theme.color("text"))
        painter.drawText(QRect(34, 0, self.width() - 42, self.height()), _FLAGS, self._text)
