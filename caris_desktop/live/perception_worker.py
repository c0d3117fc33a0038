"""Perception worker: sends the newest camera frames to the inference process, and turns its tracks into people.

Runs in a QThread. A native crash of the detector ends only its process: the worker reports it and restarts the process.
"""

import logging
import queue
import threading
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from PySide6.QtCore import QObject, QThread, Signal, Slot

from caris_desktop.domain import clock
from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.events import Event, Problem
from caris_desktop.domain.person_values import PersonLooks, PersonPortrait
from caris_desktop.domain.plugins import Plugin, PluginCall, PluginFailed, switched_off
from caris_desktop.domain.ports import ValueSink
from caris_desktop.domain.sensing import (
    CameraLens,
    DepthGrid,
    FrameRef,
    HeadState,
    LaserScan,
    Odometry,
    People,
    RobotPose,
)
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.child_process import ChildProcess, ProcessSpec
from caris_desktop.live.process_manager import PluginWatch, localize_problem
from caris_desktop.live.service import Restarts
from caris_desktop.live.status import PerceptionStatus, PersonHistory
from caris_desktop.people.decisions import PeopleIntent
from caris_desktop.people.location import PeopleLocator
from caris_desktop.people.presence import HistoryEvent, PersonRow, PresenceTracker, RecognitionSettings
from caris_desktop.people.visit_log import Portraits
from caris_desktop.perception.camera_schedule import (
    OTHERS_EVERY_NS,
    TO_COVER_EVERY_NS,
    CameraRotation,
    CameraTurning,
    DetectionRate,
)
from caris_desktop.perception.inference_messages import (
    DetectionRequest,
    DetectorAway,
    FrameSkipped,
    InferenceFailed,
    InferenceReady,
    InferenceSettings,
)

_log = logging.getLogger(__name__)
_TICK_S = 0.2
_ANSWER_WITHIN_NS = 5_000_000_000
_PACE_EVERY_NS = 1_000_000_000
_EVERYBODY_EVERY_NS = 1_000_000_000


class PerceptionWorker(QObject):
    """Perception worker. All methods but ``run``, the thread's main function, are thread-safe."""

    status_changed = Signal(object)  # PerceptionStatus
    persons_changed = Signal(object)  # tuple[PersonRow, ...]: people present
    everybody_changed = Signal(object)  # tuple[PersonRow, ...]: including former and known people
    history_found = Signal(object)  # PersonHistory

    def __init__(
        self,
        body: ProcessSpec,
        open_presence: Callable[[], tuple[PresenceTracker, list[Event]]],
        publish: ValueSink,
        portraits: Portraits | None = None,
    ) -> None:
        super().__init__()
        self._body = body
        self._open_presence = open_presence
        self._publish = publish
        self._portraits = Portraits() if portraits is None else portraits
        self._inputs: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._turns_lock = threading.Lock()
        self._turns = CameraRotation()
        self._detection_rates = DetectionRate()
        self._child: ChildProcess | None = None
        self.restarts = Restarts()
        self._status = PerceptionStatus()
        self._pace_reported_ns = 0
        self._detection_interval_ns = 0
        self._shown_persons: tuple[PersonRow, ...] = ()
        self._everybody_reported_ns = 0
        self._everybody: tuple[PersonRow, ...] = ()
        self._locator = PeopleLocator()
        self._turning = CameraTurning()
        self._cameras: dict[str, CameraModel] = {}
        self._faces = self._to_cover = False
        self._watch = PluginWatch()
        self._plugins_off: tuple[Plugin, ...] = ()

    @property
    def name(self) -> str:
        """Name of the inference process."""
        return self._body.name

    @property
    def child(self) -> ChildProcess | None:
        """Inference process, None if not running."""
        return self._child

    def use_body(self, body: ProcessSpec) -> None:
        """Restart inference with another detector or on another machine."""
        self._inputs.put(_UseBody(body))

    def offer(self, ref: FrameRef) -> None:
        """Offer a new frame, which replaces an unused one of its camera."""
        with self._turns_lock:
            detection_due = self._turns.offer(ref, now_ns=clock.now_ns())
        if detection_due:
            self._inputs.put(_FRAME_WAITS)

    def show_camera(self, name: str) -> None:
        """Set the camera on display: others get a lower detection rate."""
        with self._turns_lock:
            self._turns.show(name)

    def require_blurring(self, to_cover: bool) -> None:
        """Set whether people must be blurred in the recordings of all cameras."""
        self._to_cover = to_cover
        with self._turns_lock:
            self._turns.others_every_ns = TO_COVER_EVERY_NS if to_cover else OTHERS_EVERY_NS

    def limit_detection_rate(self, seconds: float) -> None:
        """Set a minimum interval between detections, to leave the processor to others."""
        self._detection_interval_ns = round(seconds * 1e9)

    def forget_cameras(self) -> None:
        """Reset for another robot: its cameras differ, and nobody is present."""
        with self._turns_lock:
            self._turns.forget()
        self._inputs.put(_FORGET)

    def offer_evidence(self, value: LaserScan | RobotPose | HeadState | Odometry | DepthGrid) -> None:
        """Add sensor data for people's positions and for camera motion."""
        if isinstance(value, HeadState | Odometry):
            self._turning.add(value)
        if not isinstance(value, Odometry):
            self._locator.add(value)

    def use_cameras(self, models: dict[str, CameraModel]) -> None:
        """Set the models of the robot's cameras by name; people in other cameras get no map position."""
        self._cameras = models

    def use_lens(self, lens: CameraLens) -> None:
        """Set a camera's reported lens model, which overrides the profile."""
        self._cameras = {**self._cameras, lens.camera: lens.model}

    def ask(self, intent: PeopleIntent) -> None:
        """Run a decision about people."""
        self._inputs.put(_IntentReceived(intent))

    def request_history(self, person_id: str, text: str) -> None:
        """Request a person's history; ``history_found`` delivers it."""
        self._inputs.put(_HistoryRequest(person_id, text))

    def recognise(self, settings: RecognitionSettings, *, may_decide: bool) -> None:
        """Set whom the console may recognise, and whether the wizard may name people."""
        self._inputs.put(_Recognise(settings, may_decide))

    def ask_consents_again(self, again: bool) -> None:
        """Set whether earlier consents need confirmation."""
        self._inputs.put(_AskConsents(again))

    def practise(self, on: bool) -> None:
        """Switch practice mode: people seen and named there stay separate from the study and discarded afterwards."""
        self._inputs.put(_Practise(on))

    def note(self, event: HistoryEvent) -> None:
        """Add an event to the history of the people present."""
        self._inputs.put(event)

    def stop(self) -> None:
        self._inputs.put(_STOP)

    @Slot()
    def run(self) -> None:
        try:
            self._run()
        except Exception:
            _log.exception("the perception worker failed")
            detail = QT_TR_NOOP("People are no longer recognised")
            self._set_status(replace(self._status, state="failed", detail=detail))
        finally:
            thread = self.thread()
            if isinstance(thread, QThread):
                thread.quit()

    def _run(self) -> None:
        presence, problems = self._open_presence()
        presence.portraits = self._portraits
        practising = False
        recognition, consents_again = _Recognise(RecognitionSettings(), True), False
        self._publish_all(problems)
        self._start_child()
        child = self._child
        ready = busy = False
        pending: FrameRef | None = None
        requested_ns = 0
        while True:
            try:
                item = self._inputs.get(timeout=_TICK_S)
            except queue.Empty:
                item = None
            if item is _STOP:
                break
            if isinstance(item, _UseBody) or (isinstance(item, PluginFailed) and item.plugin.group == "detectors"):
                if isinstance(item, _UseBody):
                    self._body, self.restarts = item.body, Restarts()
                else:
                    self._switch_off(item.plugin, item.reason)
                ready, busy, pending = False, False, None
                if child is not None:
                    child.stop(grace_s=2.0)
                self._publish_all(presence.restart_tracks(clock.now_ns()))
                self._start_child()
                child = self._child
            elif item is _FORGET:
                pending = None
                self._turning.forget()
                self._detection_rates.forget()
                self._publish_all(presence.restart_tracks(clock.now_ns()))
            elif isinstance(item, _IntentReceived):
                self._publish_all(presence.do(item.intent, clock.now_ns()))
            elif isinstance(item, _HistoryRequest):
                entries = presence.history(item.person_id, item.text)
                self.history_found.emit(PersonHistory(item.person_id, item.text, entries))
            elif isinstance(item, _Recognise):
                recognition = item
                presence.use_settings(item.settings, may_decide=item.may_decide)
                self._faces = item.settings.recognise == "faces"
            elif isinstance(item, _AskConsents):
                consents_again = item.again
                presence.ask_consents_again(item.again)
                self._everybody_reported_ns = 0
            elif isinstance(item, _Practise) and item.on != practising:
                practising = item.on
                self._publish_all(presence.restart_tracks(clock.now_ns()))
                presence.close()
                presence, problems = (PresenceTracker(), []) if practising else self._open_presence()
                presence.portraits = self._portraits
                presence.use_settings(recognition.settings, may_decide=recognition.may_decide)
                presence.ask_consents_again(consents_again)
                self._publish_all(problems)
                self._everybody_reported_ns = 0
            elif isinstance(item, HistoryEvent):
                presence.note(item)
            elif isinstance(item, PersonLooks):
                self._publish_all(presence.add_embeddings(item))
            elif isinstance(item, PersonPortrait):
                presence.add_portrait(item)
            elif isinstance(item, InferenceReady):
                ready, busy = True, False
                plugins = tuple(sorted((one.title, one.package) for one in item.plugins))
                self._set_status(
                    PerceptionStatus(
                        "ready", item.model, server=item.server, recognises=item.recognises, plugins=plugins
                    )
                )
            elif isinstance(item, InferenceFailed):
                self._publish(localize_problem(item.problem))
                self._set_status(PerceptionStatus(state="failed", detail=item.problem.what))
                ready = False
            elif isinstance(item, DetectorAway):
                self._publish(localize_problem(item.problem))
                self._set_status(replace(self._status, state="failed", detail=item.problem.what))
            elif isinstance(item, People):
                busy = False
                if self._status.state == "failed":  # the remote machine is back
                    self._set_status(replace(self._status, state="ready", detail=""))
                self._detection_rates.note(item.camera, now_ns=clock.now_ns())
                if pending is not None and (pending.camera, pending.sequence) == (item.camera, item.frame_sequence):
                    people, events = presence.update(item, clock.now_ns())
                    self._publish(people)
                    self._publish_all(events)
                    self._locate(people, presence)
                self._report_pace(item.inference_ms)
            elif isinstance(item, FrameSkipped):
                busy = False
            elif isinstance(item, PluginFailed):
                self._switch_off(item.plugin, item.reason)
            elif isinstance(item, Problem):
                self._publish(localize_problem(item))
            elif isinstance(item, _ChildEnded) and item.child is child:
                ready = busy = False
                child.stop(grace_s=0.0)
                self._publish_all(presence.restart_tracks(clock.now_ns()))
                self._child = None
                if (plugin := self._watch.called) is None:
                    self.restarts.after_end(self._report_ended, self._start_child)
                else:
                    self._switch_off(plugin, self._watch.blame)
                    self._start_child()
                child = self._child
                if child is None:
                    detail = QT_TR_NOOP("Stopped unexpectedly too often")
                    self._set_status(PerceptionStatus(state="failed", detail=detail))
            self._publish_all(presence.tick(clock.now_ns()))
            if busy and clock.now_ns() - requested_ns > _ANSWER_WITHIN_NS:
                busy = False
            if child is not None and self._watch.overdue:
                child.kill()
            rested = clock.now_ns() - requested_ns >= self._detection_interval_ns
            if ready and rested and not busy and child is not None:
                requested_ns = clock.now_ns()
                with self._turns_lock:
                    pending = self._turns.pop(now_ns=requested_ns)
                busy = pending is not None and child.send(self._detection_request(pending))
            self._show_persons(presence)
        if child is not None:
            child.stop(grace_s=2.0)
        presence.close()

    def _detection_request(self, frame: FrameRef) -> DetectionRequest:
        """Detection request; a camera that the robot does not carry does not rotate with it."""
        camera = self._cameras.get(frame.camera)
        if camera is None:
            return DetectionRequest(frame, faces=self._faces, to_cover=self._to_cover)
        direction = self._turning.direction(frame.shown_ns, on_head=camera.on_head)
        return DetectionRequest(frame, direction, camera.fx_px / camera.width_px, self._faces, self._to_cover)

    def _report_ended(self, advice: str) -> None:
        self._publish(
            Problem(
                clock.now_ns(),
                "warning",
                tr("People recognition stopped unexpectedly."),
                tr("Boxes and the People panel stay empty until it works again; the recording continues."),
                advice,
                until="people",
            )
        )

    def _switch_off(self, plugin: Plugin, reason: str) -> None:
        self._plugins_off += (plugin,)
        self._set_status(
            replace(self._status, plugins=tuple(each for each in self._status.plugins if each[0] != plugin.title))
        )
        self._publish(localize_problem(switched_off(clock.now_ns(), plugin.name, plugin.package, reason)))

    def _on_message(self, value: Any) -> None:
        """Receive a message, in the child's reader thread."""
        if isinstance(value, PluginCall):  # twice for each picture: the queue's work is not done for it
            self._watch.note(value)
        else:
            self._inputs.put(value)

    def _start_child(self) -> None:
        self._set_status(PerceptionStatus(state="loading"))
        self._watch = PluginWatch()
        arguments = (
            replace(each, plugins_off=self._plugins_off) if isinstance(each, InferenceSettings) else each
            for each in self._body.arguments
        )
        child = ChildProcess(
            replace(self._body, arguments=tuple(arguments)),
            on_message=lambda value, _raw: self._on_message(value),
            on_exit=lambda _code: self._inputs.put(_ChildEnded(child)),
        )
        child.start()
        self._child = child

    def _locate(self, people: People, presence: PresenceTracker) -> None:
        camera = self._cameras.get(people.camera)
        places = self._locator.locate(people, camera) if camera is not None else None
        if places is None:
            return
        self._publish(places)
        pose = self._locator.pose_at(people.stamp_ns)
        self._publish_all(presence.add_places(places, None if pose is None else pose.pose_in_map))

    def _publish_all(self, events: Iterable[Event]) -> None:
        for event in events:
            self._everybody_reported_ns = 0
            self._publish(event)

    def _set_status(self, status: PerceptionStatus) -> None:
        if status != self._status:
            self._status = status
            self.status_changed.emit(status)

    def _report_pace(self, inference_ms: float) -> None:
        """Update rates once a second: more frequent changes are illegible."""
        now_ns = clock.now_ns()
        if now_ns - self._pace_reported_ns >= _PACE_EVERY_NS:
            self._pace_reported_ns = now_ns
            looks_per_s = self._detection_rates.per_second(now_ns=now_ns)
            self._set_status(replace(self._status, inference_ms=inference_ms, looks_per_s=looks_per_s))

    def _show_persons(self, presence: PresenceTracker) -> None:
        rows = presence.persons()
        # For people present, the time of the last detection would change with every frame.
        shown = tuple(replace(row, last_seen_ns=0) if row.here else row for row in rows)
        if shown != self._shown_persons:
            self._shown_persons = shown
            self.persons_changed.emit(rows)
        now_ns = clock.now_ns()
        if now_ns - self._everybody_reported_ns >= _EVERYBODY_EVERY_NS:
            self._everybody_reported_ns = now_ns
            everybody = tuple(replace(row, last_seen_ns=0) if row.here else row for row in presence.everybody())
            if everybody != self._everybody:
                self._everybody = everybody
                self.everybody_changed.emit(everybody)


class _IntentReceived:
    def __init__(self, intent: PeopleIntent) -> None:
        self.intent = intent


class _HistoryRequest:
    def __init__(self, person_id: str, text: str) -> None:
        self.person_id, self.text = person_id, text


class _Recognise:
    def __init__(self, settings: RecognitionSettings, may_decide: bool) -> None:
        self.settings, self.may_decide = settings, may_decide


class _Practise:
    def __init__(self, on: bool) -> None:
        self.on = on


class _AskConsents:
    def __init__(self, again: bool) -> None:
        self.again = again


class _ChildEnded:
    def __init__(self, child: ChildProcess) -> None:
        self.child = child


class _UseBody:
    def __init__(self, body: ProcessSpec) -> None:
        self.body = body


_FRAME_WAITS = object()
_FORGET = object()
_STOP = object()
