"""Key bindings chosen by the wizard: validation, conflicts, storage.

Safety keys can be neither reassigned nor changed. Where two rows would share a key, the wizard's choice yields to the
table, with a report.
"""

import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, Literal

from PySide6.QtCore import QKeyCombination, Qt
from PySide6.QtGui import QKeyEvent, QKeySequence

from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.ui.action_rows import ActionSpec, say_keyed_phrase

_POSITIONS = "QWERTYUIOPASDFGHJKLZXCVBNM1234567890"
# Linux: X keycodes, which are evdev codes plus 8; Wayland compositors use the same.
_EVDEV = dict(
    zip(_POSITIONS, (*range(24, 34), *range(38, 47), *range(52, 59), *range(10, 20)), strict=True)
)  # fmt: skip
# Windows: set 1 scan codes.
_WINDOWS = dict(
    zip(_POSITIONS, (*range(0x10, 0x1A), *range(0x1E, 0x27), *range(0x2C, 0x33), *range(2, 12)), strict=True)
)  # fmt: skip
# macOS: kVK_ANSI_* of Carbon's HIToolbox/Events.h; Qt reports these as the virtual key, without a scan code.
_MAC = dict(
    zip(
        _POSITIONS,
        (
            12, 13, 14, 15, 17, 16, 32, 34, 31, 35, 0, 1, 2, 3, 5, 4, 38, 40, 37, 6, 7, 8, 9, 11, 45, 46,
            18, 19, 20, 21, 23, 22, 26, 28, 25, 29,
        ),
        strict=True,
    )
)  # fmt: skip


def position_codes(platform: str) -> Mapping[str, int]:
    """Key code of each position; empty for an unsupported system. ``platform`` as ``sys.platform``."""
    if platform == "darwin":
        return _MAC
    if platform == "win32":
        return _WINDOWS
    return _EVDEV if platform.startswith(("linux", "freebsd")) else {}


def key_code(platform: str, *, scan_code: int, virtual_key: int) -> int | None:
    """Code of an event's physical key; None if the event has none."""
    if platform == "darwin":
        return virtual_key
    return scan_code or None


def position_of(platform: str, code: int | None) -> str | None:
    """Position of the key with this code; None if it is not in the table."""
    return next((name for name, known in position_codes(platform).items() if known == code), None)


def modifier_name(platform: str, modifier: str) -> str:
    """Key cap label of Qt's ``Alt``, ``Ctrl``, ``Meta`` and ``Shift``."""
    if platform != "darwin":
        return modifier
    # On macOS, Qt calls the command key Control and the control key Meta.
    return {"Alt": "⌥", "Ctrl": "⌘", "Meta": "⌃", "Shift": "⇧"}.get(modifier, modifier)


Column = Literal["keys", "driving_keys"]
COLUMNS: tuple[Column, ...] = ("keys", "driving_keys")
_ARROWS = ("Up", "Down", "Left", "Right")
_STOPS = ("Esc", "Pause")
_NOT_A_MODIFIER = Qt.KeyboardModifier.KeypadModifier | Qt.KeyboardModifier.GroupSwitchModifier
_EDITS_TEXT = frozenset(f"Ctrl+{key}" for key in ("A", "C", "V", "X", "Z", "Y", "Left", "Right", "Backspace", "Del"))


class Keys(Value):
    """Keys of a row: those that work anywhere, and those while Drive, Video or Map has the focus."""

    keys: tuple[str, ...] = ()
    driving_keys: tuple[str, ...] = ()


Choices = Mapping[str, Keys]
"""Keyed by ``name_of_row``."""


class ResolvedBindings(Value):
    """Resolved bindings: ``rows`` with the chosen keys. ``fallen_back``: reasons for rejected choices.

    ``clashes``: phrases and gestures whose key in the scenario belongs to another row and therefore does not work.
    """

    rows: tuple[ActionSpec, ...] = ()
    fallen_back: tuple[str, ...] = ()
    clashes: tuple[tuple[ActionSpec, ActionSpec], ...] = ()


def name_of_row(spec: ActionSpec) -> str:
    """Stable name of a row. A phrase with its own key is identified by its text: its index changes with the file."""
    return f"phrase: {spec.argument.say}" if spec.intent is say_keyed_phrase else spec.id


@cache
def normalized(key: str) -> str:
    """Canonical spelling of a key sequence. Raises ValueError for one that Qt does not know."""
    sequence = QKeySequence(key, QKeySequence.SequenceFormat.PortableText)
    text = sequence.toString(QKeySequence.SequenceFormat.PortableText)
    # Qt turns an unknown word into a key without a code.
    if not text or any(sequence[place].key() == Qt.Key.Key_unknown for place in range(sequence.count())):  # type: ignore[index]
        raise ValueError(f"no such key: {key!r}")
    return text


def spellings(event: QKeyEvent) -> set[str]:
    """Canonical spellings of a pressed key. Plus matches with and without Shift; digits match by position."""
    bare = event.modifiers() & ~_NOT_A_MODIFIER
    shift = Qt.KeyboardModifier.ShiftModifier
    key = Qt.Key(event.key())
    texts = {_spelled(bare, key)}
    if bare & shift and key in (Qt.Key.Key_Plus, Qt.Key.Key_Minus, Qt.Key.Key_Equal):
        texts.add(_spelled(bare & ~shift, key))
    code = key_code(sys.platform, scan_code=event.nativeScanCode(), virtual_key=event.nativeVirtualKey())
    position = position_of(sys.platform, code)
    if position is not None and position.isdigit() and not bare & ~shift:
        texts.add(position)
    if key == Qt.Key.Key_Enter:
        texts.add(_spelled(bare, Qt.Key.Key_Return))
    return texts


def _spelled(modifiers: Qt.KeyboardModifier, key: Qt.Key) -> str:
    return QKeySequence(QKeyCombination(modifiers, key)).toString(QKeySequence.SequenceFormat.PortableText)


def conflicts(specs: Iterable[ActionSpec]) -> list[tuple[str, tuple[str, ...]]]:
    """Keys bound to more than one action while a driving panel has the focus (where all keys of the window work), or
    within a part of the window: only one part has the focus at a time.
    """
    rows = tuple(specs)
    found: dict[str, dict[str, None]] = {}
    for part in dict.fromkeys(("", *(spec.within for spec in rows))):
        owners: dict[str, list[str]] = {}
        for spec in rows:
            if spec.within in ("", part):
                keys = spec.keys if part else (*spec.keys, *spec.driving_keys)
                for key in {normalized(key) for key in keys}:
                    owners.setdefault(key, []).append(spec.id)
        for key, ids in owners.items():
            if len(ids) > 1:
                found.setdefault(key, {}).update(dict.fromkeys(ids))
    return sorted((key, tuple(ids)) for key, ids in found.items())


def types_something(key: str) -> bool:
    """Whether a key types or moves in a text field: no Ctrl or Alt, and not a function key."""
    last = normalized(key).removeprefix("Shift+")
    return not last.startswith(("Ctrl+", "Alt+", "Meta+")) and not (last[:1] == "F" and last[1:].isdecimal())


def with_keys(spec: ActionSpec, keys: Keys | None) -> ActionSpec:
    return spec if keys is None else replace(spec, keys=keys.keys, driving_keys=keys.driving_keys)


def changed(spec: ActionSpec, column: Column, key: str) -> Keys:
    """Keys of the row after choosing ``key``. A drive key keeps its arrow when a letter is chosen."""
    if not spec.by_position:
        return replace(Keys(spec.keys, spec.driving_keys), **{column: (key,)})
    arrow = key in _ARROWS
    bare = tuple(known for known in spec.driving_keys if (known in _ARROWS) != arrow)
    bare = (*bare, key) if arrow else (key, *bare)
    return Keys(tuple(f"Alt+{each}" for each in bare), bare)


def without(spec: ActionSpec, key: str) -> Keys:
    """Keys of the row after removing ``key``; a drive key is removed with its chord."""
    removed = {key, f"Alt+{key}", key.removeprefix("Alt+")} if spec.by_position else {key}
    return Keys(
        *(tuple(each for each in keys if normalized(each) not in removed) for keys in (spec.keys, spec.driving_keys))
    )


def owners(rows: Iterable[ActionSpec], spec: ActionSpec, keys: Keys) -> list[tuple[str, ActionSpec]]:
    """Other rows that currently have one of ``keys``, by key."""
    others = {row.id: row for row in rows if row.id != spec.id}
    changed_row = with_keys(spec, keys)
    found = conflicts((*others.values(), changed_row))
    return [(key, others[row]) for key, ids in found if spec.id in ids for row in ids if row != spec.id]


def refusal(spec: ActionSpec, column: Column, key: str, rows: Iterable[ActionSpec], *, position: str = "") -> str:
    """Reason why ``key`` can never be bound to the row; empty if it can. ``position``: its position on the keyboard."""
    modifiers, _plus, last = key.rpartition("+") if not key.endswith("+") else (key[:-2], "", "+")
    if spec.kind == "safety":
        return tr("This key always stops the robot and cannot be changed.")
    if last in _STOPS:
        return tr("Esc and Pause always stop the robot. Esc also closes what is open in front.")
    if last in ("Tab", "Backtab"):
        return tr("Tab moves the focus through the window.")
    if spec.by_position:
        arrow_fits = spec.kind == "hold" and last in _ARROWS
        if modifiers or not (arrow_fits or last in position_codes("linux")):
            return tr("Use a single letter or digit here. With Alt, the key then works anywhere.")
        return ""
    if "Alt" in modifiers:
        return tr("Alt is for driving while you type. Use Ctrl or Ctrl+Shift.")
    if spec.within:
        return ""
    if column == "driving_keys":
        held = {each for row in rows if row.kind == "hold" for each in row.driving_keys}
        if not modifiers and (last in held or position in held):
            return tr("{key} drives the robot here.").format(key=last)
        return ""
    if key in _EDITS_TEXT and key not in spec.keys:
        return tr("{key} is used for editing text.").format(key=key)
    if types_something(key) and not any(map(types_something, spec.keys)):
        return tr("{key} types in a text field. Use it with Ctrl, or only while driving.").format(key=key)
    return ""


def settle(specs: Iterable[ActionSpec], choices: Choices) -> ResolvedBindings:
    """Resolve the bindings: the wizard's choices where possible, which take precedence over the scenario's keys."""
    standard = list(specs)
    messages: list[str] = []
    chosen: dict[str, Keys] = {}
    for spec in standard:
        keys = choices.get(name_of_row(spec))
        if keys is not None:
            reason = _broken(spec, keys, standard)
            if reason:
                messages.append(tr("“{act}”: {why}").format(act=spec.text, why=reason))
            else:
                chosen[spec.id] = keys
    firm = [spec for spec in standard if spec.id in chosen or not spec.own_key]
    by_id = {spec.id: spec for spec in firm}
    while True:
        rows = [with_keys(spec, chosen.get(spec.id)) for spec in firm]
        found = next(((key, ids) for key, ids in conflicts(rows) if any(each in chosen for each in ids)), None)
        if found is None:
            break
        key, ids = found
        loser = next(each for each in reversed(ids) if each in chosen)
        del chosen[loser]
        other = next(each for each in ids if each != loser)
        messages.append(
            tr("“{act}”: {key} is already assigned to “{other}”.").format(
                act=by_id[loser].text, key=key, other=by_id[other].text
            )
        )
    return _with_own_keys(standard, rows, tuple(messages))


def _with_own_keys(
    standard: Sequence[ActionSpec], firm: Sequence[ActionSpec], messages: tuple[str, ...]
) -> ResolvedBindings:
    taken = {normalized(key): spec for spec in firm for key in (*spec.keys, *spec.driving_keys)}
    settled = {spec.id: spec for spec in firm}
    clashes = []
    for spec in standard:
        if spec.id in settled:
            continue
        other = taken.get(normalized(spec.keys[0]))
        if other is None:
            settled[spec.id] = taken[normalized(spec.keys[0])] = spec
        else:
            clashes.append((spec, other))
            # The row stays without a key, so that the shortcut sheet can assign another one.
            settled[spec.id] = replace(spec, keys=())
    return ResolvedBindings(
        tuple(settled[spec.id] for spec in standard if spec.id in settled), messages, tuple(clashes)
    )


def _broken(spec: ActionSpec, keys: Keys, rows: Iterable[ActionSpec]) -> str:
    """Reason why these keys are invalid for the row, regardless of other rows; empty if valid."""
    if spec.kind == "safety":
        return refusal(spec, "keys", "", rows)
    if spec.by_position and keys.keys != tuple(f"Alt+{key}" for key in keys.driving_keys):
        return tr("The saved keys cannot be used for driving.")
    for column in COLUMNS:
        for key in getattr(keys, column):
            try:
                same = normalized(key) == key
            except ValueError:
                same = False
            if not same or ", " in key:
                return tr("{key} is not a key.").format(key=key)
            bare = key.removeprefix("Alt+") if spec.by_position else key
            reason = "" if key in getattr(spec, column) else refusal(spec, column, bare, rows)
            if reason:
                return reason
    return ""


def as_text(choices: Choices) -> str:
    """JSON text for the settings."""
    return json.dumps(
        {name: {"keys": list(keys.keys), "driving_keys": list(keys.driving_keys)} for name, keys in choices.items()}
    )


def from_text(text: str) -> dict[str, Keys]:
    """Parse ``as_text``. Raises ValueError for anything else."""
    try:
        stored: Any = json.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
    if not isinstance(stored, dict):
        raise ValueError("no keys by rows")  # noqa: TRY004 - the text is wrong, not its type
    return {str(name): Keys(*(_key_list(row, column) for column in COLUMNS)) for name, row in stored.items()}


def _key_list(row: Any, column: Column) -> tuple[str, ...]:
    keys = row.get(column, []) if isinstance(row, dict) else None
    if not isinstance(keys, list) or len(keys) > 4 or not all(isinstance(key, str) and len(key) < 40 for key in keys):
        raise ValueError(f"no {column}: {row!r}")
    return tuple(keys)
