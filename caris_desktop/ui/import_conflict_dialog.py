"""Import conflict dialog: names in an imported scenario that already exist, with differences and a choice for each."""

import difflib
from collections.abc import Callable
from typing import Any

from PySide6.QtCore import QSize, Qt
from PySide6.QtWidgets import QPlainTextEdit, QWidget

from caris_desktop.domain.intents import SameName
from caris_desktop.domain.schema_paths import differences
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.yaml_source import YamlSourceError, parse_yaml
from caris_desktop.scenario.bundle import NAME, ImportQuestion, NameConflict
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui import layouts
from caris_desktop.ui.form_dialog import FormDialog, lay_out_form
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import list_area
from caris_desktop.ui.widgets.inputs import DropDown
from caris_desktop.ui.widgets.labels import label, line_edit

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
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self._decide = decide
        heading = tr("Some names in {file} already exist").format(file=question.path.name)
        hint = tr("Nothing has been changed yet. Replaced files are set aside, not deleted.")
        self._refusal = label(tone="amber", wraps=True, objectName="same_names_refusal")
        self._import = ActionButton(
            theme, tr("Import"), role="primary", height_px=40, objectName="same_names_import", clicked=self._on_import
        )
        self.parts = [_Part(theme, conflict, self._check) for conflict in question.conflicts]
        holder = QWidget()
        layouts.vbox(holder, *self.parts, 1, margins_px=(0, 0, 8, 0), spacing_px=16)
        cancel = ActionButton(theme, tr("Cancel"), height_px=40, objectName="same_names_cancel", clicked=self.reject)
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
        self.differences = QPlainTextEdit(readOnly=True)
        self.differences.setObjectName(f"differences_{kind}")
        self.differences.setAccessibleName(tr("Differences between the imported and the existing version"))
        self.differences.setMinimumHeight(180)
        self.differences.hide()
        named = layouts.hbox(None, (self.choice, 1), (self.name, 1), spacing_px=8)
        column = layouts.vbox(self, question, named, margins_px=0, spacing_px=6)
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
