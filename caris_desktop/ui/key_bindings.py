"""Which action of the table a key means: by where it lies on the keyboard, or by what it is."""

import sys
from collections.abc import Iterable, Mapping

from PySide6.QtCore import QKeyCombination, Qt
from PySide6.QtGui import QKeyEvent, QKeySequence

from caris_desktop.domain.value_class import dataclass
from caris_desktop.ui.action_spec import ActionSpec
from caris_desktop.ui.held_motion import Hold
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
    """The keys that are caught before any widget sees them: of driving, of marks, and function keys beside Alt."""

    def __init__(self) -> None:
        self._bare: dict[int | str, str] = {}
        self._chords: dict[tuple[int | str, int], str] = {}
        self._marks: dict[tuple[int, int], str] = {}
        self._bare_marks: dict[tuple[int, int], str] = {}
        self._function_keys: dict[int, str] = {}

    def take(self, specs: Iterable[ActionSpec]) -> None:
        """Begin anew with these rows of the table."""
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
        """What the key of an action of kind "mark" or "talk" means; ``bare``: a driving panel has the focus."""
        where = int(event.key()), (modifiers & ~Qt.KeyboardModifier.KeypadModifier).value
        if (mark := self._marks.get(where)) is not None:
            return Hold(mark, bare=False)
        bare_mark = self._bare_marks.get(where) if bare else None
        return None if bare_mark is None else Hold(bare_mark, bare=True)

    def drives_bare(self, code: int | None) -> bool:
        """Whether the letter at this place drives where bare keys drive."""
        return position_of(sys.platform, code) in self._bare

    def hold(self, code: int | None, event: QKeyEvent, *, bare: bool) -> Hold | None:
        """What the key is held for; ``bare``: a driving panel has the focus."""
        modifiers = event.modifiers()
        # A letter or digit is known by where it is; every other key, and what comes without a code, by what it is.
        where: int | str | None = position_of(sys.platform, code)
        if where is None:
            where = int(event.key())
            if code is None and not modifiers & Qt.KeyboardModifier.KeypadModifier:
                where = LETTERS.get(where, where)
        if not modifiers & CHORD_MODIFIERS:
            # The number pad with NumLock off drives from anywhere; on a Mac every arrow key says it is on the pad.
            on_pad = bool(modifiers & Qt.KeyboardModifier.KeypadModifier) and sys.platform != "darwin"
            if on_pad and modifiers & Qt.KeyboardModifier.ShiftModifier:
                # While a capital letter is typed some keyboard layouts turn an unlocked pad's arrows into digits.
                where = _ARROW_OF_DIGIT.get(int(event.key()), where)
            if not (bare or on_pad):
                return None
            action_id = self._bare.get(where)
            lives_by_focus = not on_pad
        else:
            action_id = self._chords.get((where, (modifiers & ~_NOT_PART_OF_A_CHORD).value))
            lives_by_focus = False
        return None if action_id is None else Hold(action_id, bare=lives_by_focus)


@dataclass(frozen=True, slots=True)
class PressedKey:
    """``key`` as it is written in the table, empty for one that has no name; ``position`` is where it lies."""

    key: str
    position: str


def pressed_key(code: int | None, event: QKeyEvent) -> PressedKey:
    """What somebody pressed to say which key they mean."""
    key, modifiers = int(event.key()), event.modifiers() & ~Qt.KeyboardModifier.KeypadModifier
    position = position_of(sys.platform, code) or (LETTERS.get(key, "") if code is None else "")
    if position.isdecimal():
        key = ord(position)  # with Shift it types another character
    elif modifiers & Qt.KeyboardModifier.ShiftModifier and 0x20 < key < 0x7F and not chr(key).isalpha():
        modifiers &= ~Qt.KeyboardModifier.ShiftModifier  # "?" says already that Shift was held
    named = 0 < key != int(Qt.Key.Key_unknown)
    sequence = QKeySequence(QKeyCombination(modifiers, Qt.Key(key))) if named else QKeySequence()
    return PressedKey(sequence.toString(QKeySequence.SequenceFormat.PortableText), position)


def _where(spec: ActionSpec, text: str) -> int | str:
    """A key's position on the keyboard, or which key it is wherever it lies."""
    key = int(_chord(text).key())
    return LETTERS.get(key, key) if spec.by_position else key


def _chord(text: str) -> QKeyCombination:
    # PySide's stubs do not know that a sequence can be indexed.
    chord: QKeyCombination = QKeySequence(text)[0]  # type: ignore[index]
    return chord


def _is_function_key(chord: QKeyCombination) -> bool:
    alone = chord.keyboardModifiers() == Qt.KeyboardModifier.NoModifier
    return alone and int(Qt.Key.Key_F1) <= int(chord.key()) <= int(Qt.Key.Key_F12)
