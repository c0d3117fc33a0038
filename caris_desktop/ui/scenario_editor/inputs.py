"""What text of the form is typed into: undo belongs to the editor, and leaving one ends a step of it."""

from typing import Any

from PySide6.QtCore import QEvent, QSize, Qt
from PySide6.QtGui import QFocusEvent, QKeyEvent, QKeySequence
from PySide6.QtWidgets import QLineEdit, QPlainTextEdit

from caris_desktop.ui import tokens
from caris_desktop.ui.scenario_editor.editing import FormContext

_LEAST_PROSE_LINES = 3
_MOST_PROSE_LINES = 14


def without_own_undo(event: QEvent) -> bool:
    """Whether it is a key that undoes or redoes, which the editor does for all fields alike."""
    return isinstance(event, QKeyEvent) and (
        event.matches(QKeySequence.StandardKey.Undo) or event.matches(QKeySequence.StandardKey.Redo)
    )


class Line(QLineEdit):
    """Undo belongs to the editor, and leaving the line ends a step."""

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
    """Several lines of text. Tab leads on, undo belongs to the editor, and leaving them ends a step."""

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
    """Paragraphs, as tall as what is in it."""

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
