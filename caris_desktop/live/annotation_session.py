"""Annotation session of a replay: editing, background saving, and the session overview for the timeline."""

import asyncio
import logging
from collections.abc import Callable
from concurrent.futures import Future, wait
from datetime import datetime
from pathlib import Path

from PySide6.QtCore import QObject, Signal

from caris_desktop.domain.translation import tr
from caris_desktop.live.asyncio_thread import AsyncioThread
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.child_process import ChildProcess, ProcessSpec
from caris_desktop.live.state import LiveValue
from caris_desktop.recording.annotation.annotation_editing import (
    AnnotationError,
    EditHistory,
    coders_of,
    merge_imported,
    tiers_of_coder,
)
from caris_desktop.recording.annotation.annotation_import import media_began_ms_of, read_csv, read_eaf
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument
from caris_desktop.recording.annotation.annotation_store import load_documents, save_coder
from caris_desktop.recording.annotation.timeline_builder import run_overview
from caris_desktop.recording.session.session_reader import Session

_log = logging.getLogger(__name__)
_SAVED_WITHIN_S = 5.0

Tell = Callable[[str, str, str], None]
"""what happened, its meaning, advice"""


class AnnotationSession(QObject):
    """Annotation session. ``coding``: AnnotationDocument of all coders; ``overview``: SessionOverview once computed."""

    _overview_made = Signal(object)
    _overview_missing = Signal()
    _save_failed = Signal(object)  # a Qt str would lose the localisable parts

    def __init__(
        self,
        session: Session,
        asyncio_thread: AsyncioThread,
        problem: Tell,
        parent: QObject | None = None,
        *,
        unsaved_dir: Path | None = None,
    ) -> None:
        """``unsaved_dir``: fallback for what cannot be saved in the session folder."""
        super().__init__(parent)
        self._session = session
        self._unsaved_dir = unsaved_dir
        self._asyncio = asyncio_thread
        self._problem = problem
        self.overview = LiveValue(None, self)
        self.coding = LiveValue(AnnotationDocument(), self)
        self._history = EditHistory(AnnotationDocument())
        self._reading = BackgroundWorker(self)
        self._saving = asyncio.Lock()
        self._saved = AnnotationDocument()
        self._unsaved: Future[None] | None = None
        self._overview_maker: ChildProcess | None = None
        self._overview_made.connect(self.overview.set)
        self._overview_missing.connect(self._on_overview_missing)
        self._save_failed.connect(self._on_save_failed)

    def start(self) -> None:
        """Load existing annotations, and compute the overview in the background."""
        document = load_documents(self._session.folder, on_damaged=self._on_damaged)
        self._history = EditHistory(document)
        self._saved = document
        self.coding.set(document)
        # In a separate process: up to a minute of Python, which would make the replay stutter.
        self._overview_maker = ChildProcess(
            ProcessSpec("overview", run_overview, (self._session,)),
            on_message=lambda overview, _raw: self._overview_made.emit(overview),
            on_exit=lambda _code: self._overview_missing.emit(),
        )
        self._overview_maker.start()

    def _on_damaged(self, reason: str) -> None:
        self._problem(
            tr("A coder's annotations cannot be read."),
            tr(reason),
            tr("They are left unchanged; repair or move the file."),
        )

    def close(self) -> str:
        """Wait until everything is saved, at most ten seconds; returns a message about what could not
        be, else empty.
        """
        if self._overview_maker is not None:
            self._overview_maker.stop(grace_s=0.0)
        self._reading.finish(lambda _words, wait_for_it: wait_for_it())
        saving, self._unsaved = self._unsaved, None
        if saving is None:
            return ""
        wait([saving], timeout=_SAVED_WITHIN_S)
        if saving.done() and self._saved != self._history.document:
            # The cause of a failed save may be fixed meanwhile.
            wait([self._asyncio.submit(self._save(self._history.document))], timeout=_SAVED_WITHIN_S)
        document, saved = self._history.document, self._saved
        if saved == document:
            return ""
        folder = self._session.folder
        lost = tr("The last annotations could not be saved in {folder}.").format(folder=folder)
        try:
            copy = self._store_copy(document, saved)
        except (AnnotationError, OSError):
            _log.exception("not even a copy of the annotations could be kept")
            copy = None
        if copy is not None:
            lost = tr(
                "The last annotations could not be saved in {folder}. A copy is in {copy}: move its files "
                "into the session's folder 'annotations'."
            ).format(folder=folder, copy=copy)
        _log.error(lost)
        return lost

    def _store_copy(self, document: AnnotationDocument, saved: AnnotationDocument) -> Path | None:
        if self._unsaved_dir is None:
            return None
        folder = self._unsaved_dir / f"{self._session.folder.absolute().name} {datetime.now():%Y-%m-%d %H%M%S}"
        folder.mkdir(parents=True, exist_ok=True)
        for coder in coders_of(document):
            if tiers_of_coder(document, coder) != tiers_of_coder(saved, coder):
                save_coder(folder, document, coder)
        return folder / "annotations"

    def edit(self, edit: Callable[[AnnotationDocument], AnnotationDocument]) -> str:
        try:
            document = self._history.apply(edit)
        except AnnotationError as refusal:
            reason = str(refusal)
            return tr(reason)
        self._show(document)
        return ""

    def undo_steps(self) -> tuple[str, str]:
        return tr(self._history.undo_step), tr(self._history.redo_step)

    def undo(self) -> bool:
        return self._step(self._history.undo)

    def redo(self) -> bool:
        return self._step(self._history.redo)

    def import_annotations(self, path: Path, coder: str, on_result: Callable[[str], None]) -> None:
        """Import in a background thread; returns at once."""

        skipped: list[str] = []

        def read() -> AnnotationDocument | str:
            try:
                if path.suffix.lower() == ".eaf":
                    return read_eaf(path, coder=coder, media_began_ms=media_began_ms_of(self._session.header))
                return read_csv(path, coder=coder, skipped=skipped)
            except AnnotationError as refusal:
                reason = str(refusal)
                return tr(reason)

        def take(found: AnnotationDocument | str) -> None:
            refused = found if isinstance(found, str) else self.edit(lambda document: merge_imported(document, found))
            if not refused and skipped:
                refused = " ".join([tr("The annotations were imported."), *map(tr, skipped)])
            on_result(refused)

        self._reading.do(read, take, lambda failure: on_result(f"{failure.what} {failure.advice}"))

    def _step(self, step: Callable[[], AnnotationDocument]) -> bool:
        before = self.coding.value
        document = step()
        if document == before:
            return False
        self._show(document)
        return True

    def _show(self, document: AnnotationDocument) -> None:
        self.coding.set(document)
        self._unsaved = self._asyncio.submit(self._save(document))

    async def _save(self, document: AnnotationDocument) -> None:
        async with self._saving:
            if document is not self._history.document:
                return  # a newer version is queued
            for coder in sorted({*coders_of(document), *coders_of(self._saved)}):
                if tiers_of_coder(document, coder) == tiers_of_coder(self._saved, coder):
                    continue
                try:
                    await asyncio.to_thread(save_coder, self._session.folder, document, coder)
                except (AnnotationError, OSError) as error:
                    self._save_failed.emit(str(error))
                    return
            self._saved = document

    def _on_overview_missing(self) -> None:
        if self.overview.value is None:
            self._problem(
                tr("The timeline cannot show the recorded data."),
                tr("Replay and annotation still work."),
                tr("Close the replay and open it again; the log has the details."),
            )

    def _on_save_failed(self, reason: str) -> None:
        self._problem(
            tr("Your annotations are not saved."),
            tr(reason),
            tr("Free some disk space, or make the session's folder writable; the next change saves them all."),
        )
