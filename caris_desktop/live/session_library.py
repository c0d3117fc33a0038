"""The sessions of a study: found through an index in a thread, exported in a process, replayed in a program of its own.

GUI thread, except where a method says otherwise.
"""

import logging
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject, Qt, Signal

from caris_desktop.domain.events import Severity
from caris_desktop.live.child_process import ChildProcess, ProcessBody
from caris_desktop.live.state import LiveValue
from caris_desktop.live.status import ExportStatus, LibraryStatus
from caris_desktop.recording.export import (
    ExportFinished,
    ExportProgress,
    ExportRequest,
    remove_partial_exports,
    run_exports,
)
from caris_desktop.recording.study_index import SessionQuery, StudyIndex

_log = logging.getLogger(__name__)


class _SomethingElseIsWantedError(Exception):
    """Reading sessions for the index stops: the window closes, or looks for something else."""


class LiveSessionLibrary(QObject):
    """Implements SessionLibrary. ``found`` holds a LibraryStatus, ``export`` an ExportStatus."""

    _looked = Signal(object)
    _exporter_spoke = Signal(object)
    _exporter_ended = Signal(object)

    def __init__(
        self, study: Path, problem: Callable[[Severity, str, str, str], None], parent: QObject | None = None
    ) -> None:
        super().__init__(parent)
        self._study = study
        self._problem = problem
        self.found = LiveValue(LibraryStatus(), self)
        self.export = LiveValue(ExportStatus(), self)
        self._looked.connect(self.found.set, Qt.ConnectionType.QueuedConnection)
        self._exporter_spoke.connect(self._on_exporter_message, Qt.ConnectionType.QueuedConnection)
        self._exporter_ended.connect(self._on_exporter_ended, Qt.ConnectionType.QueuedConnection)
        self._changed = threading.Condition()
        self._wanted: SessionQuery | None = None
        self._ended = False
        self._searcher: threading.Thread | None = None
        self._exporter: ChildProcess | None = None
        self._out = Path()
        self._replays: list[subprocess.Popen[bytes]] = []

    def shutdown(self) -> None:
        """End the search and a running export; replays stay open."""
        self.cancel_export()
        with self._changed:
            self._ended = True
            self._changed.notify()
        if self._searcher is not None:
            self._searcher.join(5.0)

    # Finding

    def find(self, query: SessionQuery) -> None:
        self.found.set(replace(self.found.value, query=query, updating=True))
        with self._changed:
            self._wanted = query
            self._changed.notify()
        if self._searcher is None:
            self._searcher = threading.Thread(target=self._search, name="session-index", daemon=True)
            self._searcher.start()

    def _search(self) -> None:  # the index thread
        index = StudyIndex.of_study(self._study)
        try:
            while True:
                with self._changed:
                    while self._wanted is None and not self._ended:
                        self._changed.wait()
                    if self._ended:
                        return
                    query, self._wanted = self._wanted, None
                assert query is not None  # noqa: S101 - waited for above
                try:
                    # What is known already is shown at once; then what has changed since.
                    self._looked.emit(_look(index, query, updating=True))
                    index.update(self._go_on)
                    self._looked.emit(_look(index, query, updating=False))
                except _SomethingElseIsWantedError:
                    continue
                except Exception as error:
                    _log.exception("looking for sessions in %s", self._study)
                    self._looked.emit(LibraryStatus(query, detail=f"The sessions could not be looked through: {error}"))
        finally:
            index.close()

    def _go_on(self, _fraction: float) -> None:
        """What was read so far is kept."""
        if self._ended or self._wanted is not None:
            raise _SomethingElseIsWantedError

    def open_replay(self, folder: Path, *, at_ns: int | None = None) -> None:
        """A program of its own: it may be slow or fail without the running session."""
        words = [sys.executable, "-m", "caris_desktop", "replay", str(folder)]
        if at_ns is not None:
            words.append(f"--at-ns={at_ns}")
        self._replays = [replay for replay in self._replays if replay.poll() is None]
        try:
            self._replays.append(subprocess.Popen(words, stdin=subprocess.DEVNULL, start_new_session=True))
        except OSError as error:
            _log.exception("the replay of %s", folder)
            self._problem("error", "The replay did not open.", f"{error.strerror}.", "Try again, or from a terminal.")

    # Exporting

    def default_export_folder(self, sessions: Sequence[Path]) -> Path:
        name = sessions[0].name if len(sessions) == 1 else f"{self._study.name} {len(sessions)} sessions"
        folder = self._study / "exports" / name
        number = 2
        while folder.exists():
            folder, number = folder.with_name(f"{name}-{number}"), number + 1
        return folder

    def start_export(self, sessions: Sequence[Path], formats: Sequence[str], out: Path, *, licence: str = "") -> None:
        if self._exporter is not None:
            return
        self._out = out
        request = ExportRequest(
            tuple(sessions), tuple(formats), out, licence=licence, folder_per_session=len(sessions) > 1
        )
        exporter = ChildProcess(
            ProcessBody("export", run_exports, (request,)),
            on_message=lambda message, _raw: self._exporter_spoke.emit(message),
            on_exit=lambda _code: self._exporter_ended.emit(exporter),
        )
        self._exporter = exporter
        self.export.set(ExportStatus("running", 0.0, "starting"))
        exporter.start()

    def cancel_export(self) -> None:
        exporter, self._exporter = self._exporter, None
        if exporter is None:
            return
        exporter.stop(grace_s=0.0)
        self._tidy()
        self.export.set(replace(self.export.value, state="cancelled", detail="What was finished before is kept."))

    def _on_exporter_message(self, message: Any) -> None:
        if self._exporter is None:
            return
        if isinstance(message, ExportProgress):
            self.export.set(ExportStatus("running", message.fraction, message.what))
        elif isinstance(message, ExportFinished):
            self.export.set(
                ExportStatus(
                    "done" if message.written else "failed",
                    1.0,
                    "",
                    message.written,
                    "\n".join((*message.problems, *message.notices)),
                )
            )
            self._exporter.ask_to_end()
            self._exporter = None

    def _on_exporter_ended(self, exporter: ChildProcess) -> None:
        if exporter is not self._exporter:
            return
        self._exporter = None
        self._tidy()
        self.export.set(ExportStatus("failed", detail="The export ended unexpectedly. The sessions are unharmed."))

    def _tidy(self) -> None:
        try:
            remove_partial_exports(self._out)
        except OSError:
            _log.warning("what the export left behind in %s stays", self._out, exc_info=True)


def _look(index: StudyIndex, query: SessionQuery, *, updating: bool) -> LibraryStatus:
    sessions = index.sessions(query)
    hits = index.search(query) if query.text.strip() else ()
    total = len(index.sessions())
    unreadable = index.unreadable()
    details = [index.message] if index.message else []
    if unreadable:
        names = ", ".join(session.folder.name for session in unreadable[:3])
        details.append(f"Cannot be read: {names}{' and others' if len(unreadable) > 3 else ''}.")
    return LibraryStatus(query, sessions, hits, total, updating, " ".join(details))
