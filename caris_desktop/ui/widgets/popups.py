"""Popups over the content: the clicked item and its commands, or a question. Child widgets, not windows.

A popup window would end driving and take the focus.
"""

from collections.abc import Callable, Sequence
from functools import partial

from PySide6.QtCore import QEvent, QPointF, Qt, Signal
from PySide6.QtGui import QAccessible, QHideEvent, QShowEvent
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.event_watch import EventWatch
from caris_desktop.ui.focus_widget import give_focus_back, window_of
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.inputs import SubmitLineEdit
from caris_desktop.ui.widgets.labels import label

_WIDTH_PX, _FROM_EDGE_PX = 520, 20
_FROM_TOP_PX = 82
"""Below the tabs and title bars of the top panels, so that these stay usable."""


class Popup(QWidget):
    """Hidden rounded box within its parent; ``tone`` is the colour of its edge."""

    def __init__(self, theme: Theme, parent: QWidget, *, tone: str = "") -> None:
        super().__init__(parent)
        self._theme = theme
        self._room = parent
        self.setProperty("role", "popup")
        self.setProperty("tone", tone)
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        # A click on the popup must not reach the widgets below.
        self.setAttribute(Qt.WidgetAttribute.WA_NoMousePropagation)
        self.hide()

    def place(self) -> None:
        """Move the visible popup to its place in the resized parent, if it follows it."""

    def follow_parent(self) -> None:
        """Keep the place at each resize of the parent."""
        EventWatch(self, self._on_parent_resized, QEvent.Type.Resize).add(self._room)

    def _on_parent_resized(self) -> None:
        if self.isVisible():
            self.place()


class DockCard(Popup):
    """Popup over the upper middle of the docks, with ``heading`` and ``text`` in a ``column``. Not a dialog: the stop
    and everything else stay usable.
    """

    accessible_role = QAccessible.Role.Dialog

    def __init__(self, theme: Theme, over: QWidget, *, tone: str) -> None:
        super().__init__(theme, over, tone=tone)
        self.heading, self.text = label("", "heading", wraps=True), label(tone="dim", wraps=True)
        self.follow_parent()
        self.column = layouts.vbox(
            self, self.heading, self.text, margins_px=(20, 16, 20, 16), spacing_px=tokens.GRID_PX
        )

    def place(self) -> None:
        """Fit the height to the contents."""
        self.setFixedWidth(min(_WIDTH_PX, self._room.width() - 2 * _FROM_EDGE_PX))
        self.resize(self.width(), self.column.heightForWidth(self.width()))
        self.move((self._room.width() - self.width()) // 2, _FROM_TOP_PX)
        self.raise_()

    def open(self) -> None:
        self.setAccessibleName(f"{self.heading.text()} {self.text.text()}")
        self.show()
        self.place()


class FloatingCard(Popup):
    """Popup that opens next to a point."""

    closed = Signal()

    def __init__(self, theme: Theme, parent: QWidget) -> None:
        super().__init__(theme, parent)
        self._focus_before: QWidget | None = None

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


class ChoiceCard(FloatingCard):
    """Popup with a line of text and buttons, set on opening."""

    def __init__(self, theme: Theme, parent: QWidget, *, name: str) -> None:
        super().__init__(theme, parent)
        self.setObjectName(name)
        self._line = label("", "note", objectName=f"{name}_line")
        self._first, self._second = layouts.hbox(spacing_px=4), layouts.hbox(spacing_px=4)
        self._buttons: list[ActionButton] = []
        column = layouts.vbox(self, self._line, self._first, self._second, margins_px=8, spacing_px=6)
        for row in (self._first, self._second):
            column.setAlignment(row, Qt.AlignmentFlag.AlignLeft)

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
            layouts.discard(button)
        self._buttons.clear()
        self._line.setText(line)
        self._line.setVisible(bool(line))
        for number, (name, text, icon, act) in enumerate(choices):
            button = ActionButton(
                self._theme, text, icon=icon, role="primary" if number == 0 else "plain", height_px=30,
                text_px=tokens.BODY_PX if number < per_row else tokens.STATUS_PX, objectName=name,
                clicked=partial(self._choose, act),
            )  # fmt: skip
            (self._first if number < per_row else self._second).addWidget(button)
            self._buttons.append(button)
        close = _close_button(self._theme, self)
        self._first.addWidget(close)
        self._buttons.append(close)
        self.open_at(where)

    def _choose(self, act: Callable[[], object], _checked: bool = False) -> None:
        self.hide()
        act()


class NameCard(FloatingCard):
    """Popup with a name field."""

    named = Signal(str)

    def __init__(self, theme: Theme, parent: QWidget, *, name: str) -> None:
        super().__init__(theme, parent)
        self.setObjectName(name)
        self.field = SubmitLineEdit(objectName=f"{name}_field", minimumWidth=150, maxLength=60)
        self._line = label("", "small")
        self._save = ActionButton(
            theme, icon="check", role="primary", height_px=30, objectName=f"{name}_save", clicked=self._finish
        )
        row = layouts.hbox(None, (self.field, 1), self._save, _close_button(theme, self), spacing_px=4)
        layouts.vbox(self, self._line, row, margins_px=8, spacing_px=6)
        self.field.returnPressed.connect(self._finish)
        self.field.textChanged.connect(self._on_text_changed)

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


def _close_button(theme: Theme, popup: Popup) -> ActionButton:
    return ActionButton(
        theme, icon="x", role="ghost", height_px=30, accessibleName=tr("Close"),
        objectName=f"{popup.objectName()}_close", clicked=popup.hide,
    )  # fmt: skip
