"""Popup over the window. Not a dialog: the robot can be driven and stopped meanwhile."""

from PySide6.QtCore import QEvent, QPoint, QRect, Qt
from PySide6.QtGui import QAccessible, QKeyEvent, QMouseEvent, QRegion
from PySide6.QtWidgets import QAbstractButton, QApplication, QCheckBox, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.ui.event_watch import EventWatch
from caris_desktop.ui.focus_widget import activate_window, existing, give_focus_back
from caris_desktop.ui.text_formatting import ESC_CLOSES
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.window_place import PLACE_CHANGES, InSight, WindowAbove, clear_place, windows_above

_ENTER = (Qt.Key.Key_Return, Qt.Key.Key_Enter)


class Overlay(QWidget):
    """Popup in the upper middle of the window over a dimmed background; a click outside closes it.

    Enter presses the focused button, as Space does: users try Enter first. A check box needs Space, so that Enter does
    not confirm it by accident.

    Floating panels lie above this window: the popup avoids them, and lowers those that would cover it while it is open.
    Alarms and the status bar stay in sight.
    """

    accessible_role = QAccessible.Role.Dialog
    dims_window = True  # Tab stays inside

    def __init__(self, theme: Theme, window: QWidget, *, width_px: int) -> None:
        super().__init__(window)
        self._theme = theme
        self._window = window
        self._width_px = width_px
        self._focus_before: QWidget | None = None
        self._keys_before: QWidget | None = None
        self._stepped_back: list[WindowAbove] = []
        self._in_sight: list[InSight] = []
        self.card = QWidget(self)
        self.card.setProperty("role", "card")
        self.card.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        # A click on the card must not close the popup.
        self.card.setAttribute(Qt.WidgetAttribute.WA_NoMousePropagation)
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self.setFocusPolicy(Qt.FocusPolicy.ClickFocus)
        EventWatch(self, self._on_window_resized, QEvent.Type.Resize).add(window)
        self._moves = EventWatch(self, self._on_part_moved, *PLACE_CHANGES)
        self.hide()

    def open(self) -> None:
        if self.isHidden():
            self._focus_before = self._window.focusWidget()
            self._keys_before = QApplication.activeWindow()
        self._in_sight = self._window.findChildren(InSight)
        for part in self._in_sight:
            part.stay_clear_of(self.card)
        self._moves.add(*self._in_sight)
        self.show()
        self._place()  # after the first showing, which styles the texts and so determines their height
        self.raise_()
        activate_window(self._window)

    def close_overlay(self) -> None:
        """Hide and restore the former focus."""
        if self.isHidden():
            return
        self.hide()
        for window in self._stepped_back:
            window.step_back(back=False)
        self._stepped_back.clear()
        give_focus_back(self._focus_before)
        before, self._keys_before = existing(self._keys_before), None
        if isinstance(before, WindowAbove) and before.isVisible():
            activate_window(before)

    def close_button(self, name: str) -> ActionButton:
        """Button that closes the popup, as Esc does."""
        return ActionButton(
            self._theme, tr("Close"), icon="x", key="Esc", role="ghost", objectName=name, toolTip=tr(ESC_CLOSES),
            clicked=self.close_overlay,
        )  # fmt: skip

    def card_height_px(self) -> int:
        return self.card.sizeHint().height()

    def _place(self) -> None:
        # The top bar stays uncovered, so that the red button can always be reached; the card ends above the status bar.
        self.setGeometry(QRect(0, 56, self._window.width(), self._window.height() - 56))
        width = min(self._width_px, self.width() - 32)
        height = min(self.card_height_px(), self.height() - 24 - 32)
        usual = QRect((self.width() - width) // 2, 24, width, height)
        windows = windows_above(self._window)
        places = [window.place_in(self) for window in windows]
        free = clear_place(usual, QRect(16, 24, self.width() - 32, height), places)
        card = free or usual
        self.card.setGeometry(card)
        if free is None:
            for window, place in zip(windows, places, strict=True):
                if place.intersects(card):
                    window.step_back(back=True)
                    self._stepped_back.append(window)
        self._leave_in_sight()

    def _on_window_resized(self) -> None:
        if self.isVisible():
            self._place()

    def _on_part_moved(self) -> None:
        if self.isVisible():
            self._leave_in_sight()

    def _leave_in_sight(self) -> None:
        visible = QRegion(self.rect())
        for part in self._in_sight:
            if part.isVisible():
                visible -= QRect(self.mapFromGlobal(part.mapToGlobal(QPoint())), part.size())
        self.setMask(visible)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        focused = self._window.focusWidget()
        if (
            event.key() in _ENTER
            and isinstance(focused, QAbstractButton)
            and not isinstance(focused, QCheckBox)
            and self.card.isAncestorOf(focused)
        ):
            if not event.isAutoRepeat():
                focused.click()
        else:
            super().keyPressEvent(event)

    def mousePressEvent(self, _event: QMouseEvent) -> None:
        self.close_overlay()
