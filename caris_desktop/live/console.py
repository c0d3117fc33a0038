"""The running console: starts the threads and child processes, carries values to the panels, and the wizard's
intents to the adapters. GUI thread, except where a method says otherwise.
"""

import logging
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject, Qt, QThread, Signal

from caris_desktop.conversation.embedded_server import EmbeddedFailed, EmbeddedReady
from caris_desktop.conversation.language_models import LanguageModelError, ModelEndpoint
from caris_desktop.conversation.prompts import MAX_QUESTION_CHARACTERS, characters_too_long
from caris_desktop.conversation.speech_messages import SilenceSpeech, Speak, SpeechFailed, SpeechReady
from caris_desktop.domain import clock, intents
from caris_desktop.domain.camera import CameraModel
from caris_desktop.domain.commands import RobotCommand, Say, Silence
from caris_desktop.domain.events import (
    ChatMessage,
    DriveEnded,
    EmergencyStopChanged,
    Event,
    GoalChanged,
    GuardChanged,
    LayoutChanged,
    LinkChanged,
    NavigationSpeedChanged,
    PersonAppeared,
    PlacesChanged,
    Problem,
    ProblemEnd,
    RobotChosen,
    ScenarioOpened,
    Severity,
    StopRequested,
    UtteranceChanged,
)
from caris_desktop.domain.failure import ToldFailure
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.sensing import AudioChunk, CameraLens, FrameRef, HeadState, LaserScan, RobotPose
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.domain.trial import TrialDetails
from caris_desktop.live.assistant_director import AssistantDirector, StreamChat
from caris_desktop.live.asyncio_thread import AsyncioThread
from caris_desktop.live.child_process import ChildProcess, ProcessBody, RingsToRead, RingToWrite
from caris_desktop.live.drive_controller import DriveController
from caris_desktop.live.frame_ring import FrameRing, FrameRings
from caris_desktop.live.gamepad import Gamepads
from caris_desktop.live.gate import Gate, Refusal
from caris_desktop.live.head_controller import HeadController
from caris_desktop.live.mailbox import Mailbox
from caris_desktop.live.marks_director import MarksDirector
from caris_desktop.live.microphone_director import MicrophoneDirector, MicrophoneMessage, MicrophoneParts
from caris_desktop.live.pace import PassPace
from caris_desktop.live.perception_worker import PerceptionWorker
from caris_desktop.live.recording_director import RecordingDirector
from caris_desktop.live.robot_director import RobotConnection, RobotDirector
from caris_desktop.live.service import Handler, Handlers
from caris_desktop.live.speech_director import SpeechDirector
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import AssistantStatus, LinkStatus, PerceptionStatus, RecordingStatus
from caris_desktop.live.status_tap import StatusTap
from caris_desktop.live.wizard_console import RobotChoice
from caris_desktop.people.presence import Presence
from caris_desktop.perception.cameras import PlayVideo
from caris_desktop.recording.recorder.messages import RecorderReport, SessionHeader
from caris_desktop.robot.profile import RobotProfile, profile_text
from caris_desktop.scenario.model import Place, Scenario

_log = logging.getLogger(__name__)
_RESTARTS_AT_MOST = 3
_UTTERANCES_KEPT = 200
_EMBEDDED_MODEL_SHOWN = "SmolLM2 on this computer"


@dataclass(frozen=True, slots=True)
class Parts:
    """The concrete adapters of a run, chosen in ``app``. A ``None`` part is not there in this run.

    ``load_scenario``, ``save_places``, ``connect_to`` and ``new_session`` raise ToldFailure.
    """

    inference: ProcessBody | None
    recorder: ProcessBody
    speech: ProcessBody
    language_model_server: ProcessBody
    camera: ProcessBody | None
    open_presence: Callable[[], tuple[Presence, list[Event]]]
    stream_chat: StreamChat
    resolve_endpoint: Callable[[str, str | None], ModelEndpoint]
    build_prompt: Callable[[Scenario, Sequence[UtteranceChanged], Sequence[str], str], tuple[ChatMessage, ...]]
    load_scenario: Callable[[Path], Scenario]
    scenario_text: Callable[[Scenario], str]
    save_places: Callable[[Scenario], Scenario]
    robots: Callable[[], Sequence[RobotChoice]]
    connect_to: Callable[[str], RobotConnection]
    suggested_details: Callable[[], TrialDetails]
    new_session: Callable[[TrialDetails, Scenario, RobotConnection | None], tuple[Path, SessionHeader]]
    expected_bytes_per_hour: Callable[[Scenario], float | None]
    free_bytes: Callable[[], int | None]
    photo_file: Callable[[], Path]
    microphone: MicrophoneParts


class Console(QObject):
    """Implements WizardConsole. ``start()`` after the window is shown, ``shutdown()`` before the program ends."""

    _woken = Signal()
    _child_spoke = Signal(object)
    _child_ended = Signal(object)

    def __init__(self, parts: Parts, scenario: Scenario, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._parts = parts
        self._scenario = scenario
        self._state = LiveState(self)
        self._state.scenario.set(scenario)
        self._embedded_url: str | None = None
        self._children: dict[str, ChildProcess] = {}
        self._restarts: Counter[str] = Counter()
        self._shut_down = False
        self._held_voice_problem: Problem | None = None
        self._video_plays = False
        self._conversation: deque[UtteranceChanged] = deque(maxlen=_UTTERANCES_KEPT)

        self._media_ring = FrameRing.create()
        self._camera_ring = FrameRing.create() if parts.camera else None
        rings = [self._media_ring] + ([self._camera_ring] if self._camera_ring else [])
        self._frames = FrameRings(rings)
        self._rings_to_read = RingsToRead(tuple(ring.name for ring in rings))

        self._mailbox = Mailbox(self._woken.emit)
        self._woken.connect(self._on_woken, Qt.ConnectionType.QueuedConnection)
        self._pace = PassPace(self)
        self._pace.due.connect(self._on_woken)
        self._child_spoke.connect(self._on_child_message, Qt.ConnectionType.QueuedConnection)
        self._child_ended.connect(self._on_child_ended, Qt.ConnectionType.QueuedConnection)

        self._asyncio = AsyncioThread()
        self._recording = RecordingDirector(
            self._state,
            new_recorder=self._new_recorder,
            problem=self.problem,
            parent=self,
        )
        self._robot = RobotDirector(
            self._state,
            self._media_ring,
            new_child=self._new_link,
            publish=self.publish,
            problem=self.problem,
            before_goal=lambda: self._drive.release("A goal was set"),
            asyncio_thread=self._asyncio,
            own_camera=parts.camera is not None,
            parent=self,
        )
        self._drive = DriveController(self._state, self, scenario, self)
        self._head = HeadController(self._state, self, self.publish, self)
        self._gamepads = Gamepads(self._state, self.publish, self)
        self._marks = MarksDirector(self._state, self.publish, self)
        self._status_tap = StatusTap(self._state, self._recording.put, self)
        self._microphone = MicrophoneDirector(
            self._state, parts.microphone, start_child=self._new_microphone, problem=self.problem, parent=self
        )
        self._layout: LayoutChanged | None = None
        self._speech = SpeechDirector(
            self._state, {"robot": _RobotVoice(self), "computer": _ComputerVoice(self)}, self.publish, self
        )
        self._assistant = AssistantDirector(self._state, self._asyncio, parts.stream_chat, self.publish, self)
        self._perception_thread = QThread(self)
        self._perception: PerceptionWorker | None = None
        self._state.robot.changed.connect(self._on_robot_changed)
        self._state.camera.changed.connect(self._on_camera_changed)
        self._state.recording.changed.connect(self._on_recording_changed)
        self._gate = Gate(self._state, lambda: self._scenario.permissions)
        services = (
            self._drive, self._head, self._robot, self._speech, self._assistant, self._marks, self._microphone,
        )  # fmt: skip
        self._handlers: dict[type[Intent], Handler] = dict(self._own_handlers())
        for service in services:
            self._handlers.update(service.handlers())
        self._apply_scenario()

    # What panels read

    @property
    def state(self) -> LiveState:
        return self._state

    @property
    def scenario(self) -> Scenario:
        return self._scenario

    @property
    def frames(self) -> FrameRings:
        return self._frames

    @property
    def session_folder(self) -> Path | None:
        """The current session's folder, or the last one's."""
        return self._recording.session_folder

    @property
    def child_pids(self) -> dict[str, int]:
        """Process ids of the children, by body name."""
        children = {**self._children, **self._robot.links, "recorder": self._recording.recorder}
        pids = {name: child.pid for name, child in children.items()}
        if self._perception is not None:
            pids["inference"] = self._perception.child_pid
        return {name: pid for name, pid in pids.items() if pid is not None}

    # Start and end

    def start(self) -> None:
        """Start what the window does not need to be usable: all child processes and the perception thread."""
        if self._shut_down:
            return
        self._recording.start(self._scenario)
        self._gamepads.start()
        if self._parts.camera is not None and self._camera_ring is not None:
            body = self._parts.camera
            self._start_child(
                replace(body, arguments=(*body.arguments, RingToWrite(self._camera_ring.name))), self._on_robot_message
            )
        self._start_child(self._parts.speech, self._on_voice_message)
        if self._scenario.permissions.audio_recording:
            self._microphone.get_ready()
        if self._parts.inference is not None:
            body = self._parts.inference
            worker = PerceptionWorker(
                replace(body, arguments=(self._rings_to_read, *body.arguments)),
                self._parts.open_presence,
                self.publish,
            )
            worker.moveToThread(self._perception_thread)
            worker.status_changed.connect(self._on_perception_status, Qt.ConnectionType.QueuedConnection)
            worker.persons_changed.connect(self._state.persons.set, Qt.ConnectionType.QueuedConnection)
            self._perception_thread.started.connect(worker.run)
            self._perception = worker
            worker.use_cameras(_camera_models(self._state.robot.value))
            worker.show_camera(self._state.camera.value)
            self._perception_thread.setObjectName("perception")
            self._perception_thread.start(QThread.Priority.LowPriority)
        self._start_language_model()

    @property
    def gamepads(self) -> Gamepads:
        """The gamepad in use; the window turns what it says into driving."""
        return self._gamepads

    @property
    def asyncio_thread(self) -> AsyncioThread:
        """The one thread for what waits on sockets."""
        return self._asyncio

    def connect_robot(self, connection: RobotConnection) -> None:
        """Connect, or connect to another robot instead."""
        if self._shut_down:
            return
        self._drive.release("Another robot is connected")
        # What the robot before said to the last is taken in first: it must not stand for the new one.
        self._robot.leave_robot()
        self._drain_mailbox()
        self._recording.forget_robot()
        if self._perception is not None and self._parts.camera is None:
            self._perception.forget_cameras()
        self._robot.connect_robot(connection)

    def shutdown(self, during: Callable[[str, Callable[[], None]], None] = lambda _what, work: work()) -> None:
        """Zero, close the recording, end every thread and child, in that order.

        Blocks: a few seconds as a rule, up to a minute and a half where much is left to write. ``during`` is given
        what takes long, with words for it, and does it before it returns; none of that touches Qt.
        """
        if self._shut_down:
            return
        self._shut_down = True
        self._drive.release("The console closes")
        self._assistant.cancel("cancelled as the program closed")
        self._robot.shutdown()
        self._gamepads.stop()
        self._stop_session()
        during("Voice, models and people detection are being ended.", self._end_helpers)
        self._microphone.shutdown()
        self._asyncio.stop()
        during(
            "The recording is being finished: what is left is written to disk, and checksums are made of all of it.",
            self._recording.shutdown,
        )
        self._frames.close()
        self._state.close()

    def _end_helpers(self) -> None:  # any thread
        for child in self._children.values():
            child.ask_to_end()
        for child in self._children.values():
            child.stop(grace_s=1.5)
        if self._perception is not None:
            self._perception.stop()
            if not self._perception_thread.wait(5000):
                _log.error("the perception thread did not end")

    # Values on their way

    def publish(self, value: Any, raw: bytes | None = None) -> None:
        """Take a domain value from any thread to the recorder, the panels and, for frames, to perception."""
        self._recording.put(value, raw)
        if self._perception is not None:
            if isinstance(value, FrameRef):
                self._perception.offer(value)
            elif isinstance(value, (LaserScan, RobotPose, HeadState)):
                self._perception.offer_evidence(value)
            elif isinstance(value, CameraLens):
                self._perception.use_lens(value)
        self._mailbox.put(value)

    def problem(self, severity: Severity, what: str, meaning: str, advice: str, *, until: ProblemEnd = "") -> None:
        """Tell the wizard, and the record."""
        _log.log(logging.INFO if severity == "info" else logging.WARNING, "%s %s %s", what, meaning, advice)
        self.publish(Problem(clock.now_ns(), severity, what, meaning, advice, until))

    def send(self, command: RobotCommand) -> bool:
        """RobotPort: to the control link, now or not at all."""
        return self._robot.send(command)

    def send_to_speech(self, message: Speak | SilenceSpeech) -> bool:
        speech = self._children.get(self._parts.speech.name)
        return speech is not None and speech.send(message)

    def _on_robot_message(self, value: Any, raw: bytes) -> None:  # reader threads
        if isinstance(value, UtteranceChanged) or type(value) not in BY_TYPE:
            self._child_spoke.emit(value)
        else:
            self.publish(value, raw)

    def _on_voice_message(self, value: Any, raw: bytes) -> None:  # reader thread
        if isinstance(value, Problem):
            self._child_spoke.emit(value)
        elif isinstance(value, AudioChunk):
            self._recording.put(value, raw)
        else:
            self._on_robot_message(value, raw)

    def _on_recorder_message(self, value: Any, raw: bytes) -> None:  # reader thread
        if isinstance(value, RecorderReport):
            self._child_spoke.emit(value)
        else:  # the recorder has written its own events already
            self._mailbox.put(value)

    def _on_woken(self) -> None:
        self._drive.renew_before_work()
        if self._pace.may_begin():
            self._drain_mailbox()
        else:
            self._take_events(self._mailbox.drain_events())

    def _drain_mailbox(self) -> None:
        events, latest = self._mailbox.drain()
        self._take_events(events)
        for value in latest:
            self._state.take(value)

    def _take_events(self, events: list[Any]) -> None:
        for event in events:
            self._before_panels(event)
            self._state.take(event)

    def _before_panels(self, event: Any) -> None:
        self._robot.on_event(event)
        if isinstance(event, (DriveEnded, EmergencyStopChanged, GuardChanged, NavigationSpeedChanged)):
            self._drive.on_robot_event(event)
        elif isinstance(event, LinkChanged) and event.link == "control":
            if event.state in ("connecting", "closed"):
                # Of what was asked of another link process nobody tells; a lost link's own process still does.
                self._speech.on_voice_lost("robot", "the link was lost")
            self._speech.on_voice_changed()
        elif isinstance(event, UtteranceChanged):
            self._conversation.append(event)

    def _on_child_message(self, message: Any) -> None:
        if isinstance(message, UtteranceChanged):
            self._speech.on_utterance(message)
        elif isinstance(message, RecorderReport):
            self._recording.on_report(message)
        elif isinstance(message, Problem):
            self._on_voice_problem(message)
        elif isinstance(message, MicrophoneMessage):
            problem = self._microphone.on_message(message)
            if problem is not None:
                self.publish(problem)
        elif isinstance(message, SpeechReady):
            status = self._state.speech.value
            self._state.speech.set(
                replace(status, ready=True, detail="" if message.audible else "no sound device: nobody hears it")
            )
        elif isinstance(message, SpeechFailed):
            self._on_voice_problem(message.problem)
            self._speech.on_voice_lost("computer", message.problem.what)
        elif isinstance(message, EmbeddedReady):
            self._embedded_url = message.url
            self._use_language_model()
        elif isinstance(message, EmbeddedFailed):
            self.publish(message.problem)
            self._assistant.show_status(AssistantStatus(state="failed", detail=message.problem.what))
        else:
            _log.info("%r", message)

    def _on_voice_problem(self, problem: Problem) -> None:
        """What is wrong with this computer's voice matters once a scenario speaks with it."""
        if self._scenario.voice == "computer":
            self.publish(problem)
        else:
            self._held_voice_problem = problem

    def _on_robot_changed(self, robot: RobotProfile | None) -> None:
        connection = self._robot.connection
        if connection is not None:
            self.publish(_robot_event(connection))
        if self._perception is not None:
            self._perception.use_cameras(_camera_models(robot))

    def _on_camera_changed(self, name: str) -> None:
        if self._perception is not None:
            self._perception.show_camera(name)

    def _on_recording_changed(self, status: RecordingStatus) -> None:
        if status.state in ("idle", "failed") and self._state.microphone.value.state != "off":
            # It ended by itself, as on a full disk.
            self._microphone.close()
            self._marks.forget()

    def _on_perception_status(self, status: PerceptionStatus) -> None:
        self._state.perception.set(status)
        camera = self._children.get(self._parts.camera.name) if self._parts.camera else None
        if camera is not None and status.state in ("ready", "failed") and not self._video_plays:
            # A recorded video waits for whoever shall see it from its start.
            self._video_plays = camera.send(PlayVideo())

    def _on_child_ended(self, child: ChildProcess) -> None:
        if self._shut_down:
            return
        if (
            self._recording.on_recorder_ended(child)
            or self._robot.on_child_ended(child)
            or self._microphone.on_ended(child)
        ):
            return
        name = child.body.name
        if self._children.get(name) is not child:
            return  # it was replaced while the news of its end was on its way
        del self._children[name]
        if self._parts.camera is not None and name == self._parts.camera.name:
            self.problem(
                "warning",
                "The camera's pictures have ended.",
                "There is no video from now on; a recording goes on without it.",
                "Start again with another --camera, or without one for the robot's own.",
                until="picture",
            )
        elif name == self._parts.speech.name:
            again = self._may_restart(name)
            self._state.speech.set(replace(self._state.speech.value, ready=False, detail="the voice stopped"))
            self._on_voice_problem(
                Problem(
                    clock.now_ns(),
                    "warning",
                    "This computer's voice stopped unexpectedly.",
                    "What it was saying is cut off; the session goes on.",
                    "It is being started again." if again else "It failed too often: restart the program.",
                    until="voice",
                )
            )
            if again:
                self._start_child(self._parts.speech, self._on_voice_message)
            self._speech.on_voice_lost("computer", "speech stopped unexpectedly")
        elif name == self._parts.language_model_server.name:
            self._on_language_model_ended()

    def _on_language_model_ended(self) -> None:
        self._embedded_url = None
        again = self._may_restart(self._parts.language_model_server.name)
        if self._scenario.permissions.assistant and self._scenario.assistant.model == "embedded":
            self._assistant.show_status(AssistantStatus(state="failed", detail="The language model stopped."))
            self.problem(
                "warning",
                "The language model stopped unexpectedly.",
                "The assistant gives no answers; everything else works.",
                "It is being started again." if again else "It failed too often: restart the program.",
                until="assistant",
            )
            if again:
                self._start_language_model()

    def _may_restart(self, name: str) -> bool:
        """Whatever crashes again and again is left alone, instead of keeping the computer busy."""
        self._restarts[name] += 1
        return self._restarts[name] <= _RESTARTS_AT_MOST

    def _new_recorder(self) -> ChildProcess:
        body = self._parts.recorder
        recorder = ChildProcess(
            replace(body, arguments=(*body.arguments, self._rings_to_read)),
            on_message=self._on_recorder_message,
            on_exit=lambda _code: self._child_ended.emit(recorder),
        )
        return recorder

    def _new_microphone(self, body: ProcessBody) -> ChildProcess:
        child = ChildProcess(
            body, on_message=self._on_voice_message, on_exit=lambda _code: self._child_ended.emit(child)
        )
        child.start()
        return child

    def _new_link(self, body: ProcessBody) -> ChildProcess:
        child = ChildProcess(
            body, on_message=self._on_robot_message, on_exit=lambda _code: self._child_ended.emit(child)
        )
        child.start()
        return child

    def _start_child(self, body: ProcessBody, on_message: Callable[[Any, bytes], None]) -> None:
        child = ChildProcess(body, on_message=on_message, on_exit=lambda _code: self._child_ended.emit(child))
        self._children[body.name] = child
        child.start()

    # What is asked

    def do(self, intent: Intent) -> str:
        """Ask for it; gives why it was refused, in words that the wizard gets too, empty when it is under way."""
        refusal = self._gate.refusal(intent)
        if refusal is None:
            try:
                self._handlers[type(intent)](intent)
            except ToldFailure as failure:
                refusal = Refusal(failure.what, failure.meaning, failure.advice, severity="error")
            else:
                return ""
        if not refusal.quiet:
            self.problem(refusal.severity, refusal.what, refusal.meaning, refusal.advice, until=refusal.until)
        return refusal.what

    def _own_handlers(self) -> Handlers:
        return {
            intents.Stop: lambda _asked: self._stop(),
            intents.EmergencyStop: lambda _asked: self._emergency_stop(),
            intents.ReleaseEmergencyStop: lambda _asked: self._release_emergency_stop(),
            intents.SavePlace: self._save_place,
            intents.RemovePlace: self._remove_place,
            intents.UseRobot: lambda asked: self.connect_robot(self._parts.connect_to(asked.robot)),
            intents.Ask: lambda asked: self._ask_assistant(asked.question.strip()),
            intents.SayAnswer: self._say_answer,
            intents.NamePerson: self._name_person,
            intents.StartRecording: lambda asked: self._start_session(asked.details),
            intents.StopRecording: lambda _asked: self._stop_session(),
            intents.PauseRecording: lambda asked: self._pause_session(paused=asked.paused),
            intents.TakePhoto: lambda _asked: self._recording.take_photo(without_session=self._parts.photo_file()),
            intents.KeepLayout: self._keep_layout,
            intents.OpenScenario: lambda asked: self._open_scenario(asked.path),
        }

    def _stop(self) -> None:
        self._drive.stop()
        self.publish(StopRequested(clock.now_ns()))

    def _emergency_stop(self) -> None:
        heard = self._drive.set_emergency_stop(latched=True)
        self.publish(EmergencyStopChanged(clock.now_ns(), True, "wizard"))
        if not heard:
            self.problem(
                "error",
                "The robot could not be told of the emergency stop.",
                "The console sends no motion. The robot stops by itself if it guards its commands.",
                "Use the robot's own emergency stop button.",
                until="connected",
            )

    def _release_emergency_stop(self) -> None:
        self._drive.set_emergency_stop(latched=False)
        self.publish(EmergencyStopChanged(clock.now_ns(), False, "wizard"))

    # Places

    def _save_place(self, asked: intents.SavePlace) -> None:
        name = " ".join(asked.place.split())
        places = list(self._scenario.places)
        at = next((index for index, place in enumerate(places) if place.name == name), len(places))
        places[at : at + 1] = [Place(name, asked.pose_in_map)]
        self._keep_places(tuple(places), PlacesChanged(clock.now_ns(), name, asked.pose_in_map))

    def _remove_place(self, asked: intents.RemovePlace) -> None:
        places = tuple(place for place in self._scenario.places if place.name != asked.place)
        if len(places) < len(self._scenario.places):
            self._keep_places(places, PlacesChanged(clock.now_ns(), asked.place, None))

    def _keep_places(self, places: tuple[Place, ...], event: PlacesChanged) -> None:
        self._scenario = self._parts.save_places(replace(self._scenario, places=places))
        self._state.places.set(places)
        self.publish(event)
        self.publish(self._scenario_event())
        self._state.scenario.set(self._scenario)

    def robots(self) -> Sequence[RobotChoice]:
        return self._parts.robots()

    # Speaking

    def _ask_assistant(self, question: str) -> None:
        if not question:
            return
        too_long = characters_too_long(question)
        if too_long:
            self.problem(
                "warning",
                f"The question is {too_long} characters too long.",
                "The assistant was not asked; half a question would get an answer to something else.",
                f"Ask in {MAX_QUESTION_CHARACTERS:,} characters at most.",
            )
            return
        # Neither the record nor a model on another computer gets to know the names.
        people = [f"person {row.number}" for row in self._state.persons.value]
        messages = self._parts.build_prompt(self._scenario, tuple(self._conversation), people, question)
        settings = self._scenario.assistant
        if not self._assistant.ask(
            question, messages, max_tokens=settings.max_tokens, temperature=settings.temperature
        ):
            status = self._state.assistant.value
            self.problem(
                "warning",
                "The assistant cannot answer now.",
                "Your question is kept in the field.",
                "Its model is still starting: ask again in a moment."
                if status.state == "starting"
                else (status.detail or "Check the scenario's model."),
            )

    def _say_answer(self, asked: intents.SayAnswer) -> None:
        self._assistant.note_use(asked.text, self._speech.say(asked.text, "assistant"))

    # People

    def _name_person(self, asked: intents.NamePerson) -> None:
        if self._perception is not None:
            self._perception.rename(asked.person_id, asked.name)

    # Session

    def suggested_details(self) -> TrialDetails:
        return self._parts.suggested_details()

    def _start_session(self, details: TrialDetails) -> None:
        if not self._recording.idle:
            return
        # What was said with one participant is neither told to the model about the next nor in the next one's record.
        self._conversation.clear()
        self._marks.forget()
        self._assistant.forget()
        if self._scenario.permissions.audio_recording:
            # Nothing that is said at the beginning shall be missing; opening it takes a second or two.
            self._recording.announce_session()
            self._microphone.open_and_then(lambda: self._begin_session(details))
        else:
            self._begin_session(details)

    def _begin_session(self, details: TrialDetails) -> None:
        connection = self._robot.connection
        started = self._recording.start_session(
            lambda: self._parts.new_session(details, self._scenario, connection),
            self._scenario,
            self._standing(resumed=False),
        )
        if not started:
            self._microphone.close()

    def _standing(self, *, resumed: bool) -> list[Event]:
        """What happened once and holds until it happens again, as it stands now that a recording begins or goes on."""
        now_ns = clock.now_ns()
        link: LinkStatus = self._state.link.value
        standing: list[Event] = [
            LinkChanged(now_ns, "control", link.state, link.address, link.detail),
            self._scenario_event(),
        ]
        connection = self._robot.connection
        if connection is not None:
            standing.append(_robot_event(connection))
        if self._layout is not None:
            standing.append(replace(self._layout, stamp_ns=now_ns))
        if self._state.drive.value.emergency_stop:
            standing.append(EmergencyStopChanged(now_ns, True, "wizard"))
        goal: GoalChanged | None = self._state.goal.value
        if goal is not None and (resumed or goal.state in ("requested", "active")):
            # One that came to its end before is none of this recording; during a pause its end is still missing.
            standing.append(replace(goal, stamp_ns=now_ns))
        standing += [
            PersonAppeared(now_ns, row.person_id, row.track, row.number)
            for row in self._state.persons.value
            if row.here
        ]
        return standing

    def _stop_session(self) -> None:
        self._marks.end_all()
        if not self._recording.idle:
            # An answer that nobody used is so until the end, and the next participant shall not see it.
            self._assistant.forget()
        self._microphone.close()
        self._recording.stop_session("console_closed" if self._shut_down else "wizard")

    def _pause_session(self, *, paused: bool) -> None:
        # What was asked before belongs to what is recorded, what is asked meanwhile does not.
        self._assistant.forget()
        if paused:
            self._marks.end_all()
            self._microphone.close()
        elif self._scenario.permissions.audio_recording:
            self._microphone.open()
        self._recording.pause_session(self._standing(resumed=True), paused=paused)

    def expected_bytes_per_hour(self) -> float | None:
        return self._parts.expected_bytes_per_hour(self._scenario)

    def free_bytes(self) -> int | None:
        return self._parts.free_bytes()

    def microphones(self) -> Sequence[str]:
        return self._microphone.names

    @property
    def microphone(self) -> str | None:
        return self._microphone.chosen

    def _keep_layout(self, asked: intents.KeepLayout) -> None:
        self._layout = LayoutChanged(clock.now_ns(), asked.layout)
        self.publish(self._layout)

    # Scenario

    def _open_scenario(self, path: Path) -> None:
        scenario = self._parts.load_scenario(path)
        self._scenario = scenario
        self._layout = None
        self._recording.use_scenario(scenario)
        if not scenario.permissions.audio_recording:
            self._microphone.wait_no_longer()
            self._microphone.close()
        elif self._recording.idle:
            self._microphone.get_ready()
        else:
            self._microphone.open()
        self._apply_scenario()
        self._start_language_model()
        self._state.scenario.set(scenario)

    def _apply_scenario(self) -> None:
        self._drive.use_scenario(self._scenario)
        if not self._scenario.permissions.driving:
            self._head.release()
            self._robot.cancel_goal()
        self._state.places.set(self._scenario.places)
        self._robot.offer_controls(self._scenario.controls, driving_permitted=self._scenario.permissions.driving)
        self._speech.use_voice(self._scenario.voice)
        if self._scenario.voice == "computer" and self._held_voice_problem is not None:
            self.publish(replace(self._held_voice_problem, stamp_ns=clock.now_ns()))
            self._held_voice_problem = None
        self.publish(self._scenario_event())

    def _scenario_event(self) -> ScenarioOpened:
        path = self._scenario.path
        return ScenarioOpened(
            clock.now_ns(),
            path.name if path else "",
            self._scenario.title,
            self._scenario.sha256,
            self._parts.scenario_text(self._scenario),
        )

    def _start_language_model(self) -> None:
        if not self._scenario.permissions.assistant:
            self._assistant.show_status(AssistantStatus(state="off"))
        elif self._scenario.assistant.model == "embedded" and self._embedded_url is None:
            self._assistant.show_status(AssistantStatus(state="starting", model=_EMBEDDED_MODEL_SHOWN))
            if self._parts.language_model_server.name not in self._children:
                self._start_child(self._parts.language_model_server, self._on_robot_message)
        else:
            self._use_language_model()

    def _use_language_model(self) -> None:
        if not self._scenario.permissions.assistant:
            return
        model = self._scenario.assistant.model
        try:
            endpoint = self._parts.resolve_endpoint(model, self._embedded_url)
            self._assistant.use_endpoint(
                endpoint, shown_as=_EMBEDDED_MODEL_SHOWN if model == "embedded" else endpoint.model
            )
        except LanguageModelError as error:
            self._assistant.show_status(AssistantStatus(state="failed", detail=f"{error.what} {error.advice}"))


def _camera_models(robot: RobotProfile | None) -> dict[str, CameraModel]:
    cameras = robot.cameras if robot is not None else ()
    return {camera.name: camera.model for camera in cameras if camera.model is not None}


def _robot_event(connection: RobotConnection) -> RobotChosen:
    profile = connection.profile
    return RobotChosen(clock.now_ns(), profile.name, connection.name, connection.address, profile_text(profile))


class _RobotVoice:
    def __init__(self, console: Console) -> None:
        self._console = console

    @property
    def held_up(self) -> bool:
        return bool(self._console.state.link.value.state == "trouble")

    def say(self, utterance: UtteranceChanged) -> bool:
        return self._console.state.link.value.state == "connected" and self._console.send(
            Say(utterance.stamp_ns, utterance.utterance_id, utterance.text)
        )

    def silence(self) -> bool:
        return self._console.send(Silence(clock.now_ns()))


class _ComputerVoice:
    held_up = False

    def __init__(self, console: Console) -> None:
        self._console = console

    def say(self, utterance: UtteranceChanged) -> bool:
        return self._console.send_to_speech(Speak(utterance.utterance_id, utterance.text, utterance.origin))

    def silence(self) -> bool:
        return self._console.send_to_speech(SilenceSpeech())
