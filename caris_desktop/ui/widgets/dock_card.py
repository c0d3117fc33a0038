"""Card over the upper middle of the docks. Not a dialog: the stop and everything else stay usable."""

from PySide6.QtCore import QEvent, QObject
from PySide6.QtGui import QAccessible, QPaintEvent
from PySide6.QtWidgets import QLabel, QWidget

from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.theme import Theme

_WIDTH_PX, _FROM_EDGE_PX = 520, 20
_FROM_TOP_PX = 82
"""Below the tabs and title bars of the top panels, so that these stay usable."""


class DockCard(QWidget):
    """Hidden card with ``heading`` and ``text`` in a ``column``; ``line`` is the colour role of its edge."""

    accessible_role = QAccessible.Role.Dialog

    def __init__(self, theme: Theme, over: QWidget, *, line: str) -> None:
        super().__init__(over)
        self._theme = theme
        self._over = over
        self._line = line
        self.heading, self.text = QLabel(), QLabel()
        for label in (self.heading, self.text):
            label.setWordWrap(True)
        self.column = layouts.vbox(self, margins_px=(20, 16, 20, 16), spacing_px=tokens.GRID_PX)
        self.column.addWidget(self.heading)
        self.column.addWidget(self.text)
        over.installEventFilter(self)
        self.hide()
        theme.restyle_on_change(self.restyle)

    def place(self) -> None:
        """Fit the height to the contents."""
        self.setFixedWidth(min(_WIDTH_PX, self._over.width() - 2 * _FROM_EDGE_PX))
        self.resize(self.width(), self.column.heightForWidth(self.width()))
        self.move((self._over.width() - self.width()) // 2, _FROM_TOP_PX)
        self.raise_()

    def open(self) -> None:
        self.setAccessibleName(f"{self.heading.text()} {self.text.text()}")
        self.show()
        self.place()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if watched is self._over and event.type() == QEvent.Type.Resize and not self.isHidden():
            self.place()
        return False

    def restyle(self) -> None:
        self.heading.setFont(self._theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        self._theme.style_text(self.text, "dim", tokens.BODY_PX)
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        self._theme.paint_box(
            self, ground="panel", line=self._line, radius_px=tokens.PANEL_RADIUS_PX, line_px=1.4, inset_px=(1, 1)
        )
