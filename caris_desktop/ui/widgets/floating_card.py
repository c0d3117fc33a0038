"""Popups over a picture or map: the clicked item and its commands. Child widgets, not windows.

A popup window would end driving and take the focus.
"""

from collections.abc import Callable, Sequence

from PySide6.QtCore import QPointF, Qt, Signal
from PySide6.QtGui import QHideEvent, QPaintEvent, QShowEvent
from PySide6.QtWidgets import QLabel, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.focus_widget import give_focus_back, window_of
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.submit_line_edit import SubmitLineEdit


class FloatingCard(QWidget):
    """Rounded popup that opens next to a point, within its parent."""

    closed = Signal()

    def __init__(self, theme: Theme, parent: QWidget) -> None:
        super().__init__(parent)
        self._theme = theme
        self._room = parent
        self._focus_before: QWidget | None = None
        theme.changed.connect(self.update)
        # A click on the popup must not reach the widgets below.
        self.setAttribute(Qt.WidgetAttribute.WA_NoMousePropagation)
        self.hide()

    def open_at(self, where: QPointF) -> None:
        self.adjustSize()
        room = self._room.rect()
        left = min(max(6, round(where.x()) - self.width() // 2), room.width() - self.width() - 6)
        top = round(where.y()) + 16
        if top + self.height() > room.height() - 6:
            top = round(where.y()) - 16 - self.height()
        self.move(max(0, left), max(6, top))
        self.show()
        self.raise_()

    def close_card(self) -> None:
        """Hide, and give the focus back if the popup has it."""
        if self.isHidden():
            return
        focused = window_of(self._room).focusWidget()
        has_focus = focused is not None and self.isAncestorOf(focused)
        self.hide()
        if has_focus:
            give_focus_back(self._focus_before)

    def showEvent(self, event: QShowEvent) -> None:
        self._focus_before = window_of(self._room).focusWidget()
        super().showEvent(event)

    def hideEvent(self, event: QHideEvent) -> None:
        super().hideEvent(event)
        self.closed.emit()

    def paintEvent(self, _event: QPaintEvent) -> None:
        self._theme.paint_box(self, ground="panel", line="line_strong", radius_px=10)


class ChoiceCard(FloatingCard):
    """Popup with a line of text and buttons, set on opening."""

    def __init__(self, theme: Theme, parent: QWidget, *, name: str) -> None:
        super().__init__(theme, parent)
        self.setObjectName(name)
        self._line = QLabel()
        self._line.setObjectName(f"{name}_line")
        self._first = layouts.hbox(spacing_px=4)
        self._second = layouts.hbox(spacing_px=4)
        self._buttons: list[ActionButton] = []
        column = layouts.vbox(self, margins_px=8, spacing_px=6)
        column.addWidget(self._line)
        column.addLayout(self._first)
        column.addLayout(self._second)
        theme.restyle_on_change(self._style)

    def _style(self) -> None:
        self._theme.style_text(self._line, "dim", tokens.STATUS_PX)

    def offer(
        self,
        where: QPointF,
        line: str,
        choices: Sequence[tuple[str, str, str, Callable[[], object]]],
        *,
        per_row: int = 1,
    ) -> None:
        """Open with ``choices`` of (object name, text, icon, callback); the first ``per_row`` are highlighted."""
        self.hide()  # widgets added to a visible popup have no size until shown
        for button in self._buttons:
            button.hide()
            button.deleteLater()
        self._buttons.clear()
        self._line.setText(line)
        self._line.setVisible(bool(line))
        for number, (name, text, icon, act) in enumerate(choices):
            button = ActionButton(
                self._theme, text, icon=icon, role="primary" if number == 0 else "plain", height_px=30,
                text_px=tokens.BODY_PX if number < per_row else tokens.STATUS_PX,
            )  # fmt: skip
            button.setObjectName(name)
            button.clicked.connect(self._closing(act))
            (self._first if number < per_row else self._second).addWidget(button)
            self._buttons.append(button)
        close = ActionButton(self._theme, "", icon="x", role="ghost", height_px=30)
        close.setAccessibleName(tr("Close"))
        close.setObjectName(f"{self.objectName()}_close")
        close.clicked.connect(self.hide)
        self._first.addWidget(close)
        self._buttons.append(close)
        self.open_at(where)

    def _closing(self, act: Callable[[], object]) -> Callable[[], None]:
        def run() -> None:
            self.hide()
            act()

        return run


class NameCard(FloatingCard):
    """Popup with a name field."""

    named = Signal(str)

    def __init__(self, theme: Theme, parent: QWidget, *, name: str) -> None:
        super().__init__(theme, parent)
        self.setObjectName(name)
        self.field = SubmitLineEdit()
        self.field.setObjectName(f"{name}_field")
        self.field.setMinimumWidth(150)
        self.field.setMaxLength(60)
        self._line = QLabel()
        self._save = ActionButton(theme, tr("Save"), icon="check", role="primary", height_px=30)
        self._save.setObjectName(f"{name}_save")
        close = ActionButton(theme, "", icon="x", role="ghost", height_px=30)
        close.setAccessibleName(tr("Close"))
        close.clicked.connect(self.hide)
        column = layouts.vbox(self, margins_px=8, spacing_px=6)
        column.addWidget(self._line)
        row = layouts.hbox(spacing_px=4)
        row.addWidget(self.field, 1)
        row.addWidget(self._save)
        row.addWidget(close)
        column.addLayout(row)
        self.field.returnPressed.connect(self._finish)
        self._save.clicked.connect(self._finish)
        self.field.textChanged.connect(self._on_text_changed)
        theme.restyle_on_change(self._style)

    def _style(self) -> None:
        self._line.setFont(self._theme.font(tokens.STATUS_PX))

    def ask(self, where: QPointF, line: str, *, verb: str = "", text: str = "") -> None:
        self._line.setText(line)
        self._save.set_label(verb or tr("Save"))
        self.field.setText(text)
        self._on_text_changed(text)
        self.open_at(where)
        self.field.setFocus(Qt.FocusReason.PopupFocusReason)
        self.field.selectAll()

    def _on_text_changed(self, text: str) -> None:
        self._save.setEnabled(bool(text.strip()))

    def _finish(self) -> None:
        name = " ".join(self.field.text().split())
        if name:
            self.hide()
            self.named.emit(name)
