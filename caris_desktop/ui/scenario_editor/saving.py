"""Saving in the scenario editor: files as they were read, the document with its undo history, and writing it back."""

import hashlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from PySide6.QtCore import QObject, QSignalBlocker, Qt, Signal
from PySide6.QtGui import QAccessible, QUndoCommand, QUndoStack
from PySide6.QtWidgets import QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.schema_fields import KeyPath
from caris_desktop.domain.schema_paths import Difference
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.domain.yaml_files import YamlSourceError, yaml_text
from caris_desktop.live.status import IN_SESSION, SavedScenario
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.document import ScenarioDocument, Step
from caris_desktop.scenario.scenario_file import own_file, own_file_called, scenario_data
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui import layouts
from caris_desktop.ui.accessibility import announce
from caris_desktop.ui.background_reading import read_for
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.labels import label

_MOST_STEPS = 500
_TITLE: KeyPath = ("title",)


class Opened(Value):
    """File contents, with the checksum that detects changes before saving."""

    path: Path
    text: str
    sha256: str


def opened_file(path: Path) -> Opened:
    """Read a file. Raises OSError, UnicodeDecodeError."""
    raw = path.read_bytes()
    return Opened(path, raw.decode("utf-8-sig"), hashlib.sha256(raw).hexdigest())


def opened_as_form(scenario: Scenario) -> tuple[Opened, str]:
    """File of the scenario; if no form can show it, the scenario in force, with the reason. Reads files."""
    path, problem, sha256 = scenario.path, "", ""
    if path is not None:
        try:
            opened = opened_file(path)
            sha256 = opened.sha256
            ScenarioDocument(opened.text, path)
        except YamlSourceError as error:
            problem = tr("{file}, line {line}: {message}").format(file=path.name, line=error.line, message=error)
        except (OSError, ValueError) as error:
            problem = str(error)
        else:
            return opened, ""
    return Opened(path or own_file(None), yaml_text(scenario_data(scenario)), sha256), problem


def reopened(path: Path, opened: Opened) -> Opened | str | None:
    """Current contents of the file, or why it is unreadable; None if it is not the file of ``opened``. Reads files."""
    try:
        return opened_file(path) if path.resolve() == opened.path.resolve() else None
    except (OSError, ValueError) as error:
        return str(error)


class _Edit(QUndoCommand):
    """Step of the document. Typing at one place merges."""

    def __init__(self, document: "EditedDocument", step: Step) -> None:
        super().__init__(" › ".join(step.words) or tr("the text"))
        self._document = document
        self.step = step

    def id(self) -> int:
        return 1  # Qt merges only commands of one non-negative id

    def mergeWith(self, other: QUndoCommand) -> bool:
        if not isinstance(other, _Edit) or not other.step.continued:
            return False
        self.step = replace(self.step, after=other.step.after)
        return True

    def undo(self) -> None:
        self._document.restore(self.step.before)

    def redo(self) -> None:
        self._document.restore(self.step.after)


class History(QUndoStack):
    """Undo history. ``changed``: the document, its saved version, or the names that it may use have changed;
    ``flush_requested``: what is being typed must reach the document.
    """

    changed = Signal()
    flush_requested = Signal()

    def __init__(self, parent: QObject | None) -> None:
        super().__init__(parent)
        self.setUndoLimit(_MOST_STEPS)
        self.indexChanged.connect(self.changed)


class EditedDocument(ScenarioDocument):
    """Document with an undo history, in the GUI thread. All edits, in the form or as text, are in the one history.
    ``parent`` owns the history, whose steps hold the document.
    """

    def __init__(self, text: str, path: Path, parent: QObject | None = None) -> None:
        super().__init__(text, path)
        self.history = History(parent)

    def _on_step(self, step: Step) -> None:
        self.history.push(_Edit(self, step))

    @property
    def to_undo(self) -> Step | None:
        return self._step_at(self.history.index() - 1)

    @property
    def to_redo(self) -> Step | None:
        return self._step_at(self.history.index())

    def _step_at(self, index: int) -> Step | None:
        command = self.history.command(index)
        return command.step if isinstance(command, _Edit) else None

    def undo(self) -> Step | None:
        step = self.to_undo
        self.history.undo()
        return step

    def redo(self) -> Step | None:
        step = self.to_redo
        self.history.redo()
        return step

    def rebase(self, text: str) -> tuple[Difference, ...]:
        with QSignalBlocker(self.history):  # one change for those who show it
            own_changes = super().rebase(text)
        self.history.changed.emit()
        return own_changes


Answer = tuple[str, Callable[[], object]]


class Notice(QWidget):
    """Message line above the form, with buttons to answer it. ``topic`` identifies the message for ``take_back``."""

    accessible_role = QAccessible.Role.AlertMessage

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self.setObjectName("editor_notice")
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self._theme = theme
        self._topic = ""
        self.text = label(wraps=True, objectName="editor_notice_text")
        self.answers: list[ActionButton] = []
        self._row = layouts.hbox(self, (self.text, 1), margins_px=(26, 8, 18, 8), spacing_px=8)
        self.hide()

    def say(self, topic: str, text: str, role: str, *answers: Answer) -> None:
        """Replace the message; ``role`` is its colour."""
        if (topic, text) == (self._topic, self.text.text()) and self.isVisible():
            return
        self._topic = topic
        self.setProperty("role", role)
        self.style().polish(self)
        self.text.setText(text)
        self.setAccessibleName(text)
        for button in self.answers:
            layouts.discard(button)
        self.answers = []
        for words, do in answers or ((tr("Dismiss"), partial(self.take_back, topic)),):
            button = ActionButton(self._theme, words, height_px=30, clicked=lambda _checked=False, do=do: do())
            self._row.addWidget(button)
            self.answers.append(button)
        self.show()
        announce(self, text)

    def take_back(self, topic: str) -> None:
        if topic == self._topic:
            self._topic = ""
            self.hide()


class Saving(QObject):
    """Saving of ``document``, made from the file ``opened``; any other contents are not overwritten without a question.

    ``title_requested``: a title for a new file is needed. ``refused``: there are errors. ``version_changed``: the saved
    version is another. ``finished``: the editor may close.
    """

    title_requested = Signal()
    refused = Signal()
    saved = Signal()
    version_changed = Signal()
    finished = Signal()

    def __init__(
        self, console: WizardConsole, document: EditedDocument, notice: Notice, opened: Opened, parent: QObject
    ) -> None:
        super().__init__(parent)
        self._console = console
        self._document = document
        self._notice = notice
        self._opened = opened
        self._to: Path | None = None
        self._sent = self._title = ""
        self._close_when_saved = False
        self._changed_elsewhere = False
        console.state.saved_scenario.changed.connect(self._on_saved)
        console.state.scenario.changed.connect(self._on_scenario_in_force)

    def save(self, *, then_close: bool = False) -> None:
        """Save to the scenario's own file, or to the user's copy of a shipped one."""
        self._close_when_saved |= then_close
        self._document.history.flush_requested.emit()
        if self._document.changed:
            target = own_file(self._document.path)
            self._save_to(target, self._opened.sha256 if target == self._opened.path else "")

    def save_as(self, title: str) -> None:
        """Save under another title, in a new file among the user's scenarios."""
        self._save_to(own_file_called(title), "", title)

    def _save_to(self, path: Path, replaces: str, title: str = "") -> None:
        """Save, optionally with a new ``title``, which the document gets once the file is written."""
        document = self._document
        if self._to is not None:
            return
        document.history.flush_requested.emit()
        document.pause()
        if document.mistakes:
            self._close_when_saved = False
            notice = tr("Nothing was saved. Errors to correct first: %n", "", len(document.mistakes))
            self._notice.say("refused", notice, "red", (tr("Show the first"), self.refused.emit))
            self.refused.emit()
            return
        sent = ScenarioDocument(document.text, document.path)
        if title:
            sent.set(_TITLE, title)
        if sent.mistakes:
            self._notice.say("name", as_sentence(sent.mistakes[0].message), "amber")
            return
        self._to, self._sent, self._title = path, sent.text, title
        refused = self._console.do(intents.SaveScenario(self._sent, path, document.path, replaces))
        if refused:
            self._on_saved(SavedScenario(path, problem=refused))

    def _on_saved(self, saved: SavedScenario | None) -> None:
        if saved is None or saved.path != self._to:
            return
        document, self._to = self._document, None
        self._changed_elsewhere &= bool(saved.problem)
        if saved.problem:
            self._on_not_saved(saved)
            return
        self._opened = Opened(saved.path, saved.text, saved.sha256)
        if self._title:
            document.replace(_TITLE, self._title)
        document.note_saved(self._sent, saved.text, saved.path)
        document.history.changed.emit()
        self.saved.emit()
        self.version_changed.emit()
        notice = tr("Saved in {file}.")
        if self._title and self._console.state.recording.value.state in IN_SESSION:
            notice = tr("Saved in {file}. The recording continues with its current scenario; open this one afterwards.")
        self._notice.say("saved", notice.format(file=saved.path), "green")
        if self._close_when_saved and not document.changed:
            self.finished.emit()
        self._close_when_saved = False

    def _on_not_saved(self, saved: SavedScenario) -> None:
        self._close_when_saved = False
        if saved.taken and saved.path == self._opened.path:
            read_for(self, self._console, partial(reopened, saved.path, self._opened), self._on_other_file)
            return
        if self._changed_elsewhere:
            self._on_scenario_in_force(self._console.scenario)
        if saved.taken:
            self.title_requested.emit()
            notice = tr("“{file}” already contains a scenario and was not changed. Choose another title.")
            self._notice.say("name", notice.format(file=saved.path.name), "amber")
            return
        notice = tr("Not saved: {reason} Your changes are still here.").format(reason=saved.problem)
        self._notice.say("saving", notice, "red", (tr("Save as…"), self.title_requested.emit))

    def _on_other_file(self, found: Opened | str | None) -> None:
        """Handle a conflict: the file has changed meanwhile and may be unreadable."""
        own_changes, reason = self._rebase(found)
        if isinstance(found, Opened) and not reason:
            message = tr(
                "Not saved yet: the file was changed elsewhere and has been reloaded. It includes your "
                    "own changes: %n. Check them on the right, then save again.", "", own_changes,
            )  # fmt: skip
            self._notice.say("meanwhile", message, "amber")
            return
        message = tr(
            "Not saved: the file was changed elsewhere and cannot be read: {reason} Your changes are still "
            "here. Save again once the file is valid, or choose:"
        ).format(reason=as_sentence(reason))
        answers: list[Answer] = [(tr("Save as…"), self.title_requested.emit)]
        if isinstance(found, Opened):
            answers.insert(0, (tr("Overwrite"), partial(self._write_over, found)))
        self._notice.say("saving", message, "red", *answers)

    def _write_over(self, broken: Opened) -> None:
        self._notice.take_back("saving")
        self._save_to(broken.path, broken.sha256)

    # ---- changes from elsewhere

    def _on_scenario_in_force(self, scenario: Scenario | None) -> None:
        """Merge what the console itself wrote to the file meanwhile, for example a place."""
        if scenario is None or scenario.path is None or self._to is not None:
            return
        if scenario.sha256 != self._opened.sha256:
            read_for(self, self._console, partial(reopened, scenario.path, self._opened), self._on_reread)

    def _on_reread(self, found: Opened | str | None) -> None:
        self._changed_elsewhere = found is not None and self._to is not None
        if found is None or self._changed_elsewhere:
            return
        own_changes, reason = self._rebase(found)
        message = tr("The file was changed elsewhere and has been reloaded.")
        if reason:
            message = tr("The file has changed and cannot be read: {reason}").format(reason=reason)
        elif own_changes:
            message = tr(
                "The file was changed elsewhere and has been reloaded. It includes your own changes: %n",
                "",
                own_changes,
            )
        self._notice.say("meanwhile", message, "red" if reason else "blue")

    def _rebase(self, found: Opened | str | None) -> tuple[int, str]:
        """Rebase the edits onto the file's current contents. Returns how many remain, and why not if it cannot be read;
        then nothing has changed.
        """
        if not isinstance(found, Opened):
            return 0, found or ""
        try:
            own_changes = self._document.rebase(found.text)
        except YamlSourceError as error:
            return 0, tr("line {line}: {message}").format(line=error.line, message=error)
        except ValueError as error:
            return 0, str(error)
        self._opened = found
        self.version_changed.emit()
        return len(own_changes), ""


def as_sentence(text: str) -> str:
    return text if text.endswith(".") else f"{text}."
