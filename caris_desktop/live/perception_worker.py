"""Perception worker: sends the newest camera frames to the inference process, and turns its tracks into people.

Runs in a QThread. A native crash of the detector ends only its process: the worker reports it and restarts the process.
"""

import logging
import queue
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from functools import partial
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
from caris_desktop.live.service import PluginWatch, Restarts, localize_problem
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
        self._inputs: queue.SimpleQueue[Callable[[], object]] = queue.SimpleQueue()
        """What is to be done in the worker's thread."""
        self._presence: PresenceTracker
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
        self._recognition: tuple[RecognitionSettings, bool] = (RecognitionSettings(), True)
        self._consents_again = self._practising = self._stopped = False
        self._ready = self._busy = False
        self._pending: FrameRef | None = None
        self._requested_ns = 0

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
        self._inputs.put(partial(self._use_body, body))

    def offer(self, ref: FrameRef) -> None:
        """Offer a new frame, which replaces an unused one of its camera."""
        with self._turns_lock:
            detection_due = self._turns.offer(ref, now_ns=clock.now_ns())
        if detection_due:
            self._inputs.put(lambda: None)

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
        self._inputs.put(self._forget_cameras)

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
        self._inputs.put(lambda: self._publish_all(self._presence.do(intent, clock.now_ns())))

    def request_history(self, person_id: str, text: str) -> None:
        """Request a person's history; ``history_found`` delivers it."""
        self._inputs.put(
            lambda: self.history_found.emit(PersonHistory(person_id, text, self._presence.history(person_id, text)))
        )

    def recognise(self, settings: RecognitionSettings, *, may_decide: bool) -> None:
        """Set whom the console may recognise, and whether the wizard may name people."""
        self._inputs.put(partial(self._recognise, settings, may_decide))

    def ask_consents_again(self, again: bool) -> None:
        """Set whether earlier consents need confirmation."""
        self._inputs.put(partial(self._ask_consents_again, again))

    def practise(self, on: bool) -> None:
        """Switch practice mode: people seen and named there stay separate from the study and discarded afterwards."""
        self._inputs.put(partial(self._practise, on))

    def note(self, event: HistoryEvent) -> None:
        """Add an event to the history of the people present."""
        self._inputs.put(lambda: self._presence.note(event))

    def stop(self) -> None:
        def stop() -> None:
            self._stopped = True

        self._inputs.put(stop)

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
        self._open()
        self._start_child()
        while True:
            with suppress(queue.Empty):
                self._inputs.get(timeout=_TICK_S)()
            if self._stopped:
                break
            self._publish_all(self._presence.tick(clock.now_ns()))
            if self._busy and clock.now_ns() - self._requested_ns > _ANSWER_WITHIN_NS:
                self._busy = False
            child = self._child
            if child is not None and self._watch.overdue:
                child.kill()
            rested = clock.now_ns() - self._requested_ns >= self._detection_interval_ns
            if self._ready and rested and not self._busy and child is not None:
                self._requested_ns = clock.now_ns()
                with self._turns_lock:
                    self._pending = self._turns.pop(now_ns=self._requested_ns)
                self._busy = self._pending is not None and child.send(self._detection_request(self._pending))
            self._show_persons(self._presence)
        if self._child is not None:
            self._child.stop(grace_s=2.0)
        self._presence.close()

    def _open(self) -> None:
        """Open the people of the study, or in practice mode nobody's."""
        self._presence, problems = (PresenceTracker(), []) if self._practising else self._open_presence()
        self._presence.portraits = self._portraits
        self._publish_all(problems)

    def _restart_tracks(self) -> None:
        self._publish_all(self._presence.restart_tracks(clock.now_ns()))

    def _use_body(self, body: ProcessSpec) -> None:
        self._body, self.restarts = body, Restarts()
        self._replace_child()

    def _replace_child(self) -> None:
        self._ready, self._busy, self._pending = False, False, None
        if self._child is not None:
            self._child.stop(grace_s=2.0)
        self._restart_tracks()
        self._start_child()

    def _forget_cameras(self) -> None:
        self._pending = None
        self._turning.forget()
        self._detection_rates.forget()
        self._restart_tracks()

    def _recognise(self, settings: RecognitionSettings, may_decide: bool) -> None:
        self._recognition = settings, may_decide
        self._presence.use_settings(settings, may_decide=may_decide)
        self._faces = settings.recognise == "faces"

    def _ask_consents_again(self, again: bool) -> None:
        self._consents_again = again
        self._presence.ask_consents_again(again)
        self._everybody_reported_ns = 0

    def _practise(self, on: bool) -> None:
        if on == self._practising:
            return
        self._practising = on
        self._restart_tracks()
        self._presence.close()
        self._open()
        settings, may_decide = self._recognition
        self._presence.use_settings(settings, may_decide=may_decide)
        self._ask_consents_again(self._consents_again)

    def _handle(self, message: Any) -> None:
        """Handle a message of the inference process."""
        match message:
            case PersonLooks():
                self._publish_all(self._presence.add_embeddings(message))
            case PersonPortrait():
                self._presence.add_portrait(message)
            case InferenceReady():
                self._ready, self._busy = True, False
                plugins = tuple(sorted((one.title, one.package) for one in message.plugins))
                self._set_status(
                    PerceptionStatus(
                        "ready", message.model, server=message.server, recognises=message.recognises, plugins=plugins
                    )
                )
            case InferenceFailed(problem=problem):
                self._publish(localize_problem(problem))
                self._set_status(PerceptionStatus(state="failed", detail=problem.what))
                self._ready = False
            case DetectorAway(problem=problem):
                self._publish(localize_problem(problem))
                self._set_status(replace(self._status, state="failed", detail=problem.what))
            case People():
                self._on_people(message)
            case FrameSkipped():
                self._busy = False
            case PluginFailed(plugin=plugin, reason=reason):
                self._switch_off(plugin, reason)
                if plugin.group == "detectors":
                    self._replace_child()
            case Problem():
                self._publish(localize_problem(message))

    def _on_people(self, found: People) -> None:
        self._busy = False
        if self._status.state == "failed":  # the remote machine is back
            self._set_status(replace(self._status, state="ready", detail=""))
        self._detection_rates.note(found.camera, now_ns=clock.now_ns())
        pending = self._pending
        if pending is not None and (pending.camera, pending.sequence) == (found.camera, found.frame_sequence):
            people, events = self._presence.update(found, clock.now_ns())
            self._publish(people)
            self._publish_all(events)
            self._locate(people, self._presence)
        self._report_pace(found.inference_ms)

    def _on_child_ended(self, child: ChildProcess) -> None:
        if child is not self._child:
            return
        self._ready = self._busy = False
        child.stop(grace_s=0.0)
        self._restart_tracks()
        self._child = None
        if (plugin := self._watch.called) is None:
            self.restarts.after_end(self._report_ended, self._start_child)
        else:
            self._switch_off(plugin, self._watch.blame)
            self._start_child()
        if self._child is None:
            detail = QT_TR_NOOP("Stopped unexpectedly too often")
            self._set_status(PerceptionStatus(state="failed", detail=detail))

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
            self._inputs.put(partial(self._handle, value))

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
            on_exit=lambda _code: self._inputs.put(partial(self._on_child_ended, child)),
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
