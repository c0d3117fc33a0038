"""Session service: coordinates the services at start, pause and end of a recording."""

import functools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from PySide6.QtCore import QObject

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import EmergencyStopChanged, Event, GoalChanged, LinkChanged, PersonAppeared
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.translation import tr
from caris_desktop.domain.trial_details import TrialDetails
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.service import Follows, Handlers, Service
from caris_desktop.live.services.assistant_service import AssistantService
from caris_desktop.live.services.crash_recovery_service import CrashRecoveryService
from caris_desktop.live.services.marks_service import MarksService
from caris_desktop.live.services.microphone_service import MicrophoneService
from caris_desktop.live.services.preflight_service import PreflightService
from caris_desktop.live.services.protocol_service import ProtocolService
from caris_desktop.live.services.recording_service import RecordingService
from caris_desktop.live.services.robot_service import RobotConnection, RobotService
from caris_desktop.live.services.scenario_service import ScenarioService
from caris_desktop.live.services.suggestions_service import SuggestionsService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import LinkStatus, RecordingStatus
from caris_desktop.live.wizard_console import BeforeRecording
from caris_desktop.recording.session.session_header import SessionHeader
from caris_desktop.scenario.scenario_model import Scenario


class SessionAdapters(Value):
    """All but ``photo_file`` access files, in a background thread; ``new_session`` creates the folder, and raises
    UserFacingError in English.
    """

    suggested_details: Callable[[], TrialDetails]
    new_session: Callable[[TrialDetails, Scenario, RobotConnection | None], tuple[Path, SessionHeader]]
    expected_bytes_per_hour: Callable[[Scenario], float | None]
    free_bytes: Callable[[], int | None]
    photo_file: Callable[[], Path]
    study: Path

    def disk(self, scenario: Scenario) -> tuple[int | None, float | None]:
        """Free space, and usage per hour of recording. Reads files."""
        return self.free_bytes(), self.expected_bytes_per_hour(scenario)


class SessionServices(Value):
    """Services involved in a session."""

    recording: RecordingService
    microphone: MicrophoneService
    marks: MarksService
    protocol: ProtocolService
    assistant: AssistantService
    suggestions: SuggestionsService
    robot: RobotService
    scenario: ScenarioService
    going_on: CrashRecoveryService
    preflight: PreflightService


class SessionService(Service):
    """Starts, pauses and ends sessions, and takes photos."""

    def __init__(
        self,
        state: LiveState,
        parts: SessionAdapters,
        slow_work: BackgroundWorker,
        concerned: SessionServices,
        parent: QObject,
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._parts = parts
        self._slow_work = slow_work
        self._with = concerned
        self._latched: EmergencyStopChanged | None = None
        state.recording.changed.connect(self._on_recording_changed)

    def handlers(self) -> Handlers:
        return {
            intents.StartRecording: self._start_session,
            intents.StopRecording: lambda intent: self._stop_session("wizard", intent.actor),
            intents.PauseRecording: self._pause,
            intents.TakePhoto: lambda intent: self._with.recording.take_photo(
                without_session=self._parts.photo_file(), actor=intent.actor
            ),
        }

    def follows(self) -> Follows:
        return {EmergencyStopChanged: self._on_emergency_stop}

    def stop(self) -> None:
        self._stop_session("console_closed", CONSOLE)

    def _start_session(self, intent: intents.StartRecording) -> None:
        concerned = self._with
        if not concerned.recording.idle:
            return
        if not intent.anyway:
            self._refuse_unready()
        # One participant's conversation must enter neither the model's context nor the record of the next.
        concerned.marks.forget()
        concerned.assistant.forget(conversation=True)
        concerned.suggestions.forget()
        concerned.protocol.begin_session(intent.actor, step_id=concerned.going_on.step)
        checked = concerned.preflight.state_events(accepted=intent.anyway)
        if not concerned.recording.announce_session([*self._state_events(resumed=False), *checked]):
            return
        if concerned.scenario.current.permissions.audio_recording:
            # Opening takes a second or two, and the first words must not be missing.
            concerned.microphone.open_and_then(lambda: self._begin(intent))
        else:
            self._begin(intent)

    def _refuse_unready(self) -> None:
        """Refuse if required checks are open and the wizard was not asked before, whatever key was used."""
        waits = self._with.preflight.waits_for()
        if waits:
            raise UserFacingError(
                tr("The recording did not start. Not ready: {checks}.").format(
                    checks=", ".join(tr(check.title) for check in waits)
                ),
                tr("Nothing is recorded."),
                tr("Resolve this in the preflight checks, or choose Record anyway in Start recording."),
                severity="warning",
            )

    def _begin(self, intent: intents.StartRecording) -> None:
        concerned = self._with
        scenario, connection = concerned.scenario.current, concerned.robot.connection
        concerned.recording.begin_session(
            functools.partial(
                _with_plugins,
                self._parts.new_session,
                intent.details,
                scenario,
                connection,
                plugins=dict(self._state.perception.value.plugins) | concerned.assistant.plugins,
            ),
            intent.actor,
            refused=concerned.microphone.close,
        )

    def _state_events(self, *, resumed: bool) -> list[Event]:
        """Persistent state as events, at the start or resumption of a recording."""
        now_ns, state = clock.now_ns(), self._state
        link: LinkStatus = state.link.value
        standing: list[Event] = [
            LinkChanged(now_ns, "control", link.state, link.address, link.detail),
            *self._with.scenario.state_events(now_ns),
            *self._with.protocol.state_events(now_ns, resumed=resumed),
            *self._with.robot.state_events(),
            *self._with.going_on.state_events(now_ns),
        ]
        if state.drive.value.emergency_stop:
            latched = self._latched or EmergencyStopChanged(now_ns, True, "wizard")
            standing.append(replace(latched, stamp_ns=now_ns))
        goal: GoalChanged | None = state.goal.value
        if goal is not None and (resumed or goal.state in ("requested", "active")):
            # A goal that ended before does not belong to this recording; during a pause its end is missing.
            standing.append(replace(goal, stamp_ns=now_ns))
        standing += [
            PersonAppeared(now_ns, row.person_id, row.track, row.number) for row in state.persons.value if row.here
        ]
        return standing

    def _stop_session(self, reason: str, actor: Actor) -> None:
        concerned = self._with
        concerned.marks.end_all(actor)
        if not concerned.recording.idle:
            # Unused answers are recorded as such at the end, and hidden from the next participant.
            concerned.assistant.forget()
            concerned.suggestions.forget()
        concerned.microphone.close()
        concerned.recording.stop_session(reason, actor)
        concerned.protocol.end_session()

    def _pause(self, intent: intents.PauseRecording) -> None:
        concerned = self._with
        # Earlier questions belong to the recording, those during the pause do not.
        concerned.assistant.forget()
        concerned.suggestions.forget()
        if intent.paused:
            concerned.marks.end_all(intent.actor)
            concerned.microphone.close()
        elif concerned.scenario.current.permissions.audio_recording:
            concerned.microphone.open()
        concerned.recording.pause_session(self._state_events(resumed=True), intent)
        concerned.protocol.pause(intent.paused)

    def _on_emergency_stop(self, event: EmergencyStopChanged) -> None:
        self._latched = event if event.latched else None

    def _on_recording_changed(self, status: RecordingStatus) -> None:
        if status.state in ("idle", "failed"):
            self._with.protocol.end_session()
        if status.state in ("idle", "failed") and self._with.microphone.records:
            # It ended unexpectedly, for example on a full disk.
            self._with.microphone.close()
            self._with.marks.forget()

    def check_before(self, on_result: Callable[[BeforeRecording], None]) -> None:
        """Implements :meth:`WizardConsole.check_before_recording`."""
        scenario = self._with.scenario.current

        def query() -> BeforeRecording:
            free_bytes, bytes_per_hour = self._parts.disk(scenario)
            return BeforeRecording(self._parts.suggested_details(), bytes_per_hour, free_bytes)

        self._slow_work.do(query, on_result, lambda _failure: on_result(BeforeRecording()))


def _with_plugins(
    new_session: Callable[[TrialDetails, Scenario, RobotConnection | None], tuple[Path, SessionHeader]],
    details: TrialDetails,
    scenario: Scenario,
    connection: RobotConnection | None,
    *,
    plugins: dict[str, str],
) -> tuple[Path, SessionHeader]:
    """New session whose header names the plug-ins that run, with the package and version of each."""
    folder, header = new_session(details, scenario, connection)
    return folder, replace(header, software=header.software | {f"plug-in {name}": of for name, of in plugins.items()})
