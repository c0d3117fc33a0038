"""Saving of the edited scenario, with conflict handling when the file was changed elsewhere."""

from functools import partial
from pathlib import Path
from typing import Protocol

from PySide6.QtCore import QObject

from caris_desktop.domain import intents
from caris_desktop.domain.key_path import KeyPath
from caris_desktop.domain.translation import tr
from caris_desktop.domain.yaml_source import YamlSourceError
from caris_desktop.live.status import IN_SESSION, SavedScenario
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.document import ScenarioDocument
from caris_desktop.scenario.scenario_library import own_file, own_file_called
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui.background_reading import read_for
from caris_desktop.ui.scenario_editor.compare_page import ComparePage
from caris_desktop.ui.scenario_editor.editing_context import Editing
from caris_desktop.ui.scenario_editor.editor_notice import Notice
from caris_desktop.ui.scenario_editor.opened_scenario import Opened, reopened
from caris_desktop.ui.scenario_editor.text_page import TextPage

_TITLE: KeyPath = ("title",)


class Edits(Protocol):
    """The part of the editor window that saving needs."""

    editing: Editing
    notice: Notice
    text_page: TextPage
    compare_page: ComparePage

    @property
    def document(self) -> ScenarioDocument: ...
    @property
    def unsaved(self) -> bool: ...
    def show_mistake(self, number: int) -> None: ...
    def ask_for_name(self) -> None: ...
    def leave_name(self) -> None: ...
    def close(self) -> bool: ...


class Saving(QObject):
    """Saving for one ``editor``, owned by ``parent``. ``opened``: the file from which the document was made; any other
    contents are not overwritten without a question.
    """

    def __init__(self, editor: Edits, console: WizardConsole, opened: Opened, parent: QObject) -> None:
        super().__init__(parent)
        self._editor = editor
        self._console = console
        self._opened = opened
        self._to: Path | None = None
        self._sent = self._title = ""
        self._close_when_saved = False
        self._changed_elsewhere = False
        console.state.saved_scenario.changed.connect(self._on_saved)
        console.state.scenario.changed.connect(self._on_scenario_in_force)

    def save(self) -> None:
        """Save to the scenario's own file, or to the user's copy of a shipped one."""
        if self._editor.unsaved:
            target = own_file(self._editor.document.path)
            self._save_to(target, self._opened.sha256 if target == self._opened.path else "")

    def save_and_close(self) -> None:
        self._close_when_saved = True
        self.save()

    def save_as(self, title: str) -> None:
        """Save under another title, in a new file among the user's scenarios."""
        self._save_to(own_file_called(title), "", title)

    def _save_to(self, path: Path, replaces: str, title: str = "") -> None:
        """Save, optionally with a new ``title``, which the document gets once the file is written."""
        editor = self._editor
        if self._to is not None:
            return
        editor.text_page.flush()
        editor.document.pause()
        if editor.document.mistakes:
            self._close_when_saved = False
            said = tr("Nothing was saved. Errors to correct first: %n", "", len(editor.document.mistakes))
            editor.notice.say("refused", said, "red", (tr("Show the first"), lambda: editor.show_mistake(0)))
            editor.show_mistake(0)
            return
        sent = ScenarioDocument(editor.document.text, editor.document.path)
        if title:
            sent.set(_TITLE, title)
        if sent.mistakes:
            editor.notice.say("name", as_sentence(sent.mistakes[0].message), "amber")
            return
        self._to, self._sent, self._title = path, sent.text, title
        refused = self._console.do(intents.SaveScenario(self._sent, path, editor.document.path, replaces))
        if refused:
            self._on_saved(SavedScenario(path, problem=refused))

    def _on_saved(self, saved: SavedScenario | None) -> None:
        if saved is None or saved.path != self._to:
            return
        editor, self._to = self._editor, None
        self._changed_elsewhere &= bool(saved.problem)
        if saved.problem:
            self._on_not_saved(saved)
            return
        self._opened = Opened(saved.path, saved.text, saved.sha256)
        if self._title:
            editor.document.pause()
            editor.document.set(_TITLE, self._title)
        editor.document.note_saved(self._sent, saved.text, saved.path)
        editor.leave_name()
        editor.editing.emit_changes(reshaped=True)
        editor.compare_page.offer_again()
        said = tr("Saved in {file}.")
        if self._title and self._console.state.recording.value.state in IN_SESSION:
            said = tr("Saved in {file}. The recording continues with its current scenario; open this one afterwards.")
        editor.notice.say("saved", said.format(file=saved.path), "green")
        if self._close_when_saved and not editor.document.changed:
            editor.close()
        self._close_when_saved = False

    def _on_not_saved(self, saved: SavedScenario) -> None:
        editor, self._close_when_saved = self._editor, False
        if saved.taken and saved.path == self._opened.path:
            read_for(self, self._console, partial(reopened, saved.path, self._opened), self._on_other_file)
            return
        if self._changed_elsewhere:
            self._on_scenario_in_force(self._console.scenario)
        if saved.taken:
            editor.ask_for_name()
            said = tr("“{file}” already contains a scenario and was not changed. Choose another title.")
            editor.notice.say("name", said.format(file=saved.path.name), "amber")
            return
        said = tr("Not saved: {reason} Your changes are still here.").format(reason=saved.problem)
        editor.notice.say("saving", said, "red", (tr("Save as…"), editor.ask_for_name))

    def _on_other_file(self, found: Opened | str | None) -> None:
        """Handle a conflict: the file has changed meanwhile and may be unreadable."""
        notice, reason = self._editor.notice, found if isinstance(found, str) else ""
        if isinstance(found, Opened):
            try:
                kept = self._rebase(found)
            except ValueError as error:
                reason = _error_text(error)
            else:
                said = tr(
                    "Not saved yet: the file was changed elsewhere and has been reloaded. It includes your "
                        "own changes: %n. Check them on the right, then save again.", "", kept,
                )  # fmt: skip
                notice.say("meanwhile", said, "amber")
                return
        said = tr(
            "Not saved: the file was changed elsewhere and cannot be read: {reason} Your changes are still "
            "here. Save again once the file is valid, or choose:"
        ).format(reason=as_sentence(reason))
        answers = [(tr("Save as…"), self._editor.ask_for_name)]
        if isinstance(found, Opened):
            answers.insert(0, (tr("Overwrite"), partial(self._write_over, found)))
        notice.say("saving", said, "red", *answers)

    def _write_over(self, broken: Opened) -> None:
        self._editor.notice.take_back("saving")
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
        notice, broken = self._editor.notice, tr("The file has changed and cannot be read: {reason}")
        if isinstance(found, str):
            notice.say("meanwhile", broken.format(reason=found), "red")
            return
        try:
            kept = self._rebase(found)
        except ValueError as error:
            notice.say("meanwhile", broken.format(reason=_error_text(error)), "red")
            return
        said = tr("The file was changed elsewhere and has been reloaded.")
        if kept:
            said = tr(
                "The file was changed elsewhere and has been reloaded. It includes your own changes: %n", "", kept
            )
        notice.say("meanwhile", said, "blue")

    def _rebase(self, found: Opened) -> int:
        """Rebase the edits onto the file's current contents; returns how many remain. Raises ValueError."""
        kept = self._editor.document.rebase(found.text)
        self._opened = found
        self._editor.editing.emit_changes(reshaped=True)
        self._editor.compare_page.offer_again()
        return len(kept)


def _error_text(error: ValueError) -> str:
    if isinstance(error, YamlSourceError):
        return tr("line {line}: {message}").format(line=error.line, message=error)
    return str(error)


def as_sentence(text: str) -> str:
    return text if text.endswith(".") else f"{text}."
