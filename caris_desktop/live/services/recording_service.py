"""Recording service: recorder process and current session. GUI thread unless stated otherwise."""

import logging
import pickle
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import ANSWER, Event, Gap, Problem, UtteranceChanged
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.sensing import AudioChunk, FrameRef, People
from caris_desktop.domain.streams import BY_TYPE, STREAMS_OF_LINK, Delivery, streams_voided_by
from caris_desktop.domain.translation import QT_TR_NOOP, localized, tr
from caris_desktop.live.child_process import ChildProcess, ProcessSpec, RingsToRead
from caris_desktop.live.service import ContextService, Restarts, ServiceContext
from caris_desktop.live.speech_queue import addressee
from caris_desktop.live.status import IN_SESSION
from caris_desktop.people.presence import PersonRow
from caris_desktop.recording.recorder.recorder_messages import (
    ARRIVED,
    BlurDemand,
    OfferMarkers,
    PauseRecording,
    RecorderReport,
    SetRecordingPermissions,
    StartRecording,
    StopRecording,
    TakePhoto,
    UseConsents,
)
from caris_desktop.recording.session.session_header import SessionHeader
from caris_desktop.scenario.scenario_model import Scenario

# Feed of all events and values to the recorder process: queue bounded in bytes, before any conflation.

MAX_QUEUED_BYTES = 64 * 1024 * 1024
VERDICTS_WITHIN_S = 6.0
"""Maximum wait at the end of a session for transcripts of earlier turns: a pass of the recogniser on a busy machine
takes 2 to 4 s.
"""


class RecorderFeed:
    """Queue from any thread to one writer thread, with arrival times.

    If the recorder falls behind by ``max_bytes``, state values and frames are dropped and counted; events are still
    queued. The count follows in a ``Gap`` event once there is room.

    A heard turn is announced at its start, with speaker and transcript later. At the end of a recording, and in a
    pause, these still pass for earlier turns; the end waits for them up to ``verdicts_within_s``.
    """

    def __init__(
        self, recorder: ChildProcess, *, max_bytes: int = MAX_QUEUED_BYTES, verdicts_within_s: float = VERDICTS_WITHIN_S
    ) -> None:
        self._recorder = recorder
        self._max_bytes = max_bytes
        self._verdicts_within_s = verdicts_within_s
        self._open_turns: set[str] = set()
        self._nothing_since_ns = 0
        self._stop: Any = None
        self._stop_ns = 0
        self._stop_by_s = 0.0
        self._queue: deque[bytes] = deque()
        self._queued_bytes = 0
        self._dropped: dict[str, int] = {}
        self._recording = False
        self._paused = False
        self._ended = False
        self._latched: dict[str, bytes] = {}
        self._held: list[bytes] | None = None
        self._held_ns = 0
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._write, name="recorder-feed", daemon=True)
        self._thread.start()

    def put(self, value: Any, raw: bytes | None = None) -> None:
        """Queue a value; ``raw`` is its pickled form if available."""
        spec = BY_TYPE[type(value)]
        if isinstance(value, UtteranceChanged) and value.origin == "heard":
            self._put_utterance(value, raw)
            return
        if not (self._recording or spec.latched):
            return
        if raw is None:
            raw = pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)
        with self._changed:
            if spec.latched:
                self._latched[spec.key_of(value)] = raw
            if not self._recording or self._paused:
                return
            if spec.delivery is not Delivery.LOSSLESS and self._queued_bytes + len(raw) > self._max_bytes:
                name = "audio" if isinstance(value, AudioChunk) else spec.name
                self._dropped[name] = self._dropped.get(name, 0) + 1
                return
            self._append(raw)

    def _put_utterance(self, turn: UtteranceChanged, raw: bytes | None) -> None:
        with self._changed:
            known = turn.utterance_id in self._open_turns
            over = turn.state not in ("requested", "started")
            if self._recording and not self._paused:
                if not over:
                    self._open_turns.add(turn.utterance_id)
            elif not known:
                return
            elif turn.stamp_ns > self._nothing_since_ns:
                turn, raw = replace(turn, stamp_ns=self._nothing_since_ns), None
            self._append(pickle.dumps(turn, protocol=pickle.HIGHEST_PROTOCOL) if raw is None else raw)
            if over:
                self._open_turns.discard(turn.utterance_id)
                if not self._open_turns:
                    self._send_stop()

    @property
    def records(self) -> bool:
        """Whether a recording is running, possibly paused."""
        return self._recording

    @property
    def holds(self) -> bool:
        """Whether values are held until ``begin``."""
        return self._held is not None

    def hold(self, *events: Any) -> None:
        """Hold values for a recording about to begin, after the latched values and ``events``."""
        with self._changed:
            self._send_stop()
            self._open_turns.clear()
            self._recording, self._paused = True, False
            self._held, self._held_ns = [], clock.now_ns()
            self._append_all(*events)

    def begin(self, message: Any) -> None:
        """Send ``message`` with the time of ``hold``, then all held values."""
        with self._changed:
            held, self._held = self._held or [], None
            self._append(pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL), arrived_ns=self._held_ns)
            self._queue.extend(held)

    def drop(self) -> None:
        """Discard held values: the recording does not begin."""
        with self._changed:
            self._recording = False
            self._open_turns.clear()
            self._queued_bytes -= sum(map(len, self._held or []))
            self._held = None

    def pause(self, message: Any, *events: Any, paused: bool) -> None:
        """Pause or resume; resuming sends ``message``, the latched values and ``events``."""
        with self._changed:
            if not self._recording or self._paused == paused:
                return
            self._paused = paused
            if paused:
                self._nothing_since_ns = clock.now_ns()
                self._append_gaps()
                self._append(pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL))
            else:
                self._append(pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL))
                self._append_all(*events)

    def forget_streams(self, names: Iterable[str]) -> None:
        """Drop latched values of these streams of a lost link or robot."""
        with self._changed:
            forgotten = {f"/{name}" for name in names}
            self._latched = {key: raw for key, raw in self._latched.items() if f"/{key.split('/')[1]}" not in forgotten}

    def stop(self, message: Any) -> None:
        """End the recording: queued values and pending transcripts are still written; then ``message``, with the
        current time.
        """
        with self._changed:
            if self._recording and not self._paused:
                self._nothing_since_ns = clock.now_ns()
                self._append_gaps()
            self._recording = False
            self._stop, self._stop_by_s = message, time.monotonic() + self._verdicts_within_s
            self._stop_ns = clock.now_ns()
            if self._open_turns:
                self._changed.notify()  # limits the thread's wait
            else:
                self._send_stop()

    def _send_stop(self) -> None:
        message, self._stop = self._stop, None
        if message is not None:
            self._open_turns.clear()
            self._append(pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL), arrived_ns=self._stop_ns)

    def end(self) -> None:
        """The recorder has ended the session: record nothing more."""
        with self._changed:
            self._recording = False
            self._stop = None
            self._open_turns.clear()

    def use_recorder(self, recorder: ChildProcess) -> None:
        """Switch to a new recorder process. The session of the former one is lost; queued values are dropped, except
        those held for a session that it had not started.
        """
        with self._changed:
            self._recorder = recorder
            self._recording = self.holds
            self._stop = None
            self._forget()

    def request(self, message: Any) -> None:
        """Send a request to the recorder, such as a photo, ahead of a recording about to begin."""
        with self._changed:
            held, self._held = self._held, None
            self._append(pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL))
            self._held = held

    def close(self, *, timeout_s: float = 30.0) -> None:
        """Write the queue, which may be long with a slow disk, and end the thread."""
        with self._changed:
            self._send_stop()
            self._ended = True
            self._recording = False
            self._changed.notify()
        self._thread.join(timeout_s)

    def _append_all(self, *events: Any) -> None:
        for raw in self._latched.values():
            self._append(raw)
        for event in events:
            self._append(pickle.dumps(event, protocol=pickle.HIGHEST_PROTOCOL))

    def _append_gaps(self) -> None:
        for stream, count in self._dropped.items():
            gap = Gap(clock.now_ns(), stream, count, QT_TR_NOOP("the recorder could not keep up"))
            self._append(pickle.dumps(gap, protocol=pickle.HIGHEST_PROTOCOL))
        self._dropped.clear()

    def _append(self, raw: bytes, *, arrived_ns: int | None = None) -> None:
        arrived_ns = clock.now_ns() if arrived_ns is None else arrived_ns
        raw = ARRIVED + arrived_ns.to_bytes(8, "little", signed=True) + raw
        (self._queue if self._held is None else self._held).append(raw)
        self._queued_bytes += len(raw)
        self._changed.notify()

    def _write(self) -> None:
        while True:
            with self._changed:
                while not self._queue and not self._ended:
                    left_s = None if self._stop is None else self._stop_by_s - time.monotonic()
                    if left_s is not None and left_s <= 0:
                        self._send_stop()
                    else:
                        self._changed.wait(left_s)
                if not self._queue:
                    return
                recorder = self._recorder
                raw = self._queue.popleft()
                self._queued_bytes -= len(raw)
                if self._queued_bytes < self._max_bytes // 2:
                    self._append_gaps()
            if not recorder.send_raw_waiting(raw):
                with self._changed:
                    if recorder is self._recorder:
                        _log.error("the recorder is gone: %d values were not handed over", len(self._queue) + 1)
                        self._recording = self.holds
                        self._forget()
                    if self._ended:
                        return

    def _forget(self) -> None:
        self._queue.clear()
        self._queued_bytes = sum(map(len, self._held or []))
        self._dropped.clear()


_log = logging.getLogger(__name__)
# The recorder limits itself to a minute for checksums, and logs when it gives up.
_CLOSE_WITHIN_S = 65.0
ACTIVE = ("starting", "recording", "paused")


class RecordingService(ContextService):
    """Starts and ends sessions, forwards all values to the recorder, and maintains ``state.recording``."""

    def __init__(self, context: ServiceContext, body: ProcessSpec, *, rings: RingsToRead) -> None:
        super().__init__(context)
        self._body = replace(body, arguments=(*body.arguments, rings))
        self._problem = self._bus.problem
        self._bus.tap(self.put)
        self._state.persons.changed.connect(self._on_persons_changed)
        self._recorder = self._new_recorder()
        self._feed = RecorderFeed(self._recorder)
        self.session_folder: Path | None = None
        """Folder of the current session, or of the last one."""
        self._making_folder = False
        self._video = self._audio = False
        self._markers_offered = OfferMarkers(False)
        self._blur = BlurDemand()
        self._consents = UseConsents()
        self._restarts = Restarts()
        self._started = False

    def _new_recorder(self) -> ChildProcess:
        return self._children.new(self._body, ended=self._on_ended, on_message=self.on_report, reads=self._read)

    def _read(self, value: Any, _raw: bytes) -> None:  # reader thread
        if isinstance(value, RecorderReport):
            self._children.call_in_gui(self.on_report, value)
        else:
            self._bus.publish_recorded(value)

    @property
    def idle(self) -> bool:
        return self._state.recording.value.state not in IN_SESSION

    def processes(self) -> dict[str, ChildProcess]:
        return {"recorder": self._recorder}

    def restarts(self) -> dict[str, Restarts]:
        return {"recorder": self._restarts}

    def start(self) -> None:
        self._started = True
        self._recorder.start()
        self._report_consents()
        self._offer_markers(self._scenario)

    def put(self, value: Any, raw: bytes | None = None) -> None:
        """Record a domain value; ``raw`` is its pickled form if available. Any thread."""
        if isinstance(value, FrameRef) and not self._video:
            return
        if isinstance(value, AudioChunk) and not self._audio:
            return
        if isinstance(value, People) and self._blur.who != "nobody" and not self._feed.records:
            self._feed.request(value)  # a photo may wait for it
            return
        voided = streams_voided_by(value)
        if voided:
            self._feed.forget_streams(voided)
        if isinstance(value, Problem):
            value, raw = _without_home(value), None
        self._feed.put(value, raw)

    def forget_robot(self) -> None:
        """Reset for another robot: values of the former one must not start the next recording."""
        for names in (*STREAMS_OF_LINK.values(), ("lens",)):
            self._feed.forget_streams(names)

    # Sessions

    def announce_session(self, opened: Sequence[Event]) -> bool:
        """Announce a recording: ``opened`` are its initial events, and later values are included. Can be abandoned
        until ``begin_session``. False if refused, with a reported reason if there is one.
        """
        if not self.idle:
            return False
        if self._restarts.exhausted:
            self._state.recording.update(state="failed")
            self._problem(
                "error", tr("The recorder failed too often."), tr("Nothing is recorded."), tr("Restart the program.")
            )
            return False
        self.session_folder = None
        self._audio = self._scenario.permissions.audio_recording
        now_ns = clock.now_ns()
        self._state.recording.update(state="starting", folder=None, started_ns=now_ns, detail="")
        self._feed.hold(*opened)
        return True

    def begin_session(
        self, new_session: Callable[[], tuple[Path, SessionHeader]], actor: Actor, *, refused: Callable[[], None]
    ) -> None:
        """Create the folder of the announced session and record into it; ``refused`` is called on failure.

        ``new_session`` raises UserFacingError in English, for the record; ``tr`` localises it.
        """
        if not self._feed.holds or self._making_folder:
            return
        self._making_folder = True

        def failed(failure: UserFacingError) -> None:
            self._making_folder = self._audio = False
            self._feed.drop()
            self._state.recording.update(state="failed", detail=failure.what)
            self._problem("error", tr(failure.what), tr(failure.meaning), tr(failure.advice), until="recording")
            refused()

        self._slow_work.do(lambda: _made(new_session), lambda made: self._on_folder_made(*made, actor), failed)

    def _on_folder_made(self, folder: Path, header: SessionHeader, actor: Actor) -> None:
        self._making_folder = False
        if not self._feed.holds:
            return  # the recorder failed too often meanwhile
        self.session_folder = folder
        permissions, recording = self._scenario.permissions, self._scenario.recording
        # No video before: frames would have left the ring. A session that ended meanwhile has what came until then.
        self._video = permissions.video_recording and self._state.recording.value.state == "starting"
        self._state.recording.update(folder=folder)
        self._feed.begin(
            StartRecording(
                folder,
                header,
                video=permissions.video_recording,
                photos=permissions.photos,
                audio=permissions.audio_recording,
                lsl=recording.lsl,
                lsl_words=recording.lsl_words,
                actor=actor,
                blur=self._blur,
            )
        )

    def stop_session(self, reason: str = "wizard", actor: Actor = CONSOLE) -> None:
        if self._state.recording.value.state not in ACTIVE:
            return
        self._video = self._audio = False
        if self._feed.holds and not self._making_folder:
            self._feed.drop()
            self._state.recording.update(state="idle")
            return
        self._state.recording.update(state="stopping")
        self._feed.stop(StopRecording(reason, actor))

    def pause_session(self, opened: Sequence[Event], intent: intents.PauseRecording) -> None:
        """Pause or resume. ``opened``: current state for the record, which misses changes during a pause."""
        if self._state.recording.value.state in ("recording", "paused"):
            standing = () if intent.paused else opened
            self._feed.pause(PauseRecording(intent.paused, intent.actor), *standing, paused=intent.paused)

    def use_scenario(self, scenario: Scenario) -> None:
        """Apply permissions at once, also to a running session."""
        self._scenario = scenario
        self._blur = BlurDemand(scenario.blur.who, scenario.blur.what)
        if not self._started:
            return
        self._offer_markers(scenario)
        recording = self._state.recording.value.state in ACTIVE
        permissions = scenario.permissions
        self._audio = recording and permissions.audio_recording
        recording = recording and not self._feed.holds  # otherwise it begins with the permissions of that time
        self._video = recording and permissions.video_recording
        if recording:
            self._feed.request(
                SetRecordingPermissions(
                    video=permissions.video_recording,
                    photos=permissions.photos,
                    audio=permissions.audio_recording,
                    blur=self._blur,
                )
            )

    def _offer_markers(self, scenario: Scenario) -> None:
        """Offer the marker outlet before the recording, for recorders of physiological data."""
        offer = OfferMarkers(scenario.recording.lsl, words=scenario.recording.lsl_words)
        if offer != self._markers_offered:
            self._markers_offered = offer
            self._feed.request(offer)

    def take_photo(self, *, without_session: Path, actor: Actor = CONSOLE) -> None:
        """Save the newest frame with the session, or as ``without_session`` if there is none."""
        ref = self._state.frame.value
        if ref is None:
            self._problem(
                "warning",
                tr("No photo was taken."),
                tr("There is no video from the camera."),
                tr("Take the photo when the video is back."),
                until="picture",
                cause=ANSWER,
            )
            return
        state = self._state
        people: People | None = state.people.value if state.people.freshness == "fresh" else None
        person_ids = (
            () if people is None else tuple(dict.fromkeys(box.person_id for box in people.boxes if box.person_id))
        )
        pose = state.pose.value.pose_in_map if state.pose.freshness == "fresh" else None
        self._feed.request(TakePhoto(ref, without_session, actor, self._blur, addressee(state), person_ids, pose))

    def _on_persons_changed(self, persons: tuple[PersonRow, ...]) -> None:
        """Update consents: consenting people stay unblurred where only others must be blurred."""
        consents = UseConsents(
            frozenset(person.person_id for person in persons if "video" in person.consents),
            frozenset(person.person_id for person in persons if "photo" in person.consents),
        )
        if consents != self._consents:
            self._consents = consents
            if self._started:
                self._feed.request(consents)

    def _report_consents(self) -> None:
        """Send the consents to a new recorder, which starts without any."""
        if self._consents != UseConsents():
            self._feed.request(self._consents)

    # Recorder messages

    def on_report(self, report: RecorderReport) -> None:
        if self._state.recording.value.state == "stopping" and report.state not in ("idle", "failed"):
            return  # sent before the end was requested
        self._state.recording.update(
            state=report.state,
            written_bytes=report.written_bytes,
            free_bytes=report.free_bytes,
            detail=report.detail,
            bytes_per_s=report.bytes_per_s,
            room_s=report.room_s,
            dropped=report.dropped,
            covered_whole=report.covered_whole,
        )
        if report.state in ("idle", "failed"):
            self._video = self._audio = False
            self._feed.end()

    def _on_ended(self, child: ChildProcess) -> None:
        """Replace the recorder, unless it failed too often."""
        if child is not self._recorder:
            return
        interrupted = not self.idle
        # Restarted before the report, which belongs into the new recorder's session.
        again = self._restarts.another()
        if again:
            self._recorder = self._new_recorder()
            self._recorder.start()
        self._feed.use_recorder(self._recorder)
        if again:
            self._report_consents()
        if self._feed.holds and again:
            return  # the announced session begins with the new recorder
        self._feed.drop()
        self._video = self._audio = False
        self._state.recording.update(
            state="failed" if interrupted or not again else "idle", detail=QT_TR_NOOP("the recorder stopped")
        )
        self._problem(
            "error",
            tr("The recorder stopped unexpectedly."),
            tr("The session so far is saved on disk; nothing is recorded from now on.")
            if interrupted
            else tr("No session was being recorded."),
            tr("Start recording again to create a new session.")
            if again
            else tr("Restart the program to record again."),
            until="recording",
        )

    # Shutdown

    def end(self) -> None:
        """Write the queue and end the recorder, which computes checksums first: a minute for hours of video."""
        self._feed.close()
        self._recorder.stop(grace_s=_CLOSE_WITHIN_S)


def _made(new_session: Callable[[], tuple[Path, SessionHeader]]) -> tuple[Path, SessionHeader]:
    """Create a session folder. Raises UserFacingError."""
    try:
        return new_session()
    except UserFacingError:
        raise
    except Exception as error:
        _log.exception("a session was not begun")
        raise UserFacingError(
            QT_TR_NOOP("The session folder could not be created."),
            localized(QT_TR_NOOP("Nothing is recorded ({error})."), error=f"{type(error).__name__}: {error}"),
            QT_TR_NOOP("Start recording again; the log has the details."),
        ) from error


def _without_home(problem: Problem) -> Problem:
    """The problem without home folder: paths in messages must not identify the user in the record."""
    home = str(Path.home())
    return replace(
        problem,
        what=problem.what.replace(home, "~"),
        meaning=problem.meaning.replace(home, "~"),
        advice=problem.advice.replace(home, "~"),
    )
