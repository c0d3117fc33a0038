"""YAML text page with highlighted changes; edits apply to the form at once."""

import difflib
import time
from typing import Any

from PySide6.QtCore import QRect, QSize, Qt, QTimer
from PySide6.QtGui import QColor, QFont, QFontDatabase, QPainter, QPaintEvent, QTextCursor, QTextFormat
from PySide6.QtWidgets import QPlainTextEdit, QTextEdit, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.scenario_editor.editing_context import FormContext
from caris_desktop.ui.scenario_editor.inputs import Lines

_TYPING_PAUSE_MS = 200
_ONE_STEP_S = 1.5


def changed_lines(before: str, after: str) -> tuple[set[int], set[int]]:
    """Changed or new lines of ``after``, and lines that follow a deletion; counted from 0."""
    matcher = difflib.SequenceMatcher(None, before.splitlines(), after.splitlines(), autojunk=False)
    changed: set[int] = set()
    deletions: set[int] = set()
    for tag, _from, _to, start, end in matcher.get_opcodes():
        if tag in ("replace", "insert"):
            changed.update(range(start, end))
        elif tag == "delete":
            deletions.add(start)
    return changed, deletions


class TextPage(QWidget):
    """Text page. ``flush`` applies pending typing."""

    def __init__(self, context: FormContext) -> None:
        super().__init__()
        self._context = context
        self._editing = context.editing
        self.editor = CodeEditor(context)
        self.editor.setObjectName("scenario_text")
        self.editor.setAccessibleName(tr("The text of the scenario file"))
        column = layouts.vbox(self, margins_px=12)
        column.addWidget(self.editor)
        self._typing = QTimer(self, singleShot=True, interval=_TYPING_PAUSE_MS)
        self._typing.timeout.connect(self._take)
        self._flushed_s = 0.0
        self.editor.textChanged.connect(self._typing.start)
        self._editing.changed.connect(self._on_changed)
        context.theme.changed.connect(self._mark)

    def flush(self) -> None:
        if self._typing.isActive():
            self._typing.stop()
            self._take()

    def _take(self) -> None:
        document, typed = self._editing.document, self.editor.toPlainText()
        if "\r\n" in document.text:
            typed = typed.replace("\n", "\r\n")
        if typed != document.text:
            now_s = time.monotonic()
            if now_s - self._flushed_s > _ONE_STEP_S:
                document.pause()
            self._flushed_s = now_s
            document.set_text(typed)
            self._editing.emit_changes(reshaped=True)

    def _on_changed(self) -> None:
        if self.isVisible():
            self._show()

    def showEvent(self, event: Any) -> None:
        self._show()
        super().showEvent(event)

    def hideEvent(self, event: Any) -> None:
        self.flush()
        super().hideEvent(event)

    def _show(self) -> None:
        text = self._editing.document.text.replace("\r\n", "\n")
        if text != self.editor.toPlainText():
            self.editor.show_text(text)
            self._typing.stop()
        self._mark()

    def _mark(self) -> None:
        if not self.isVisible():
            return
        document = self._editing.document
        changed, deletions = changed_lines(document.saved_text, document.text)
        wrong = {mistake.line - 1: mistake.message for mistake in document.mistakes}
        self.editor.mark(changed, deletions, wrong)

    def show_line(self, line: int) -> None:
        """Scroll to a line, counted from 1."""
        block = self.editor.document().findBlockByNumber(max(0, line - 1))
        cursor = QTextCursor(block)
        self.editor.setTextCursor(cursor)
        self.editor.centerCursor()
        self.editor.setFocus(Qt.FocusReason.OtherFocusReason)


class CodeEditor(Lines):
    """Plain text editor with line numbers."""

    def __init__(self, context: FormContext, *, read_only: bool = False) -> None:
        super().__init__(context)
        self._changed: set[int] = set()
        self._deletions: set[int] = set()
        self._wrong: dict[int, str] = {}
        self.setReadOnly(read_only)
        self.setLineWrapMode(QPlainTextEdit.LineWrapMode.NoWrap)
        font = QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont)
        font.setPixelSize(tokens.BODY_PX - 1)
        font.setStyleHint(QFont.StyleHint.Monospace)
        self._font = font
        self.setFont(font)
        self._numbers = _LineNumbers(self)
        self.blockCountChanged.connect(self._make_room)
        self.updateRequest.connect(self._on_update)
        self._make_room()

    def show_text(self, text: str) -> None:
        """Replace the text, keeping the cursor's line."""
        line, scrolled = self.textCursor().blockNumber(), self.verticalScrollBar().value()
        self.blockSignals(True)
        self.setPlainText(text)
        self.blockSignals(False)
        self._make_room()
        self.setTextCursor(QTextCursor(self.document().findBlockByNumber(min(line, self.blockCount() - 1))))
        self.verticalScrollBar().setValue(scrolled)

    def mark(self, changed: set[int], deletions: set[int], wrong: dict[int, str]) -> None:
        self._changed, self._deletions, self._wrong = changed, deletions, wrong
        theme = self._context.theme
        selections = []
        for line, role in (*((line, "green_soft") for line in changed), *((line, "red_soft") for line in wrong)):
            selection = QTextEdit.ExtraSelection()
            selection.cursor = QTextCursor(self.document().findBlockByNumber(line))
            selection.format.setBackground(theme.color(role))
            selection.format.setProperty(QTextFormat.Property.FullWidthSelection, True)
            selections.append(selection)
        self.setExtraSelections(selections)
        self._numbers.update()

    def number_width(self) -> int:
        return self.fontMetrics().horizontalAdvance("9") * (len(str(self.blockCount())) + 2) + 10

    def _make_room(self, _count: int = 0) -> None:
        self.setViewportMargins(self.number_width(), 0, 0, 0)

    def _on_update(self, rect: QRect, scrolled: int) -> None:
        if scrolled:
            self._numbers.scroll(0, scrolled)
        else:
            self._numbers.update(0, rect.y(), self._numbers.width(), rect.height())

    def resizeEvent(self, event: Any) -> None:
        super().resizeEvent(event)
        inside = self.contentsRect()
        self._numbers.setGeometry(inside.left(), inside.top(), self.number_width(), inside.height())

    def paint_numbers(self, event: QPaintEvent) -> None:
        theme = self._context.theme
        painter = QPainter(self._numbers)
        painter.fillRect(event.rect(), theme.color("panel"))
        painter.setFont(self._font)
        block = self.firstVisibleBlock()
        top = self.blockBoundingGeometry(block).translated(self.contentOffset()).top()
        while block.isValid() and top <= event.rect().bottom():
            height = self.blockBoundingRect(block).height()
            line = block.blockNumber()
            self._paint_number(painter, line, QRect(0, round(top), self._numbers.width(), round(height)))
            top += height
            block = block.next()

    def _paint_number(self, painter: QPainter, line: int, rect: QRect) -> None:
        theme = self._context.theme
        role = "red" if line in self._wrong else "green" if line in self._changed else "dim"
        sign = "" if self.isReadOnly() else "!" if line in self._wrong else "+" if line in self._changed else ""
        painter.setPen(QColor(theme.color(role)))
        painter.drawText(rect.adjusted(4, 0, 0, 0), Qt.AlignmentFlag.AlignLeft, sign)
        painter.drawText(rect.adjusted(0, 0, -8, 0), Qt.AlignmentFlag.AlignRight, str(line + 1))
        if line in self._deletions:
            painter.setPen(theme.color("amber"))
            painter.drawLine(rect.topLeft(), rect.topRight())


class _LineNumbers(QWidget):
    def __init__(self, editor: CodeEditor) -> None:
        super().__init__(editor)
        self._editor = editor

    def sizeHint(self) -> QSize:
        return QSize(self._editor.number_width(), 0)

    def paintEvent(self, event: QPaintEvent) -> None:
        self._editor.paint_numbers(event)
