"""Undo and redo of annotation edits; documents are immutable, so each step is a document."""

from collections import deque
from collections.abc import Callable

from caris_desktop.recording.annotation.annotation_model import AnnotationDocument

Edit = Callable[[AnnotationDocument], AnnotationDocument]


class EditHistory:
    """The edited document with its last ``limit`` states."""

    def __init__(self, document: AnnotationDocument, *, limit: int = 1000) -> None:
        self._document = document
        self._done: deque[AnnotationDocument] = deque(maxlen=limit)
        self._undone: list[AnnotationDocument] = []

    @property
    def document(self) -> AnnotationDocument:
        return self._document

    def apply(self, edit: Edit) -> AnnotationDocument:
        """Apply ``edit`` and return the new document.

        An exception of ``edit`` (AnnotationError if refused) changes nothing. An edit without an effect is not an undo
        step.
        """
        after = edit(self._document)
        if after != self._document:
            self._done.append(self._document)
            self._undone.clear()
            self._document = after
        return self._document

    def undo(self) -> AnnotationDocument:
        """Undo one step, if any."""
        if self._done:
            self._undone.append(self._document)
            self._document = self._done.pop()
        return self._document

    def redo(self) -> AnnotationDocument:
        """Redo the last undone step, if any."""
        if self._undone:
            self._done.append(self._document)
            self._document = self._undone.pop()
        return self._document
