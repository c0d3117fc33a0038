"""Undo and redo of edits. Documents are values, so a step back is the document that was there before."""

from collections import deque
from collections.abc import Callable

from caris_desktop.recording.annotation.model import AnnotationDocument

Edit = Callable[[AnnotationDocument], AnnotationDocument]


class EditHistory:
    """The document that is being edited, with the ``limit`` last states before it."""

    def __init__(self, document: AnnotationDocument, *, limit: int = 1000) -> None:
        self._document = self._saved = document
        self._done: deque[tuple[AnnotationDocument, str]] = deque(maxlen=limit)
        self._undone: list[tuple[AnnotationDocument, str]] = []

    @property
    def document(self) -> AnnotationDocument:
        return self._document

    @property
    def undo_text(self) -> str | None:
        """What :meth:`undo` takes back; None where there is nothing."""
        return self._done[-1][1] if self._done else None

    @property
    def redo_text(self) -> str | None:
        """What :meth:`redo` does again; None where there is nothing."""
        return self._undone[-1][1] if self._undone else None

    @property
    def changed(self) -> bool:
        """Whether there is something that :meth:`mark_saved` has not seen."""
        return self._document is not self._saved and self._document != self._saved

    def apply(self, edit: Edit, text: str = "") -> AnnotationDocument:
        """The document as ``edit`` makes it; ``text`` names the edit in the menu.

        Whatever ``edit`` raises (an AnnotationError says what cannot be done) leaves everything as it was. An edit
        that changes nothing is no step.
        """
        after = edit(self._document)
        if after != self._document:
            self._done.append((self._document, text))
            self._undone.clear()
            self._document = after
        return self._document

    def undo(self) -> AnnotationDocument:
        """One step back, where there is one."""
        if self._done:
            before, text = self._done.pop()
            self._undone.append((self._document, text))
            self._document = before
        return self._document

    def redo(self) -> AnnotationDocument:
        """The step that was taken back last, again, where there is one."""
        if self._undone:
            after, text = self._undone.pop()
            self._done.append((self._document, text))
            self._document = after
        return self._document

    def mark_saved(self) -> None:
        """The present document is safe on the disk."""
        self._saved = self._document
