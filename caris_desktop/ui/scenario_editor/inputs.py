"""Text inputs of the form: undo is the editor's, and leaving the field ends an undo step."""

from typing import Any

from PySide6.QtCore import QEvent, QSize, Qt
from PySide6.QtGui import QFocusEvent, QKeyEvent, QKeySequence
from PySide6.QtWidgets import QLineEdit, QPlainTextEdit

from caris_desktop.ui import tokens
from caris_desktop.ui.scenario_editor.editing_context import FormContext

_LEAST_PROSE_LINES = 3
_MOST_PROSE_LINES = 14


def without_own_undo(event: QEvent) -> bool:
    """Whether the event is an undo or redo key, which the editor handles for all fields."""
    return isinstance(event, QKeyEvent) and (
        event.matches(QKeySequence.StandardKey.Undo) or event.matches(QKeySequence.StandardKey.Redo)
    )


class Line(QLineEdit):
    """Line edit; undo is the editor's, and leaving it ends an undo step."""

    def __init__(self, context: FormContext) -> None:
        super().__init__()
        self._context = context
        self.setMinimumHeight(tokens.CONTROL_HEIGHT_PX)

    def event(self, event: QEvent) -> bool:
        if event.type() == QEvent.Type.ShortcutOverride and without_own_undo(event):
            event.ignore()
            return False
        return super().event(event)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        ctrl = event.modifiers() & Qt.KeyboardModifier.ControlModifier
        moves_entry = ctrl and event.key() in (Qt.Key.Key_Up, Qt.Key.Key_Down)
        if moves_entry or without_own_undo(event):
            event.ignore()
            return
        super().keyPressEvent(event)

    def focusOutEvent(self, event: QFocusEvent) -> None:
        self._context.editing.document.pause()
        super().focusOutEvent(event)


class Lines(QPlainTextEdit):
    """Multi-line edit. Tab moves on, undo is the editor's, and leaving it ends an undo step."""

    def __init__(self, context: FormContext) -> None:
        super().__init__()
        self._context = context
        self.setTabChangesFocus(True)
        self.setUndoRedoEnabled(False)

    def event(self, event: QEvent) -> bool:
        if event.type() == QEvent.Type.ShortcutOverride and without_own_undo(event):
            event.ignore()
            return False
        return super().event(event)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if without_own_undo(event):
            event.ignore()
            return
        super().keyPressEvent(event)

    def focusOutEvent(self, event: QFocusEvent) -> None:
        self._context.editing.document.pause()
        super().focusOutEvent(event)


class Prose(Lines):
    """Multi-line edit that grows with its text."""

    def __init__(self, context: FormContext) -> None:
        super().__init__(context)
        self.textChanged.connect(self.updateGeometry)

    def sizeHint(self) -> QSize:
        line = self.fontMetrics().lineSpacing()
        document = self.document()
        lines = max(_LEAST_PROSE_LINES, min(_MOST_PROSE_LINES, round(document.size().height())))
        return QSize(240, lines * line + 26)

    def minimumSizeHint(self) -> QSize:
        return QSize(120, self.sizeHint().height())

    def resizeEvent(self, event: Any) -> None:
        super().resizeEvent(event)
        self.updateGeometry()
