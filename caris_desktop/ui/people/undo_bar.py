"""Undo bar: the last decision about a person, with an undo button for some seconds."""

from PySide6.QtCore import Qt, QTimer, Signal
from PySide6.QtGui import QPainter, QPaintEvent
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.action_bindings import cap_text
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.elided_label import ElidedLabel

_SHOWN_MS = 8_000


class UndoBar(QWidget):
    """Bar at the lower edge of a panel."""

    undone = Signal()

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self.setObjectName("people_undo")
        self._theme = theme
        self.text = ElidedLabel()
        self.button = ActionButton(theme, tr("Undo"), icon="arrow-u-up-left", key=cap_text("Ctrl+Z"), height_px=28)
        self.button.setObjectName("people_undo_button")
        self.button.clicked.connect(self.undone)
        row = layouts.hbox(self, margins_px=(14, 2, 10, 2), spacing_px=tokens.GRID_PX)
        row.addWidget(self.text, 1, Qt.AlignmentFlag.AlignVCenter)
        row.addWidget(self.button)
        self._away = QTimer(self, singleShot=True, interval=_SHOWN_MS)
        self._away.timeout.connect(self.hide)
        theme.restyle_on_change(self._style)
        self.hide()

    def say(self, text: str) -> None:
        self.text.setText(text)

    def offer(self) -> None:
        self.show()
        self._away.start()

    def put_away(self) -> None:
        self._away.stop()
        self.hide()

    def _style(self) -> None:
        self._theme.style_text(self.text, "text", tokens.STATUS_PX)
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.fillRect(self.rect().adjusted(1, 0, -1, 0), self._theme.color("blue_soft"))
