"""Hold-to-drive: teleoperation input from keyboard, on-screen controls and gamepad, and the stop keys.

Keys are handled by an application event filter, before any widget.
"""

import sys
import time
from collections.abc import Callable, Sequence
from typing import Literal

from PySide6.QtCore import QChildEvent, QDynamicPropertyChangeEvent, QEvent, QObject, Qt, QTimer, QTimerEvent, Signal
from PySide6.QtGui import (
    QAccessible,
    QActionEvent,
    QCloseEvent,
    QFocusEvent,
    QKeyEvent,
    QKeySequence,
    QMouseEvent,
    QMoveEvent,
    QPaintEvent,
    QPlatformSurfaceEvent,
    QResizeEvent,
    QShortcut,
    QWindow,
)
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractItemView,
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QDialog,
    QLineEdit,
    QMenu,
    QPlainTextEdit,
    QSlider,
    QTabBar,
    QTextEdit,
    QWidget,
)

from caris_desktop.domain import intents
from caris_desktop.domain.events import DriveEnded
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.gamepad import Gamepads
from caris_desktop.live.status import DriveStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.focus_widget import bar_of, focused_widget, follow_click, key_place_of, window_of
from caris_desktop.ui.input.physical_keys import (
    LONGEST_REPEAT_GAP_S,
    X11_LEVELS,
    KeyboardGrab,
    NativeKeyEvents,
    PhysicalKeys,
    had_the_keys,
)
from caris_desktop.ui.input.teleop_input import (
    CHORD_MODIFIERS,
    LETTERS,
    WISHES,
    Hold,
    KeyBindings,
    PressedKey,
    TeleopInput,
    pressed_key,
)
from caris_desktop.ui.key_choices import key_code, position_codes, position_of

DOUBLE_STOP_S = 0.6
STOPS = "stops"
"""Property of a button that stops the robot; a key presses it however it got the focus."""
_NEVER = float("-inf"), 0
_OF_NO_CONCERN = frozenset(
    (QChildEvent, QDynamicPropertyChangeEvent, QMoveEvent, QResizeEvent, QPaintEvent, QTimerEvent, QActionEvent)
)

NOWHERE_MS = 3000
HELD_TO_TALK_MS = 300

KeyOwner = Literal["driving", "typing", "window", "nowhere", "dialog", "menu", "elsewhere", "off"]
"""Recipient of a key press: driving (bare keys drive), typing or another part of the window (Alt drives), none
because a command was refused, a dialog, a menu, another program, or none because the scenario does not drive.
"""

_MODIFIER_KEYS = (
    Qt.Key.Key_Shift, Qt.Key.Key_Control, Qt.Key.Key_Alt, Qt.Key.Key_Meta, Qt.Key.Key_AltGr, Qt.Key.Key_CapsLock,
    Qt.Key.Key_NumLock,
)  # fmt: skip
_CTRL_SHIFT = Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier
_PRESSING_KEYS = (Qt.Key.Key_Space, Qt.Key.Key_Return, Qt.Key.Key_Enter, Qt.Key.Key_Select)
_MOVING_KEYS = (
    Qt.Key.Key_Tab, Qt.Key.Key_Backtab, Qt.Key.Key_Up, Qt.Key.Key_Down, Qt.Key.Key_Left, Qt.Key.Key_Right,
)  # fmt: skip
_BY_TAB = (Qt.FocusReason.TabFocusReason, Qt.FocusReason.BacktabFocusReason)
_COMES_BACK = (Qt.FocusReason.ActiveWindowFocusReason, Qt.FocusReason.PopupFocusReason)
_MULTI_LINE_INPUTS = (QPlainTextEdit, QTextEdit)
_TEXT_INPUTS = (QLineEdit, QAbstractSpinBox, *_MULTI_LINE_INPUTS)
_CHANGED_BY_WHEEL = (QAbstractSpinBox, QComboBox, QSlider, QTabBar)
# In a list or combo box, letters search for entries and arrows move the selection.
_KEEPS_ITS_KEYS = (*_TEXT_INPUTS, QComboBox, QAbstractItemView)


class DriveInputFilter(QObject):
    """Turns held keys into the intents Drive, ReleaseDrive and TurnHead, and Esc and Pause into stops.

    A drive key belongs to driving from its press to its physical release, whatever happens to modifiers or focus in
    between; no other widget sees it. Keyboard, screen and gamepad add up. Motion ends when nothing is held any more,
    and at once when the application or its windows are deactivated, a dialog or menu opens, or the driving focus is
    lost; then a key must be pressed again, and a stick must return to centre first.

    The owner installs it as an application event filter once the window is built: building a window produces many
    events, none of them keys.

    While the robot is driven, or a drive key is still down, no window closes: with Alt held to drive, F4 is a phrase.
    """

    key_owner_changed = Signal(str)
    windows_changed = Signal()  # a window, dialog or menu opened or closed
    escape_pressed = Signal()
    close_refused = Signal()  # a close was refused because the robot is being driven
    help_requested = Signal()  # F1 in a window other than the console's own, where it is a phrase
    nowhere_ended = Signal()
    slipped = Signal(str)  # reason why a key press had no effect
    mark_pressed = Signal(str)  # a key of an action of kind "mark" went down
    mark_released = Signal(str)  # released, or its release can no longer be received

    def __init__(self, console: WizardConsole, actions: Actions, window: QWidget) -> None:
        super().__init__(window)
        self._console = console
        self._actions = actions
        self._window = window
        self._driving_panels: tuple[QWidget, ...] = ()
        self._always_pressable: QWidget | None = None
        self._reached_by_tab: QWidget | None = None
        self._followed_ms = 0
        self._clicked_elsewhere = False
        self.motion = TeleopInput(console, actions, self._takes_keys, self)
        self._bindings = KeyBindings()
        self._alt_drove = self._alt_gr_down = False
        self._last_refused_s = float("-inf")
        self._marking: dict[int, str] = {}
        self._about_to_talk: dict[int, QTimer] = {}
        self._nowhere = QTimer(self, singleShot=True, interval=NOWHERE_MS)
        self._nowhere.timeout.connect(self._on_nowhere_ended)
        self._types_at_button = QTimer(self, singleShot=True, interval=NOWHERE_MS)
        self._question: tuple[str, Callable[[str], None], Qt.KeyboardModifier] | None = None
        self.captures: Callable[[PressedKey], None] | None = None
        """While there is one, it gets every key but Esc and Pause, which does nothing else."""
        self._owned: dict[int, Hold | None] = {}
        self._pressed_in: dict[int, QWidget | None] = {}
        """By key: the widget that had the focus at its press."""
        self.key_owner: KeyOwner = "elsewhere"
        """Recipient of a key that is pressed now."""
        self._last_escape = _NEVER
        self._keys = PhysicalKeys()
        self._keyboard_grab = KeyboardGrab(self._keys.focused_window, self)
        app = QApplication.instance()
        assert isinstance(app, QApplication)  # noqa: S101 (a widget exists, so the application does)
        self._app = app
        self._native_keys = NativeKeyEvents(self._on_keyboard_taken, self._on_lost_key)
        if self._keys.exact:
            app.installNativeEventFilter(self._native_keys)
        app.focusChanged.connect(self._on_focus_changed)
        app.applicationStateChanged.connect(self._on_application_state_changed)
        actions.rebuilt.connect(self._on_rebuilt)
        actions.rebound.connect(self._on_rebound)
        actions.not_done.connect(self._on_not_done)
        actions.use_letters(self._keys.letters(position_codes(sys.platform)))
        console.state.drive.changed.connect(self._on_drive_changed)
        console.state.event_happened.connect(self._on_event)
        self._bindings.use(actions.all_specs)

    def close(self) -> None:
        """Stop listening; all held input is released."""
        for identity in (*self._marking, *self._about_to_talk):
            self._end_marking(identity)
        self._nowhere.stop()
        self.release_all(QT_TR_NOOP("The window was closed"))
        self._app.removeEventFilter(self)
        self._app.removeNativeEventFilter(self._native_keys)
        self._keyboard_grab.give_back()

    def ask_next_key(
        self, letters: str, answer: Callable[[str], None], *, after: Qt.KeyboardModifier = _CTRL_SHIFT
    ) -> None:
        """Capture the next key press, before any other handler, if its position is one of ``letters``.

        ``answer`` receives the letter, or an empty text if another key was pressed or a part of the window clicked,
        which keep their usual effect. Held drive keys keep driving and do not answer. ``after``: modifiers of the chord
        that asked, which may still be held.
        """
        self._question = letters, answer, after

    def ask_no_key(self) -> None:
        """Cancel ``ask_next_key``."""
        self._question = None

    # ---- held input

    @property
    def held(self) -> frozenset[str]:
        """Directions held on the keyboard and by on-screen arrows."""
        return self.motion.held

    @property
    def must_let_go(self) -> bool:
        """Whether input is held that moves nothing because the motion was ended; only a new press moves again."""
        keys = any(
            hold is not None and hold.action_id in WISHES and not self.motion.moves_by(identity)
            for identity, hold in self._owned.items()
        )
        return keys or self.motion.must_rest

    def set_driving_panels(self, panels: Sequence[QWidget]) -> None:
        """Set the panels in which the bare keys drive."""
        self._driving_panels = tuple(panels)
        self._update_driving_focus(focused_widget())

    def set_emergency_button(self, button: QWidget) -> None:
        """Set the red button, whose first press works even while a menu or combo box is open."""
        self._always_pressable = button

    def use_gamepads(self, gamepads: Gamepads) -> None:
        """Connect the gamepad: driving, stop and button bindings."""
        gamepads.moved.connect(self.motion.push_gamepad)
        gamepads.lost.connect(self.motion.lose_gamepad)
        gamepads.pressed.connect(self._on_gamepad_button)

    def release_all(self, reason: str) -> None:
        """End teleoperation now. Keys still held drive again only after a new press, sticks after
        returning to centre.
        """
        self.motion.release_all(reason)

    # ---- key bindings

    def _on_rebound(self) -> None:
        self.release_all(QT_TR_NOOP("The key bindings were changed"))
        self._bindings.use(self._actions.all_specs)

    def _on_rebuilt(self) -> None:
        self.release_all(QT_TR_NOOP("The scenario was changed"))
        self._bindings.use(self._actions.all_specs)
        self._update_key_owner()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        # Querying the type of ten thousand events costs more than the rest of the filter.
        if type(event) in _OF_NO_CONCERN:
            return False
        kind = event.type()
        if kind in (QEvent.Type.KeyPress, QEvent.Type.KeyRelease, QEvent.Type.ShortcutOverride):
            if QAccessible.isActive() and (kind == QEvent.Type.ShortcutOverride or not event.spontaneous()):
                _come_first(self, self._app)
            if not isinstance(event, QKeyEvent):
                return False
            pressed = kind == QEvent.Type.KeyPress
            if self._filter_key(event) or (pressed and self._blocks_button_key(watched, event)):
                return True
            return pressed and self._marks_repeat(watched, event)
        if kind == QEvent.Type.MouseButtonPress:
            return isinstance(event, QMouseEvent) and self._filter_press(watched, event)
        if kind == QEvent.Type.Wheel and isinstance(watched, _CHANGED_BY_WHEEL):
            event.ignore()  # the pointer only rests there; the area around it scrolls
            return True
        if kind == QEvent.Type.FocusIn and isinstance(event, QFocusEvent) and isinstance(watched, QWidget):
            return self._filter_focus(watched, event.reason())
        if kind == QEvent.Type.WindowDeactivate and self._is_ours(watched):
            # Focus moves between the main window and a floating panel, which belong together.
            if not self._is_ours(self._app.activeWindow()):
                self.release_all(QT_TR_NOOP("The window lost focus"))
            self._update_key_owner()
        elif kind == QEvent.Type.WindowActivate and self._is_ours(watched):
            self._forget_keys_that_went_up_elsewhere()
            letters = self._keys.letters(position_codes(sys.platform))
            if letters:
                self._actions.use_letters(letters)
            self._update_key_owner()
        elif kind == QEvent.Type.Close and isinstance(event, QCloseEvent) and isinstance(watched, QWidget):
            # A close by the program is not spontaneous for the widget, but is for its native window.
            return event.spontaneous() and self._filter_close(event)
        elif kind in (QEvent.Type.Show, QEvent.Type.Hide) and isinstance(watched, QWidget) and watched.isWindow():
            if kind == QEvent.Type.Show and _takes_over(watched):
                self.release_all(QT_TR_NOOP("A dialog or menu opened"))
            elif kind == QEvent.Type.Hide and watched is not self._window and had_the_keys(watched):
                # Closed by a button: an Esc that follows at once still needs a recipient.
                self._keyboard_grab.hold_during_close(watched, self._window)
            # Qt registers popups and dialogs only after this event.
            QTimer.singleShot(0, self, self._on_windows_changed)
        elif (
            isinstance(event, QPlatformSurfaceEvent)
            and event.surfaceEventType() == QPlatformSurfaceEvent.SurfaceEventType.SurfaceAboutToBeDestroyed
            and isinstance(watched, QWindow)
        ):
            self._native_keys.add_closed_window(int(watched.winId()))
        return False

    def _filter_press(self, watched: QObject, event: QMouseEvent) -> bool:
        self._end_nowhere()
        # A press propagates through the parents until one accepts it; only the first receiver counts.
        goes_up = bool(event.timestamp()) and event.timestamp() == self._followed_ms
        if not goes_up and isinstance(watched, QWidget):
            self._followed_ms = int(event.timestamp())
            self._clicked_elsewhere = not self._is_driving_part(watched)
            if key_place_of(watched) is not None:
                self._end_question()  # the next key is for the clicked part
            if self._is_ours(window := window_of(watched)):
                follow_click(watched, drives=self._drives_with(window.focusWidget()))
        # Qt uses the first press outside a menu or combo box to close it; a stop must not need a second press.
        button, popup = self._always_pressable, self._app.activePopupWidget()
        if button is None or popup is None or not button.isVisible():
            return False
        if not button.rect().contains(button.mapFromGlobal(event.globalPosition().toPoint())):
            return False
        if popup.geometry().contains(event.globalPosition().toPoint()):
            return False
        popup.close()
        self._emergency_stop()
        return True

    def _filter_focus(self, watched: QWidget, reason: Qt.FocusReason) -> bool:
        """Move the focus from a bar's button to the window on activation, since Qt focuses the first button of a window
        without focus; and away from driving when a closed card or dialog returns it there after a click elsewhere.
        Returns whether it did.
        """
        bar = bar_of(watched)
        if bar is None:
            if key_place_of(watched) is not None:
                self._reached_by_tab = None
            if self._drives_with(watched):
                if self._clicked_elsewhere and reason in _COMES_BACK:
                    window_of(watched).setFocus(reason)
                    return True
                self._clicked_elsewhere = False
        elif reason in _BY_TAB:
            self._reached_by_tab = watched
        elif reason == Qt.FocusReason.ActiveWindowFocusReason and watched is not self._reached_by_tab:
            window_of(watched).setFocus(reason)
            return True
        return False

    def _blocks_button_key(self, watched: QObject, event: QKeyEvent) -> bool:
        """Whether to block Space and Enter: on a bar's widget unless it got the focus by Tab, and on any button while
        the wizard types letters that nothing takes. The red button always works.
        """
        target = watched if isinstance(watched, QWidget) else focused_widget()
        if target is None or event.modifiers() & CHORD_MODIFIERS or target.property(STOPS):
            return False
        if event.key() not in _PRESSING_KEYS:
            if isinstance(target, QAbstractButton) and event.text().isprintable() and event.text():
                self._types_at_button.start()
            elif event.key() in (Qt.Key.Key_Tab, Qt.Key.Key_Backtab):
                self._types_at_button.stop()
            return False
        if self._types_at_button.isActive():
            self._types_at_button.start()
            self.slipped.emit(
                tr("You are typing, but no text field has the focus. Pause for 3 seconds, then this key works again.")
            )
            return True
        if bar_of(target) is None or not self._is_ours(window_of(target)):
            return False
        return target is not self._reached_by_tab

    def _filter_close(self, event: QCloseEvent) -> bool:
        """Refuse a window manager's close request while the wizard drives: another key was meant."""
        if not self._fingers_drive():
            return False
        event.ignore()
        now_s = time.monotonic()
        repeats = now_s - self._last_refused_s < LONGEST_REPEAT_GAP_S
        self._last_refused_s = now_s
        if repeats:
            return True
        # The window manager received the key itself.
        down = self._keys.function_key_down()
        action_id = None if down is None or down[1] in self._owned else self._bindings.function_key(down[0])
        if action_id is not None:
            self._actions.press(action_id, opens=False)
        else:
            self.close_refused.emit()
        return True

    def _fingers_drive(self) -> bool:
        """Whether the robot is driven, a drive key is still down, or the Alt key that drove."""
        down = {identity for identity, hold in self._owned.items() if hold is not None}
        if self._keys.exact:
            down = self._keys.still_down(down)
        alt_down = bool(QApplication.queryKeyboardModifiers() & Qt.KeyboardModifier.AltModifier)
        return self.motion.moving or bool(down) or (self._alt_drove and alt_down)

    def _filter_key(self, event: QKeyEvent) -> bool:
        key = int(event.key())
        if key == Qt.Key.Key_AltGr:
            self._alt_gr_down = event.type() != QEvent.Type.KeyRelease
        if key == Qt.Key.Key_Alt:
            self._alt_drove = self._alt_drove and event.type() != QEvent.Type.KeyRelease
        elif not event.modifiers() & Qt.KeyboardModifier.AltModifier:
            self._alt_drove = False
        if key in (Qt.Key.Key_Escape, Qt.Key.Key_Pause):
            event.accept()
            if event.type() == QEvent.Type.KeyRelease:
                self._keys.released(event)
            elif not self._keys.repeated(event) and event.type() == QEvent.Type.KeyPress:
                self._on_stop_key(Qt.Key(key), pressed_ms=int(event.timestamp()))
            return True
        code = key_code(sys.platform, scan_code=event.nativeScanCode(), virtual_key=event.nativeVirtualKey())
        identity = key if code is None else code
        if event.type() == QEvent.Type.KeyRelease:
            return self._on_release(identity, repeated=not self._keys.released(event))
        repeated = self._keys.repeated(event)
        if event.type() == QEvent.Type.KeyPress and not repeated and self._did_by_position(identity, code, event):
            return True
        if not repeated and self._wants_help(event):
            event.accept()
            if event.type() == QEvent.Type.KeyPress:
                self.help_requested.emit()
            return True
        if self._goes_nowhere(code, event):
            event.accept()
            if event.type() == QEvent.Type.KeyPress:
                self._nowhere.start()
                self._owned.setdefault(identity, None)
            return True
        if identity in self._owned and (repeated or self.motion.moves_by(identity)):
            event.accept()
            return True
        if self._is_stray_repeat(identity, event, repeated=repeated):
            event.accept()
            return True
        self._learn_letter(code, event)
        if self.captures is not None and key not in _MODIFIER_KEYS and self._takes_keys():
            event.accept()
            if event.type() == QEvent.Type.KeyPress and not repeated:
                self._owned[identity] = None
                self.captures(pressed_key(code, event))
            return True
        if not repeated and self._answers(code, event):
            if event.type() == QEvent.Type.KeyPress:
                self._owned[identity] = None
            event.accept()
            return True
        mark = None if repeated else self._mark_for(event)
        if mark is not None:
            event.accept()
            if event.type() == QEvent.Type.KeyPress:
                self._end_marking(identity)
                self._owned[identity] = None
                self._press_mark(identity, mark)
            return True
        command = None if repeated else self._function_key_for(event)
        if command is not None:
            event.accept()
            if event.type() == QEvent.Type.KeyPress:
                self._owned[identity] = None
                self._actions.press(command)
            return True
        hold = self._hold_for(code, event)
        if hold is None:
            if repeated and event.type() == QEvent.Type.ShortcutOverride and not event.isAutoRepeat():
                # Qt treats this auto-repeat as a press; a held F1 would repeat its phrase.
                event.accept()
                return True
            return event.type() == QEvent.Type.KeyPress and self._is_in_vain(identity, code, event, repeated=repeated)
        event.accept()
        if event.type() == QEvent.Type.KeyPress and not repeated:
            self._alt_drove = bool(event.modifiers() & Qt.KeyboardModifier.AltModifier)
            self._on_press(identity, hold)
        return True

    def _is_stray_repeat(self, identity: int, event: QKeyEvent, *, repeated: bool) -> bool:
        """Whether a held key repeats in another widget than it was pressed in, or would press or confirm once more.

        Tab and the arrows may move on.
        """
        popup = self._app.activePopupWidget()
        target = focused_widget() if popup is None or _is_completion(popup) else popup
        if not repeated:
            if event.type() == QEvent.Type.ShortcutOverride:  # the first event of a press
                self._pressed_in[identity] = target
            else:
                self._pressed_in.setdefault(identity, target)
            return False
        if self._pressed_in.get(identity, target) is not target:
            return event.key() not in _MOVING_KEYS
        types = _TEXT_INPUTS if event.key() == Qt.Key.Key_Space else _MULTI_LINE_INPUTS
        return event.key() in _PRESSING_KEYS and not isinstance(target, types)

    def _marks_repeat(self, watched: QObject, event: QKeyEvent) -> bool:
        """Replace an auto-repeat that Qt took for a press by a marked one; returns whether it did. On X11 that is every
        repeat, because the X server sends no releases in between.
        """
        if event.isAutoRepeat() or not self._keys.repeated(event):
            return False
        marked = QKeyEvent(
            event.type(), event.key(), event.modifiers(), event.nativeScanCode(), event.nativeVirtualKey(),
            event.nativeModifiers(), event.text(), True,
        )  # fmt: skip
        marked.setTimestamp(event.timestamp())
        QApplication.sendEvent(watched, marked)
        event.accept()
        return True

    def _wants_help(self, event: QKeyEvent) -> bool:
        """Whether this is the system's help key (F1) in a dialog or another window without phrase keys."""
        window = self._app.activeModalWidget() or self._app.activeWindow()
        other = window is not None and not self._in_console(window) and self._app.activePopupWidget() is None
        return other and event.matches(QKeySequence.StandardKey.HelpContents)

    def _in_console(self, window: QWidget | None) -> bool:
        """Whether a window is the main window or a floating panel of it."""
        return window is self._window or (window is not None and window.windowType() == Qt.WindowType.Tool)

    def _answers(self, code: int | None, event: QKeyEvent) -> bool:
        """Whether this key answers ``ask_next_key``; any other key ends the question."""
        if self._question is None or event.key() in _MODIFIER_KEYS or not self._takes_keys():
            return False
        hold = self._hold_for(code, event)
        if hold is not None and hold.action_id in WISHES:
            return False
        letters, answer, after = self._question
        letter = position_of(sys.platform, code) or ""
        if code is None:
            letter = LETTERS.get(int(event.key()), "")
        left_over = (Qt.KeyboardModifier.NoModifier, Qt.KeyboardModifier.ShiftModifier, after)
        if letter and letter in letters and self._without_driving_alt(event) in left_over:
            if event.type() == QEvent.Type.KeyPress:
                self._question = None
                answer(letter)
            return True
        self._end_question()
        return False

    def _end_question(self) -> None:
        """Answer the question with an empty text."""
        question, self._question = self._question, None
        if question is not None:
            question[1]("")

    def _mark_for(self, event: QKeyEvent) -> Hold | None:
        """Action of kind "mark" or "talk" on this key now."""
        if not self._takes_keys():
            return None
        mark = self._bindings.mark(event, self._without_driving_alt(event), bare=self._actions.driving_focus)
        return mark if mark is not None and self._actions.spec(mark.action_id) is not None else None

    def _press_mark(self, identity: int, mark: Hold) -> None:
        action_id, spec = mark.action_id, self._actions.spec(mark.action_id)
        if not self._actions.available(action_id):
            self._actions.press(action_id, opens=not mark.bare)
        elif mark.bare and spec is not None and spec.kind == "talk":
            # A delay: typing in the wrong place must not open the microphone.
            timer = self._about_to_talk[identity] = QTimer(self, singleShot=True, interval=HELD_TO_TALK_MS)
            timer.timeout.connect(lambda: self._begin_talking(identity, action_id))
            timer.start()
        else:
            self._marking[identity] = action_id
            self.mark_pressed.emit(action_id)

    def _begin_talking(self, identity: int, action_id: str) -> None:
        self._about_to_talk.pop(identity).deleteLater()
        self._marking[identity] = action_id
        self.mark_pressed.emit(action_id)

    def _function_key_for(self, event: QKeyEvent) -> str | None:
        """Command of a function key pressed while Alt drives; Qt would read it as Alt+F-key."""
        if not event.modifiers() & Qt.KeyboardModifier.AltModifier or not self._takes_keys():
            return None
        alone = self._without_driving_alt(event) == Qt.KeyboardModifier.NoModifier
        return self._bindings.function_key(int(event.key())) if alone else None

    def _without_driving_alt(self, event: QKeyEvent) -> Qt.KeyboardModifier:
        """Modifiers of a key event without an Alt that is held to drive."""
        modifiers = event.modifiers()
        # Also after the motion has ended: the fingers are still on the keys.
        if self._alt_drove or any(hold is not None and not hold.bare for hold in self._owned.values()):
            modifiers &= ~Qt.KeyboardModifier.AltModifier
        return modifiers

    def _is_in_vain(self, identity: int, code: int | None, event: QKeyEvent, *, repeated: bool) -> bool:
        """Report a press without a binding that was probably meant for a command; returns whether to consume it."""
        if not self._takes_keys():
            return False
        typing = isinstance(focused_widget(), _TEXT_INPUTS)
        chord = event.modifiers() & CHORD_MODIFIERS
        if not chord:
            if repeated and typing and self._bindings.drives_bare(code) and self._actions.spec("drive_forward"):
                self.slipped.emit(self._how_to_drive(tr("You are typing.")))
            return False
        if repeated:
            return False
        if absent := self._actions.absent(QKeySequence(event.keyCombination())):
            self._owned[identity] = None
            self._actions.not_done.emit(absent, True)
            return True
        if not self._is_slip(event):
            return False
        self._owned[identity] = None
        if event.key() == Qt.Key.Key_Space and self._actions.spec("push_to_talk") is not None:
            talk = self._actions.key_text("push_to_talk")
            hint = tr("Alt+Space has no function. Hold {key} to speak through the robot.").format(key=talk)
        elif self._actions.spec("drive_forward") is not None:
            hint = self._how_to_drive(tr("This key has no function with Alt."))
        else:
            hint = tr("This key has no function with Alt.")
        self.slipped.emit(hint)
        return True

    def _how_to_drive(self, why_not: str) -> str:
        how = tr("{why} Hold {key} to drive, or press {back} to return to driving.")
        caps = [self._actions.caps(spec, spec.keys[:1])[0] for name in ("drive_forward", "focus_driving")
                if (spec := self._actions.spec(name)) is not None and spec.keys]  # fmt: skip
        return how.format(why=why_not, key=caps[0], back=caps[-1]) if len(caps) > 1 else why_not

    def _is_slip(self, event: QKeyEvent) -> bool:
        """Whether Alt was pressed with an unbound character: next to the drive key, or a direction that the robot
        lacks.

        Qt would type the character. On a Mac, Alt types other characters, so it is left alone.
        """
        return (
            sys.platform != "darwin"
            and event.modifiers() & CHORD_MODIFIERS == Qt.KeyboardModifier.AltModifier
            and event.text().isprintable()
            and bool(event.text())
        )

    # ---- discarded keys

    @property
    def keys_go_nowhere(self) -> bool:
        """Whether keystrokes are discarded because they were meant for something that could not be opened."""
        return self._nowhere.isActive()

    def _on_not_done(self, _reason: str, opens: bool) -> None:
        if opens and not self.motion.moving:
            self._nowhere.start()
            self._update_key_owner()

    def _goes_nowhere(self, code: int | None, event: QKeyEvent) -> bool:
        """Discard typing and bare drive keys until the hands rest; a new chord is a new command."""
        if not self._nowhere.isActive() or event.key() in _MODIFIER_KEYS or not self._takes_keys():
            return False
        pad = event.modifiers() & Qt.KeyboardModifier.KeypadModifier and not event.text()
        if event.modifiers() & CHORD_MODIFIERS or Qt.Key.Key_F1 <= event.key() <= Qt.Key.Key_F35 or pad:
            if event.type() == QEvent.Type.KeyPress:
                self._end_nowhere()
            return False
        return True

    def _end_nowhere(self) -> None:
        self._types_at_button.stop()
        if self._nowhere.isActive():
            self._nowhere.stop()
            self._on_nowhere_ended()

    def _on_nowhere_ended(self) -> None:
        self._update_key_owner()
        self.nowhere_ended.emit()

    def _on_press(self, identity: int, hold: Hold) -> None:
        spec = self._actions.spec(hold.action_id)
        self._owned[identity] = hold
        if spec is not None and spec.kind != "hold":
            self._actions.press(hold.action_id, opens=not hold.bare)
        else:
            self.motion.press(identity, hold)

    def _hold_for(self, code: int | None, event: QKeyEvent) -> Hold | None:
        if not self._takes_keys():
            return None
        hold = self._bindings.hold(code, event, bare=self._actions.driving_focus)
        return None if hold is None or self._actions.spec(hold.action_id) is None else hold

    def _learn_letter(self, code: int | None, event: QKeyEvent) -> None:
        """Update the key caps when the keyboard layout changes, also on systems that send no notification.

        Only unmodified keys count: AltGr, Option or Ctrl+Alt do not mean another layout.
        """
        position, key = position_of(sys.platform, code), int(event.key())
        if position is None or not 0x20 < key < 0x2000 or self._actions.letter(position) == chr(key):
            return
        other_level = Qt.KeyboardModifier.ShiftModifier | Qt.KeyboardModifier.GroupSwitchModifier
        if sys.platform == "darwin":
            other_level |= Qt.KeyboardModifier.AltModifier
        both = Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.AltModifier
        other_level_now = bool(event.modifiers() & other_level) or event.modifiers() & both == both
        if self._keys.exact:
            other_level_now = other_level_now or bool(event.nativeModifiers() & X11_LEVELS)
        if self._alt_gr_down or other_level_now:
            return
        self._actions.use_letters({**self._actions.letters, position: chr(key)})

    def _did_by_position(self, identity: int, code: int | None, event: QKeyEvent) -> bool:
        """Run the command bound to another key (``_bound_key``). Qt tries the other installed layouts first;
        this is reached only if none matches.
        """
        chord = event.modifiers() & CHORD_MODIFIERS == Qt.KeyboardModifier.ControlModifier
        bare = self._actions.driving_focus and not event.modifiers() & CHORD_MODIFIERS
        bare = bare and not self._nowhere.isActive() and self._question is None
        if self.captures is not None and self._takes_keys():
            return False
        key = _bound_key(position_of(sys.platform, code), event)
        if key is None or not (chord or bare):
            return False
        meant = QKeyEvent(
            event.type(), key, event.modifiers() & ~Qt.KeyboardModifier.KeypadModifier, event.nativeScanCode(),
            event.nativeVirtualKey(), event.nativeModifiers(), "", event.isAutoRepeat(),
        )  # fmt: skip
        if bare and self._hold_for(code, meant) is not None:
            return False  # driving already goes by position
        self._owned[identity] = None
        if (mark := self._mark_for(meant)) is not None:
            self._end_marking(identity)
            self._press_mark(identity, mark)
            return True
        keys = QKeySequence(meant.keyCombination())
        window, focused = self._app.activeWindow(), focused_widget()
        # Editors and lists in other windows have their own key bindings.
        in_console = self._in_console(window) and self._takes_keys()
        action_id = self._actions.on_key(keys, bare=bare) if in_console else None
        if action_id is not None:
            self._actions.press(action_id, opens=chord)
            return True
        for shortcut in [] if window is None else window.findChildren(QShortcut):
            if chord and shortcut.key() == keys and shortcut.isEnabled():
                shortcut.activated.emit()
                return True
        if chord and focused is not None:
            QApplication.sendEvent(focused, meant)  # copy and paste
            return True
        del self._owned[identity]
        return False

    def _on_release(self, identity: int, *, repeated: bool) -> bool:
        if not repeated:
            self._pressed_in.pop(identity, None)
        if identity not in self._owned:
            return False
        if not repeated:
            del self._owned[identity]
            self._end_marking(identity)
            self.motion.let_go(identity)
        return True

    def _forget_keys_that_went_up_elsewhere(self) -> None:
        still_down = self._keys.still_down(set(self._owned))
        self._owned = {identity: hold for identity, hold in self._owned.items() if identity in still_down}
        for identity in [identity for identity in (*self._marking, *self._about_to_talk) if identity not in still_down]:
            self._end_marking(identity)

    def _end_marking(self, identity: int) -> None:
        if (timer := self._about_to_talk.pop(identity, None)) is not None:
            timer.stop()
            timer.deleteLater()
            self.slipped.emit(tr("Hold this key to speak. A short press does not turn on the microphone."))
        mark = self._marking.pop(identity, None)
        if mark is not None:
            self.mark_released.emit(mark)

    # ---- stops

    def _on_stop_key(self, key: Qt.Key, *, pressed_ms: int = 0) -> None:
        """Stop, or emergency stop on a double press. ``pressed_ms``: system timestamp, 0 if unknown; it is exact even
        when this thread runs late.
        """
        self._end_nowhere()
        now_s, (last_s, last_ms) = time.monotonic(), self._last_escape
        twice = now_s - last_s <= DOUBLE_STOP_S
        if pressed_ms and last_ms:
            twice = twice or 0 <= pressed_ms - last_ms <= DOUBLE_STOP_S * 1000
        if key == Qt.Key.Key_Pause or twice:
            self._last_escape = _NEVER
            self._emergency_stop()
        else:
            self._last_escape = now_s, pressed_ms
            self._stop()
        if key == Qt.Key.Key_Escape:
            self._close_what_escape_closes()

    def _on_keyboard_taken(self) -> None:
        if self._app.activePopupWidget() is not None or not self._is_ours(self._app.activeWindow()):
            return  # our own menus grab the keyboard too
        if self._keyboard_grab.just_taken:
            return
        key = self._keys.stop_key_down()
        if key is not None:
            # A stop must work even where the window manager grabs Alt+Escape.
            self._on_stop_key(Qt.Key(key))
        else:
            self.release_all(QT_TR_NOOP("The window manager took over the keyboard"))

    def _on_lost_key(self, code: int, time_ms: int, pressed: bool) -> None:
        """Stop for Esc and Pause that the X server sent to a window which has closed meanwhile."""
        key = self._keys.stop_key(code)
        if not pressed:
            self._keys.release(code)
        elif key is not None and not self._keys.repeats(code, time_ms):
            self._on_stop_key(Qt.Key(key), pressed_ms=time_ms)

    def _stop(self) -> None:
        self.motion.end_held()
        self._console.do(intents.Stop())

    def _emergency_stop(self) -> None:
        self.motion.end_held()
        self._console.do(intents.EmergencyStop())

    def _close_what_escape_closes(self) -> None:
        popup = self._app.activePopupWidget()
        # A non-modal dialog closes only while it is in front; a stop from the main window leaves it open.
        modal, front = self._app.activeModalWidget(), self._app.activeWindow()
        if modal is not None and (front is None or front.parentWidget() is not modal):
            front = modal  # its own window, such as its help, closes before it
        if popup is not None:
            # A menu closes with its submenus, so that a second Esc finds neither.
            while popup is not None:
                popup.hide()  # closing would destroy its native window, and a following Esc sent to it would be lost
                below = self._app.activePopupWidget()
                popup = below if isinstance(popup, QMenu) and isinstance(below, QMenu) and below is not popup else None
            return
        if front is not None and front is not self._window:
            self._keyboard_grab.hold_during_close(front, self._window)
        if isinstance(front, QDialog):
            front.reject()
        else:
            self.escape_pressed.emit()
        if front is not None and front is not self._window and front.isVisible():
            self._keyboard_grab.give_back()  # the window stays open and keeps the focus

    def _on_gamepad_button(self, action_id: str) -> None:
        if action_id == "stop":
            self._stop()
        elif action_id == "emergency_stop":
            self._emergency_stop()
        else:
            self._actions.press(action_id, opens=False)

    def _on_drive_changed(self, drive: DriveStatus) -> None:
        if drive.emergency_stop or not drive.allowed:
            self.release_all(drive.reason or QT_TR_NOOP("Driving is not possible now"))

    def _on_event(self, event: object) -> None:
        if isinstance(event, DriveEnded):
            # The link ended it: held keys must not move the robot at the next change.
            self.motion.end_held()

    # ---- keyboard focus

    def _is_ours(self, window: object) -> bool:
        """Whether a window is the main window or one of its floating panels."""
        if not isinstance(window, QWidget) or not window.isWindow():
            return False
        if window is self._window:
            return True
        if window.windowType() == Qt.WindowType.Popup or isinstance(window, QDialog):
            return False
        parent = window.parentWidget()
        while parent is not None and parent is not self._window and not isinstance(parent, QDialog):
            parent = parent.parentWidget()
        return parent is self._window

    def _takes_keys(self) -> bool:
        """Whether keys and sticks reach driving: one of our windows is active, and no popup or modal dialog is open."""
        popup = self._app.activePopupWidget()
        if popup is not None and not _is_completion(popup):
            return False
        return self._app.activeModalWidget() is None and self._is_ours(self._app.activeWindow())

    def _on_focus_changed(self, _old: QWidget | None, new: QWidget | None) -> None:
        self._update_driving_focus(new)

    def _drives_with(self, focused: QWidget | None) -> bool:
        """Whether bare keys drive while ``focused`` has the focus."""
        return (
            focused is not None
            and not isinstance(focused, _KEEPS_ITS_KEYS)
            and focused.isVisible()
            and self._is_driving_part(focused)
        )

    def _is_driving_part(self, widget: QWidget) -> bool:
        return any(panel is widget or panel.isAncestorOf(widget) for panel in self._driving_panels)

    def _update_driving_focus(self, focused: QWidget | None) -> None:
        driving = self._drives_with(focused)
        self._actions.set_driving_focus(driving)
        self._update_key_owner()
        if not driving:
            self.motion.end_bare_keys(QT_TR_NOOP("The driving panels lost focus"))
            for identity in tuple(self._about_to_talk):
                self._end_marking(identity)

    def _on_windows_changed(self) -> None:
        self._update_key_owner()
        self.windows_changed.emit()

    def _update_key_owner(self) -> None:
        owner = self._owner_now()
        if owner != self.key_owner:
            self.key_owner = owner
            self.key_owner_changed.emit(owner)

    def _owner_now(self) -> KeyOwner:
        popup = self._app.activePopupWidget()
        if self._actions.spec("drive_forward") is None:
            return "off"
        if popup is not None and not _is_completion(popup):
            return "menu"
        if self._app.activeModalWidget() is not None:
            return "dialog"
        active = self._app.activeWindow()
        if not self._is_ours(active):
            return "dialog" if isinstance(active, QDialog) else "elsewhere"
        if self._nowhere.isActive():
            return "nowhere"
        if self._actions.driving_focus:
            return "driving"
        return "typing" if isinstance(focused_widget(), _TEXT_INPUTS) else "window"

    def _on_application_state_changed(self, state: Qt.ApplicationState) -> None:
        if state != Qt.ApplicationState.ApplicationActive:
            self.release_all(QT_TR_NOOP("Another program came to the front"))
            # The release of a held mark key goes to the other program.
            for identity in (*self._marking, *self._about_to_talk):
                self._end_marking(identity)
        self._update_key_owner()


def _come_first(events: QObject, app: QApplication) -> None:
    """Reinstall the event filter: the filter installed last runs first.

    With a screen reader, Qt intercepts each key, queries the reader, and posts the key after its answer or 100 ms; its
    filter moves to the front whenever a reader connects. A key release must not be delayed by that. Called before a
    press, when Qt sends ShortcutOverride, and whenever a posted key arrives.
    """
    app.removeEventFilter(events)
    app.installEventFilter(events)


def _bound_key(position: str | None, event: QKeyEvent) -> int | None:
    """Key with the wizard's command: Return for the Enter key of the number pad, and the one at this position where the
    layout has no Latin letters, or types a digit only with Shift (Ctrl with the first digit of AZERTY is Ctrl+&).
    """
    key = int(event.key())
    if key == Qt.Key.Key_Enter:
        return int(Qt.Key.Key_Return)
    if position is None or not 0x20 < key < int(Qt.Key.Key_Escape):
        return None
    shift = event.modifiers() & Qt.KeyboardModifier.ShiftModifier
    other_digit = position.isdecimal() and key < 0x80 and not chr(key).isdecimal() and not shift
    return ord(position) if key >= 0x80 or other_digit else None


def _is_completion(popup: QWidget) -> bool:
    """Whether a popup is a completer of the focused text field."""
    return isinstance(popup.focusProxy(), _TEXT_INPUTS)


def _takes_over(window: QWidget) -> bool:
    return window.isModal() or (window.windowType() == Qt.WindowType.Popup and not _is_completion(window))
