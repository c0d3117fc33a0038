"""Shared state of the editor's widgets: document, change signals, and names known to the program."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from PySide6.QtCore import QObject, Signal

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.key_path import KeyPath, name_of
from caris_desktop.domain.schema_fields import Known, ValueForm
from caris_desktop.domain.schema_labels import allowed_by, said_of
from caris_desktop.domain.schema_paths import ABSENT
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.scenario.document import Mistake, ScenarioDocument, UndoStep
from caris_desktop.ui.theme import Theme


class Editing(QObject):
    """Document under edit, in the GUI thread. ``changed``: any change; ``reshaped``: list entries were added, removed
    or moved, or anything may have changed.
    """

    changed = Signal()
    reshaped = Signal()

    def __init__(self, document: ScenarioDocument, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self.document = document

    def emit_changes(self, *, reshaped: bool = False) -> None:
        """Emit the signals of a change."""
        if reshaped:
            self.reshaped.emit()
        self.changed.emit()

    def set(self, path: KeyPath, value: Any) -> None:
        self.document.set(path, value)
        self.emit_changes()

    def clear(self, path: KeyPath) -> None:
        self.document.clear(path)
        self.emit_changes()

    def add(self, path: KeyPath, entry: Any) -> None:
        self.document.add(path, entry)
        self.emit_changes(reshaped=True)

    def remove(self, path: KeyPath) -> None:
        self.document.remove(path)
        self.emit_changes(reshaped=True)

    def move(self, path: KeyPath, place: int) -> None:
        self.document.move(path, place)
        self.emit_changes(reshaped=True)

    def replace(self, path: KeyPath, value: Any) -> None:
        """Replace the whole value."""
        if value is ABSENT:
            self.document.clear(path)
        else:
            self.document.set(path, value)
        self.document.pause()
        self.emit_changes(reshaped=True)

    def undo(self) -> UndoStep | None:
        step = self.document.undo()
        self.emit_changes(reshaped=True)
        return step

    def redo(self) -> UndoStep | None:
        step = self.document.redo()
        self.emit_changes(reshaped=True)
        return step

    def mistakes_at(self, path: KeyPath) -> list[Mistake]:
        return [mistake for mistake in self.document.mistakes if mistake.path == path]

    def mistakes_within(self, path: KeyPath) -> list[Mistake]:
        return [mistake for mistake in self.document.mistakes if mistake.path[: len(path)] == path]


class Names(Value):
    """Known names; ``all_of_them``: any other name does not exist."""

    names: tuple[str, ...] = ()
    all_of_them: bool = False


class FormContext(Value):
    """Context of the form's widgets. ``robot_pose``: current map pose or None; ``known``: existing names of a kind.
    ``within``: titles of the enclosing parts, innermost first, for screen readers.
    """

    theme: Theme
    editing: Editing
    robot_pose: Callable[[], Pose2D | None]
    known: Callable[[Known], Names]
    within: str = ""

    def inside(self, title: str) -> "FormContext":
        """Context for parts within an enclosing title."""
        return replace(self, within=self.spoken(title)) if title else self

    def spoken(self, name: str) -> str:
        """Accessible name of a field."""
        return f"{name}, {self.within}" if self.within else name


def help_of(form: ValueForm) -> str:
    """Help text below a field: meaning and permitted values."""
    rule = form.rule
    parts = [readable(said_of(form))]
    if rule.allowed:
        parts.append(tr("Allowed: {allowed}").format(allowed=readable(allowed_by(form))))
    least, most = rule.at_least, rule.at_most
    if least is not None and most is not None:
        parts.append(tr("From {least} to {most}.").format(least=f"{least:g}", most=f"{most:g}"))
    elif rule.more_than is not None and most is not None:
        parts.append(tr("More than {least}, up to {most}.").format(least=f"{rule.more_than:g}", most=f"{most:g}"))
    return " ".join(part for part in parts if part)


def readable(text: str) -> str:
    """Schema text with quotes in place of code marks."""
    pieces = text.split("`")
    return "".join(piece if number % 2 == 0 else f"“{piece}”" for number, piece in enumerate(pieces))


def sentence_at(mistake: Mistake, title: str) -> str:
    """Error message at its own field, without the full path."""
    named = name_of(mistake.path)
    text = mistake.message
    if text.startswith(named):
        text = f"“{title}”{text[len(named) :]}"
    return text[:1].upper() + text[1:]
