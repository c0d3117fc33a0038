"""Session service: coordinates the services at start, pause and end of a recording."""

import contextlib
import functools
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from PySide6.QtCore import QObject

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.address import plugin_address
from caris_desktop.domain.events import (
    EmergencyStopChanged,
    Event,
    GoalChanged,
    GuardChanged,
    LinkChanged,
    Marked,
    PersonAppeared,
    TrialDetails,
)
from caris_desktop.domain.failure import RefusedError
from caris_desktop.domain.plugins import PluginError, PluginGroup, find, installed
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.service import ContextService, Follows, Handlers, Service, ServiceContext
from caris_desktop.live.services.assistant_service import AssistantService
from caris_desktop.live.services.crash_recovery_service import CrashRecoveryService
from caris_desktop.live.services.microphone_service import MicrophoneService
from caris_desktop.live.services.preflight_service import PreflightService
from caris_desktop.live.services.protocol_service import ProtocolService
from caris_desktop.live.services.recording_service import RecordingService
from caris_desktop.live.services.robot_service import RobotConnection, RobotService
from caris_desktop.live.services.scenario_service import ScenarioService
from caris_desktop.live.services.suggestions_service import SuggestionsService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import LinkStatus, MarksStatus, RecordingStatus
from caris_desktop.live.wizard_console import BeforeRecording
from caris_desktop.recording.session.session_header import SessionHeader
from caris_desktop.recording.session.session_marks import final_marks_of, notes_among
from caris_desktop.scenario.scenario_model import Scenario, plugin_panels

# Mark service: marks and notes of the wizard; each change is an event with the same id. GUI thread.

_NANOSECONDS = 1_000_000_000


class MarksService(Service):
    """Creates and changes marks and notes, and maintains ``state.marks`` and ``state.notes``."""

    def __init__(self, state: LiveState, publish: Callable[[Event], None], parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._state = state
        self._publish = publish
        self._marks: dict[str, Marked] = {}
        self._withdrawn: dict[str, Marked] = {}
        self._of_notes: list[Marked] = []

    def forget(self) -> None:
        """Start a new session without earlier marks."""
        self._marks.clear()
        self._withdrawn.clear()
        self._of_notes.clear()
        self._state.marks.set(MarksStatus())
        self._state.notes.set(())

    def handlers(self) -> Handlers:
        return {
            intents.Mark: self.mark,
            intents.BeginMark: self.begin,
            intents.StretchMark: self.open_interval,
            intents.EndMark: lambda intent: self.end_mark(intent.mark_id, intent.actor),
            intents.ChangeMark: self.change,
            intents.WithdrawMark: lambda intent: self.withdraw(intent.mark_id, intent.actor),
            intents.AddNote: self.add_note,
            intents.ChangeNote: lambda intent: self.write_note(intent.note_id, intent.text, intent.actor),
            intents.RemoveNote: self.remove_note,
            intents.RestoreNote: self.restore_note,
        }

    def mark(self, intent: intents.Mark) -> None:
        now_ns = clock.now_ns()
        start_ns = now_ns - round(intent.earlier_s * _NANOSECONDS) if intent.earlier_s > 0 else None
        self._persist(Marked(now_ns, intent.label, intent.kind, intent.mark_id, start_ns, actor=intent.actor))

    def begin(self, intent: intents.BeginMark) -> None:
        now_ns = clock.now_ns()
        start_ns = now_ns - round(intent.earlier_s * _NANOSECONDS)
        self._persist(
            Marked(now_ns, intent.label, intent.kind, intent.mark_id, start_ns, state="open", actor=intent.actor)
        )

    def open_interval(self, intent: intents.StretchMark) -> None:
        """Turn the moment into an open interval."""
        mark = self._marks.get(intent.mark_id)
        if mark is not None and mark.state == "done" and mark.end_ns is None:
            now_ns = clock.now_ns()
            self._persist(replace(mark, stamp_ns=now_ns, start_ns=mark.moment_ns, state="open", actor=intent.actor))

    def end_mark(self, mark_id: str, actor: Actor = CONSOLE) -> None:
        mark = self._marks.get(mark_id)
        if mark is not None and mark.state == "open":
            now_ns = clock.now_ns()
            self._persist(replace(mark, stamp_ns=now_ns, end_ns=now_ns, state="done", actor=actor))

    def end_all(self, actor: Actor = CONSOLE) -> None:
        """End all open intervals with the session."""
        for mark_id in tuple(self._marks):
            self.end_mark(mark_id, actor)

    def change(self, intent: intents.ChangeMark) -> None:
        mark = self._marks.get(intent.mark_id)
        if mark is None:
            return
        start_ns = mark.moment_ns - round(intent.earlier_s * _NANOSECONDS)
        label = mark.label if intent.label is None else intent.label
        # The stamp becomes the time of the change.
        self._persist(replace(mark, stamp_ns=clock.now_ns(), start_ns=start_ns, label=label, actor=intent.actor))

    def withdraw(self, mark_id: str, actor: Actor = CONSOLE) -> None:
        mark = self._marks.pop(mark_id, None)
        if mark is None:
            return
        self._withdrawn[mark_id] = mark
        self._notify(replace(mark, stamp_ns=clock.now_ns(), state="withdrawn", actor=actor))
        self._show(None)

    def add_note(self, intent: intents.AddNote) -> None:
        text = _written(intent.text)
        if self._state.recording.value.state != "recording":
            raise RefusedError(
                tr(
                "The note was not "
                "saved."), tr("Nothing is being recorded now, so the note would not belong to a session."),
                tr("Start or continue the recording, then press Enter again."),
            )  # fmt: skip
        now_ns = clock.now_ns()
        at_ns = now_ns - round(intent.earlier_s * _NANOSECONDS)
        self._persist(Marked(now_ns, "", "note", intent.note_id, at_ns, note=text, actor=intent.actor))

    def write_note(self, note_id: str, text: str, actor: Actor) -> None:
        mark = self._of_this_session(note_id)
        if mark.kind == "note":
            text = _written(text)
        at_ns = mark.moment_ns
        self._persist(replace(mark, stamp_ns=clock.now_ns(), start_ns=at_ns, note=" ".join(text.split()), actor=actor))

    def remove_note(self, intent: intents.RemoveNote) -> None:
        if self._of_this_session(intent.note_id).kind == "note":
            self.withdraw(intent.note_id, intent.actor)
        else:
            self.write_note(intent.note_id, "", intent.actor)

    def restore_note(self, intent: intents.RestoreNote) -> None:
        note = self._withdrawn.pop(intent.note_id, None)
        if note is not None:
            self._persist(replace(note, stamp_ns=clock.now_ns(), start_ns=note.moment_ns, actor=intent.actor))

    def _of_this_session(self, note_id: str) -> Marked:
        mark = self._marks.get(note_id)
        if mark is None:
            raise RefusedError(
                tr("That note belongs to another session."), tr("Nothing was changed."),
                tr("Change it in the session in which it was written."),
            )  # fmt: skip
        return mark

    def _persist(self, mark: Marked) -> None:
        self._marks[mark.mark_id] = mark
        self._notify(mark)
        self._show(mark)

    def _notify(self, mark: Marked) -> None:
        self._publish(mark)
        known = any(earlier.mark_id == mark.mark_id for earlier in self._of_notes)
        if known or mark.kind == "note" or mark.note:
            self._of_notes.append(mark)
            marks = final_marks_of(self._of_notes, ended_ns=mark.stamp_ns)
            self._state.notes.set(notes_among(marks))

    def _show(self, last: Marked | None) -> None:
        going_on = tuple(mark for mark in self._marks.values() if mark.state == "open")
        self._state.marks.set(MarksStatus(last, going_on))


def _written(text: str) -> str:
    text = " ".join(text.split())
    if not text:
        raise RefusedError(
            tr("A note needs text."), tr("The note is unchanged."), tr("Remove the note if you do not need it.")
        )
    return text


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


class SessionService(ContextService):
    """Starts, pauses and ends sessions, and takes photos."""

    def __init__(self, context: ServiceContext, parts: SessionAdapters, concerned: SessionServices) -> None:
        super().__init__(context)
        self._parts = parts
        self._with = concerned
        self._emergency: EmergencyStopChanged | None = None
        self._stopped_before_pause = False
        self._state.recording.changed.connect(self._on_recording_changed)

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
            # Refuse if required checks are open and the wizard was not asked before, whatever key was used.
            waits = self._with.preflight.waits_for()
            if waits:
                raise RefusedError(
                    tr("The recording did not start. Not ready: {checks}.").format(
                        checks=", ".join(tr(check.title) for check in waits)
                    ),
                    tr("Nothing is recorded."),
                    tr("Resolve this in the preflight checks, or choose Record anyway in Start recording."),
                )
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
                named={
                    "speech": (self._state.voice.value.used, self._state.listening.value.model),
                    "panels": plugin_panels(scenario),
                },
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
        drive = state.drive.value
        if drive.emergency_stop or (resumed and self._stopped_before_pause):
            known = self._emergency or EmergencyStopChanged(now_ns, drive.emergency_stop, "wizard")
            standing.append(replace(known, stamp_ns=now_ns, latched=drive.emergency_stop))
        if resumed:
            standing.append(GuardChanged(now_ns, drive.guard, drive.guard_distance_m, drive.guard_detail, CONSOLE))
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
            self._stopped_before_pause = self._state.drive.value.emergency_stop
            concerned.marks.end_all(intent.actor)
            concerned.microphone.close()
        elif concerned.scenario.current.permissions.audio_recording:
            concerned.microphone.open()
        concerned.recording.pause_session(self._state_events(resumed=True), intent)
        concerned.protocol.pause(intent.paused)

    def _on_emergency_stop(self, event: EmergencyStopChanged) -> None:
        self._emergency = event

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
    named: Mapping[PluginGroup, tuple[str, ...]],
) -> tuple[Path, SessionHeader]:
    """New session whose header names the plug-ins that run, with the package and version of each.

    ``named`` are those in use, ``plugin:NAME`` if a plug-in.
    """
    folder, header = new_session(details, scenario, connection)
    for group, names in named.items():
        for name in names:
            if name.startswith("plugin:"):
                with contextlib.suppress(PluginError):
                    plugin = find(group, name.removeprefix("plugin:"))
                    plugins |= {plugin.title: plugin.package}
    of_robot = plugin_address(connection.address) if connection is not None else None
    robot = installed("robots").get(of_robot[0]) if of_robot is not None else None
    if robot is not None and not robot.is_built_in:
        plugins = {**plugins, robot.title: robot.package}
    return folder, replace(header, software=header.software | {f"plug-in {name}": of for name, of in plugins.items()})
