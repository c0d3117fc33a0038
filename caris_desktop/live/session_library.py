"""Session library of a study: index in a thread, export in a process, replay in a separate program.

GUI thread unless stated otherwise.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from PySide6.QtCore import QObject, Qt, Signal

from caris_desktop.domain.events import Severity
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.free_names import free_path
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import BackgroundWorker, new_timer
from caris_desktop.live.child_process import ChildProcess, ProcessSpec
from caris_desktop.live.state import LiveValue
from caris_desktop.live.status import ExportStatus, LibraryStatus
from caris_desktop.recording.csv_cells import SHOWN, CsvStyle
from caris_desktop.recording.studies.study_query import SessionQuery

if TYPE_CHECKING:
    from caris_desktop.recording.studies.study_index import StudyIndex
# Exporters and index are imported on demand: the window opens sooner.

_log = logging.getLogger(__name__)
_THIS_PROGRAM = (sys.executable, "-m", "caris_desktop")
_CHECK_AFTER_REPLAYS_MS = 300
_LAST_WORDS_BYTES = 4096
_LAST_LINE_CHARACTERS = 400


class _SupersededError(Exception):
    """Interrupts reading for the index: the window closes, or another search was started."""


class _Replay(Value):
    """Replay program, with its terminal output."""

    folder: Path
    process: subprocess.Popen[bytes]
    words: IO[bytes]


class LiveSessionLibrary(QObject):
    """``found`` holds a LibraryStatus, ``export`` an ExportStatus. Every call returns at once."""

    _looked = Signal(object)
    _exporter_spoke = Signal(object, object)
    _exporter_ended = Signal(object)

    def __init__(
        self,
        study: Path,
        problem: Callable[[Severity, str, str, str], None],
        parent: QObject | None = None,
        *,
        program: Sequence[str] = _THIS_PROGRAM,
        replay_options: Sequence[str] = (),
    ) -> None:
        """``program``: command of a replay; ``replay_options``: further arguments."""
        super().__init__(parent)
        self._study = study
        self._problem = problem
        self._program = program
        self._replay_options = replay_options
        self.found = LiveValue(LibraryStatus(), self)
        self.export = LiveValue(ExportStatus(), self)
        self._looked.connect(self.found.set, Qt.ConnectionType.QueuedConnection)
        self._exporter_spoke.connect(self._on_exporter_message, Qt.ConnectionType.QueuedConnection)
        self._exporter_ended.connect(self._on_exporter_ended, Qt.ConnectionType.QueuedConnection)
        self._requested: SessionQuery | None = None
        self._index: StudyIndex | None = None
        self._index_work = BackgroundWorker(self)
        self._exporter: ChildProcess | None = None
        self._out = Path()
        self._slow_work = BackgroundWorker(self)
        self._replays: list[_Replay] = []
        self._replay_watch = new_timer(self, self._supervise_replays, _CHECK_AFTER_REPLAYS_MS)

    def shutdown(self) -> None:
        """End the search and a running export; replays stay open."""
        self._replay_watch.stop()
        for replay in self._replays:
            replay.words.close()
        self._replays.clear()
        self.cancel_export()
        self._requested = None
        self._index_work.do(self._close_index, lambda _closed: None, self._notify)
        for work in (self._index_work, self._slow_work):
            work.finish(lambda _words, wait: wait())

    # Search

    def find(self, query: SessionQuery) -> None:
        """Search, update the index, and search again."""
        self.found.update(query=query, updating=True)
        self._requested = query
        self._index_work.do(partial(self._search, query), lambda _found: None, self._notify)

    def _search(self, query: SessionQuery) -> None:  # index thread
        from caris_desktop.recording.studies.study_index import StudyIndex

        if query is not self._requested:
            return
        try:
            index = self._index = self._index or StudyIndex.of_study(self._study)
            # Known results first; then changes since.
            self._looked.emit(_search(index, query, updating=True))
            index.update(partial(self._go_on, query))
            self._looked.emit(_search(index, query, updating=False))
        except _SupersededError:
            return
        except Exception as error:
            _log.exception("looking for sessions in %s", self._study)
            detail = tr("The sessions could not be searched: {error}").format(error=error)
            self._looked.emit(LibraryStatus(query, detail=detail))

    def _close_index(self) -> None:  # index thread
        if self._index is not None:
            self._index.close()

    def _go_on(self, query: SessionQuery, _fraction: float) -> None:
        """Progress callback that interrupts reading; what was read so far is saved."""
        if query is not self._requested:
            raise _SupersededError

    def open_replay(self, folder: Path, *, at_ns: int | None = None) -> None:
        """Open a replay in a separate program, which cannot slow or crash the running session."""
        command = [*self._program, "replay", str(folder), "--told-in-window", *self._replay_options]
        if at_ns is not None:
            command.append(f"--at-ns={at_ns}")

        def begun(replay: _Replay) -> None:
            self._replays.append(replay)
            self._replay_watch.start()

        self._slow_work.do(lambda: _begun_replay(folder, command), begun, self._notify)

    def _notify(self, failure: UserFacingError) -> None:
        self._problem(failure.severity, failure.what, failure.meaning, failure.advice)

    def _supervise_replays(self) -> None:
        ended = [replay for replay in self._replays if replay.process.poll() is not None]
        self._replays = [replay for replay in self._replays if replay not in ended]
        if not self._replays:
            self._replay_watch.stop()
        for replay in ended:
            self._slow_work.do(partial(_last_words, replay), partial(self._on_replay_ended, replay), self._notify)

    def _on_replay_ended(self, replay: _Replay, last_words: Sequence[str]) -> None:
        if replay.process.returncode == 0:
            return
        _log.error("the replay of %s ended with %s: %s", replay.folder, replay.process.returncode, last_words)
        self._problem(
            "error",
            tr("The replay of {name} ended unexpectedly.").format(name=replay.folder.name),
            last_words[-1][:_LAST_LINE_CHARACTERS]
            if last_words
            else tr("It did not report a reason; the log may have details."),
            tr("The running session is not affected."),
        )

    # Export

    def choose_export_folder(
        self, sessions: Sequence[Path], on_folder: Callable[[Path], None], *, chosen: Path | None = None
    ) -> None:
        """Propose a new export folder; ``on_folder`` receives it later. ``chosen``: the wizard's folder, used itself if
        empty, else a new subfolder.
        """
        name = sessions[0].name if len(sessions) == 1 else f"{self._study.name} {len(sessions)} sessions"
        usual = self._study / "exports" / name

        def usual_folder() -> Path:
            if chosen is None:
                return free_path(usual)
            return free_path(chosen / name) if _holds_something(chosen) else chosen

        self._slow_work.do(usual_folder, on_folder, self._notify)

    def start_export(
        self,
        sessions: Sequence[Path],
        formats: Sequence[str],
        out: Path,
        *,
        licence: str = "",
        with_names: bool = False,
        csv: CsvStyle = SHOWN,
    ) -> None:
        """Export each session in each format in a process.

        Wizards, coders and the robot's address are pseudonymised unless ``with_names``.
        """
        if self._exporter is not None:
            return
        from caris_desktop.recording.session_export import ExportRequest, run_exports

        self._out = out
        request = ExportRequest(
            tuple(sessions),
            tuple(formats),
            out,
            licence=licence,
            folder_per_session=len(sessions) > 1,
            with_names=with_names,
            csv=csv,
        )
        exporter = ChildProcess(
            ProcessSpec("export", run_exports, (request,)),
            on_message=lambda message, _raw: self._exporter_spoke.emit(exporter, message),
            on_exit=lambda _code: self._exporter_ended.emit(exporter),
        )
        self._exporter = exporter
        self.export.set(ExportStatus("running", 0.0, tr("starting")))
        exporter.start()

    def cancel_export(self) -> None:
        """Cancel the export; complete files stay, partial ones are removed."""
        exporter, self._exporter = self._exporter, None
        if exporter is None:
            return
        self.export.update(state="cancelled", detail=tr("Completed files remain."))
        self._end(exporter)

    def _on_exporter_message(self, exporter: ChildProcess, message: Any) -> None:
        if exporter is not self._exporter:
            return
        from caris_desktop.recording.session_export import ExportFinished, ExportProgress

        if isinstance(message, ExportProgress):
            self.export.set(ExportStatus("running", message.fraction, tr(message.what)))
        elif isinstance(message, ExportFinished):
            self.export.set(
                ExportStatus(
                    "done" if message.written else "failed",
                    1.0,
                    "",
                    message.written,
                    "\n".join(map(tr, (*message.problems, *message.notices))),
                )
            )
            exporter.ask_to_end()
            self._exporter = None

    def _on_exporter_ended(self, exporter: ChildProcess) -> None:
        if exporter is not self._exporter:
            return
        self._exporter = None
        self._end(exporter)
        self.export.set(ExportStatus("failed", detail=tr("The export ended unexpectedly. The sessions are unharmed.")))

    def _end(self, exporter: ChildProcess) -> None:
        """End the exporter in the background: removing its output may take long."""
        self._slow_work.do(partial(_end_and_tidy, exporter, self._out), lambda _ended: None, self._notify)


def _end_and_tidy(exporter: ChildProcess, out: Path) -> None:
    exporter.stop(grace_s=0.0)
    from caris_desktop.recording.session_export import remove_partial_exports

    try:
        remove_partial_exports(out)
    except OSError:
        _log.warning("what the export left behind in %s stays", out, exc_info=True)


def _begun_replay(folder: Path, command: Sequence[str]) -> _Replay:
    """Start a replay. Raises UserFacingError."""
    try:
        words = tempfile.TemporaryFile()  # noqa: SIM115 - open for as long as the replay
        try:
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=words, start_new_session=True)
        except OSError:
            words.close()
            raise
    except OSError as error:
        _log.exception("the replay of %s", folder)
        raise UserFacingError(
            tr("The replay did not open ({why}).").format(why=error.strerror),
            tr("The session itself is unharmed, and the running session is not affected."),
            tr("Try again; the log has the details."),
        ) from error
    return _Replay(folder, process, words)


def _last_words(replay: _Replay) -> list[str]:
    """Last lines of its terminal output; empty if none."""
    with replay.words as words:
        words.seek(0, os.SEEK_END)
        words.seek(max(0, words.tell() - _LAST_WORDS_BYTES))
        lines = words.read(_LAST_WORDS_BYTES).decode("utf-8", "replace").splitlines()
    return [line.strip() for line in lines if line.strip()]


def _holds_something(folder: Path) -> bool:
    try:
        return any(folder.iterdir())
    except OSError:
        return False  # the export reports why it is unusable


def _search(index: StudyIndex, query: SessionQuery, *, updating: bool) -> LibraryStatus:
    sessions = index.sessions(query)
    hits = index.search(query)
    places = index.places(query)
    total = len(index.sessions())
    unreadable = index.unreadable()
    details = [tr(index.message)] if index.message else []
    if unreadable:
        names = ", ".join(session.folder.name for session in unreadable[:3])
        message = tr("Unreadable: {names} and others.") if len(unreadable) > 3 else tr("Unreadable: {names}.")
        details.append(message.format(names=names))
    return LibraryStatus(query, sessions, hits, total, updating, " ".join(details), places)
