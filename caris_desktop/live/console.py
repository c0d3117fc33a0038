"""Console: ordered list of services, with the bus between them and the gate in front.

GUI thread unless stated otherwise.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from PySide6.QtCore import QObject

from caris_desktop.domain.actor import WIZARD, Actor
from caris_desktop.domain.events import ANSWER, ProblemEnd
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.sensing import People
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import AsyncioThread, BackgroundWorker, During
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ChildProcess, ProcessSpec, RingsToRead
from caris_desktop.live.frame_ring import FrameRing, FrameRings
from caris_desktop.live.gamepad import Gamepads
from caris_desktop.live.gate import Gate, Refusal
from caris_desktop.live.replay_video import DisplayFrames
from caris_desktop.live.service import Handler, ProcessManager, Service, ServiceContext
from caris_desktop.live.services.alarms_service import AlarmsService
from caris_desktop.live.services.assistant_service import AssistantAdapters, AssistantService
from caris_desktop.live.services.cameras_service import CameraSelection, CamerasService
from caris_desktop.live.services.crash_recovery_service import CrashRecoveryAdapters, CrashRecoveryService
from caris_desktop.live.services.drive_service import DriveService, HeadService
from caris_desktop.live.services.face_service import FaceService
from caris_desktop.live.services.forgetting_service import ForgettingService
from caris_desktop.live.services.listening_service import ListeningService
from caris_desktop.live.services.load_shedding_service import HealthService, LoadSheddingService
from caris_desktop.live.services.microphone_service import MicrophoneAdapters, MicrophoneService
from caris_desktop.live.services.people_service import (
    PeopleAdapters,
    PeopleService,
    ResponseTimeService,
    SpeakersService,
    TranscriptService,
)
from caris_desktop.live.services.photos_service import PhotosService
from caris_desktop.live.services.practice_service import PracticeAdapters, PracticeService
from caris_desktop.live.services.preflight_service import PreflightService
from caris_desktop.live.services.protocol_service import ProtocolService
from caris_desktop.live.services.recording_service import RecordingService
from caris_desktop.live.services.robot_service import AnotherRobotService, RobotConnection, RobotService
from caris_desktop.live.services.scenario_service import ScenarioAdapters, ScenarioService
from caris_desktop.live.services.session_service import MarksService, SessionAdapters, SessionService, SessionServices
from caris_desktop.live.services.sound_service import SoundAdapters, SoundService
from caris_desktop.live.services.speaking_service import SpeakingService
from caris_desktop.live.services.speech_service import SpeechService
from caris_desktop.live.services.suggestions_service import ProposalsService, SuggestionsService
from caris_desktop.live.state import LiveState, tap_status
from caris_desktop.robot.profile import ListedProfile
from caris_desktop.scenario.scenario_model import Scenario


class RobotAdapters(Value):
    """``choices`` and ``connect_to`` read files in a background thread; ``connect_to`` raises UserFacingError.
    ``simulated`` as in AnotherRobotService.
    """

    choices: Callable[[], Sequence[ListedProfile]]
    connect_to: Callable[[str], RobotConnection]
    simulated: Callable[[Actor], None]


class Adapters(Value):
    """Adapters of a run, chosen in ``app``, per service."""

    recorder: ProcessSpec
    speech: ProcessSpec
    speech_history: Path
    people: PeopleAdapters
    cameras: Callable[[Scenario], CameraSelection]
    assistant: AssistantAdapters
    scenario: ScenarioAdapters
    robots: RobotAdapters
    session: SessionAdapters
    going_on: CrashRecoveryAdapters
    practice: PracticeAdapters
    microphone: MicrophoneAdapters
    sound: SoundAdapters
    listening: Callable[[Scenario], ProcessSpec]
    forgetting: Callable[[str], ProcessSpec]


T = TypeVar("T")


class Console(QObject):
    """Implements WizardConsole. ``start()`` after the window is shown, ``shutdown()`` before the program ends."""

    def __init__(self, parts: Adapters, scenario: Scenario, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._shut_down = False
        state = self.state = LiveState(self)
        bus = self._bus = Bus(state, self)
        slow_work = self._slow_work = BackgroundWorker(self)
        children = self._children = ProcessManager(bus, self)
        self.asyncio_thread = AsyncioThread()
        self._media_ring = FrameRing.create()
        self._frames = FrameRings([self._media_ring])
        self.frames = DisplayFrames(self._frames, state)
        bus.tap(self.frames.add, (People,))
        to_read = RingsToRead((self._media_ring.name,))

        context = ServiceContext(state, bus, children, slow_work, self)
        self._scenario = ScenarioService(context, parts.scenario, scenario, apply=self._apply)
        recording = self._recording = RecordingService(context, parts.recorder, rings=to_read)
        cameras = CamerasService(context, parts.cameras, frames=self._frames)
        speakers = SpeakersService(context)
        self._people = PeopleService(context, parts.people, rings=to_read, who_speaks=speakers.who_speaks)
        forgetting = ForgettingService(context, parts.forgetting, then=self._people.decide)
        self._robot = RobotService(
            context, self._media_ring, new_child=self._new_link, selected_cameras=parts.cameras,
            before_goal=lambda: self._drive.release(QT_TR_NOOP("A goal was set")), asyncio_thread=self.asyncio_thread,
        )  # fmt: skip
        self._microphone = MicrophoneService(
            context, parts.microphone, to_robot=self._robot.send_sound, hear_camera=cameras.hear
        )
        self._drive = DriveService(state, self._robot, scenario, self, publish=bus.publish, problem=bus.problem)
        head = HeadService(state, self._robot, self)
        self._speech = SpeechService(context, parts.speech, robot=self._robot)
        sound = SoundService(context, parts.sound, microphones=self._microphone, robot=self._robot, speech=self._speech)
        listening = ListeningService(context, parts.listening)
        transcript = TranscriptService(context)
        response_time = ResponseTimeService(bus, self)
        speaking = SpeakingService(context, self._speech.queue, parts.speech_history, do=self.do)
        assistant = AssistantService(
            context, parts.assistant, asyncio_thread=self.asyncio_thread, speech=self._speech.queue, scenario=scenario
        )
        proposals = ProposalsService(context, assistant.client, do=self.do)
        suggestions = SuggestionsService(
            context, assistant.client, speech=self._speech.queue, proposals=proposals, scenario=scenario
        )
        marks = MarksService(state, bus.publish, self)
        alarms = AlarmsService(state, bus.publish, self)
        protocol = ProtocolService(state, bus.publish, self)
        photos = PhotosService(context, recording, assistant, frames=self.frames, study=parts.session.study)
        going_on = CrashRecoveryService(
            context, parts.going_on,
            robot=self._robot, do=self.do, show_conversation=transcript.show_earlier,
        )  # fmt: skip
        preflight = PreflightService(
            context, disk=parts.session.disk, microphone_chosen=lambda: self._microphone.chosen is not None
        )
        self._session = SessionService(
            context, parts.session,
            SessionServices(
                recording, self._microphone, marks, protocol, assistant, suggestions, self._robot, self._scenario,
                going_on, preflight,
            ),
        )  # fmt: skip
        practice = PracticeService(context, parts.practice, do=self.do)
        face = FaceService(context, self.asyncio_thread, frames=self.frames)
        governor = LoadSheddingService(context, self._people, assistant.client)
        another_robot = self._another_robot = AnotherRobotService(
            context, by_name=parts.robots.connect_to, simulated=parts.robots.simulated,
            robot=self._robot, drive=self._drive, recording=recording, people=self._people,
        )  # fmt: skip
        self.gamepads = Gamepads(state, bus.publish, self)
        self.check_before_recording, self.robots = self._session.check_before, parts.robots.choices
        self.connect_robot = another_robot.connect_to  # from composition only, as use_robot
        self.expect_end, self.expect_shutdown = going_on.expect_end, going_on.expect_shutdown
        self.problem, self.report = bus.problem, bus.publish

        # Recording starts first and ends last, so that nothing is missing; the robot is stopped before all other
        # services.
        self._services: tuple[Service, ...] = (
            recording, self._microphone, cameras, forgetting, self._people, self._speech, speaking, sound, listening,
            speakers, transcript, response_time, marks, alarms, going_on, protocol, preflight, self._session,
            assistant, suggestions, proposals, photos, face, self._robot, head, self._drive, self._scenario, practice,
            governor, another_robot, HealthService(state, lambda: self._services, self),
        )  # fmt: skip
        tap_status(state, recording.put)
        bus.before_work(self._drive.renew_before_work)
        self._gate = Gate(state, lambda: self.scenario.permissions)
        self._handlers: dict[type[Intent], Handler] = {}
        for service in reversed(self._services):
            self._handlers.update(service.handlers())
            bus.follow(service.follows())
        self._apply(scenario)

    # State for panels

    @property
    def scenario(self) -> Scenario:
        return self._scenario.current

    @property
    def session_folder(self) -> Path | None:
        """Folder of the current session, or of the last one."""
        return self._recording.session_folder

    def run_in_background(
        self, read: Callable[[], T], done: Callable[[T], None], failed: Callable[[UserFacingError], None] | None = None
    ) -> None:
        self._slow_work.do(read, done, self._bus.answer if failed is None else failed)

    def microphones(self) -> Sequence[str]:
        return self._microphone.names

    @property
    def microphone(self) -> str | None:
        return self._microphone.chosen

    @property
    def wizard_microphone(self) -> str | None:
        return self._microphone.wizards_choice

    # Intents

    def do(self, intent: Intent) -> str:
        """Run an intent; returns the reason if it was refused, which the wizard also gets, else empty."""
        refusal = self._gate.refusal(intent)
        if refusal is None:
            try:
                self._handlers[type(intent)](intent)
            except UserFacingError as failure:
                what, meaning, advice = map(tr, (failure.what, failure.meaning, failure.advice))
                refusal = Refusal(what, meaning, advice, severity=failure.severity)
            else:
                return ""
        if not refusal.quiet:
            self._bus.problem(
                refusal.severity, refusal.what, refusal.meaning, refusal.advice, until=refusal.until, cause=ANSWER
            )
        return refusal.what

    def use_robot(self, find: Callable[[], RobotConnection], actor: Actor = WIZARD, *, until: ProblemEnd = "") -> None:
        """Connect a robot at start-up, from composition only; the wizard uses an intent and the gate. As
        :meth:`AnotherRobotService.use`.
        """
        self._another_robot.use(find, actor, until=until)

    # Access for helpers outside the services

    @property
    def child_pids(self) -> dict[str, int]:
        """Process ids of the children by name."""
        pids = {name: child.pid for service in self._services for name, child in service.processes().items()}
        return {name: pid for name, pid in pids.items() if pid is not None}

    # Start and shutdown

    def start(self) -> None:
        """Start all child processes and the perception thread, after the window is usable."""
        if self._shut_down:
            return
        self.gamepads.start()
        for service in self._services:
            service.start()

    def shutdown(self, during: During = lambda _what, work: work()) -> None:
        """Stop the robot, close the recording, end all threads and children, in that order.

        Blocks a few seconds, up to 90 s if much data must be written. ``during`` runs slow work with a message and
        returns when it is done; that work does not use Qt.
        """
        if self._shut_down:
            return
        self._shut_down = True
        self._children.close()
        self.gamepads.stop()
        for service in reversed(self._services):
            if service is self._session:
                # The robot is stopped; pending disk work still belongs to this session.
                self._slow_work.finish(during)
            service.stop()
        during(tr("Voice, models and people detection are being stopped."), self._end_helpers)
        self.asyncio_thread.stop()
        during(
            tr(
                "The recording is being completed: the remaining data is written to disk, and checksums are calculated."
            ),
            self._recording.end,
        )
        self._frames.close()
        self._bus.end()
        self.state.close()

    def _end_helpers(self) -> None:  # any thread
        for service in reversed(self._services):
            if service is not self._recording:
                service.end()
        self._children.end()

    def _apply(self, scenario: Scenario) -> None:
        for service in self._services:
            service.use_scenario(scenario)

    def _new_link(self, body: ProcessSpec) -> ChildProcess:
        return self._children.start(
            body, ended=self._robot.on_child_ended, on_message=self._speech.on_heard, reads=self._speech.read
        )
