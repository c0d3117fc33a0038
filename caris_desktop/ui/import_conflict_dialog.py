"""Import conflict dialog: names in an imported scenario that already exist, with differences and a choice for each."""

import difflib
from collections.abc import Callable
from typing import Any

from PySide6.QtCore import QSize, Qt
from PySide6.QtWidgets import QDialog, QLabel, QLineEdit, QPlainTextEdit, QScrollArea, QWidget

from caris_desktop.domain.intents import SameName
from caris_desktop.domain.schema_paths import differences
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.yaml_source import YamlSourceError, parse_yaml
from caris_desktop.scenario.bundle import NAME, ImportQuestion, NameConflict
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.tab_order import VisualTabOrderMixin
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.drop_down import DropDown

_ASKED = {
    "scenario": QT_TR_NOOP("A scenario called “{name}” already exists with different content."),
    "robot": QT_TR_NOOP("A robot profile called “{name}” already exists with different content."),
    "face": QT_TR_NOOP("A face called “{name}” already exists with different content."),
}
_LONGEST_NAME = 60


class ImportConflictDialog(VisualTabOrderMixin, QDialog):
    """Non-modal: the robot can be driven and stopped meanwhile. ``decide`` gets the choice for each name."""

    def __init__(
        self, theme: Theme, parent: QWidget, question: ImportQuestion, decide: Callable[[tuple[SameName, ...]], None]
    ) -> None:
        super().__init__(parent)
        self.setObjectName("same_names_dialog")
        self.setWindowTitle(tr("Import a scenario"))
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self._decide = decide
        heading = QLabel(tr("Some names in {file} already exist").format(file=question.path.name))
        heading.setFont(theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        hint = QLabel(tr("Nothing has been changed yet. Replaced files are set aside, not deleted."), wordWrap=True)
        self._refusal = QLabel(wordWrap=True)
        self._refusal.setObjectName("same_names_refusal")
        holder = QWidget()
        column = layouts.vbox(holder, margins_px=(0, 0, 8, 0), spacing_px=16)
        self.parts = [_Part(theme, conflict, self._check) for conflict in question.conflicts]
        for part in self.parts:
            column.addWidget(part)
        column.addStretch(1)
        scroll = QScrollArea(widgetResizable=True)
        scroll.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        scroll.setFrameShape(QScrollArea.Shape.NoFrame)
        scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        scroll.setWidget(holder)
        cancel = ActionButton(theme, tr("Cancel"), height_px=40)
        cancel.setObjectName("same_names_cancel")
        cancel.clicked.connect(self.reject)
        self._import = ActionButton(theme, tr("Import"), role="primary", height_px=40)
        self._import.setObjectName("same_names_import")
        self._import.clicked.connect(self._on_import)
        buttons = layouts.hbox()
        buttons.addStretch(1)
        buttons.addWidget(cancel)
        buttons.addWidget(self._import)
        layout = layouts.vbox(self, margins_px=(24, 20, 24, 20), spacing_px=12)
        layout.addWidget(heading)
        layout.addWidget(hint)
        layout.addWidget(scroll, 1)
        layout.addWidget(self._refusal)
        layout.addLayout(buttons)
        theme.color_text(hint, "dim")
        theme.color_text(self._refusal, "amber")
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
        question = QLabel(tr(_ASKED[kind]).format(name=name), wordWrap=True)
        question.setFont(theme.font(tokens.BODY_PX, tokens.WEIGHT_MEDIUM))
        self.choice = DropDown(theme, f"same_name_choice_{kind}", tr("How to import {name}").format(name=name))
        self.choice.setSizeAdjustPolicy(DropDown.SizeAdjustPolicy.AdjustToContents)
        self.choice.setMinimumSize(320, 36)
        self.choice.addItem(tr("Keep both; name of the imported one:"), False)
        self.name = QLineEdit(conflict.free, maxLength=_LONGEST_NAME)
        self.name.setObjectName(f"new_name_{kind}")
        self.name.setAccessibleName(tr("New name for {name}").format(name=name))
        self.name.setMinimumHeight(36)
        self.differs = ActionButton(theme, tr("Show differences"), icon="git-diff", height_px=32)
        self.differs.setObjectName(f"what_differs_{kind}")
        self.differs.clicked.connect(self._show_differences)
        self.differences = QPlainTextEdit(readOnly=True)
        self.differences.setObjectName(f"differences_{kind}")
        self.differences.setAccessibleName(tr("Differences between the imported and the existing version"))
        self.differences.setMinimumHeight(180)
        self.differences.hide()
        named = layouts.hbox(spacing_px=8)
        named.addWidget(self.choice, 1)
        named.addWidget(self.name, 1)
        column = layouts.vbox(self, margins_px=0, spacing_px=6)
        column.addWidget(question)
        column.addLayout(named)
        if conflict.own:
            self.choice.addItem(tr("Replace the existing one"), True)
        else:
            shipped = QLabel(tr("It comes with the program and cannot be replaced."))
            theme.color_text(shipped, "dim")
            column.addWidget(shipped)
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
