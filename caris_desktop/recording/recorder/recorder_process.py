"""Recorder process, so that neither encoding nor a full disk blocks the console."""

import json
import logging
import os
import pickle
import signal
import sys
import threading
import time
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain import clock, events
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import ANSWER, Problem, Severity
from caris_desktop.domain.free_names import free_name
from caris_desktop.domain.ports import FrameReader
from caris_desktop.domain.schema import to_jsonable
from caris_desktop.domain.sensing import FrameRef, People
from caris_desktop.domain.streams import Delivery, StreamSpec
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.recording.recorder.blurring import Blurring, Covering
from caris_desktop.recording.recorder.disk_watch import DiskLimits
from caris_desktop.recording.recorder.media_writer import IMAGE_LOST, photo_event, texts_for, write_photo
from caris_desktop.recording.recorder.recorder_messages import (
    ARRIVED,
    OfferMarkers,
    PauseRecording,
    RecorderReport,
    SetRecordingPermissions,
    StartRecording,
    StopRecording,
    TakePhoto,
    UseConsents,
)
from caris_desktop.recording.recorder.session_recorder import SessionRecorder, explain_start_error
from caris_desktop.recording.recorder.video_writer import Encoders
from caris_desktop.recording.session.session_header import SessionClock

STREAM_NAME, STREAM_TYPE = "CARIS markers", "Markers"
_SOURCE_ID = "caris-desktop-markers"
# Anyone on the network can listen: speech and names go out only if the scenario asks for it. Without ``words``, only
# these fields of these events are sent.
_WITHOUT_WORDS: dict[type, tuple[str, ...]] = {
    events.Marked: ("stamp_ns", "label", "kind", "mark_id", "start_ns", "end_ns", "state"),
    events.StepEntered: ("stamp_ns", "step_id", "title", "number", "how"),
    events.ProtocolEnded: ("stamp_ns", "left_step_id", "skipped"),
    events.RecordingPaused: ("stamp_ns", "paused"),
    events.SessionStarted: ("stamp_ns",),
    events.SessionEnded: ("stamp_ns",),
}
# Many per second, or useless next to a physiological signal.
_NOT_SENT = (events.CommandSent, events.HeadMoved, events.LinkQuality, events.TrafficMeasured)
_LONGEST_TEXT = 1000
_TRIES = 25
_MEASURE_EVERY_NS = 10_000_000_000


class OutletUnavailableError(Exception):
    """The outlet does not work; ``what`` and ``advice`` are for the wizard."""

    def __init__(self, what: str, advice: str) -> None:
        super().__init__(what)
        self.what, self.advice = what, advice


class MarkerOutlet:
    """One JSON string per event: ``event``, ``stamp_ns`` of the session clock, and the event's fields.

    Sends labelled marks, protocol steps, and start, pause and end of the recording; with ``words``, every event with
    all texts. The sample's timestamp is the same moment on LSL's clock. One thread.
    """

    def __init__(self) -> None:
        """Raises OutletUnavailableError if the library is missing or does not work."""
        try:
            import pylsl
        except (ImportError, RuntimeError, OSError) as error:
            # Without its native library the package raises RuntimeError, or OSError if it does not load.
            _log.warning("pylsl: %s", error)
            raise OutletUnavailableError(
                QT_TR_NOOP("No markers are sent: Lab Streaming Layer is not installed."),
                QT_TR_NOOP("Install it (pip install pylsl), then start the recording again."),
            ) from error
        try:
            info = pylsl.StreamInfo(STREAM_NAME, STREAM_TYPE, 1, pylsl.IRREGULAR_RATE, pylsl.cf_string, _SOURCE_ID)
            info.desc().append_child_value("manufacturer", "CARIS Desktop")
            info.desc().append_child_value("format", "one JSON object per event, with stamp_ns of the session clock")
            self._outlet: Any = pylsl.StreamOutlet(info)
        except (RuntimeError, OSError) as error:
            _log.exception("the outlet does not open")
            raise OutletUnavailableError(
                localized(
                    QT_TR_NOOP("No markers are sent: the Lab Streaming Layer outlet could not be opened ({error})."),
                    error=error,
                ),
                QT_TR_NOOP("Check this computer's network, then start the recording again."),
            ) from error
        self._lsl_clock = pylsl.local_clock
        self.words = False
        self._lsl_minus_session_s = 0.0
        self._measured_ns = 0
        self._measure()

    def offer(self, spec: StreamSpec, value: Any) -> None:
        """Send ``value`` if it is an event for markers.

        Raises OutletUnavailableError on failure, with the outlet closed.
        """
        if spec.delivery is not Delivery.LOSSLESS or isinstance(value, _NOT_SENT):
            return
        if not self.words and type(value) not in _WITHOUT_WORDS:
            return
        try:
            self._send(spec, value)
        except Exception as error:
            # An exception in a foreign library must not end the recording.
            _log.exception("%s is not sent", spec.name)
            self.close()
            raise OutletUnavailableError(
                localized(QT_TR_NOOP("Markers are no longer sent: Lab Streaming Layer failed ({error})."), error=error),
                QT_TR_NOOP("Check this computer's network, then start the recording again."),
            ) from error

    def _send(self, spec: StreamSpec, value: Any) -> None:
        if clock.now_ns() - self._measured_ns > _MEASURE_EVERY_NS:
            self._measure()
        fields = _shortened(to_jsonable(value))
        if not self.words:
            fields = {name: fields[name] for name in _WITHOUT_WORDS[type(value)]}
        marker = json.dumps({"event": spec.name.removeprefix("event/"), **fields}, ensure_ascii=False)
        text = marker.encode("utf-8", "replace").decode("utf-8")
        self._outlet.push_sample([text], value.stamp_ns / 1e9 + self._lsl_minus_session_s)

    def close(self) -> None:
        """Remove the stream from the network."""
        self._outlet = None

    def _measure(self) -> None:
        """Measure the clock offset; of several readings, the one with the shortest duration counts."""
        readings = []
        for _ in range(_TRIES):
            before_ns = clock.now_ns()
            lsl_s = self._lsl_clock()
            after_ns = clock.now_ns()
            readings.append((after_ns - before_ns, lsl_s - (before_ns + after_ns) / 2e9))
        self._lsl_minus_session_s = min(readings)[1]
        self._measured_ns = clock.now_ns()


def _shortened(value: Any) -> Any:
    """Shorten long texts at any depth, such as the prompt in an exchange."""
    if isinstance(value, str):
        return f"{value[:_LONGEST_TEXT]}…" if len(value) > _LONGEST_TEXT else value
    if isinstance(value, dict):
        return {key: _shortened(item) for key, item in value.items()}
    return [_shortened(item) for item in value] if isinstance(value, list) else value


_log = logging.getLogger(__name__)
_TICK_S = 0.05
_IDLE_TICK_S = 0.5
_REPORT_EVERY_NS = 1_000_000_000
# Timeout for checksums of large sessions at exit.
_FINISH_WITHIN_S = 60.0
_FINISH_NICENESS = 10


def run_recorder(
    connection: Connection,
    frames: FrameReader,
    limits: DiskLimits | None = None,
    encoders: Encoders | None = None,
    *,
    covering: Covering,
) -> None:
    """Process entry point: record what ``connection`` delivers until it closes; see ``recording.messages``.

    One process records any number of sessions in sequence. If the connection closes during a session, the session ends
    with the reason ``console_closed``. ``covering`` blurs people where demanded.
    """
    _Recorder(connection, frames, limits or DiskLimits(), encoders or Encoders(), covering).run()


class _Recorder:
    def __init__(
        self, connection: Connection, frames: FrameReader, limits: DiskLimits, encoders: Encoders, covering: Covering
    ) -> None:
        self._connection = connection
        self._frames = frames
        self._limits = limits
        self._encoders = encoders
        self._blurring = Blurring(covering)
        self._session: SessionRecorder | None = None
        self._outlet: MarkerOutlet | None = None
        self._finishing: list[threading.Thread] = []
        self._hurry = threading.Event()
        self._reported_ns = 0
        self._console_lost = False
        self._terminated = False

    def run(self) -> None:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, self._on_terminate)
        _import_writers()
        threading.Thread(target=self._encoders.probe, name="probe-encoders", daemon=True).start()
        try:
            while not self._terminated and self._serve_one():
                pass
        finally:
            self._stop("console_closed", CONSOLE, clock.now_ns())
            self._offer_markers(offered=False, words=False)
            self._finish_all()

    def _on_terminate(self, _number: int, _frame: object) -> None:
        """A console that exits in haste terminates its processes: close the session between two writes."""
        self._terminated = True

    def _serve_one(self) -> bool:
        """Handle one message, if any arrives within a tick. False when the connection is closed."""
        raw = None
        try:
            idle = self._session is None and not self._blurring.waits
            if self._connection.poll(_IDLE_TICK_S if idle else _TICK_S):
                raw = self._connection.recv_bytes()
        except (EOFError, OSError):
            return False
        if raw is not None:
            self._handle_raw(raw)
        session = self._session
        self._blurring.go_on(clock.now_ns())
        if session is not None:
            session.tick()
            if session.full:
                self._give_up(session)
            elif time.monotonic_ns() - self._reported_ns >= _REPORT_EVERY_NS:
                self._send_report(session.status())
        return True

    def _handle_raw(self, raw: bytes) -> None:
        """Handle one raw message: a pickle, optionally prefixed with its arrival time."""
        arrived_ns, begin = clock.now_ns(), 0
        if raw[:1] == ARRIVED:
            arrived_ns, begin = int.from_bytes(raw[1:9], "little", signed=True), 9
        try:
            message = pickle.loads(memoryview(raw)[begin:])  # noqa: S301 - from our own console, over a private pipe
        except Exception:
            # An undecodable value must not end the session; which one it was is unknown.
            _log.exception("a message of the console could not be read")
            if self._session is not None:
                self._session.note_unreadable()
            return
        self._handle(message, arrived_ns)

    def _handle(self, message: Any, arrived_ns: int) -> None:
        match message:
            case StartRecording():
                self._stop("wizard", message.actor, arrived_ns)
                self._start(message, arrived_ns)
            case StopRecording():
                self._stop(message.reason, message.actor, arrived_ns)
            case PauseRecording():
                if self._session is not None:
                    self._session.pause(paused=message.paused, at_ns=arrived_ns, actor=message.actor)
                    self._send_report(self._session.status())
            case TakePhoto():
                if self._session is None:
                    self._store_photo(message)
                else:
                    self._session.take_photo(message)
            case SetRecordingPermissions():
                if self._session is not None:
                    self._session.set_permissions(
                        video=message.video, photos=message.photos, audio=message.audio, blur=message.blur
                    )
            case UseConsents():
                self._blurring.use_consents(message)
            case OfferMarkers():
                self._report_outlet(self._offer_markers(offered=message.offered, words=message.words))
            case _:
                if isinstance(message, People):
                    self._blurring.add_detections(message, clock.now_ns())
                if self._session is not None:
                    self._session.write(message, arrived_ns)

    def _store_photo(self, request: TakePhoto) -> None:
        """Save a photo without a session: nothing else needs this process then."""
        image_bgr = self._frames.read(request.ref)
        if image_bgr is None:
            self._report_problem(QT_TR_NOOP("No photo was taken."), *IMAGE_LOST, "warning", cause=ANSWER)
            return
        self._blurring.use_demand(request.blur)
        self._blurring.add(
            request.ref, image_bgr, clock.now_ns(), lambda covered: self._write_photo(request, covered), photo=True
        )

    def _write_photo(self, request: TakePhoto, image_bgr: NDArray[np.uint8]) -> None:
        try:
            path = request.without_session
            # Two photos within a second.
            path = path.with_name(free_name(path.stem, path.suffix, lambda name: path.with_name(name).exists()))
            write_photo(image_bgr, path, texts=texts_for(request, _utc(request.ref)))
        except (OSError, ValueError) as error:
            _log.exception("photo %s", request.without_session)
            self._report_problem(
                QT_TR_NOOP("The photo could not be saved."),
                localized(
                    QT_TR_NOOP("{parent} cannot be written to ({error})."),
                    parent=request.without_session.parent,
                    error=error,
                ),
                QT_TR_NOOP("Free some disk space, or make the study folder writable, then take the photo again."),
                cause=ANSWER,
            )
            return
        self._send(photo_event(request, f"{path.parent.name}/{path.name}"))

    def _start(self, start: StartRecording, started_ns: int) -> None:
        unavailable = self._offer_markers(offered=start.lsl, words=start.lsl_words)
        try:
            session = SessionRecorder(
                start,
                frames=self._frames,
                report=self._send,
                limits=self._limits,
                encoders=self._encoders,
                offer=self._offer if self._outlet is not None else None,
                started_ns=started_ns,
                blurring=self._blurring,
            )
        except OSError as error:
            _log.exception("no session in %s", start.folder)
            what, meaning, advice = explain_start_error(error, start.folder)
            self._report_problem(what, meaning, advice)
            self._send_report(RecorderReport(clock.now_ns(), "failed", start.folder, detail=what))
            return
        self._session = session
        self._report_outlet(unavailable)
        self._send_report(session.status())

    def _stop(self, reason: str, actor: Actor, at_ns: int) -> None:
        session, self._session = self._session, None
        if session is None:
            return
        session.end(reason, actor, at_ns)
        self._send_report(replace(session.status(), state="idle"))
        self._finish(session)

    def _give_up(self, session: SessionRecorder) -> None:
        self._session = None
        message = session.give_up()
        self._send_report(replace(session.status(), state="failed", detail=message))
        self._finish(session)

    # Work after a session

    def _finish(self, session: SessionRecorder) -> None:
        """Compute checksums of gigabytes in a thread: the next session can begin meanwhile."""

        def finish() -> None:
            if sys.platform == "linux":
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _FINISH_NICENESS)
            session.finish(may_go_on=lambda: not self._hurry.is_set())

        self._finishing = [thread for thread in self._finishing if thread.is_alive()]
        self._finishing.append(threading.Thread(target=finish, name="finish-session", daemon=True))
        self._finishing[-1].start()

    def _finish_all(self) -> None:
        deadline_s = time.monotonic() + _FINISH_WITHIN_S
        waiting = [thread for thread in self._finishing if thread.is_alive()]
        if waiting:
            _log.info("waiting up to %.0f s for the checksums of %d sessions", _FINISH_WITHIN_S, len(waiting))
        for thread in waiting:
            thread.join(max(0.0, deadline_s - time.monotonic()))
        self._hurry.set()
        for thread in waiting:
            thread.join(1.0)

    # Markers for others

    def _offer_markers(self, *, offered: bool, words: bool) -> OutletUnavailableError | None:
        """Open or close the outlet; return the error if it does not open."""
        if not offered and self._outlet is not None:
            self._outlet.close()
            self._outlet = None
        if offered and self._outlet is None:
            try:
                self._outlet = MarkerOutlet()
            except OutletUnavailableError as error:
                return error
        if self._outlet is not None:
            self._outlet.words = words
        return None

    def _offer(self, spec: StreamSpec, value: Any) -> None:
        if self._outlet is None:
            return
        try:
            self._outlet.offer(spec, value)
        except OutletUnavailableError as error:
            self._outlet = None
            self._report_outlet(error)

    def _report_outlet(self, error: OutletUnavailableError | None) -> None:
        if error is None:
            return
        meaning = QT_TR_NOOP("Everything is still recorded here; other recorders do not receive markers.")
        if self._session is not None:
            self._session.problem("warning", error.what, meaning, error.advice)
        else:
            self._send(Problem(clock.now_ns(), "warning", error.what, meaning, error.advice))

    # To the console

    def _report_problem(
        self, what: str, meaning: str, advice: str, severity: Severity = "error", *, cause: str = ""
    ) -> None:
        self._send(Problem(clock.now_ns(), severity, what, meaning, advice, "recording", cause))

    def _send_report(self, report: RecorderReport) -> None:
        self._reported_ns = time.monotonic_ns()
        self._send(report)

    def _send(self, message: Any) -> None:
        try:
            self._connection.send(message)
        except OSError:
            # The console has ended, but the session must still be closed properly.
            if not self._console_lost:
                _log.warning("the console no longer listens")
            self._console_lost = True


def _utc(ref: FrameRef) -> str:
    return SessionClock(ClockAnchor.take(), ref.stamp_ns).utc(ref.stamp_ns)


def _import_writers() -> None:
    """Import before the first session, so that its first frames are not lost to imports."""
    import av  # noqa: F401 - for its side effect, as said above
    import cv2  # noqa: F401 - likewise
    import zstandard  # noqa: F401 - likewise
