"""Keys that move or stop the robot: hold-to-drive and the stop keys, caught before any widget sees them."""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

from PySide6.QtCore import QEvent, QKeyCombination, QObject, Qt, Signal
from PySide6.QtGui import QKeyEvent, QKeySequence
from PySide6.QtWidgets import (
    QAbstractSpinBox,
    QApplication,
    QDialog,
    QLineEdit,
    QPlainTextEdit,
    QTextEdit,
    QWidget,
)

from caris_desktop.domain.events import CommandSource, DriveEnded
from caris_desktop.live.intents import WizardIntents
from caris_desktop.live.status import DriveStatus
from caris_desktop.ui.actions import Actions
from caris_desktop.ui.physical_keys import PhysicalKeys

DOUBLE_STOP_S = 0.6

_AXES: dict[str, tuple[float, float]] = {
    "drive_forward": (1.0, 0.0),
    "drive_back": (-1.0, 0.0),
    "turn_left": (0.0, 1.0),
    "turn_right": (0.0, -1.0),
}
_CHORD_MODIFIERS = (
    Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.AltModifier | Qt.KeyboardModifier.MetaModifier
)
_TEXT_INPUTS = (QLineEdit, QPlainTextEdit, QTextEdit, QAbstractSpinBox)


def combine(action_ids: Sequence[str]) -> tuple[float, float]:
    """(forward, turn), each -1..1, of the held directions; opposite ones cancel."""
    forward = sum(_AXES[action_id][0] for action_id in set(action_ids))
    turn = sum(_AXES[action_id][1] for action_id in set(action_ids))
    return forward, turn


@dataclass(frozen=True, slots=True)
class _Hold:
    action_id: str
    bare: bool  # pressed without a modifier, so it lives only while a driving panel has the focus


class HoldToDrive(QObject):
    """Turns presses and releases into ``console.drive`` and ``console.release_drive``, and Esc and Pause into stops.

    A drive key belongs to driving from its press to its physical release, whatever happens to modifiers or focus
    in between; nothing else in the application sees it. Motion ends when the last key is up, and at once when the
    application or window is deactivated, a dialog or popup opens, or the driving focus is lost; then a key has to
    be pressed anew.
    """

    held_changed = Signal(object)  # frozenset of action ids
    escape_pressed = Signal()

    def __init__(self, console: WizardIntents, actions: Actions, window: QWidget) -> None:
        super().__init__(window)
        self._console = console
        self._actions = actions
        self._window = window
        self._driving_panels: tuple[QWidget, ...] = ()
        self._bare: dict[int, str] = {}
        self._chords: dict[tuple[int, int], str] = {}
        self._owned: dict[int, _Hold] = {}
        self._active: dict[int, _Hold] = {}
        self._onscreen: set[str] = set()
        self._last_escape_s = float("-inf")
        self._keys = PhysicalKeys()
        app = QApplication.instance()
        assert isinstance(app, QApplication)  # noqa: S101 (a widget exists, so the application does)
        self._app = app
        app.installEventFilter(self)
        app.focusChanged.connect(self._on_focus_changed)
        app.applicationStateChanged.connect(self._on_application_state_changed)
        actions.rebuilt.connect(self._take_keys)
        console.state.drive.changed.connect(self._on_drive_changed)
        console.state.event_happened.connect(self._on_event)
        self._take_keys()

    def close(self) -> None:
        """Stop listening; anything held is released."""
        self.release_all("The window was closed")
        self._app.removeEventFilter(self)

    @property
    def held(self) -> frozenset[str]:
        """The directions that are asked for now."""
        return frozenset(hold.action_id for hold in self._active.values()) | self._onscreen

    def set_driving_panels(self, panels: Sequence[QWidget]) -> None:
        """The panels in which the bare keys drive."""
        self._driving_panels = tuple(panels)
        self._update_driving_focus(self._app.focusWidget())

    def hold_onscreen(self, action_id: str) -> None:
        """An on-screen arrow is pressed."""
        if self._actions.spec(action_id) is not None and self._may_drive():
            self._onscreen.add(action_id)
            self._send("onscreen")

    def let_go_onscreen(self, action_id: str) -> None:
        if action_id in self._onscreen:
            self._onscreen.discard(action_id)
            self._send("onscreen")

    def release_all(self, reason: str) -> None:
        """End direct driving now. Keys that are still down drive again only after a new press."""
        if self._active or self._onscreen:
            self._active.clear()
            self._onscreen.clear()
            self._console.release_drive(reason)
            self.held_changed.emit(self.held)

    def _may_drive(self) -> bool:
        # A key pressed in vain must not move the robot later, when driving is possible again.
        drive: DriveStatus = self._console.state.drive.value
        return drive.allowed and not drive.emergency_stop

    def _take_keys(self) -> None:
        self.release_all("The scenario was changed")
        self._bare.clear()
        self._chords.clear()
        for spec in self._actions.specs:
            if spec.kind != "hold":
                continue
            for text in spec.driving_keys:
                self._bare[int(_chord(text).key())] = spec.id
            for text in spec.keys:
                chord = _chord(text)
                self._chords[int(chord.key()), chord.keyboardModifiers().value] = spec.id

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        kind = event.type()
        if kind in (QEvent.Type.KeyPress, QEvent.Type.KeyRelease, QEvent.Type.ShortcutOverride):
            return isinstance(event, QKeyEvent) and self._filter_key(event)
        if kind == QEvent.Type.WindowDeactivate and watched is self._window:
            self.release_all("The window lost the focus")
        elif kind == QEvent.Type.WindowActivate and watched is self._window:
            self._forget_keys_that_went_up_elsewhere()
        elif kind == QEvent.Type.Show and isinstance(watched, QWidget) and watched.isWindow() and _takes_over(watched):
            self.release_all("A dialog or menu opened")
        return False

    def _filter_key(self, event: QKeyEvent) -> bool:
        key = int(event.key())
        if key in (Qt.Key.Key_Escape, Qt.Key.Key_Pause):
            event.accept()
            if event.type() == QEvent.Type.KeyRelease:
                self._keys.released(event)
            elif not self._keys.repeated(event) and event.type() == QEvent.Type.KeyPress:
                self._on_stop_key(Qt.Key(key))
            return True
        identity = int(event.nativeScanCode()) or key
        if event.type() == QEvent.Type.KeyRelease:
            return self._on_release(identity, repeated=not self._keys.released(event))
        repeated = self._keys.repeated(event)
        if identity in self._owned and (repeated or identity in self._active):
            event.accept()
            return True
        hold = self._hold_for(event)
        if hold is None:
            if repeated and event.type() == QEvent.Type.ShortcutOverride and not event.isAutoRepeat():
                # Qt takes this repeat for a press; a held F1 would say its phrase again and again.
                event.accept()
                return True
            return False
        event.accept()
        if event.type() == QEvent.Type.KeyPress and not repeated:
            self._owned[identity] = hold
            if self._may_drive():
                self._active[identity] = hold
                self._send("keyboard")
        return True

    def _hold_for(self, event: QKeyEvent) -> _Hold | None:
        if self._app.activePopupWidget() is not None or self._app.activeModalWidget() is not None:
            return None
        modifiers = event.modifiers()
        key = int(event.key())
        if not modifiers & _CHORD_MODIFIERS:
            # The number pad with NumLock off drives from anywhere; on a Mac every arrow key says it is on the pad.
            on_pad = bool(modifiers & Qt.KeyboardModifier.KeypadModifier) and sys.platform != "darwin"
            if self._actions.driving_focus or (on_pad and self._window.isActiveWindow()):
                action_id = self._bare.get(key)
                return _Hold(action_id, bare=not on_pad) if action_id is not None else None
            return None
        if not self._window.isActiveWindow():
            return None
        chord = (modifiers & ~Qt.KeyboardModifier.KeypadModifier & ~Qt.KeyboardModifier.ShiftModifier).value
        action_id = self._chords.get((key, chord))
        return _Hold(action_id, bare=False) if action_id is not None else None

    def _on_release(self, identity: int, *, repeated: bool) -> bool:
        if identity not in self._owned:
            return False
        if not repeated:
            del self._owned[identity]
            if self._active.pop(identity, None) is not None:
                self._send("keyboard")
        return True

    def _send(self, source: CommandSource) -> None:
        held = self.held
        if held:
            forward, turn = combine(tuple(held))
            self._console.drive(forward=forward, left=0.0, turn=turn, source=source)
        else:
            self._console.release_drive("")
        self.held_changed.emit(held)

    def _forget_keys_that_went_up_elsewhere(self) -> None:
        still_down = self._keys.still_down(set(self._owned))
        self._owned = {identity: hold for identity, hold in self._owned.items() if identity in still_down}

    def _on_drive_changed(self, drive: DriveStatus) -> None:
        if drive.emergency_stop or not drive.allowed:
            self.release_all(drive.reason or "Driving is not possible now")

    def _on_event(self, event: object) -> None:
        if isinstance(event, DriveEnded) and (self._active or self._onscreen):
            # The link ended it: what is still down must not move the robot on the next change of keys.
            self._active.clear()
            self._onscreen.clear()
            self.held_changed.emit(self.held)

    def _on_stop_key(self, key: Qt.Key) -> None:
        if self._active or self._onscreen:
            # The console's stop ends the motion; a key that is still down must not start it again.
            self._active.clear()
            self._onscreen.clear()
            self.held_changed.emit(self.held)
        now_s = time.monotonic()
        if key == Qt.Key.Key_Pause or now_s - self._last_escape_s <= DOUBLE_STOP_S:
            self._last_escape_s = float("-inf")
            self._console.emergency_stop()
        else:
            self._last_escape_s = now_s
            self._console.stop()
        if key == Qt.Key.Key_Escape:
            self._close_what_escape_closes()

    def _close_what_escape_closes(self) -> None:
        popup = self._app.activePopupWidget()
        dialog = self._app.activeModalWidget()
        if popup is not None:
            popup.close()
        elif isinstance(dialog, QDialog):
            dialog.reject()
        else:
            self.escape_pressed.emit()

    def _on_focus_changed(self, _old: QWidget | None, new: QWidget | None) -> None:
        self._update_driving_focus(new)

    def _update_driving_focus(self, focused: QWidget | None) -> None:
        driving = (
            focused is not None
            and not isinstance(focused, _TEXT_INPUTS)
            and any(panel is focused or panel.isAncestorOf(focused) for panel in self._driving_panels)
        )
        self._actions.set_driving_focus(driving)
        if not driving and any(hold.bare for hold in self._active.values()):
            kept = {identity: hold for identity, hold in self._active.items() if not hold.bare}
            if kept or self._onscreen:
                self._active = kept
                self._send("keyboard")
            else:
                self.release_all("The driving panels lost the focus")

    def _on_application_state_changed(self, state: Qt.ApplicationState) -> None:
        if state != Qt.ApplicationState.ApplicationActive:
            self.release_all("Another program came to the front")


def _chord(text: str) -> QKeyCombination:
    # PySide's stubs do not know that a sequence can be indexed.
    chord: QKeyCombination = QKeySequence(text)[0]  # type: ignore[index]
    return chord


def _takes_over(window: QWidget) -> bool:
    return window.isModal() or window.windowType() == Qt.WindowType.Popup
