"""Banners under the top bar: states that last until the wizard decides, each with the one button that ends it;
and the hint next to the focused widget on why a key had no effect.
"""

from collections.abc import Callable
from typing import Any

import shiboken6
from PySide6.QtCore import QEvent, QObject, QPoint, QRect, Qt, QTimer
from PySide6.QtGui import QAccessible, QShowEvent
from PySide6.QtWidgets import QLabel, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import DriveStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.accessibility import announce
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.dock_area import DockArea
from caris_desktop.ui.event_watch import EventWatch
from caris_desktop.ui.focus_widget import Bar, focused_widget, window_of
from caris_desktop.ui.input.drive_input_filter import NOWHERE_MS, DriveInputFilter
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.labels import label

_BUTTON_PX = 28
_HEIGHT_PX, _EDGE_PX = 38, 4
_SHARE = 0.5
"""Maximum covered share of a picture's height: the path ahead is in its lower part."""


class Banner(QWidget):
    """Banner with one sentence and its buttons, in a colour for its severity."""

    accessible_role = QAccessible.Role.AlertMessage

    def __init__(self, theme: Theme, name: str, *, role: str, text: QLabel | None = None) -> None:
        """``text``: its label, such as one that elides; else its sentence wraps."""
        super().__init__()
        self.setObjectName(name)
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self.setProperty("role", "banner")
        self.setProperty("tone", role)
        self._theme = theme
        self.text = text or label("", "title", wraps=True, textFormat=Qt.TextFormat.PlainText)
        self.row = layouts.hbox(self, (self.text, 1), margins_px=(14, 4, 4, 4), spacing_px=tokens.GRID_PX)
        self.hide()

    def add_button(self, name: str, text: str, run: Callable[[], object], **more: Any) -> ActionButton:
        button = ActionButton(self._theme, text, height_px=_BUTTON_PX, objectName=name, clicked=run, **more)
        self.row.addWidget(button)
        return button

    def say(self, text: str) -> None:
        self.text.setText(text)
        self.setAccessibleName(text.replace("\n", " "))
        if self.isVisible():
            announce(self, self.accessibleName())

    @property
    def needed_px(self) -> int:
        """Width with the whole sentence on one line."""
        self.text.ensurePolished()
        text_px = self.text.fontMetrics().size(0, self.text.text()).width()
        return self.row.sizeHint().width() - self.text.sizeHint().width() + text_px + 4

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        if not event.spontaneous():
            announce(self, self.accessibleName())


class EmergencyBanner(Banner):
    """Banner while the emergency stop is latched, with the only button that releases it.

    It is apart from the red button, so that a frightened second press never releases the stop.
    """

    def __init__(self, theme: Theme, console: WizardConsole) -> None:
        super().__init__(theme, "emergency_band", role="red")
        self.release = self.add_button(
            "emergency_release", tr("Release emergency stop"), lambda: console.do(intents.ReleaseEmergencyStop())
        )
        console.state.drive.follow(self._on_drive_changed)

    def _on_drive_changed(self, drive: DriveStatus) -> None:
        match drive.movement:
            case "uncommanded":
                text = tr("Emergency stop active, but the robot is moving. Use the stop on the robot itself.")
            case "standing":
                text = tr("Emergency stop active, robot stationary. No motion until you release the stop.")
            case _:
                text = tr("Emergency stop active. No motion commands until you release it.")
        if text != self.accessibleName():
            self.say(text)
        self.setVisible(drive.emergency_stop)


class GuardBanner(Banner):
    """Banner that reminds the wizard while the obstacle guard is switched off."""

    def __init__(self, theme: Theme, console: WizardConsole) -> None:
        super().__init__(theme, "guard_band", role="amber")
        self.say(tr("Obstacle guard is off. Nothing stops the robot at obstacles."))
        self.add_button(
            "guard_on", tr("Turn on"), lambda: console.do(intents.SetGuard(on=True)), icon="shield-check",
            accessibleName=tr("Turn on the guard"), toolTip=tr("Turn on the guard"),
        )  # fmt: skip
        console.state.drive.follow(self._on_drive_changed)

    def _on_drive_changed(self, drive: DriveStatus) -> None:
        self.setVisible(drive.guard == "overridden")


class QuestionBanner(Banner):
    """Confirmation before something irreversible. Not a dialog: driving and Stop keep working."""

    def __init__(self, theme: Theme) -> None:
        super().__init__(theme, "question_band", role="amber")
        self._do: Callable[[], object] | None = None
        self.yes = self.add_button("question_yes", tr("Yes"), self._on_yes)
        self.add_button("question_no", tr("Cancel"), self.put_away, role="ghost")

    def ask(self, question: str, answer: str, do: Callable[[], object]) -> None:
        """Show the question; ``answer`` labels the button that runs ``do``. Replaces an earlier question."""
        self._do = do
        self.say(question)
        self.yes.set_label(answer)
        self.show()

    def put_away(self) -> None:
        self._do = None
        self.hide()

    def _on_yes(self) -> None:
        do = self._do
        self.put_away()
        if do is not None:
            do()


class NoticeStrip(Bar, QWidget):
    """Visible banners, one below the other: over the upper edge of the picture, or above the panels where the picture
    is too small or not in view. They cover no title, field or button.
    """

    def __init__(self, over: DockArea, *bands: Banner) -> None:
        super().__init__(over)
        self.setObjectName("notice_strip")
        self._over = over
        self._bands = bands
        self._column = layouts.vbox(self, *bands, margins_px=0, spacing_px=_EDGE_PX)
        for band in bands:
            band.setMinimumHeight(_HEIGHT_PX)
        changes = QEvent.Type.ShowToParent, QEvent.Type.HideToParent, QEvent.Type.LayoutRequest
        self._changes = EventWatch(self, self._place, *changes)
        self._changes.add(*bands)
        over.laid_out.connect(self._place)
        self.hide()

    def use_replay(self) -> None:
        """Stay hidden: what the banners tell was then."""
        for change in (self._changes.happened, self._over.laid_out):
            change.disconnect(self._place)
        self.hide()

    def _place(self) -> None:
        needed_px = [band.needed_px for band in self._bands if not band.isHidden()]
        picture = self._over.picture_place()
        place = self._place_in(picture, max(needed_px, default=0))
        on_picture = place.height() <= picture.height() * _SHARE
        if not on_picture:
            place = self._place_in(self._over.rect(), max(needed_px, default=0))
        self._over.reserve(place.bottom() + 1 + _EDGE_PX if needed_px and not on_picture else 0)
        self.setGeometry(place)
        self.setVisible(bool(needed_px))
        self.raise_()
        for dock in self._over.docks.values():
            on_dock = on_picture and bool(needed_px) and dock.parentWidget() is self._over
            dock.leave_clear(place if on_dock else QRect())

    def _place_in(self, room: QRect, needed_px: int) -> QRect:
        width = max(0, min(needed_px, room.width() - 2 * _EDGE_PX))
        return QRect(room.left() + _EDGE_PX, room.top() + _EDGE_PX, width, self._column.heightForWidth(width))


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
