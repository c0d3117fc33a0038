"""The recorder: a process of its own, so that neither encoding nor a full disk holds up the console."""

import logging
import signal
import threading
import time
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from caris_desktop.domain import clock
from caris_desktop.domain.events import Problem
from caris_desktop.domain.ports import FrameReader
from caris_desktop.recording.messages import (
    RecorderReport,
    SetRecordingPermissions,
    StartRecording,
    StopRecording,
    TakePhoto,
)
from caris_desktop.recording.session_recorder import DiskLimits, SessionRecorder, explain_start_error

_log = logging.getLogger(__name__)
_TICK_S = 0.05
_IDLE_TICK_S = 0.5
_REPORT_EVERY_NS = 1_000_000_000
_SYNC_EVERY_S = 1.0


def run_recorder(connection: Connection, frames: FrameReader, limits: DiskLimits | None = None) -> None:
    """Process body. Records what ``connection`` brings until it ends; see ``recording.messages``.

    One process serves any number of sessions, one after the other. When the connection ends during a session, the
    session is closed with the reason ``console_closed``.
    """
    _Recorder(connection, frames, limits or DiskLimits()).run()


class _Recorder:
    def __init__(self, connection: Connection, frames: FrameReader, limits: DiskLimits) -> None:
        self._connection = connection
        self._frames = frames
        self._limits = limits
        self._session: SessionRecorder | None = None
        self._reported_ns = 0
        self._console_gone = False
        self._terminated = False

    def run(self) -> None:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, self._on_terminate)
        _import_writers()
        ended = threading.Event()
        syncing = threading.Thread(target=self._sync_until, args=(ended,), name="disk-sync", daemon=True)
        syncing.start()
        try:
            while not self._terminated and self._serve_one():
                pass
        finally:
            self._stop("console_closed")
            ended.set()
            syncing.join(2 * _SYNC_EVERY_S)

    def _on_terminate(self, _number: int, _frame: object) -> None:
        """A console that ends in haste terminates its children: the session is closed between two writes."""
        self._terminated = True

    def _serve_one(self) -> bool:
        """Take one message, if there is one within a tick. False when the console has ended the connection."""
        message = None
        try:
            if self._connection.poll(_IDLE_TICK_S if self._session is None else _TICK_S):
                message = self._connection.recv()
        except (EOFError, OSError):
            return False
        if message is not None:
            self._handle(message)
        session = self._session
        if session is not None:
            session.tick()
            if session.full:
                self._stop_for_full_disk(session)
            elif time.monotonic_ns() - self._reported_ns >= _REPORT_EVERY_NS:
                self._send_report(session.status())
        return True

    def _handle(self, message: Any) -> None:
        match message:
            case StartRecording():
                self._stop("wizard")
                self._start(message)
            case StopRecording():
                self._stop(message.reason)
            case TakePhoto():
                if self._session is None:
                    self._tell_problem("No photo was taken.", "Photos are kept with a session.", "Start recording.")
                else:
                    self._session.take_photo(message.ref)
            case SetRecordingPermissions():
                if self._session is not None:
                    self._session.set_permissions(video=message.video, photos=message.photos)
            case _:
                if self._session is not None:
                    self._session.write(message)

    def _start(self, start: StartRecording) -> None:
        try:
            session = SessionRecorder(start, frames=self._frames, report=self._send, limits=self._limits)
        except OSError as error:
            _log.exception("no session in %s", start.folder)
            what, meaning, advice = explain_start_error(error, start.folder)
            self._tell_problem(what, meaning, advice)
            self._send_report(RecorderReport(clock.now_ns(), "failed", start.folder, detail=what))
            return
        self._session = session
        self._send_report(session.status())

    def _stop(self, reason: str) -> None:
        session, self._session = self._session, None
        if session is None:
            return
        session.close(reason)
        self._send_report(replace(session.status(), state="idle"))

    def _stop_for_full_disk(self, session: SessionRecorder) -> None:
        what = "The disk is full."
        session.problem(
            "error",
            what,
            "The recording has ended; everything up to now is kept. Driving and speaking still work.",
            "Free some room, or choose another study folder, then record again.",
        )
        self._session = None
        session.close("disk_full")
        self._send_report(replace(session.status(), state="failed", detail=what))

    def _tell_problem(self, what: str, meaning: str, advice: str) -> None:
        self._send(Problem(clock.now_ns(), "error", what, meaning, advice))

    def _send_report(self, report: RecorderReport) -> None:
        self._reported_ns = time.monotonic_ns()
        self._send(report)

    def _send(self, message: Any) -> None:
        try:
            self._connection.send(message)
        except OSError:
            # The console is gone: nobody to tell, but the session is still to be closed properly.
            if not self._console_gone:
                _log.warning("the console no longer listens")
            self._console_gone = True

    def _sync_until(self, ended: threading.Event) -> None:
        while not ended.wait(_SYNC_EVERY_S):
            session = self._session
            if session is not None:
                session.sync()


def _import_writers() -> None:
    """Before the first session, so that its first frames are not lost to imports."""
    import av  # noqa: F401 - for its side effect, as said above
    import cv2  # noqa: F401 - likewise
    import mcap.writer  # noqa: F401 - likewise
