"""Intents of marks, marked intervals and notes."""

import secrets
from collections.abc import Mapping
from dataclasses import field

from caris_desktop.domain.events import MarkKind
from caris_desktop.domain.intents.base_intents import Bounds, Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


def new_mark_id() -> str:
    return f"m-{secrets.token_hex(4)}"


@dataclass(frozen=True, slots=True)
class Mark(Intent):
    """Mark this moment, or one ``earlier_s`` ago."""

    label: str
    kind: MarkKind = "mark"
    earlier_s: float = 0.0
    mark_id: str = field(default_factory=new_mark_id)


@dataclass(frozen=True, slots=True)
class BeginMark(Intent):
    """Mark an interval that starts now, or ``earlier_s`` ago, and lasts until it is ended."""

    label: str
    kind: MarkKind = "mark"
    earlier_s: float = 0.0
    mark_id: str = field(default_factory=new_mark_id)


@dataclass(frozen=True, slots=True)
class StretchMark(Intent):
    """Extend a marked moment to an interval, which lasts until it is ended."""

    mark_id: str


@dataclass(frozen=True, slots=True)
class EndMark(Intent):
    """End the interval now."""

    mark_id: str


@dataclass(frozen=True, slots=True)
class ChangeMark(Intent):
    """Change a mark of this session: its label, or an earlier start."""

    mark_id: str
    label: str | None = None
    earlier_s: float = 0.0


@dataclass(frozen=True, slots=True)
class WithdrawMark(Intent):
    """Withdraw a mark."""

    mark_id: str


@dataclass(frozen=True, slots=True)
class AddNote(Intent):
    """Write a note about this moment, or one ``earlier_s`` ago. Words that begin with # are its tags."""

    text: str
    earlier_s: float = 0.0
    note_id: str = field(default_factory=new_mark_id)


@dataclass(frozen=True, slots=True)
class ChangeNote(Intent):
    """Change a note of this session, or the note of a mark."""

    note_id: str
    text: str


@dataclass(frozen=True, slots=True)
class RemoveNote(Intent):
    """Remove a note; a mark itself remains."""

    note_id: str


@dataclass(frozen=True, slots=True)
class RestoreNote(Intent):
    """Restore a removed note."""

    note_id: str


_MOMENT: Mapping[str, Bounds] = {"earlier_s": (0.0, 86_400.0)}

MARKS: IntentTable = {
    Mark: IntentSpec(QT_TR_NOOP("Marking the moment"), bounds=_MOMENT),
    BeginMark: IntentSpec(QT_TR_NOOP("Marking an interval"), bounds=_MOMENT),
    StretchMark: IntentSpec(QT_TR_NOOP("Making the mark an interval")),
    EndMark: IntentSpec(QT_TR_NOOP("Ending the mark"), quiet=True),
    ChangeMark: IntentSpec(QT_TR_NOOP("Changing the mark"), bounds=_MOMENT),
    WithdrawMark: IntentSpec(QT_TR_NOOP("Withdrawing the mark")),
    AddNote: IntentSpec(QT_TR_NOOP("Writing a note"), "notes", bounds=_MOMENT),
    ChangeNote: IntentSpec(QT_TR_NOOP("Changing the note"), "notes"),
    RemoveNote: IntentSpec(QT_TR_NOOP("Removing the note"), "notes"),
    RestoreNote: IntentSpec(QT_TR_NOOP("Restoring the note"), "notes"),
}
