"""Pages of the scenario editor: sections of the form, text of the file, and comparison with other scenarios."""

import difflib
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from PySide6.QtCore import QRect, QSignalBlocker, Qt, QTimer
from PySide6.QtGui import (
    QFont,
    QFontDatabase,
    QHideEvent,
    QPainter,
    QPaintEvent,
    QResizeEvent,
    QShowEvent,
    QTextCursor,
    QTextFormat,
)
from PySide6.QtWidgets import QFrame, QLabel, QPlainTextEdit, QScrollArea, QSplitter, QTextEdit, QVBoxLayout, QWidget

from caris_desktop.domain.schema_fields import Key, KeyPath, keys_of
from caris_desktop.domain.schema_paths import Difference, differences, title_of, value_at
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.domain.yaml_files import YamlSourceError, parse_yaml
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.background_reading import read_for
from caris_desktop.ui.scenario_editor.form import FormContext, FormPart, drop, part_for, show_at_once
from caris_desktop.ui.scenario_editor.preview import difference_words
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import list_area
from caris_desktop.ui.widgets.inputs import DropDown
from caris_desktop.ui.widgets.labels import named

_WIDEST_PX, _LEAST_WORDS_PX, _SIDE_PX = 900, 200, 24
_TYPING_PAUSE_MS = 200
_ONE_STEP_S = 1.5

_SECTIONS: dict[str, tuple[str, str]] = {
    QT_TR_NOOP("About"): ("info", QT_TR_NOOP("Title and purpose of this scenario.")),
    QT_TR_NOOP("Phrases"): (
        "chat-text",
        QT_TR_NOOP(
            "Phrases that the robot says at the press of a key. F10 selects the next group and puts its "
            "phrases on F1 to F8. {name} stands for the person addressed, {place} for the robot's goal or "
            "current place; the wizard is asked for other words in braces."
        ),
    ),
    QT_TR_NOOP("Protocol"): (
        "list-numbers",
        QT_TR_NOOP("The steps of the study, in order. The wizard sees the current step above the panels."),
    ),
    QT_TR_NOOP("Places"): (
        "map-pin",
        QT_TR_NOOP(
            "Places that the robot can be sent to by name. Drive the robot there, then use its current position."
        ),
    ),
    QT_TR_NOOP("What is allowed"): (
        "shield-check",
        QT_TR_NOOP(
            "A permission that is off has no button and no key in this scenario. The preview shows what changes."
        ),
    ),
    QT_TR_NOOP("Assistant"): (
        "sparkle",
        QT_TR_NOOP("The language model: its instructions and its level of automation."),
    ),
    QT_TR_NOOP("Robot and cameras"): ("robot", QT_TR_NOOP("Robot, speed limits and cameras.")),
    QT_TR_NOOP("Voice and sound"): ("speaker-high", QT_TR_NOOP("Who speaks, and which microphones are used.")),
    QT_TR_NOOP("Listening"): ("ear", QT_TR_NOOP("Transcription of speech near the robot.")),
    QT_TR_NOOP("People"): ("users", QT_TR_NOOP("How people are detected and recognised, and who is blurred.")),
    QT_TR_NOOP("Recording"): ("record", QT_TR_NOOP("Recording settings of this scenario.")),
    QT_TR_NOOP("Panels"): (
        "layout",
        QT_TR_NOOP(
            "Positions of the panels. It is easier to move them in the main window and save that as the layout."
        ),
    ),
}
"""Sections of the form in order: icon and explanation."""


class Section(Value):
    """Section of the form: ``words`` explain it, ``keys`` are its keys of the file."""

    title: str
    icon: str
    words: str
    keys: tuple[Key, ...]


def sections() -> tuple[Section, ...]:
    """Sections from the schema: a key with a new or no section is put at the end."""
    found: dict[str, list[Key]] = {title: [] for title in _SECTIONS}
    for key in keys_of(Scenario):
        if len(key.form.choices) != 1:
            found.setdefault(key.form.rule.section or title_of(key), []).append(key)
    return tuple(
        Section(title, *_SECTIONS.get(title, ("sliders", "")), tuple(keys)) for title, keys in found.items() if keys
    )


class SectionPage(QScrollArea):
    """Form page of one section, built when first shown; refreshes only while visible."""

    def __init__(self, context: FormContext, section: Section) -> None:
        super().__init__()
        self.section = section
        self._context = context
        self.parts: list[FormPart] = []
        self._column: QVBoxLayout | None = None
        self._stale = False
        self._next = QTimer(self, singleShot=True, interval=0)
        self._next.timeout.connect(self._make_next)
        self.setObjectName("section_page")
        context.document.history.changed.connect(self._on_changed)

    def build(self) -> None:
        """Create all fields now."""
        self._begin()
        while len(self.parts) < len(self.section.keys):
            self._make_next()
        if self._stale:
            self.refresh()

    def _begin(self) -> None:
        """Create the head: not in the constructor, since each move of a new page into its parents styles it again."""
        if self._column is not None:
            return
        holder = named(QWidget(), "section_holder")
        self._column = layouts.vbox(holder, margins_px=(_SIDE_PX, 16, _SIDE_PX, 24), spacing_px=20)
        words = QLabel(tr(self.section.words), wordWrap=True, textFormat=Qt.TextFormat.PlainText)
        self._words = named(words, "page_words")
        self._column.addWidget(named(QLabel(tr(self.section.title)), "page_title"))
        if self.section.words:
            self._column.addWidget(words)
        self._column.addStretch(1)
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setWidget(holder)
        self._fit_words()

    def _make_next(self) -> None:
        """Create one field per event loop turn, so that keys are still handled."""
        if len(self.parts) == len(self.section.keys) or self._column is None:
            return
        key = self.section.keys[len(self.parts)]
        part = part_for(self._context, (key.name,), key)
        part.setMaximumWidth(_WIDEST_PX)
        self.parts.append(part)
        self._column.insertWidget(self._column.count() - 1, part)
        show_at_once(part)
        part.refresh()
        if len(self.parts) < len(self.section.keys):
            self._next.start()

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        if self._column is not None:
            self._fit_words()

    def _fit_words(self) -> None:
        """Fit the explanation to the visible width, however wide the lists are."""
        room_px = max(_LEAST_WORDS_PX, self.viewport().width() - 2 * _SIDE_PX)
        self._words.setMaximumWidth(room_px)
        self._words.setMinimumHeight(self._words.heightForWidth(room_px))

    def refresh(self) -> None:
        self._stale = False
        for part in self.parts:
            part.refresh()
        self.setEnabled(self._context.document.unreadable is None)

    def _on_changed(self) -> None:
        self._stale = True
        if self.isVisible():
            self.refresh()

    def showEvent(self, event: QShowEvent) -> None:
        self._begin()
        self._next.start()
        if self._stale:
            self.refresh()
        super().showEvent(event)

    def reveal(self, path: KeyPath) -> FormPart | None:
        """Part of a path, or of the closest enclosing one, scrolled to and focused."""
        self.build()
        part = next((part for part in self.parts if part.path == path[:1]), None)
        found = (part.reveal(path[:cut]) for cut in range(len(path), 0, -1) if part is not None)
        revealed = next((each for each in found if each is not None), None)
        if revealed is not None:
            self.ensureWidgetVisible(revealed)
            revealed.setFocus(Qt.FocusReason.OtherFocusReason)
        return revealed


def changed_lines(before: str, after: str) -> tuple[set[int], set[int]]:
    """Changed or new lines of ``after``, and lines that follow a deletion; counted from 0."""
    matcher = difflib.SequenceMatcher(None, before.splitlines(), after.splitlines(), autojunk=False)
    blocks = [(tag, start, end) for tag, _from, _to, start, end in matcher.get_opcodes()]
    changed = {line for tag, start, end in blocks if tag != "equal" for line in range(start, end)}
    return changed, {start for tag, start, _end in blocks if tag == "delete"}


class TextPage(QWidget):
    """YAML text of the file with highlighted changes; edits apply to the form at once. ``flush`` applies pending
    typing.
    """

    def __init__(self, context: FormContext) -> None:
        super().__init__()
        self._document = context.document
        self.editor = CodeEditor(context, "scenario_text", tr("The text of the scenario file"))
        layouts.vbox(self, self.editor, margins_px=12)
        self._typing = QTimer(self, singleShot=True, interval=_TYPING_PAUSE_MS)
        self._typing.timeout.connect(self._apply)
        self._applied_s = 0.0
        self.editor.textChanged.connect(self._typing.start)
        self._document.history.flush_requested.connect(self.flush)
        self._document.history.changed.connect(self._on_changed)
        context.theme.changed.connect(self._on_changed)

    def flush(self) -> None:
        if self._typing.isActive():
            self._typing.stop()
            self._apply()

    def _apply(self) -> None:
        document, typed = self._document, self.editor.toPlainText()
        if "\r\n" in document.text:
            typed = typed.replace("\n", "\r\n")
        if typed != document.text:
            now_s = time.monotonic()
            if now_s - self._applied_s > _ONE_STEP_S:
                document.pause()
            self._applied_s = now_s
            document.set_text(typed)

    def _on_changed(self) -> None:
        if self.isVisible():
            self._show()

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        self._show()

    def hideEvent(self, event: QHideEvent) -> None:
        self.flush()
        super().hideEvent(event)

    def _show(self) -> None:
        document = self._document
        text = document.text.replace("\r\n", "\n")
        if text != self.editor.toPlainText():
            self.editor.show_text(text)
            self._typing.stop()
        changed, deletions = changed_lines(document.saved_text, document.text)
        self.editor.mark(changed, deletions, {mistake.line - 1 for mistake in document.mistakes})

    def show_line(self, line: int) -> None:
        """Scroll to a line, counted from 1."""
        block = self.editor.document().findBlockByNumber(max(0, line - 1))
        self.editor.setTextCursor(QTextCursor(block))
        self.editor.centerCursor()
        self.editor.setFocus(Qt.FocusReason.OtherFocusReason)


class CodeEditor(QPlainTextEdit):
    """Plain text editor with line numbers. Tab moves on, and undo is the document's."""

    def __init__(self, context: FormContext, name: str, title: str, *, read_only: bool = False) -> None:
        super().__init__(
            readOnly=read_only, tabChangesFocus=True, undoRedoEnabled=False,
            lineWrapMode=QPlainTextEdit.LineWrapMode.NoWrap,
        )  # fmt: skip
        named(self, name, title)
        self._theme = context.theme
        self._changed: set[int] = set()
        self._deletions: set[int] = set()
        self._wrong: set[int] = set()
        self.installEventFilter(context.input_keys)
        font = QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont)
        font.setPixelSize(tokens.BODY_PX - 1)
        font.setStyleHint(QFont.StyleHint.Monospace)
        self.setFont(font)
        self._numbers = _LineNumbers(self)
        self.blockCountChanged.connect(self._make_room)
        self.updateRequest.connect(self._on_update)
        self._make_room()

    def show_text(self, text: str) -> None:
        """Replace the text, keeping the cursor's line."""
        line, scrolled = self.textCursor().blockNumber(), self.verticalScrollBar().value()
        with QSignalBlocker(self):
            self.setPlainText(text)
        self._make_room()
        self.setTextCursor(QTextCursor(self.document().findBlockByNumber(min(line, self.blockCount() - 1))))
        self.verticalScrollBar().setValue(scrolled)

    def mark(self, changed: set[int], deletions: set[int], wrong: set[int]) -> None:
        """Highlight lines, counted from 0."""
        self._changed, self._deletions, self._wrong = changed, deletions, wrong
        selections = []
        for line, role in (*((line, "green_soft") for line in changed), *((line, "red_soft") for line in wrong)):
            selection = QTextEdit.ExtraSelection()
            selection.cursor = QTextCursor(self.document().findBlockByNumber(line))
            selection.format.setBackground(self._theme.color(role))
            selection.format.setProperty(QTextFormat.Property.FullWidthSelection, True)
            selections.append(selection)
        self.setExtraSelections(selections)
        self._numbers.update()

    def _number_width(self) -> int:
        return self.fontMetrics().horizontalAdvance("9") * (len(str(self.blockCount())) + 2) + 10

    def _make_room(self, _count: int = 0) -> None:
        self.setViewportMargins(self._number_width(), 0, 0, 0)

    def _on_update(self, rect: QRect, scrolled: int) -> None:
        if scrolled:
            self._numbers.scroll(0, scrolled)
        else:
            self._numbers.update(0, rect.y(), self._numbers.width(), rect.height())

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        inside = self.contentsRect()
        self._numbers.setGeometry(inside.left(), inside.top(), self._number_width(), inside.height())

    def paint_numbers(self, event: QPaintEvent) -> None:
        painter = QPainter(self._numbers)
        painter.fillRect(event.rect(), self._theme.color("panel"))
        painter.setFont(self.font())
        block = self.firstVisibleBlock()
        top = self.blockBoundingGeometry(block).translated(self.contentOffset()).top()
        while block.isValid() and top <= event.rect().bottom():
            line, height = block.blockNumber(), self.blockBoundingRect(block).height()
            rect = QRect(0, round(top), self._numbers.width(), round(height))
            wrong, changed = line in self._wrong, line in self._changed
            painter.setPen(self._theme.color("red" if wrong else "green" if changed else "dim"))
            if not self.isReadOnly():
                sign = "!" if wrong else "+" if changed else ""
                painter.drawText(rect.adjusted(4, 0, 0, 0), Qt.AlignmentFlag.AlignLeft, sign)
            painter.drawText(rect.adjusted(0, 0, -8, 0), Qt.AlignmentFlag.AlignRight, str(line + 1))
            if line in self._deletions:
                painter.setPen(self._theme.color("amber"))
                painter.drawLine(rect.topLeft(), rect.topRight())
            top += height
            block = block.next()


class _LineNumbers(QWidget):
    def __init__(self, editor: CodeEditor) -> None:
        super().__init__(editor)
        self._editor = editor

    def paintEvent(self, event: QPaintEvent) -> None:
        self._editor.paint_numbers(event)


class Other(Value):
    """Scenario to compare with: ``text`` reads its file."""

    title: str
    text: Callable[[], str]


class ComparePage(QWidget):
    """Differences from another scenario, each applied by a click, and line by line. ``others`` lists candidates
    whenever the page is opened, the default first; it runs in a background thread because it reads files.
    """

    def __init__(self, context: FormContext, console: WizardConsole, others: Callable[[], Sequence[Other]]) -> None:
        super().__init__()
        self._context = context
        self._document = context.document
        self._console = console
        self._others = others
        self._offered: list[Other] = []
        self._other_data: dict[str, Any] = {}
        self._other_text = ""
        self.rows: list[QWidget] = []
        self.choice = DropDown(context.theme, "compare_with", tr("Compare with"), activated=self._on_chosen)
        self.choice.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.choice.setSizeAdjustPolicy(DropDown.SizeAdjustPolicy.AdjustToContents)
        self.summary = QLabel(wordWrap=True)
        holder = QWidget(maximumWidth=_WIDEST_PX)
        self._list = layouts.vbox(spacing_px=6)
        layouts.vbox(holder, self._list, 1, margins_px=(0, 0, 8, 0))
        area = list_area(holder, framed=False)
        self.diff = CodeEditor(context, "scenario_diff", tr("Differences line by line"), read_only=True)
        splitter = QSplitter(Qt.Orientation.Vertical, childrenCollapsible=False)
        for part, stretch in ((area, 3), (self.diff, 2)):
            splitter.addWidget(part)
            splitter.setStretchFactor(splitter.count() - 1, stretch)
        splitter.setSizes([360, 240])
        head = layouts.hbox(None, QLabel(tr("Compare with")), self.choice, 1)
        layouts.vbox(self, head, self.summary, (splitter, 1), margins_px=(24, 16, 24, 16), spacing_px=12)
        self._document.history.changed.connect(self._on_changed)
        context.theme.changed.connect(self._on_changed)

    def showEvent(self, event: QShowEvent) -> None:
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

        read_for(self, self._console, partial(_contents_of, other), show)

    def refresh(self) -> None:
        while self.rows:
            drop(self.rows.pop())
        found = list(differences(Scenario, self._other_data, self._document.data))
        summary = tr("Both are identical.")
        if found:
            summary = tr("Differences: %n. Each line shows the value there → the value here.", "", len(found))
        self.summary.setText(summary)
        for difference in found:
            row = self._row(difference, " › ".join(self._document.words(difference.path)))
            self.rows.append(row)
            self._list.addWidget(row)
        texts = (self._other_text.splitlines(), self._document.text.splitlines())
        names = (self.choice.currentText(), self._document.path.name)
        lines = list(difflib.unified_diff(*texts, *names, lineterm="", n=2))
        self.diff.setVisible(bool(lines))
        self.diff.show_text("\n".join(lines))
        added, removed = (
            {number for number, line in enumerate(lines) if line.startswith(sign) and number > 1} for sign in "+-"
        )
        self.diff.mark(added, set(), removed)

    def _row(self, difference: Difference, where: str) -> QWidget:
        row, words = QWidget(), QLabel(difference_words(difference), wordWrap=True)
        texts = layouts.vbox(None, named(QLabel(where), "field_title"), named(words, "help"), spacing_px=0)
        take = ActionButton(self._context.theme, tr("Take theirs"), icon="arrow-left", height_px=30)
        named(take, "take_value", tr("Take theirs: {what}").format(what=where))
        take.setEnabled(self._document.unreadable is None)
        theirs = value_at(self._other_data, difference.path)
        take.clicked.connect(lambda: self._document.replace(difference.path, theirs))
        layouts.hbox(row, (texts, 1), take, margins_px=(0, 2, 0, 2))
        return row


def _contents_of(other: Other) -> tuple[str, dict[str, Any]]:
    """Text and parsed data of a candidate; empty if unreadable. Reads files."""
    try:
        text = other.text()
        data = parse_yaml(text).data
    except (OSError, UnicodeDecodeError, YamlSourceError):
        return "", {}
    return text, data if isinstance(data, dict) else {}
