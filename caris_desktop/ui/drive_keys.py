"""What moves or stops the robot by hand: keys, caught before any widget sees them, the screen and the gamepad."""

import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from PySide6.QtCore import QEvent, QKeyCombination, QObject, Qt, QTimer, Signal
from PySide6.QtGui import QCloseEvent, QKeyEvent, QKeySequence, QMouseEvent
from PySide6.QtWidgets import (
    QAbstractItemView,
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QDialog,
    QLineEdit,
    QPlainTextEdit,
    QTextEdit,
    QWidget,
)

from caris_desktop.domain import intents
from caris_desktop.domain.events import CommandSource, DriveEnded
from caris_desktop.live.gamepad import Gamepads
from caris_desktop.live.motion_wish import AT_REST, MotionWish, merged
from caris_desktop.live.status import DriveStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui.actions import Actions, ActionSpec
from caris_desktop.ui.key_positions import key_code, position_codes, position_of
from caris_desktop.ui.physical_keys import LONGEST_REPEAT_GAP_S, KeyboardGrabs, PhysicalKeys

DOUBLE_STOP_S = 0.6

KeyOwner = Literal["driving", "typing", "window", "dialog", "menu", "elsewhere", "off"]
"""Who gets a key now: driving (bare keys drive), typing or another part of the window (Alt drives), a dialog, a menu,
another program, or, with a scenario that does not drive, nobody."""

_WISHES: dict[str, MotionWish] = {
    "drive_forward": MotionWish(forward=1.0), "drive_back": MotionWish(forward=-1.0),
    "strafe_left": MotionWish(left=1.0), "strafe_right": MotionWish(left=-1.0),
    "turn_left": MotionWish(turn=1.0), "turn_right": MotionWish(turn=-1.0),
    "look_left": MotionWish(pan=1.0), "look_right": MotionWish(pan=-1.0),
    "look_up": MotionWish(tilt=-1.0), "look_down": MotionWish(tilt=1.0),
}  # fmt: skip
_CHORD_MODIFIERS = (
    Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.AltModifier | Qt.KeyboardModifier.MetaModifier
)
_NOT_PART_OF_A_CHORD = Qt.KeyboardModifier.KeypadModifier | Qt.KeyboardModifier.ShiftModifier
_MODIFIER_KEYS = (
    Qt.Key.Key_Shift, Qt.Key.Key_Control, Qt.Key.Key_Alt, Qt.Key.Key_Meta, Qt.Key.Key_AltGr, Qt.Key.Key_CapsLock,
    Qt.Key.Key_NumLock,
)  # fmt: skip
_LEFT_OVER = (
    Qt.KeyboardModifier.NoModifier, Qt.KeyboardModifier.ShiftModifier,
    Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier,
)  # fmt: skip
_TEXT_INPUTS = (QLineEdit, QPlainTextEdit, QTextEdit, QAbstractSpinBox)
# In a list or a drop-down letters look for lines and arrows move between them.
_KEEPS_ITS_KEYS = (*_TEXT_INPUTS, QComboBox, QAbstractItemView)


def wish_of(action_ids: Iterable[str]) -> MotionWish:
    """What the held directions ask for together; opposite ones cancel."""
    return merged(_WISHES[action_id] for action_id in set(action_ids))


@dataclass(frozen=True, slots=True)
class _Hold:
    action_id: str
    bare: bool  # pressed without a modifier, so it lives only while a driving panel has the focus


class HoldToDrive(QObject):
    """Turns what is held into the intents Drive, ReleaseDrive and TurnHead, and Esc and Pause into stops.

    A drive key belongs to driving from its press to its physical release, whatever happens to modifiers or focus
    in between; nothing else in the application sees it. Keys, screen and gamepad add up. Motion ends when nothing is
    held any more, and at once when the application or its windows are deactivated, a dialog or menu opens, or the
    driving focus is lost; then a key has to be pressed anew, and a stick to be let go first.

    While something drives, or a finger is still on its key, no window closes: with Alt held to drive, F4 is a phrase.
    """

    held_changed = Signal(object)  # frozenset of action ids
    wish_changed = Signal(object)  # MotionWish
    key_owner_changed = Signal(str)
    windows_changed = Signal()  # a window, dialog or menu opened or closed
    escape_pressed = Signal()
    close_refused = Signal()  # a window was asked to close while something drives
    mark_pressed = Signal(str)  # a key of an action of kind "mark" went down
    mark_released = Signal(str)  # and came up again, or can no longer be heard of

    def __init__(self, console: WizardConsole, actions: Actions, window: QWidget) -> None:
        super().__init__(window)
        self._console = console
        self._actions = actions
        self._window = window
        self._driving_panels: tuple[QWidget, ...] = ()
        self._always_pressable: QWidget | None = None
        self._bare: dict[int | str, str] = {}
        self._chords: dict[tuple[int | str, int], str] = {}
        self._mark_keys: dict[tuple[int, int], str] = {}
        self._bare_mark_keys: dict[tuple[int, int], str] = {}
        self._function_keys: dict[int, str] = {}
        self._alt_drove = False
        self._last_refused_s = float("-inf")
        self._marking: dict[int, str] = {}
        self._question: tuple[str, Callable[[str], None]] | None = None
        self._owned: dict[int, _Hold | None] = {}
        self._active: dict[int, _Hold] = {}
        self._arrows: set[str] = set()
        self._resting_arrows: set[str] = set()
        self._sticks: dict[str, MotionWish] = {}
        self._resting_sticks: set[str] = set()
        self._pad, self._pad_must_rest = AT_REST, False
        self._sent = AT_REST
        self._key_owner: KeyOwner = "elsewhere"
        self._last_escape_s = float("-inf")
        self._keys = PhysicalKeys()
        app = QApplication.instance()
        assert isinstance(app, QApplication)  # noqa: S101 (a widget exists, so the application does)
        self._app = app
        app.installEventFilter(self)
        self._grabs = KeyboardGrabs(self._on_keyboard_taken)
        if self._keys.exact:
            app.installNativeEventFilter(self._grabs)
        app.focusChanged.connect(self._on_focus_changed)
        app.applicationStateChanged.connect(self._on_application_state_changed)
        actions.rebuilt.connect(self._on_rebuilt)
        actions.use_letters(self._keys.letters(position_codes(sys.platform)))
        console.state.drive.changed.connect(self._on_drive_changed)
        console.state.event_happened.connect(self._on_event)
        self._take_keys()

    def close(self) -> None:
        """Stop listening; anything held is released."""
        for identity in tuple(self._marking):
            self._end_marking(identity)
        self.release_all("The window was closed")
        self._app.removeEventFilter(self)
        self._app.removeNativeEventFilter(self._grabs)

    def ask_next_key(self, letters: str, answer: Callable[[str], None]) -> None:
        """Take the next key press before anything else sees it, if it is one of ``letters``, by their places.

        ``answer`` gets the letter, or an empty text when another key came first, which does what it always does. Keys
        that drive do so meanwhile, and answer nothing.
        """
        self._question = letters, answer

    def ask_no_key(self) -> None:
        """The answer is no longer waited for."""
        self._question = None

    # ---- what is held

    @property
    def held(self) -> frozenset[str]:
        """The directions that keys and arrows on the screen ask for now."""
        return frozenset(hold.action_id for hold in self._active.values()) | self._arrows

    @property
    def must_let_go(self) -> bool:
        """Whether something is held that moves nothing: the motion was ended, and only a new press begins another."""
        keys = any(
            hold is not None and hold.action_id in _WISHES and identity not in self._active
            for identity, hold in self._owned.items()
        )
        return keys or self._pad_must_rest or bool(self._resting_arrows or self._resting_sticks)

    @property
    def wish(self) -> MotionWish:
        """Everything that is asked for now, from all sources."""
        robot = self._console.state.robot.value
        total = merged((wish_of(self.held), *self._sticks.values(), self._pad))
        return total.limited_to(
            sideways=robot is not None and robot.holonomic, head=robot is not None and robot.head is not None
        )

    @property
    def key_owner(self) -> KeyOwner:
        """Who gets a key that is pressed now."""
        return self._key_owner

    def set_driving_panels(self, panels: Sequence[QWidget]) -> None:
        """The panels in which the bare keys drive."""
        self._driving_panels = tuple(panels)
        self._update_driving_focus(self._app.focusWidget())

    def set_emergency_button(self, button: QWidget) -> None:
        """The red button, which works by the first press also while a menu or a drop-down is open."""
        self._always_pressable = button

    def hold_onscreen(self, action_id: str) -> None:
        """An on-screen arrow is pressed."""
        if self._actions.spec(action_id) is not None and self._may_drive():
            self._arrows.add(action_id)
            self._send("onscreen")
        else:
            self._resting_arrows.add(action_id)

    def let_go_onscreen(self, action_id: str) -> None:
        if action_id in self._arrows:
            self._arrows.discard(action_id)
            self._send("onscreen")
        elif action_id in self._resting_arrows:
            self._resting_arrows.discard(action_id)
            self._tell()

    def push_onscreen(self, stick: str, wish: MotionWish) -> None:
        """An on-screen stick is there now. After a forced end it has to come to rest first."""
        if not wish.moving:
            self._resting_sticks.discard(stick)
            self._sticks.pop(stick, None)
        elif stick not in self._resting_sticks and self._may_drive():
            self._sticks[stick] = wish
        else:
            self._resting_sticks.add(stick)
            self._sticks.pop(stick, None)
        self._send("onscreen")

    def push_gamepad(self, wish: MotionWish) -> None:
        """The gamepad's sticks are there now. After a forced end they have to come to rest first."""
        free = self._may_drive() and self._takes_keys()
        self._pad_must_rest = wish.moving and (self._pad_must_rest or not free)
        self._pad = AT_REST if self._pad_must_rest else wish
        self._send("gamepad")

    def use_gamepads(self, gamepads: Gamepads) -> None:
        """Let the gamepad drive, stop and do what its buttons are set to."""
        gamepads.moved.connect(self.push_gamepad)
        gamepads.lost.connect(self._on_gamepad_lost)
        gamepads.pressed.connect(self._on_gamepad_button)

    def release_all(self, reason: str) -> None:
        """End direct driving now. What is still held drives again only after a new press, sticks after a rest."""
        if self._forget_held():
            sent, self._sent = self._sent, AT_REST
            if sent.base != AT_REST.base:
                self._console.do(intents.ReleaseDrive(reason))
            if sent.head != AT_REST.head:
                self._console.do(intents.TurnHead(0.0, 0.0))
            self._tell()

    def _forget_held(self) -> bool:
        """Nothing is held any more; False where nothing was."""
        was_held = bool(self._active or self._arrows or self._sticks) or self._pad.moving
        self._active.clear()
        self._resting_arrows.update(self._arrows)
        self._arrows.clear()
        self._resting_sticks.update(self._sticks)
        self._sticks.clear()
        self._pad_must_rest = self._pad_must_rest or self._pad.moving
        self._pad = AT_REST
        return was_held

    def _may_drive(self) -> bool:
        # What is pressed in vain must not move the robot later, when driving is possible again.
        drive: DriveStatus = self._console.state.drive.value
        return drive.allowed and not drive.emergency_stop and self._actions.spec("drive_forward") is not None

    def _send(self, source: CommandSource) -> None:
        wish = self.wish
        sent, self._sent = self._sent, wish
        if wish.base != sent.base:
            if wish.base == AT_REST.base:
                self._console.do(intents.ReleaseDrive())
            else:
                forward, left, turn = wish.base
                self._console.do(intents.Drive(forward, left, turn, self._moving_source(source)))
        if wish.head != sent.head:
            self._console.do(intents.TurnHead(wish.pan, wish.tilt))
        self._tell()

    def _moving_source(self, changed: CommandSource) -> CommandSource:
        """Who drives: the one that has just changed, or what is left when it was let go."""
        moving: dict[CommandSource, bool] = {
            "keyboard": wish_of(hold.action_id for hold in self._active.values()).base != AT_REST.base,
            "gamepad": self._pad.base != AT_REST.base,
            "onscreen": merged((wish_of(self._arrows), *self._sticks.values())).base != AT_REST.base,
        }
        return changed if moving[changed] else next((source for source, moves in moving.items() if moves), changed)

    def _tell(self) -> None:
        self.held_changed.emit(self.held)
        self.wish_changed.emit(self._sent)

    # ---- which keys these are

    def _on_rebuilt(self) -> None:
        self.release_all("The scenario was changed")
        self._take_keys()
        self._update_key_owner()

    def _take_keys(self) -> None:
        self._bare.clear()
        self._chords.clear()
        self._mark_keys.clear()
        self._bare_mark_keys.clear()
        self._function_keys.clear()
        for spec in self._actions.all_specs:
            if spec.kind == "command" and not spec.within:
                chords = (_chord(text) for text in spec.keys)
                self._function_keys |= {int(chord.key()): spec.id for chord in chords if _is_function_key(chord)}
            if spec.kind == "mark":
                for keys, texts in ((self._mark_keys, spec.keys), (self._bare_mark_keys, spec.driving_keys)):
                    for text in texts:
                        chord = _chord(text)
                        keys[int(chord.key()), chord.keyboardModifiers().value] = spec.id
            if spec.kind != "hold" and not spec.by_position:
                continue
            for text in spec.driving_keys:
                self._bare[_where(spec, text)] = spec.id
            for text in spec.keys:
                self._chords[_where(spec, text), _chord(text).keyboardModifiers().value] = spec.id

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        kind = event.type()
        if kind in (QEvent.Type.KeyPress, QEvent.Type.KeyRelease, QEvent.Type.ShortcutOverride):
            return isinstance(event, QKeyEvent) and self._filter_key(event)
        if kind == QEvent.Type.MouseButtonPress:
            return isinstance(event, QMouseEvent) and self._filter_press(event)
        if kind == QEvent.Type.WindowDeactivate and self._is_ours(watched):
            # Between the main window and a floating panel nothing is lost: both belong to this window.
            if not self._is_ours(self._app.activeWindow()):
                self.release_all("The window lost the focus")
            self._update_key_owner()
        elif kind == QEvent.Type.WindowActivate and self._is_ours(watched):
            self._forget_keys_that_went_up_elsewhere()
            letters = self._keys.letters(position_codes(sys.platform))
            if letters:
                self._actions.use_letters(letters)
            self._update_key_owner()
        elif kind == QEvent.Type.Close and isinstance(event, QCloseEvent) and isinstance(watched, QWidget):
            # What the program closes itself is not spontaneous for the widget, though it is for its window.
            return event.spontaneous() and self._filter_close(event)
        elif kind in (QEvent.Type.Show, QEvent.Type.Hide) and isinstance(watched, QWidget) and watched.isWindow():
            if kind == QEvent.Type.Show and _takes_over(watched):
                self.release_all("A dialog or menu opened")
            # Qt takes note of popups and dialogs only after this event.
            QTimer.singleShot(0, self, self._on_windows_changed)
        return False

    def _filter_press(self, event: QMouseEvent) -> bool:
        # Qt spends the first press beside a menu or drop-down on closing it; a stop must not wait for a second one.
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

    def _filter_close(self, event: QCloseEvent) -> bool:
        """A window manager asks to close a window: not while the wizard drives, who meant another key."""
        if not self._fingers_drive():
            return False
        event.ignore()
        now_s = time.monotonic()
        repeats = now_s - self._last_refused_s < LONGEST_REPEAT_GAP_S
        self._last_refused_s = now_s
        if repeats:
            return True
        # The key itself went to the window manager.
        down = self._keys.function_key_down()
        action_id = None if down is None or down[1] in self._owned else self._function_keys.get(down[0])
        if action_id is not None:
            self._actions.run(action_id)
        else:
            self.close_refused.emit()
        return True

    def _fingers_drive(self) -> bool:
        """Whether something moves the robot, or a key that did is still down, or Alt from driving."""
        down = {identity for identity, hold in self._owned.items() if hold is not None}
        if self._keys.exact:
            down = self._keys.still_down(down)
        alt_down = bool(QApplication.queryKeyboardModifiers() & Qt.KeyboardModifier.AltModifier)
        return self._sent.moving or bool(down) or (self._alt_drove and alt_down)

    def _filter_key(self, event: QKeyEvent) -> bool:
        key = int(event.key())
        if key == Qt.Key.Key_Alt:
            self._alt_drove = self._alt_drove and event.type() != QEvent.Type.KeyRelease
        elif not event.modifiers() & Qt.KeyboardModifier.AltModifier:
            self._alt_drove = False
        if key in (Qt.Key.Key_Escape, Qt.Key.Key_Pause):
            event.accept()
            if event.type() == QEvent.Type.KeyRelease:
                self._keys.released(event)
            elif not self._keys.repeated(event) and event.type() == QEvent.Type.KeyPress:
                self._on_stop_key(Qt.Key(key))
            return True
        code = key_code(sys.platform, scan_code=event.nativeScanCode(), virtual_key=event.nativeVirtualKey())
        identity = key if code is None else code
        if event.type() == QEvent.Type.KeyRelease:
            return self._on_release(identity, repeated=not self._keys.released(event))
        repeated = self._keys.repeated(event)
        if identity in self._owned and (repeated or identity in self._active):
            event.accept()
            return True
        self._learn_letter(code, event)
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
                self._marking[identity] = mark
                self.mark_pressed.emit(mark)
            return True
        command = None if repeated else self._function_key_for(event)
        if command is not None:
            event.accept()
            if event.type() == QEvent.Type.KeyPress:
                self._owned[identity] = None
                self._actions.run(command)
            return True
        hold = self._hold_for(code, event)
        if hold is None:
            if repeated and event.type() == QEvent.Type.ShortcutOverride and not event.isAutoRepeat():
                # Qt takes this repeat for a press; a held F1 would say its phrase again and again.
                event.accept()
                return True
            if event.type() == QEvent.Type.KeyPress and self._is_slip(event):
                self._owned[identity] = None
                return True
            return False
        event.accept()
        if event.type() == QEvent.Type.KeyPress and not repeated:
            self._alt_drove = bool(event.modifiers() & Qt.KeyboardModifier.AltModifier)
            self._on_press(identity, hold)
        return True

    def _answers(self, code: int | None, event: QKeyEvent) -> bool:
        """Whether this key is the answer that was asked for; any other one ends the question."""
        if self._question is None or event.key() in _MODIFIER_KEYS or not self._takes_keys():
            return False
        if self._hold_for(code, event) is not None:
            return False
        letters, answer = self._question
        letter = position_of(sys.platform, code) or ""
        if code is None:
            letter = _LETTERS.get(int(event.key()), "")
        # The fingers may still be on the modifiers of the chord before.
        if letter and letter in letters and self._without_driving_alt(event) in _LEFT_OVER:
            if event.type() == QEvent.Type.KeyPress:
                self._question = None
                answer(letter)
            return True
        self._question = None
        answer("")
        return False

    def _mark_for(self, event: QKeyEvent) -> str | None:
        """The action of kind "mark" that this key means now."""
        if not self._takes_keys():
            return None
        where = int(event.key()), (self._without_driving_alt(event) & ~Qt.KeyboardModifier.KeypadModifier).value
        mark = self._mark_keys.get(where)
        if mark is None and self._actions.driving_focus:
            mark = self._bare_mark_keys.get(where)
        return mark if mark is not None and self._actions.available(mark) else None

    def _function_key_for(self, event: QKeyEvent) -> str | None:
        """The command of a function key that is pressed beside an Alt that drives; Qt would take it for another key."""
        if not event.modifiers() & Qt.KeyboardModifier.AltModifier or not self._takes_keys():
            return None
        alone = self._without_driving_alt(event) == Qt.KeyboardModifier.NoModifier
        return self._function_keys.get(int(event.key())) if alone else None

    def _without_driving_alt(self, event: QKeyEvent) -> Qt.KeyboardModifier:
        """The modifiers of a key, less an Alt that is down because the wizard drives with it."""
        modifiers = event.modifiers()
        # Also where the motion has ended meanwhile: the fingers are still where they were.
        if self._alt_drove or any(hold is not None and not hold.bare for hold in self._owned.values()):
            modifiers &= ~Qt.KeyboardModifier.AltModifier
        return modifiers

    def _is_slip(self, event: QKeyEvent) -> bool:
        """Alt with a character that nothing is bound to: beside the drive key, or a direction the robot lacks.

        Qt would type it. A Mac types other characters in this way, so there it is left alone.
        """
        return (
            sys.platform != "darwin"
            and event.modifiers() & _CHORD_MODIFIERS == Qt.KeyboardModifier.AltModifier
            and event.text().isprintable()
            and bool(event.text())
            and self._takes_keys()
            and isinstance(self._app.focusWidget(), _TEXT_INPUTS)
        )

    def _on_press(self, identity: int, hold: _Hold) -> None:
        spec = self._actions.spec(hold.action_id)
        self._owned[identity] = hold
        if spec is not None and spec.kind != "hold":
            self._actions.run(hold.action_id)
        elif self._may_drive():
            self._active[identity] = hold
            self._send("keyboard")

    def _hold_for(self, code: int | None, event: QKeyEvent) -> _Hold | None:
        if not self._takes_keys():
            return None
        modifiers = event.modifiers()
        # A letter or digit is known by where it is; every other key, and what comes without a code, by what it is.
        where: int | str | None = position_of(sys.platform, code)
        if where is None:
            where = int(event.key())
            if code is None and not modifiers & Qt.KeyboardModifier.KeypadModifier:
                where = _LETTERS.get(where, where)
        if not modifiers & _CHORD_MODIFIERS:
            # The number pad with NumLock off drives from anywhere; on a Mac every arrow key says it is on the pad.
            on_pad = bool(modifiers & Qt.KeyboardModifier.KeypadModifier) and sys.platform != "darwin"
            if on_pad and modifiers & Qt.KeyboardModifier.ShiftModifier:
                # While a capital letter is typed some keyboard layouts turn an unlocked pad's arrows into digits.
                where = _ARROW_OF_DIGIT.get(int(event.key()), where)
            if not (self._actions.driving_focus or on_pad):
                return None
            action_id = self._bare.get(where)
        else:
            action_id = self._chords.get((where, (modifiers & ~_NOT_PART_OF_A_CHORD).value))
            on_pad = True
        if action_id is None or self._actions.spec(action_id) is None:
            return None
        return _Hold(action_id, bare=not on_pad)

    def _learn_letter(self, code: int | None, event: QKeyEvent) -> None:
        """Keep the key caps true when the keyboard layout changes, on systems that do not tell of it too."""
        position, key = position_of(sys.platform, code), int(event.key())
        if position is None or event.modifiers() & Qt.KeyboardModifier.ShiftModifier or not 0x20 < key < 0x2000:
            return
        if sys.platform == "darwin" and event.modifiers() & Qt.KeyboardModifier.AltModifier:
            return  # the option key makes other characters of them
        if self._actions.letter(position) != chr(key):
            self._actions.use_letters({**self._actions.letters, position: chr(key)})

    def _on_release(self, identity: int, *, repeated: bool) -> bool:
        if identity not in self._owned:
            return False
        if not repeated:
            del self._owned[identity]
            self._end_marking(identity)
            if self._active.pop(identity, None) is not None:
                self._send("keyboard")
            else:
                self._tell()
        return True

    def _forget_keys_that_went_up_elsewhere(self) -> None:
        still_down = self._keys.still_down(set(self._owned))
        self._owned = {identity: hold for identity, hold in self._owned.items() if identity in still_down}
        for identity in [identity for identity in self._marking if identity not in still_down]:
            self._end_marking(identity)

    def _end_marking(self, identity: int) -> None:
        mark = self._marking.pop(identity, None)
        if mark is not None:
            self.mark_released.emit(mark)

    # ---- stops

    def _on_stop_key(self, key: Qt.Key) -> None:
        now_s = time.monotonic()
        if key == Qt.Key.Key_Pause or now_s - self._last_escape_s <= DOUBLE_STOP_S:
            self._last_escape_s = float("-inf")
            self._emergency_stop()
        else:
            self._last_escape_s = now_s
            self._stop()
        if key == Qt.Key.Key_Escape:
            self._close_what_escape_closes()

    def _on_keyboard_taken(self) -> None:
        if self._app.activePopupWidget() is not None or not self._is_ours(self._app.activeWindow()):
            return  # our own menus take it too
        key = self._keys.stop_key_down()
        if key is not None:
            # A stop is a stop, also where the window manager keeps Alt+Escape for itself.
            self._on_stop_key(Qt.Key(key))
        else:
            self.release_all("The window manager took the keyboard")

    def _stop(self) -> None:
        self._end_held()
        self._console.do(intents.Stop())

    def _emergency_stop(self) -> None:
        self._end_held()
        self._console.do(intents.EmergencyStop())

    def _end_held(self) -> None:
        """The console's stop ends the motion of the base; what is still held must not start it again."""
        if self._forget_held():
            if self._sent.head != AT_REST.head:
                self._console.do(intents.TurnHead(0.0, 0.0))
            self._sent = AT_REST
            self._tell()

    def _close_what_escape_closes(self) -> None:
        popup = self._app.activePopupWidget()
        # A dialog that is not modal closes while it is in front: who stops from the main window keeps it.
        dialog = self._app.activeModalWidget() or self._app.activeWindow()
        if popup is not None:
            popup.close()
        elif isinstance(dialog, QDialog):
            dialog.reject()
        else:
            self.escape_pressed.emit()

    def _on_gamepad_lost(self, reason: str) -> None:
        if self._pad.moving and not (self._active or self._arrows or self._sticks):
            self.release_all(reason)  # so that the record says why it ended
        self._pad, self._pad_must_rest = AT_REST, False
        self._send("gamepad")

    def _on_gamepad_button(self, action_id: str) -> None:
        if action_id == "stop":
            self._stop()
        elif action_id == "emergency_stop":
            self._emergency_stop()
        else:
            self._actions.run(action_id)

    def _on_drive_changed(self, drive: DriveStatus) -> None:
        if drive.emergency_stop or not drive.allowed:
            self.release_all(drive.reason or "Driving is not possible now")

    def _on_event(self, event: object) -> None:
        if isinstance(event, DriveEnded):
            # The link ended it: what is still held must not move the robot on the next change.
            self._end_held()

    # ---- who has the keys

    def _is_ours(self, window: object) -> bool:
        """Whether a window is the main one or one of its floating panels."""
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
        """Whether keys and sticks reach driving: one of our windows is in front and nothing has taken over."""
        popup = self._app.activePopupWidget()
        if popup is not None and not _is_completion(popup):
            return False
        return self._app.activeModalWidget() is None and self._is_ours(self._app.activeWindow())

    def _on_focus_changed(self, _old: QWidget | None, new: QWidget | None) -> None:
        self._update_driving_focus(new)

    def _update_driving_focus(self, focused: QWidget | None) -> None:
        driving = (
            focused is not None
            and not isinstance(focused, _KEEPS_ITS_KEYS)
            and any(panel is focused or panel.isAncestorOf(focused) for panel in self._driving_panels)
        )
        self._actions.set_driving_focus(driving)
        self._update_key_owner()
        if not driving and any(hold.bare for hold in self._active.values()):
            kept = {identity: hold for identity, hold in self._active.items() if not hold.bare}
            if kept or self._arrows or self._sticks or self._pad.moving:
                self._active = kept
                self._send("keyboard")
            else:
                self.release_all("The driving panels lost the focus")

    def _on_windows_changed(self) -> None:
        self._update_key_owner()
        self.windows_changed.emit()

    def _update_key_owner(self) -> None:
        owner = self._owner_now()
        if owner != self._key_owner:
            self._key_owner = owner
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
        if self._actions.driving_focus:
            return "driving"
        return "typing" if isinstance(self._app.focusWidget(), _TEXT_INPUTS) else "window"

    def _on_application_state_changed(self, state: Qt.ApplicationState) -> None:
        if state != Qt.ApplicationState.ApplicationActive:
            self.release_all("Another program came to the front")
            # The release of a held mark key goes to that program.
            for identity in tuple(self._marking):
                self._end_marking(identity)
        self._update_key_owner()


_ARROW_OF_DIGIT: Mapping[int, int] = {
    int(Qt.Key.Key_8): int(Qt.Key.Key_Up),
    int(Qt.Key.Key_2): int(Qt.Key.Key_Down),
    int(Qt.Key.Key_4): int(Qt.Key.Key_Left),
    int(Qt.Key.Key_6): int(Qt.Key.Key_Right),
}
_LETTERS: Mapping[int, str] = {ord(name): name for name in position_codes("linux")}


def _where(spec: ActionSpec, text: str) -> int | str:
    """A key's position on the keyboard, or which key it is wherever it lies."""
    key = int(_chord(text).key())
    return _LETTERS.get(key, key) if spec.by_position else key


def _chord(text: str) -> QKeyCombination:
    # PySide's stubs do not know that a sequence can be indexed.
    chord: QKeyCombination = QKeySequence(text)[0]  # type: ignore[index]
    return chord


def _is_function_key(chord: QKeyCombination) -> bool:
    alone = chord.keyboardModifiers() == Qt.KeyboardModifier.NoModifier
    return alone and int(Qt.Key.Key_F1) <= int(chord.key()) <= int(Qt.Key.Key_F12)


def _is_completion(popup: QWidget) -> bool:
    """Whether a popup only proposes words for the field that is typed into."""
    return isinstance(popup.focusProxy(), _TEXT_INPUTS)


def _takes_over(window: QWidget) -> bool:
    return window.isModal() or (window.windowType() == Qt.WindowType.Popup and not _is_completion(window))
