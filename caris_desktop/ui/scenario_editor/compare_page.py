"""Comparison with another scenario: differences as text, each applied by a click, and line by line."""

import difflib
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QScrollArea, QSplitter, QWidget

from caris_desktop.domain.schema_paths import Difference, differences
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.domain.yaml_source import YamlSourceError, parse_yaml
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.background_reading import read_for
from caris_desktop.ui.scenario_editor.editing_context import FormContext
from caris_desktop.ui.scenario_editor.groups import drop
from caris_desktop.ui.scenario_editor.preview import difference_words
from caris_desktop.ui.scenario_editor.text_page import CodeEditor
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.drop_down import DropDown

_WIDEST_PX = 900


class Other(Value):
    """Scenario to compare with: ``text`` reads its file."""

    title: str
    text: Callable[[], str]


class ComparePage(QWidget):
    """Comparison page. ``others`` lists candidates whenever the page is opened, the default first; it runs in a
    background thread because it reads files.
    """

    def __init__(self, context: FormContext, console: WizardConsole, others: Callable[[], Sequence[Other]]) -> None:
        super().__init__()
        self._context = context
        self._console = console
        self._editing = context.editing
        self._others = others
        self._offered: list[Other] = []
        self._other_data: dict[str, Any] = {}
        self._other_text = ""
        self.rows: list[QWidget] = []
        label = QLabel(tr("Compare with"))
        self.choice = DropDown(context.theme, "compare_with", tr("Compare with"))
        self.choice.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.choice.setSizeAdjustPolicy(DropDown.SizeAdjustPolicy.AdjustToContents)
        self.choice.activated.connect(self._on_chosen)
        self.summary = QLabel(wordWrap=True)
        self._list = layouts.vbox(spacing_px=6)
        holder = QWidget()
        holder.setMaximumWidth(_WIDEST_PX)
        column = layouts.vbox(holder, margins_px=(0, 0, 8, 0))
        column.addLayout(self._list)
        column.addStretch(1)
        scroll = QScrollArea(widgetResizable=True)
        scroll.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        scroll.setFrameShape(QFrame.Shape.NoFrame)
        scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        scroll.setWidget(holder)
        self.diff = CodeEditor(context, read_only=True)
        self.diff.setObjectName("scenario_diff")
        self.diff.setAccessibleName(tr("Differences line by line"))
        splitter = QSplitter(Qt.Orientation.Vertical, childrenCollapsible=False)
        splitter.addWidget(scroll)
        splitter.addWidget(self.diff)
        splitter.setStretchFactor(0, 3)
        splitter.setStretchFactor(1, 2)
        splitter.setSizes([360, 240])
        head = QHBoxLayout()
        head.addWidget(label)
        head.addWidget(self.choice)
        head.addStretch(1)
        layout = layouts.vbox(self, margins_px=(24, 16, 24, 16), spacing_px=12)
        layout.addLayout(head)
        layout.addWidget(self.summary)
        layout.addWidget(splitter, 1)
        self._editing.changed.connect(self._on_changed)
        context.theme.changed.connect(self._on_changed)

    def showEvent(self, event: Any) -> None:
        super().showEvent(event)
        self.offer_again()
        self.refresh()

    def offer_again(self) -> None:
        """Refresh the candidates."""
        if self.isVisible():
            read_for(self, self._console, self._others, self._offer)

    def _on_changed(self) -> None:
        if self.isVisible():
            self.refresh()

    def _offer(self, others: Sequence[Other]) -> None:
        chosen = self.choice.currentText()
        self._offered = list(others)
        titles = [other.title for other in self._offered]
        self.choice.clear()
        self.choice.addItems(titles)
        self.choice.setCurrentIndex(titles.index(chosen) if chosen in titles else 0)
        self._on_chosen(self.choice.currentIndex())

    def _on_chosen(self, index: int) -> None:
        other = self._offered[index]

        def show(found: tuple[str, dict[str, Any]]) -> None:
            if other in self._offered and self.choice.currentIndex() == self._offered.index(other):
                self._other_text, self._other_data = found
                self.refresh()

        read_for(self, self._console, partial(_said_by, other), show)

    def differences(self) -> list[Difference]:
        return list(differences(Scenario, self._other_data, self._editing.document.data))

    def refresh(self) -> None:
        while self.rows:
            drop(self.rows.pop())
        document, found = self._editing.document, self.differences()
        theme = self._context.theme
        summary = tr("Both are identical.")
        if found:
            summary = tr("Differences: %n. Each line shows the value there → the value here.", "", len(found))
        self.summary.setText(summary)
        self.summary.setFont(theme.font(tokens.BODY_PX))
        for difference in found:
            row = self._row(difference, " › ".join(document.words(difference.path)))
            self.rows.append(row)
            self._list.addWidget(row)
        lines = list(
            difflib.unified_diff(
                self._other_text.splitlines(), document.text.splitlines(),
                self.choice.currentText(), document.path.name, lineterm="", n=2,
            )
        )  # fmt: skip
        self.diff.setVisible(bool(lines))
        self.diff.show_text("\n".join(lines))
        self.diff.mark(
            {number for number, line in enumerate(lines) if line.startswith("+") and number > 1}, set(),
            {number: "" for number, line in enumerate(lines) if line.startswith("-") and number > 1},
        )  # fmt: skip

    def _row(self, difference: Difference, where: str) -> QWidget:
        theme, row = self._context.theme, QWidget()
        texts = layouts.vbox(spacing_px=0)
        title, words = QLabel(where), QLabel(difference_words(difference))
        title.setFont(theme.font(tokens.BODY_PX, tokens.WEIGHT_MEDIUM))
        words.setFont(theme.font(tokens.STATUS_PX))
        words.setWordWrap(True)
        theme.color_text(words, "dim")
        texts.addWidget(title)
        texts.addWidget(words)
        take = ActionButton(theme, tr("Take theirs"), icon="arrow-left", height_px=30)
        take.setObjectName("take_value")
        take.setAccessibleName(tr("Take theirs: {what}").format(what=where))
        take.setEnabled(self._editing.document.unreadable is None)
        take.clicked.connect(lambda: self._take(difference))
        line = layouts.hbox(row, margins_px=(0, 2, 0, 2))
        line.addLayout(texts, 1)
        line.addWidget(take)
        return row

    def _take(self, difference: Difference) -> None:
        self._editing.document.adopt_value(difference.path, self._other_data)
        self._editing.emit_changes(reshaped=True)


def _said_by(other: Other) -> tuple[str, dict[str, Any]]:
    """Text and parsed data of a candidate; empty if unreadable. Reads files."""
    try:
        text = other.text()
        data = parse_yaml(text).data
    except (OSError, UnicodeDecodeError, YamlSourceError):
        return "", {}
    return text, data if isinstance(data, dict) else {}
