"""People service: perception in its own thread."""

import logging
import queue
import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, get_args

from PySide6.QtCore import QObject, Qt, QThread, Signal, Slot

from caris_desktop.conversation.conversation_transcript import ResponseTimes, Transcript, Turn, UtteranceReport
from caris_desktop.conversation.listening.speaker_attribution import Here, PeopleHere, WizardsVoice, is_wizards
from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE
from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.events import (
    Event,
    PersonAttended,
    Problem,
    SessionStarted,
    SuggestionChanged,
    UtteranceChanged,
    UtteranceCorrected,
)
from caris_desktop.domain.failure import RefusedError, UserFacingError
from caris_desktop.domain.person_values import PersonLooks, PersonPortrait
from caris_desktop.domain.plugins import Plugin, PluginCall, PluginFailed, switched_off
from caris_desktop.domain.ports import ValueSink
from caris_desktop.domain.process_settings import RECORD_NICENESS
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
from caris_desktop.domain.sound_values import WIZARD_MICROPHONE, Hearing
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ChildProcess, ProcessSpec, RingsToRead
from caris_desktop.live.service import (
    ContextService,
    Follows,
    Handlers,
    PluginWatch,
    Restarts,
    Service,
    ServiceContext,
    localize_problem,
)
from caris_desktop.live.status import PerceptionStatus, PersonHistory, PracticeStatus
from caris_desktop.people.decisions import PeopleIntent
from caris_desktop.people.location import PeopleLocator
from caris_desktop.people.presence import HistoryEvent, PersonRow, PortraitsOf, PresenceTracker, RecognitionSettings
from caris_desktop.people.visit_log import Portraits
from caris_desktop.perception.camera_schedule import (
    OTHERS_EVERY_NS,
    TO_COVER_EVERY_NS,
    CameraRotation,
    CameraSchedule,
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
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.scenario.scenario_model import BlurWho, Scenario

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
        open_presence: Callable[[], tuple[PresenceTracker, list[Event]]],
        publish: ValueSink,
        portraits: Portraits | None = None,
    ) -> None:
        super().__init__()
        self._body: ProcessSpec
        self._open_presence = open_presence
        self._publish = publish
        self._portraits = Portraits() if portraits is None else portraits
        self._inputs: queue.SimpleQueue[Callable[[], object]] = queue.SimpleQueue()
        """What is to be done in the worker's thread."""
        self._presence: PresenceTracker
        self._turns_lock = threading.Lock()
        self._schedule = CameraSchedule()
        self._detection_rates = DetectionRate()
        self.child: ChildProcess | None = None
        self.restarts = Restarts()
        self._status = PerceptionStatus()
        self._pace_reported_ns = 0
        self._detection_interval_ns = 0
        self._shown_persons: tuple[PersonRow, ...] = ()
        self._everybody_reported_ns = 0
        self._everybody: tuple[PersonRow, ...] = ()
        self._locator = PeopleLocator()
        self._rotation = CameraRotation()
        self._cameras: dict[str, CameraModel] = {}
        self._faces = self._to_cover = False
        self._watch = PluginWatch()
        self._plugins_off: tuple[Plugin, ...] = ()
        self._recognition: tuple[RecognitionSettings, bool] = (RecognitionSettings(), True)
        self._consents_again = self._practising = self._stopped = False
        self._ready = self._busy = False
        self._pending: FrameRef | None = None
        self._requested_ns = 0

    def use_body(self, body: ProcessSpec) -> None:
        """Start inference, or restart it with another detector or on another machine."""
        self._inputs.put(partial(self._use_body, body))

    def offer(self, ref: FrameRef) -> None:
        """Offer a new frame, which replaces an unused one of its camera."""
        with self._turns_lock:
            detection_due = self._schedule.offer(ref, now_ns=clock.now_ns())
        if detection_due:
            self._inputs.put(lambda: None)

    def show_camera(self, name: str) -> None:
        """Set the camera on display: others get a lower detection rate."""
        with self._turns_lock:
            self._schedule.show(name)

    def require_blurring(self, to_cover: bool) -> None:
        """Set whether people must be blurred in the recordings of all cameras."""
        self._to_cover = to_cover
        with self._turns_lock:
            self._schedule.others_every_ns = TO_COVER_EVERY_NS if to_cover else OTHERS_EVERY_NS

    def limit_detection_rate(self, seconds: float) -> None:
        """Set a minimum interval between detections, to leave the processor to others."""
        self._detection_interval_ns = round(seconds * 1e9)

    def forget_cameras(self) -> None:
        """Reset for another robot: its cameras differ, and nobody is present."""
        with self._turns_lock:
            self._schedule.forget()
        self._inputs.put(self._forget_cameras)

    def offer_evidence(self, value: LaserScan | RobotPose | HeadState | Odometry | DepthGrid) -> None:
        """Add sensor data for people's positions and for camera motion."""
        if isinstance(value, HeadState | Odometry):
            self._rotation.add(value)
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
        while True:
            with suppress(queue.Empty):
                self._inputs.get(timeout=_TICK_S)()
            if self._stopped:
                break
            self._publish_all(self._presence.tick(clock.now_ns()))
            if self._busy and clock.now_ns() - self._requested_ns > _ANSWER_WITHIN_NS:
                self._busy = False
            child = self.child
            if child is not None and self._watch.overdue:
                child.kill()
            rested = clock.now_ns() - self._requested_ns >= self._detection_interval_ns
            if self._ready and rested and not self._busy and child is not None:
                self._requested_ns = clock.now_ns()
                with self._turns_lock:
                    self._pending = self._schedule.pop(now_ns=self._requested_ns)
                self._busy = self._pending is not None and child.send(self._detection_request(self._pending))
            self._show_persons(self._presence)
        if self.child is not None:
            self.child.stop(grace_s=2.0)
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
        if self.child is not None:
            self.child.stop(grace_s=2.0)
        self._restart_tracks()
        self._start_child()

    def _forget_cameras(self) -> None:
        self._pending = None
        self._rotation.forget()
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
        # Update rates once a second: more frequent changes are illegible.
        now_ns = clock.now_ns()
        if now_ns - self._pace_reported_ns >= _PACE_EVERY_NS:
            self._pace_reported_ns = now_ns
            looks_per_s = self._detection_rates.per_second(now_ns=now_ns)
            self._set_status(replace(self._status, inference_ms=found.inference_ms, looks_per_s=looks_per_s))

    def _on_child_ended(self, child: ChildProcess) -> None:
        if child is not self.child:
            return
        self._ready = self._busy = False
        child.stop(grace_s=0.0)
        self._restart_tracks()
        self.child = None
        if (plugin := self._watch.called) is None:
            self.restarts.after_end(self._report_ended, self._start_child)
        else:
            self._switch_off(plugin, self._watch.blame)
            self._start_child()
        if self.child is None:
            detail = QT_TR_NOOP("Stopped unexpectedly too often")
            self._set_status(PerceptionStatus(state="failed", detail=detail))

    def _detection_request(self, frame: FrameRef) -> DetectionRequest:
        """Detection request; a camera that the robot does not carry does not rotate with it."""
        camera = self._cameras.get(frame.camera)
        if camera is None:
            return DetectionRequest(frame, faces=self._faces, to_cover=self._to_cover)
        direction = self._rotation.direction(frame.shown_ns, on_head=camera.on_head)
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
        self.child = child

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


_log = logging.getLogger(__name__)
_ENDS_WITHIN_MS = 5000
_PORTRAITS: dict[BlurWho, PortraitsOf] = {
    "nobody": "everybody", "everybody": "nobody", "without_consent": "consenting",
}  # fmt: skip
"""Whom to save portraits of, by blur setting."""


class PeopleAdapters(Value):
    """``inference`` is None without perception; ``as_configured`` adapts it to a scenario."""

    inference: ProcessSpec | None
    open_presence: Callable[[], tuple[PresenceTracker, list[Event]]]
    as_configured: Callable[[ProcessSpec, Scenario], ProcessSpec] = lambda body, _scenario: body


class PeopleService(ContextService):
    """Runs the perception worker."""

    def __init__(
        self,
        context: ServiceContext,
        parts: PeopleAdapters,
        *,
        rings: RingsToRead,
        who_speaks: Callable[[UtteranceChanged], str],
    ) -> None:
        """``who_speaks`` returns the participant id of an utterance, empty if uncertain."""
        super().__init__(context)
        self._who_speaks = who_speaks
        self._parts = parts
        self._rings = rings
        self._inference: ProcessSpec | None = None
        self._thread = QThread(self)
        self._thread.setObjectName("perception")
        state = self._state
        self._worker = worker = PerceptionWorker(parts.open_presence, self._bus.publish, state.portraits)
        worker.moveToThread(self._thread)
        self._thread.started.connect(worker.run)
        if parts.inference is None:
            return
        worker.status_changed.connect(state.perception.set, Qt.ConnectionType.QueuedConnection)
        worker.persons_changed.connect(state.persons.set, Qt.ConnectionType.QueuedConnection)
        worker.history_found.connect(state.person_history.reset_value, Qt.ConnectionType.QueuedConnection)
        worker.everybody_changed.connect(state.everybody.set, Qt.ConnectionType.QueuedConnection)
        state.robot.changed.connect(self._on_cameras_changed)
        state.own_cameras.changed.connect(self._on_cameras_changed)
        # Not queued: the worker's thread runs no event loop.
        state.camera.changed.connect(worker.show_camera, Qt.ConnectionType.DirectConnection)
        state.going_on.changed.connect(lambda status: worker.ask_consents_again("consent" in status.unconfirmed))
        state.practice.changed.connect(self._on_practice_changed)
        self._bus.tap(lambda ref, _raw: worker.offer(ref), (FrameRef,))
        self._bus.tap(lambda lens, _raw: worker.use_lens(lens), (CameraLens,))
        evidence = (LaserScan, Odometry, RobotPose, HeadState, DepthGrid)
        self._bus.tap(lambda value, _raw: worker.offer_evidence(value), evidence)

    def handlers(self) -> Handlers:
        return dict.fromkeys(get_args(PeopleIntent), self.decide) | {
            intents.AttendPerson: self._attend,
            intents.LookUpPerson: self._request_history,
        }

    def follows(self) -> Follows:
        return {} if self._parts.inference is None else dict.fromkeys(get_args(HistoryEvent), self._note)

    def use_scenario(self, scenario: Scenario) -> None:
        body = self._parts.inference
        if body is None:
            return
        before, self._inference = self._inference, self._parts.as_configured(body, scenario)
        if self._inference != before:
            self._worker.use_body(self._placed(self._inference, scenario))
        names = scenario.permissions.naming_people
        settings = scenario.perception
        # Without naming there is nobody to recognise, so nothing is learnt about people.
        recognition = RecognitionSettings(
            settings.recognise if names else "nobody",
            settings.confirm_at,
            _PORTRAITS[scenario.blur.who],
            settings.ask_at,
        )
        self._worker.recognise(recognition, may_decide=names)
        self._worker.require_blurring(scenario.covers_people)

    def _placed(self, body: ProcessSpec, scenario: Scenario) -> ProcessSpec:
        """Process that reads the frames. If recordings must be blurred, detection has the recorder's priority; a
        process cannot raise its priority later, so a later scenario does not change it.
        """
        covers = scenario.covers_people
        arguments = (
            replace(each, niceness=RECORD_NICENESS) if covers and isinstance(each, InferenceSettings) else each
            for each in body.arguments
        )
        return replace(body, arguments=(self._rings, *arguments))

    def processes(self) -> dict[str, ChildProcess]:
        child = self._worker.child
        return {} if child is None else {child.body.name: child}

    def restarts(self) -> dict[str, Restarts]:
        return {} if self._inference is None else {self._inference.name: self._worker.restarts}

    def start(self) -> None:
        if self._parts.inference is not None:
            self._thread.start(QThread.Priority.LowPriority)

    def stop(self) -> None:
        self._worker.stop()

    def end(self) -> None:
        if not self._thread.wait(_ENDS_WITHIN_MS):
            _log.error("the perception thread did not end")

    def limit_detection_rate(self, seconds: float) -> None:
        """Set the minimum interval between detections; 0 for none."""
        self._worker.limit_detection_rate(seconds)

    def forget_robot(self) -> None:
        """Reset for another robot with other cameras: nobody is present."""
        robot: RobotProfile | None = self._state.robot.value
        if robot is not None and robot.cameras:
            self._worker.forget_cameras()

    def decide(self, intent: PeopleIntent) -> None:
        """Run a decision in the perception thread. Raises UserFacingError without perception."""
        if self._parts.inference is None:
            raise UserFacingError(
                tr("People detection is not available here."),
                tr("Nothing about them was changed."),
                tr("Start with people detection."),
            )
        self._worker.ask(intent)

    def _request_history(self, intent: intents.LookUpPerson) -> None:
        self._worker.request_history(intent.person_id, intent.text)

    def _attend(self, intent: intents.AttendPerson) -> None:
        self._state.selected_person.set(intent.person_id)
        self._bus.publish(PersonAttended(clock.now_ns(), intent.person_id, intent.actor))

    def _note(self, event: HistoryEvent) -> None:
        if isinstance(event, UtteranceChanged) and event.speaker == "participant" and not event.person_id:
            event = replace(event, person_id=self._who_speaks(event))
        self._worker.note(event)

    def _on_cameras_changed(self, _value: object) -> None:
        robot: RobotProfile | None = self._state.robot.value
        models: dict[str, CameraModel | None] = dict(self._state.own_cameras.value)
        models.update({camera.name: camera.model for camera in (robot.cameras if robot is not None else ())})
        self._worker.use_cameras({name: model for name, model in models.items() if model is not None})

    def _on_practice_changed(self, status: PracticeStatus) -> None:
        # People in view belong to the practice, whose robot stays until its result is dismissed.
        self._worker.practise(status.state != PracticeStatus().state)


# Transcript service: turns of the session, with the wizard's corrections.


class TranscriptService(ContextService):
    """Maintains ``state.transcript``, and applies corrections."""

    def __init__(self, context: ServiceContext) -> None:
        super().__init__(context)
        self._transcript = Transcript()
        self._earlier: tuple[Turn, ...] = ()
        self._keeps_earlier = False

    def handlers(self) -> Handlers:
        return {intents.CorrectUtterance: self._correct}

    def follows(self) -> Follows:
        return {UtteranceChanged: self._take, UtteranceCorrected: self._take, SessionStarted: self._restart}

    def show_earlier(self, turns: tuple[Turn, ...]) -> None:
        """Show the turns of an interrupted session before those of the next one, which resumes it; () for none."""
        self._earlier, self._keeps_earlier = turns, True
        self._show()

    def _show(self) -> None:
        self._state.transcript.reset_value((*self._earlier, *self._transcript.turns))

    def _take(self, event: UtteranceReport) -> None:
        self._transcript.add(event)
        self._show()

    def _restart(self, event: SessionStarted) -> None:
        if not self._keeps_earlier:
            self._earlier = ()
        self._keeps_earlier = False
        self._transcript.forget_before(event.stamp_ns)
        self._show()

    def _correct(self, intent: intents.CorrectUtterance) -> None:
        if self._transcript.turn(intent.utterance_id) is None:
            raise RefusedError(
                tr("That utterance belongs to another session."), tr("Nothing was corrected."),
                tr("Correct it in the session in which it was said."),
            )  # fmt: skip
        text = None if intent.text is None else " ".join(intent.text.split())
        self._bus.publish(
            UtteranceCorrected(
                clock.now_ns(), intent.utterance_id, text, intent.speaker, intent.person_id, intent.tags, intent.actor
            )
        )


class ResponseTimeService(Service):
    """Response time service: the participant's waiting time per turn, published once known.

    Publishes ResponseTimed.
    """

    def __init__(self, bus: Bus, parent: QObject) -> None:
        super().__init__(parent)
        self._bus = bus
        self._times = ResponseTimes()

    def follows(self) -> Follows:
        return dict.fromkeys((UtteranceChanged, UtteranceCorrected, SuggestionChanged), self._take)

    def _take(self, event: UtteranceReport | SuggestionChanged) -> None:
        for timed in self._times.add(event, clock.now_ns()):
            self._bus.publish(timed)


_TURNS_AT_MOST = 20


class SpeakersService(ContextService):
    """Speaker service: assigns a participant's turns to people present; the wizard's are detected separately. GUI
    thread.

    Publishes assignments as corrections by the console, which the wizard can change with one key; nothing is learnt
    from them.
    """

    def __init__(self, context: ServiceContext) -> None:
        super().__init__(context)
        self._here = PeopleHere()
        self._began: OrderedDict[str, int] = OrderedDict()
        self._wizards: deque[WizardsVoice] = deque(maxlen=_TURNS_AT_MOST)
        self._state.persons.changed.connect(self._on_people_changed)
        self._state.selected_person.changed.connect(self._on_people_changed)
        self._state.hearing_of(WIZARD_MICROPHONE).changed.connect(self._on_wizard_heard)

    def follows(self) -> Follows:
        return {UtteranceChanged: self._on_utterance}

    def who_speaks(self, utterance: UtteranceChanged) -> str:
        """Person id of the speaker; empty if uncertain."""
        return utterance.person_id or self._who_spoke(utterance)[0]

    def _who_spoke(self, utterance: UtteranceChanged) -> tuple[str, float]:
        started_ns = self._began.get(utterance.utterance_id, utterance.stamp_ns)
        return self._here.who_spoke(started_ns, max(started_ns + 1, utterance.stamp_ns))

    def _on_people_changed(self, _value: object) -> None:
        attended = self._state.selected_person.value
        rows: list[PersonRow] = self._state.persons.value
        self._here.note(
            clock.now_ns(),
            (Here(row.person_id, row.facing, row.distance_m, row.person_id == attended) for row in rows if row.here),
        )

    def _on_wizard_heard(self, hearing: Hearing) -> None:
        if hearing.speech_started_ns is None:
            return
        text = f"{hearing.committed} {hearing.tentative}"
        voice = WizardsVoice(hearing.speech_started_ns, hearing.silent_since_ns, text)
        if self._wizards and self._wizards[-1].started_ns == voice.started_ns:
            self._wizards.pop()
        self._wizards.append(voice)

    def _on_utterance(self, utterance: UtteranceChanged) -> None:
        if utterance.speaker != "participant" or utterance.origin != "heard":
            return
        if utterance.state == "started":
            self._began[utterance.utterance_id] = utterance.stamp_ns
            if len(self._began) > _TURNS_AT_MOST:
                self._began.popitem(last=False)
        if utterance.state != "finished":
            return
        started_ns = self._began.get(utterance.utterance_id, utterance.stamp_ns)
        wizards = is_wizards(utterance.text, started_ns, utterance.stamp_ns, self._wizards)
        person_id, confidence = ("", 0.0) if wizards or utterance.person_id else self._who_spoke(utterance)
        if wizards or person_id:
            self._bus.publish(
                UtteranceCorrected(
                    clock.now_ns(),
                    utterance.utterance_id,
                    speaker="wizard" if wizards else None,
                    person_id=person_id,
                    actor=CONSOLE,
                    person_confidence=round(confidence, 3) if person_id else None,
                )
            )
