"""Import and export of scenarios as one file: file dialogs, and the questions about references to other files and about
names that already exist. The console does the work.
"""

import difflib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from PySide6.QtCore import QSize, Qt
from PySide6.QtWidgets import QDialog, QFileDialog, QGridLayout, QPlainTextEdit, QScrollArea, QVBoxLayout, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.foreign_text import printable
from caris_desktop.domain.intents import SameName
from caris_desktop.domain.schema_paths import differences
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.yaml_files import YamlSourceError, parse_yaml
from caris_desktop.live.confirmed_files import KIND_TITLES, FileQuestion, FileReference
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.bundle import NAME, SUFFIX, ImportQuestion, NameConflict, bundle_name
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui import layouts
from caris_desktop.ui.form_dialog import FormDialog, file_dialog, lay_out_form, resize_to
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import list_area
from caris_desktop.ui.widgets.inputs import DropDown
from caris_desktop.ui.widgets.labels import label, line_edit, named


class ScenarioFiles:
    """Import, export and their questions in non-modal dialogs."""

    def __init__(self, console: WizardConsole, window: QWidget, theme: Theme) -> None:
        self._console = console
        self._window = window
        self._theme = theme
        self._shown_question: QDialog | None = None
        console.state.import_question.changed.connect(self._ask)
        console.state.file_question.changed.connect(self._ask_to_confirm)

    def choose_import(self) -> None:
        self._dialog(tr("Import a scenario"), lambda path: self._console.do(intents.ImportScenario(path))).show()

    def _ask(self, question: ImportQuestion | None) -> None:
        """Ask about name conflicts. Cancel changes nothing."""
        if question is None:
            return

        def decide(decided: tuple[intents.SameName, ...]) -> None:
            self._console.do(intents.ImportScenario(question.path, decided))

        ImportConflictDialog(self._theme, self._window, question, decide).show()

    def _ask_to_confirm(self, question: FileQuestion | None) -> None:
        """List the references of a file. Nothing in the file is used before a yes; closing the dialog means no."""
        if self._shown_question is not None:
            previous, self._shown_question = self._shown_question, None
            previous.close()
        if question is None:
            return

        def answer(accepted: bool) -> None:
            self._shown_question = None
            self._console.do(intents.ConfirmFile(question.sha256, accepted))
            if accepted:
                self._console.do(question.then)

        dialog = self._shown_question = ConfirmFileDialog(self._theme, self._window, question)
        dialog.finished.connect(lambda result: answer(result == QDialog.DialogCode.Accepted))
        dialog.show()

    def choose_share(self) -> None:
        scenario = self._console.scenario
        stem = bundle_name(scenario.path.stem if scenario.path is not None else scenario.title)
        title = tr("Export this scenario as one file")
        share, mode = (lambda path: self._console.do(intents.ShareScenario(path))), QFileDialog.FileMode.AnyFile
        dialog = self._dialog(title, share, mode)
        dialog.setAcceptMode(QFileDialog.AcceptMode.AcceptSave)
        dialog.setDefaultSuffix(SUFFIX.removeprefix("."))
        dialog.selectFile(f"{stem}{SUFFIX}")
        dialog.show()

    def _dialog(
        self, title: str, do: Callable[[Path], object], mode: QFileDialog.FileMode = QFileDialog.FileMode.ExistingFile
    ) -> QFileDialog:
        files = tr("Scenarios ({files})").format(files=f"*{SUFFIX}")
        return file_dialog(self._window, "scenario_file_dialog", title, do, files=files, mode=mode)


_SELECTABLE = Qt.TextInteractionFlag.TextSelectableByMouse


class ConfirmFileDialog(FormDialog):
    """Non-modal dialog: the robot can be driven and stopped meanwhile. Cancel has the focus, so Enter means no."""

    def __init__(self, theme: Theme, parent: QWidget, question: FileQuestion) -> None:
        super().__init__(theme, parent, "confirm_file_dialog", tr("Confirm before use"))
        heading = (
            tr("“{title}” has changed. May it use this?") if question.is_changed else tr("May “{title}” use this?")
        )
        hint = tr(
            "Nothing in the file is used until you allow it. You will be asked again if the file refers to something "
            "new."
        )
        cancel = self.button("confirm_file_cancel", tr("Do not allow"), self.reject, height_px=40)
        allow = self.button("confirm_file_allow", tr("Allow all"), self.accept, height_px=40)
        lay_out_form(
            self,
            label(heading.format(title=printable(question.title)), "heading", wraps=True),
            label(_broken(str(question.path)), tone="dim", wraps=True, textInteractionFlags=_SELECTABLE),
            label(hint, wraps=True),
            (self._list(question), 1),
            buttons=(1, cancel, allow),
            scrolls=False,
        )
        cancel.setFocus()
        resize_to(self, QSize(860, 720))

    def _list(self, question: FileQuestion) -> QScrollArea:
        """List of references, unconfirmed ones first."""
        holder = QWidget()
        column = layouts.vbox(holder, margins_px=(0, 4, 8, 4), spacing_px=10)
        new = [one for one in question.named if one not in question.known]
        if question.is_changed:
            column.addWidget(label(tr("New in this file"), tone="amber", wraps=True))
        self._add_groups(column, new)
        if question.is_changed and len(new) < len(question.named):
            column.addWidget(label(tr("Confirmed before"), tone="dim", wraps=True))
            self._add_groups(column, [one for one in question.named if one in question.known])
        column.addStretch(1)
        scroll = list_area(holder, framed=False)
        scroll.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        scroll.setObjectName("confirm_file_list")
        scroll.setAccessibleName(tr("Items the file refers to"))
        return scroll

    def _add_groups(self, column: QVBoxLayout, references: list[FileReference]) -> None:
        for kind, title in KIND_TITLES.items():
            of_kind = [one for one in references if one.kind == kind]
            if of_kind:
                column.addWidget(self._group(tr(title), of_kind))

    def _group(self, title: str, references: list[FileReference]) -> QWidget:
        group = QWidget()
        grid = QGridLayout(group)
        grid.setHorizontalSpacing(16)
        grid.setVerticalSpacing(2)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setColumnStretch(0, 3)
        grid.setColumnStretch(1, 2)
        grid.addWidget(label(title, "title", wraps=True), 0, 0, 1, 2)
        for row, reference in enumerate(references, start=1):
            names = label(
                _broken(reference.text), wraps=True, objectName="confirm_file_named", textInteractionFlags=_SELECTABLE
            )
            grid.addWidget(names, row, 0, 1, 1 if reference.purpose else 2, Qt.AlignmentFlag.AlignTop)
            if reference.purpose:
                purpose = label(reference.purpose, tone="dim", wraps=True)
                grid.addWidget(purpose, row, 1, Qt.AlignmentFlag.AlignTop)
        return group


def _broken(text: str) -> str:
    """Insert zero-width break opportunities into a long address or path."""
    text = printable(text)
    return "\u200b".join(text[start : start + 24] for start in range(0, len(text), 24))


_ASKED = {
    "scenario": QT_TR_NOOP("A scenario called “{name}” already exists with different content."),
    "robot": QT_TR_NOOP("A robot profile called “{name}” already exists with different content."),
    "face": QT_TR_NOOP("A face called “{name}” already exists with different content."),
}
_LONGEST_NAME = 60


class ImportConflictDialog(FormDialog):
    """``decide`` gets the choice for each name."""

    def __init__(
        self, theme: Theme, parent: QWidget, question: ImportQuestion, decide: Callable[[tuple[SameName, ...]], None]
    ) -> None:
        super().__init__(theme, parent, "same_names_dialog", tr("Import a scenario"))
        self._decide = decide
        heading = tr("Some names in {file} already exist").format(file=question.path.name)
        hint = tr("Nothing has been changed yet. Replaced files are set aside, not deleted.")
        self._refusal = label(tone="amber", wraps=True, objectName="same_names_refusal")
        self._import = self.button("same_names_import", tr("Import"), self._on_import, role="primary", height_px=40)
        self.parts = [_Part(theme, conflict, self._check) for conflict in question.conflicts]
        holder = QWidget()
        layouts.vbox(holder, *self.parts, 1, margins_px=(0, 0, 8, 0), spacing_px=16)
        cancel = self.button("same_names_cancel", tr("Cancel"), self.reject, height_px=40)
        lay_out_form(
            self,
            label(heading, "heading"),
            label(hint, tone="dim", wraps=True),
            (list_area(holder, framed=False), 1),
            self._refusal,
            buttons=(1, cancel, self._import),
            scrolls=False,
        )
        self._check()

    def sizeHint(self) -> QSize:
        return QSize(680, 560)

    def _check(self) -> None:
        refusal = next((part.refusal for part in self.parts if part.refusal), "")
        self._refusal.setText(refusal)
        self._refusal.setVisible(bool(refusal))
        self._import.setEnabled(not refusal)

    def _on_import(self) -> None:
        self._decide(tuple(part.chosen for part in self.parts))
        self.accept()


class _Part(QWidget):
    """One conflict: keep both or replace, with the differences."""

    def __init__(self, theme: Theme, conflict: NameConflict, changed: Callable[[], None]) -> None:
        kind, name = conflict.part.kind, conflict.part.name
        super().__init__()
        self.setObjectName(f"same_name_{kind}")
        self._conflict = conflict
        self._changed = changed
        question = label(tr(_ASKED[kind]).format(name=name), "medium", wraps=True)
        self.choice = DropDown(theme, f"same_name_choice_{kind}", tr("How to import {name}").format(name=name))
        self.choice.setSizeAdjustPolicy(DropDown.SizeAdjustPolicy.AdjustToContents)
        self.choice.setMinimumSize(320, 36)
        self.choice.addItem(tr("Keep both; name of the imported one:"), False)
        self.name = line_edit(
            f"new_name_{kind}", tr("New name for {name}").format(name=name), conflict.free, maxLength=_LONGEST_NAME
        )
        self.differs = ActionButton(
            theme, tr("Show differences"), icon="git-diff", height_px=32, objectName=f"what_differs_{kind}",
            clicked=self._show_differences,
        )  # fmt: skip
        self.differences = named(QPlainTextEdit(readOnly=True), f"differences_{kind}")
        self.differences.setAccessibleName(tr("Differences between the imported and the existing version"))
        self.differences.setMinimumHeight(180)
        self.differences.hide()
        names = layouts.hbox(None, (self.choice, 1), (self.name, 1), spacing_px=8)
        column = layouts.vbox(self, question, names, margins_px=0, spacing_px=6)
        if conflict.own:
            self.choice.addItem(tr("Replace the existing one"), True)
        else:
            column.addWidget(label(tr("It comes with the program and cannot be replaced."), tone="dim"))
        column.addWidget(self.differs, 0, Qt.AlignmentFlag.AlignLeft)
        column.addWidget(self.differences)
        self.name.textChanged.connect(self._on_changed)
        self.choice.currentIndexChanged.connect(self._on_changed)

    def _on_changed(self) -> None:
        self.name.setVisible(not self._replaces)
        self._changed()

    @property
    def _replaces(self) -> bool:
        return bool(self.choice.currentData())

    @property
    def chosen(self) -> SameName:
        part = self._conflict.part
        return SameName(part.kind, part.name, "" if self._replaces else self.name.text().strip())

    @property
    def refusal(self) -> str:
        """Reason why the new name is invalid; empty if valid. Whether it is free is checked on import."""
        if self._replaces:
            return ""
        name = self.name.text().strip()
        if not NAME.fullmatch(name):
            return tr("A name consists of letters, digits, - and _, and starts with a letter or digit.")
        if name == self._conflict.part.name:
            return tr("“{name}” already exists: choose another name.").format(name=name)
        return ""

    def _show_differences(self) -> None:
        # Imported late: the first window does not need it.
        from caris_desktop.ui.scenario_editor.preview import difference_words

        there, theirs = self._conflict.text, self._conflict.part.text
        lines = list(
            difflib.unified_diff(
                there.splitlines(), theirs.splitlines(), tr("existing"), tr("imported"), lineterm="", n=2
            )
        )
        if self._conflict.part.kind == "scenario":
            found = differences(Scenario, _data(there), _data(theirs))
            summary = [f"{' › '.join(map(str, each.path))}: {difference_words(each)}" for each in found]
            lines = [*summary, *([""] if summary else []), *lines]
        self.differences.setPlainText("\n".join(lines))
        self.differences.show()
        self.differs.hide()


def _data(text: str) -> dict[str, Any]:
    try:
        data = parse_yaml(text).data
    except YamlSourceError:
        return {}
    return data if isinstance(data, dict) else {}
