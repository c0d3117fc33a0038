"""Undo and redo of edits. Documents are values, so a step back is the document that was there before."""

from collections import deque
from collections.abc import Callable

from caris_desktop.recording.annotation.model import AnnotationDocument

Edit = Callable[[AnnotationDocument], AnnotationDocument]


class EditHistory:
    """The document that is being edited, with the ``limit`` last states before it."""

    def __init__(self, document: AnnotationDocument, *, limit: int = 1000) -> None:
        self._document = document
        self._done: deque[AnnotationDocument] = deque(maxlen=limit)
        self._undone: list[AnnotationDocument] = []

    @property
    def document(self) -> AnnotationDocument:
        return self._document

    def apply(self, edit: Edit) -> AnnotationDocument:
        """The document as ``edit`` makes it.

        Whatever ``edit`` raises (an AnnotationError says what cannot be done) leaves everything as it was. An edit
        that changes nothing is no step.
        """
        after = edit(self._document)
        if after != self._document:
            self._done.append(self._document)
            self._undone.clear()
            self._document = after
        return self._document

    def undo(self) -> AnnotationDocument:
        """One step back, where there is one."""
        if self._done:
            self._undone.append(self._document)
            self._document = self._done.pop()
        return self._document

    def redo(self) -> AnnotationDocument:
        """The step that was taken back last, again, where there is one."""
        if self._undone:
            self._done.append(self._document)
            self._document = self._undone.pop()
        return self._document
