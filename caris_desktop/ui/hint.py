"""Hint next to the focused widget: a short-lived sentence on why a key had no effect."""

import shiboken6
from PySide6.QtCore import QObject, QPoint, QRect, Qt, QTimer
from PySide6.QtGui import QAccessible
from PySide6.QtWidgets import QLabel, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.announcing import announce
from caris_desktop.ui.focus_widget import focused_widget, window_of
from caris_desktop.ui.input.drive_input_filter import NOWHERE_MS, DriveInputFilter

_FIELD_PX = 120
"""A focused widget up to this height is a field, with the hint next to it; in a larger one the hint is inside."""
_GAP_PX, _MOST_PX = 6, 460


class Hints(QObject):
    """One hint at a time, shown as long as keys are discarded. ``middle``: its anchor while nothing has the focus."""

    def __init__(self, middle: QWidget, actions: Actions, hold: DriveInputFilter) -> None:
        super().__init__(middle)
        self._middle, self._hold = middle, hold
        self._hint: Hint | None = None
        self._by_nowhere = False
        self._goes = QTimer(self, singleShot=True, interval=NOWHERE_MS)
        self._goes.timeout.connect(self._on_time)
        actions.not_done.connect(self._on_not_done)
        hold.slipped.connect(self.say)
        hold.escape_pressed.connect(self.take_away)
        hold.nowhere_ended.connect(self._on_nowhere_ended)

    def _on_not_done(self, reason: str, _opens: bool) -> None:
        nowhere = self._hold.keys_go_nowhere
        ends = tr("{why} Typing is ignored until you press Esc or click.")
        self.say(ends.format(why=reason) if nowhere else reason)
        self._by_nowhere = nowhere

    def say(self, text: str) -> None:
        self.take_away()
        focused = focused_widget()
        beside = self._middle if focused is None or focused.isWindow() else focused
        # A new widget each time: the former one is deleted with its floating panel.
        self._hint = Hint(beside, text)
        self._goes.start()

    def take_away(self) -> None:
        hint, self._hint, self._by_nowhere = self._hint, None, False
        self._goes.stop()
        if hint is not None and shiboken6.isValid(hint):
            hint.hide()
            hint.deleteLater()

    def _on_nowhere_ended(self) -> None:
        if self._by_nowhere:
            self.take_away()

    def _on_time(self) -> None:
        if self._by_nowhere and self._hold.keys_go_nowhere:
            self._goes.start()
        else:
            self.take_away()


class Hint(QLabel):
    """Label that ignores mouse and keyboard."""

    accessible_role = QAccessible.Role.AlertMessage

    def __init__(self, beside: QWidget, text: str) -> None:
        window = window_of(beside)
        super().__init__(text, window)
        self.setObjectName("key_hint")
        self.setTextFormat(Qt.TextFormat.PlainText)
        self.setWordWrap(True)
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.setAccessibleName(text)
        self.setProperty("role", "hint")
        self.ensurePolished()
        width = min(_MOST_PX, window.width() - 2 * _GAP_PX, self.fontMetrics().horizontalAdvance(text) + 24)
        self.resize(width, self.heightForWidth(width))
        self._stand(QRect(beside.mapTo(window, QPoint()), beside.size()), window.rect())
        self.show()
        self.raise_()
        announce(self, text)

    def _stand(self, beside: QRect, room: QRect) -> None:
        place = QRect(QPoint(), self.size())
        if beside.height() > _FIELD_PX:
            place.moveCenter(beside.center())
            place.moveBottom(beside.bottom() - 2 * _GAP_PX)
        else:
            place.moveBottomLeft(QPoint(beside.left(), beside.top() - _GAP_PX))
            if place.top() < room.top():
                place.moveTop(beside.bottom() + _GAP_PX)
        place.moveRight(min(place.right(), room.right() - _GAP_PX))
        self.move(max(place.left(), _GAP_PX), max(place.top(), _GAP_PX))
