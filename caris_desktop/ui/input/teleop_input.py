"""Teleoperation input: held keys, on-screen arrows and sticks, and the gamepad, summed to one command;
maps a key event to an action, by key position or by key symbol.
"""

import sys
from collections.abc import Callable, Iterable, Mapping

from PySide6.QtCore import QKeyCombination, QObject, Qt, Signal
from PySide6.QtGui import QKeyEvent, QKeySequence

from caris_desktop.domain import intents
from caris_desktop.domain.events import CommandSource
from caris_desktop.domain.value_class import Value
from caris_desktop.live.gamepad import AT_REST, TeleopCommand, merged
from caris_desktop.live.status import DriveStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_rows import ActionSpec
from caris_desktop.ui.key_choices import position_codes, position_of

WISHES: dict[str, TeleopCommand] = {
    "drive_forward": TeleopCommand(forward=1.0), "drive_back": TeleopCommand(forward=-1.0),
    "strafe_left": TeleopCommand(left=1.0), "strafe_right": TeleopCommand(left=-1.0),
    "turn_left": TeleopCommand(turn=1.0), "turn_right": TeleopCommand(turn=-1.0),
    "look_left": TeleopCommand(pan=1.0), "look_right": TeleopCommand(pan=-1.0),
    "look_up": TeleopCommand(tilt=-1.0), "look_down": TeleopCommand(tilt=1.0),
}  # fmt: skip


def command_of(action_ids: Iterable[str]) -> TeleopCommand:
    """Sum of the held directions; opposite ones cancel."""
    return merged(WISHES[action_id] for action_id in set(action_ids))


class Hold(Value):
    """A pressed key and its action."""

    action_id: str
    bare: bool  # pressed without a modifier, so it counts only while a driving panel has the focus


class TeleopInput(QObject):
    """Sends drive and head commands on each change, and releases all of them at once.

    After a forced release a key must be pressed again, and a stick must return to centre. ``takes_keys`` says whether
    keys and sticks reach driving now.
    """

    held_changed = Signal(object)  # frozenset of action ids

    def __init__(
        self, console: WizardConsole, actions: Actions, takes_keys: Callable[[], bool], parent: QObject
    ) -> None:
        super().__init__(parent)
        self._console = console
        self._actions = actions
        self._takes_keys = takes_keys
        self._keys: dict[int, Hold] = {}
        self._arrows: set[str] = set()
        self._resting_arrows: set[str] = set()
        self._sticks: dict[str, TeleopCommand] = {}
        self._resting_sticks: set[str] = set()
        self._pad, self._pad_must_rest = AT_REST, False
        self._sent = AT_REST

    @property
    def held(self) -> frozenset[str]:
        """Directions held on the keyboard and by on-screen arrows."""
        return frozenset(hold.action_id for hold in self._keys.values()) | self._arrows

    @property
    def must_rest(self) -> bool:
        """Whether an arrow or stick is held that moves nothing because the motion was ended."""
        return self._pad_must_rest or bool(self._resting_arrows or self._resting_sticks)

    @property
    def moving(self) -> bool:
        """Whether the last command sent moves something."""
        return self._sent.moving

    @property
    def command(self) -> TeleopCommand:
        """Sum of all input sources."""
        robot = self._console.state.robot.value
        total = merged((command_of(self.held), *self._sticks.values(), self._pad))
        return total.limited_to(
            sideways=robot is not None and robot.holonomic, head=robot is not None and robot.head is not None
        )

    # ---- keys

    def moves_by(self, key: int) -> bool:
        """Whether this key moves the robot now."""
        return key in self._keys

    def press(self, key: int, hold: Hold) -> None:
        if self._may_drive():
            self._keys[key] = hold
            self._send("keyboard")

    def let_go(self, key: int) -> None:
        if self._keys.pop(key, None) is not None:
            self._send("keyboard")
        else:
            self._notify()

    def end_bare_keys(self, reason: str) -> None:
        """Release bare keys: the driving panels lost the focus."""
        if not any(hold.bare for hold in self._keys.values()):
            return
        with_modifier = {key: hold for key, hold in self._keys.items() if not hold.bare}
        if with_modifier or self._arrows or self._sticks or self._pad.moving:
            self._keys = with_modifier
            self._send("keyboard")
        else:
            self.release_all(reason)

    # ---- on-screen controls and gamepad

    def hold_onscreen(self, action_id: str) -> None:
        """Press an on-screen arrow."""
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
            self._notify()

    def push_onscreen(self, stick: str, wish: TeleopCommand) -> None:
        """Set an on-screen stick. After a forced release it must return to centre first."""
        if not wish.moving:
            self._resting_sticks.discard(stick)
            self._sticks.pop(stick, None)
        elif stick not in self._resting_sticks and self._may_drive():
            self._sticks[stick] = wish
        else:
            self._resting_sticks.add(stick)
            self._sticks.pop(stick, None)
        self._send("onscreen")

    def push_gamepad(self, wish: TeleopCommand) -> None:
        """Set the gamepad's sticks. After a forced release they must return to centre first."""
        free = self._may_drive() and self._takes_keys()
        self._pad_must_rest = wish.moving and (self._pad_must_rest or not free)
        self._pad = AT_REST if self._pad_must_rest else wish
        self._send("gamepad")

    def lose_gamepad(self, reason: str) -> None:
        if self._pad.moving and not (self._keys or self._arrows or self._sticks):
            self.release_all(reason)  # for the reason in the record
        self._pad, self._pad_must_rest = AT_REST, False
        self._send("gamepad")

    # ---- release

    def release_all(self, reason: str) -> None:
        """End teleoperation now. Keys still held drive again only after a new press, sticks after they were centred."""
        if self._forget_held():
            sent, self._sent = self._sent, AT_REST
            if sent.base != AT_REST.base:
                self._console.do(intents.ReleaseDrive(reason))
            if sent.head != AT_REST.head:
                self._console.do(intents.TurnHead(0.0, 0.0))
            self._notify()

    def end_held(self) -> None:
        """Clear held input after the console stopped the base, so that it does not move again."""
        if self._forget_held():
            if self._sent.head != AT_REST.head:
                self._console.do(intents.TurnHead(0.0, 0.0))
            self._sent = AT_REST
            self._notify()

    def _forget_held(self) -> bool:
        """Clear all held input; False if there was none."""
        was_held = bool(self._keys or self._arrows or self._sticks) or self._pad.moving
        self._keys.clear()
        self._resting_arrows.update(self._arrows)
        self._arrows.clear()
        self._resting_sticks.update(self._sticks)
        self._sticks.clear()
        self._pad_must_rest = self._pad_must_rest or self._pad.moving
        self._pad = AT_REST
        return was_held

    def _may_drive(self) -> bool:
        # Input that is refused now must not move the robot later, when driving is allowed again.
        drive: DriveStatus = self._console.state.drive.value
        return drive.allowed and not drive.emergency_stop and self._actions.spec("drive_forward") is not None

    def _send(self, source: CommandSource) -> None:
        wish = self.command
        sent, self._sent = self._sent, wish
        if wish.base != sent.base:
            if wish.base == AT_REST.base:
                self._console.do(intents.ReleaseDrive())
            else:
                forward, left, turn = wish.base
                self._console.do(intents.Drive(forward, left, turn, self._moving_source(source)))
        if wish.head != sent.head:
            self._console.do(intents.TurnHead(wish.pan, wish.tilt))
        self._notify()

    def _moving_source(self, changed: CommandSource) -> CommandSource:
        """Source of the motion: the one that changed, or another one that is still active after its release."""
        moving: dict[CommandSource, bool] = {
            "keyboard": command_of(hold.action_id for hold in self._keys.values()).base != AT_REST.base,
            "gamepad": self._pad.base != AT_REST.base,
            "onscreen": merged((command_of(self._arrows), *self._sticks.values())).base != AT_REST.base,
        }
        return changed if moving[changed] else next((source for source, moves in moving.items() if moves), changed)

    def _notify(self) -> None:
        self.held_changed.emit(self.held)


CHORD_MODIFIERS = (
    Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.AltModifier | Qt.KeyboardModifier.MetaModifier
)
_NOT_PART_OF_A_CHORD = Qt.KeyboardModifier.KeypadModifier | Qt.KeyboardModifier.ShiftModifier
_ARROW_OF_DIGIT: Mapping[int, int] = {
    int(Qt.Key.Key_8): int(Qt.Key.Key_Up),
    int(Qt.Key.Key_2): int(Qt.Key.Key_Down),
    int(Qt.Key.Key_4): int(Qt.Key.Key_Left),
    int(Qt.Key.Key_6): int(Qt.Key.Key_Right),
}
LETTERS: Mapping[int, str] = {ord(name): name for name in position_codes("linux")}


class KeyBindings:
    """Bindings of keys that the event filter handles before any widget: driving, marks, and function keys with Alt."""

    def __init__(self) -> None:
        self._bare: dict[int | str, str] = {}
        self._chords: dict[tuple[int | str, int], str] = {}
        self._marks: dict[tuple[int, int], str] = {}
        self._bare_marks: dict[tuple[int, int], str] = {}
        self._function_keys: dict[int, str] = {}

    def use(self, specs: Iterable[ActionSpec]) -> None:
        """Replace all bindings by these rows of the table."""
        for keys in (self._bare, self._chords, self._marks, self._bare_marks, self._function_keys):
            keys.clear()
        for spec in specs:
            if spec.kind == "command" and not spec.within:
                chords = (_chord(text) for text in spec.keys)
                self._function_keys |= {int(chord.key()): spec.id for chord in chords if _is_function_key(chord)}
            if spec.kind in ("mark", "talk"):
                for keys, texts in ((self._marks, spec.keys), (self._bare_marks, spec.driving_keys)):
                    for text in texts:
                        chord = _chord(text)
                        keys[int(chord.key()), chord.keyboardModifiers().value] = spec.id
            if spec.kind != "hold" and not spec.by_position:
                continue
            for text in spec.driving_keys:
                self._bare[_where(spec, text)] = spec.id
            for text in spec.keys:
                self._chords[_where(spec, text), _chord(text).keyboardModifiers().value] = spec.id

    def function_key(self, key: int) -> str | None:
        return self._function_keys.get(key)

    def mark(self, event: QKeyEvent, modifiers: Qt.KeyboardModifier, *, bare: bool) -> Hold | None:
        """Action of kind "mark" or "talk" on this key; ``bare``: a driving panel has the focus."""
        where = int(event.key()), (modifiers & ~Qt.KeyboardModifier.KeypadModifier).value
        if (mark := self._marks.get(where)) is not None:
            return Hold(mark, bare=False)
        bare_mark = self._bare_marks.get(where) if bare else None
        return None if bare_mark is None else Hold(bare_mark, bare=True)

    def drives_bare(self, code: int | None) -> bool:
        """Whether the key at this position is a bare drive key."""
        return position_of(sys.platform, code) in self._bare

    def hold(self, code: int | None, event: QKeyEvent, *, bare: bool) -> Hold | None:
        """Action that holding this key triggers; ``bare``: a driving panel has the focus."""
        modifiers = event.modifiers()
        # Letters and digits are matched by position; all other keys, and events without a code, by symbol.
        position = position_of(sys.platform, code)
        if position is not None and _is_another_character(position, event):
            position = None
        where: int | str | None = position
        if where is None:
            where = int(event.key())
            if code is None and not modifiers & Qt.KeyboardModifier.KeypadModifier:
                where = LETTERS.get(where, where)
        if not modifiers & CHORD_MODIFIERS:
            # The number pad with NumLock off drives from anywhere; on a Mac all arrow keys carry the keypad flag.
            on_pad = bool(modifiers & Qt.KeyboardModifier.KeypadModifier) and sys.platform != "darwin"
            if on_pad and modifiers & Qt.KeyboardModifier.ShiftModifier:
                # With Shift down, some keyboard layouts turn the arrows of an unlocked number pad into digits.
                where = _ARROW_OF_DIGIT.get(int(event.key()), where)
            if not (bare or on_pad):
                return None
            action_id = self._bare.get(where)
            lives_by_focus = not on_pad
        else:
            action_id = self._chords.get((where, (modifiers & ~_NOT_PART_OF_A_CHORD).value))
            lives_by_focus = False
        return None if action_id is None else Hold(action_id, bare=lives_by_focus)


class PressedKey(Value):
    """``key`` as written in the table, empty for a key without a name; ``position`` on the keyboard."""

    key: str
    position: str


def pressed_key(code: int | None, event: QKeyEvent) -> PressedKey:
    """The key that a user pressed to choose a binding."""
    key, modifiers = int(event.key()), event.modifiers() & ~Qt.KeyboardModifier.KeypadModifier
    position = position_of(sys.platform, code) or (LETTERS.get(key, "") if code is None else "")
    if position.isdecimal():
        key = ord(position)  # with Shift the key types another character
    elif modifiers & Qt.KeyboardModifier.ShiftModifier and 0x20 < key < 0x7F and not chr(key).isalpha():
        modifiers &= ~Qt.KeyboardModifier.ShiftModifier  # "?" already implies Shift
    named = 0 < key != int(Qt.Key.Key_unknown)
    sequence = QKeySequence(QKeyCombination(modifiers, Qt.Key(key))) if named else QKeySequence()
    return PressedKey(sequence.toString(QKeySequence.SequenceFormat.PortableText), position)


def _where(spec: ActionSpec, text: str) -> int | str:
    """Key position, or key symbol for rows that are not bound by position."""
    key = int(_chord(text).key())
    return LETTERS.get(key, key) if spec.by_position else key


def _chord(text: str) -> QKeyCombination:
    # PySide's stubs lack indexing of QKeySequence.
    chord: QKeyCombination = QKeySequence(text)[0]  # type: ignore[index]
    return chord


def _is_another_character(position: str, event: QKeyEvent) -> bool:
    """Whether Shift turns the digit key at this position into another character, such as the slash of many layouts."""
    shift = event.modifiers() & Qt.KeyboardModifier.ShiftModifier
    return bool(shift) and position.isdecimal() and int(event.key()) != ord(position)


def _is_function_key(chord: QKeyCombination) -> bool:
    alone = chord.keyboardModifiers() == Qt.KeyboardModifier.NoModifier
    return alone and int(Qt.Key.Key_F1) <= int(chord.key()) <= int(Qt.Key.Key_F12)
