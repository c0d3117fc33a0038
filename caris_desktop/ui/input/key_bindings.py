"""Key bindings of teleoperation: maps a key event to an action, by key position or by key symbol."""

import sys
from collections.abc import Iterable, Mapping

from PySide6.QtCore import QKeyCombination, Qt
from PySide6.QtGui import QKeyEvent, QKeySequence

from caris_desktop.domain.value_class import Value
from caris_desktop.ui.action_spec import ActionSpec
from caris_desktop.ui.input.teleop_input import Hold
from caris_desktop.ui.key_positions import position_codes, position_of

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
        where: int | str | None = position_of(sys.platform, code)
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


def _is_function_key(chord: QKeyCombination) -> bool:
    alone = chord.keyboardModifiers() == Qt.KeyboardModifier.NoModifier
    return alone and int(Qt.Key.Key_F1) <= int(chord.key()) <= int(Qt.Key.Key_F12)
