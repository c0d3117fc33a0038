"""Message line above the form, with buttons to answer it."""

from collections.abc import Callable

from PySide6.QtGui import QAccessible, QPaintEvent
from PySide6.QtWidgets import QLabel, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.announcing import announce
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton

Answer = tuple[str, Callable[[], None]]


class Notice(QWidget):
    """``say`` replaces the message. ``what`` identifies it for ``take_back``."""

    accessible_role = QAccessible.Role.AlertMessage

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self.setObjectName("editor_notice")
        self._theme = theme
        self._what = ""
        self._role = "blue"
        self.text = QLabel(wordWrap=True)
        self.text.setObjectName("editor_notice_text")
        self.answers: list[ActionButton] = []
        self._row = layouts.hbox(self, margins_px=(26, 8, 18, 8), spacing_px=8)
        self._row.addWidget(self.text, 1)
        theme.changed.connect(self.update)
        self.hide()

    def say(self, what: str, text: str, role: str, *answers: Answer) -> None:
        if (what, text) == (self._what, self.text.text()) and self.isVisible():
            return
        self._what, self._role = what, role
        self.text.setText(text)
        self.setAccessibleName(text)
        for button in self.answers:
            self._row.removeWidget(button)
            button.hide()
            button.deleteLater()
        self.answers = [self._answer(words, do) for words, do in answers or ((tr("Dismiss"), self._dismiss),)]
        self.show()
        announce(self, text)
        self.update()

    def _answer(self, words: str, do: Callable[[], None]) -> ActionButton:
        button = ActionButton(self._theme, words, height_px=30)
        button.clicked.connect(do)
        self._row.addWidget(button)
        return button

    def _dismiss(self) -> None:
        self.take_back(self._what)

    def take_back(self, what: str) -> None:
        if what == self._what:
            self._what = ""
            self.hide()

    def paintEvent(self, _event: QPaintEvent) -> None:
        self._theme.paint_box(
            self,
            ground=f"{self._role}_soft",
            line=self._role,
            radius_px=tokens.CONTROL_RADIUS_PX,
            line_px=1.4,
            inset_px=(16.7, 2.7),
        )
