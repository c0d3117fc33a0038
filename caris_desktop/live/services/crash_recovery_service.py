"""Crash recovery of a trial: saves its state, offers it to the next run, and resumes it."""

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar, get_args

from caris_desktop.conversation.conversation_transcript import Turn
from caris_desktop.domain import clock, intents
from caris_desktop.domain.events import ConfirmedAsBefore, Event, InitialPoseSet, TrialDetails, TrialResumed
from caris_desktop.domain.failure import UserFacingError, reported
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import new_timer
from caris_desktop.live.service import ContextService, Follows, Handlers, ServiceContext
from caris_desktop.live.services.robot_service import RobotService
from caris_desktop.live.status import IN_SESSION, CrashRecoveryStatus, RecordingStatus
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.study import unfinished_trial
from caris_desktop.study.unfinished_trial import UnfinishedTrial

_log = logging.getLogger(__name__)
_SAVE_EVERY_MS = 5000
_NOT_SHUT_DOWN_AFTER_MS = 60_000
T = TypeVar("T")


class CrashRecoveryAdapters(Value):
    """``folder``: where running programs save their trial; ``details`` and ``conversation`` read those of a session in
    a background thread, empty if unavailable.
    """

    folder: Path
    study: Path
    details: Callable[[Path], TrialDetails]
    conversation: Callable[[Path], tuple[Turn, ...]]


class CrashRecoveryService(ContextService):
    """Maintains ``state.going_on``.

    After a crash nothing is assumed: the emergency stop is latched, and pose, people, recording and consents need
    confirmation. Until then the gate blocks recording.
    """

    def __init__(
        self,
        context: ServiceContext,
        parts: CrashRecoveryAdapters,
        *,
        robot: RobotService,
        do: Callable[[intents.Intent], str],
        show_conversation: Callable[[tuple[Turn, ...]], None],
    ) -> None:
        super().__init__(context)
        self._parts = parts
        self._robot = robot
        self._do = do
        self._show_conversation = show_conversation
        self._offered: UnfinishedTrial | None = None
        self._resumed: TrialResumed | None = None
        self._confirmed: list[ConfirmedAsBefore] = []
        self.step = ""
        """Protocol step in which the next recording resumes; empty if no recording broke off in a step."""
        self._saved: UnfinishedTrial | None = None
        self._soon = new_timer(self, self._persist, _SAVE_EVERY_MS, single_shot=True)
        self._end_expected = False
        self._shut_down_soon = new_timer(self, self._on_not_shut_down, _NOT_SHUT_DOWN_AFTER_MS, single_shot=True)
        self._state.recording.changed.connect(self._on_recording_changed)
        for value in (
            self._state.persons,
            self._state.selected_person,
            self._state.protocol,
            self._state.scenario,
            self._state.robot,
        ):
            value.changed.connect(self._on_changed)

    def handlers(self) -> Handlers:
        return {
            intents.GoOnWithTrial: self._go_on,
            intents.LeaveTrial: self._leave,
            intents.ConfirmAsBefore: self._confirm,
        }

    def follows(self) -> Follows:
        # Setting the robot's pose confirms it.
        return {InitialPoseSet: lambda event: self._confirm(intents.ConfirmAsBefore("map", actor=event.actor))}

    def use_scenario(self, scenario: Scenario) -> None:
        status: CrashRecoveryStatus = self._state.going_on.value
        resumed = status.state in ("unconfirmed", "confirmed")
        if resumed and _recording_permissions(self._scenario) != _recording_permissions(scenario):
            # The confirmation was given for another scenario.
            left = tuple(what for what in get_args(intents.AsBefore) if what in (*status.unconfirmed, "permissions"))
            self._state.going_on.set(replace(status, state="unconfirmed", unconfirmed=left))
        self._scenario = scenario

    def start(self) -> None:
        def work() -> tuple[UnfinishedTrial, TrialDetails] | None:
            found = unfinished_trial.take_newest(self._parts.folder, self._parts.study)
            return (found, self._parts.details(found.session)) if found is not None else None

        self._do_slowly(work, self._on_found)

    def end(self) -> None:
        """Called when the recording has ended normally."""
        try:
            unfinished_trial.forget(self._parts.folder)
        except OSError:
            _log.exception("the next run will offer to go on with a trial that has ended")

    def expect_end(self) -> None:
        """The program is asked to quit: what follows is no crash."""
        self._shut_down_soon.stop()
        self._end_expected = True
        self.end()

    def expect_shutdown(self) -> None:
        """The computer is shutting down or the user is logging out, which can still be cancelled."""
        if not self._end_expected:
            self._shut_down_soon.start()
        self._end_expected = True
        self.end()

    def _on_not_shut_down(self) -> None:
        self._end_expected = False
        if self._saved is not None:
            self._saved = None
            self._persist()

    def state_events(self, now_ns: int) -> list[Event]:
        """Initial events in the recording of a resumed trial."""
        if self._resumed is None:
            return []
        return [replace(self._resumed, stamp_ns=now_ns), *(replace(one, stamp_ns=now_ns) for one in self._confirmed)]

    def _do_slowly(self, work: Callable[[], T], done: Callable[[T], None] = lambda _done: None) -> None:
        def run() -> T:
            with reported(OSError, tr("An interrupted trial cannot be offered for resuming."), ""):
                return work()

        # No session data is lost by a failure: the log suffices.
        self._slow_work.do(run, done, lambda failure: _log.warning("%s %s", failure.what, failure.meaning))

    # Saving

    def _on_recording_changed(self, status: RecordingStatus) -> None:
        if status.state in ("recording", "paused"):
            if self._saved is None:
                self._state.going_on.set(CrashRecoveryStatus())
                self._persist()
        elif status.state in ("idle", "failed") and self._saved is not None:
            self._saved = None
            self._soon.stop()
            self._do_slowly(lambda: unfinished_trial.forget(self._parts.folder))
            # The resumed trial was recorded.
            self._resumed, self._confirmed, self.step = None, [], ""
            self._state.going_on.set(CrashRecoveryStatus())

    def _on_changed(self, _value: object) -> None:
        if self._saved is not None and not self._soon.isActive():
            self._soon.start()

    def _persist(self) -> None:
        state, scenario, connection = self._state, self._scenario, self._robot.connection
        folder: Path | None = state.recording.value.folder
        if folder is None or self._end_expected or state.practice.value.state:
            return  # a practice begins anew, with no participant to ask
        trial = UnfinishedTrial(
            folder,
            str(scenario.path) if scenario.path is not None else "",
            connection.profile.name if connection is not None else "",
            tuple(row.person_id for row in state.persons.value if row.here),
            state.selected_person.value,
            state.protocol.value.step_id,
        )
        if trial != self._saved:
            self._saved = trial
            self._do_slowly(lambda: self._write(trial))

    def _write(self, trial: UnfinishedTrial) -> None:  # any thread
        if not self._end_expected:
            unfinished_trial.save_unfinished(self._parts.folder, trial)

    # Resuming

    def _on_found(self, found: tuple[UnfinishedTrial, TrialDetails] | None) -> None:
        if found is None:
            return
        self._offered, details = found
        self._state.going_on.set(CrashRecoveryStatus("offered", self._offered.session.name, details))

    def _go_on(self, intent: intents.GoOnWithTrial) -> None:
        trial, status = self._offered, self._state.going_on.value
        if trial is None or status.state != "offered":
            raise UserFacingError(
                tr("There is no trial to resume."), tr("Nothing was changed."), tr("Start a recording.")
            )
        if self._state.recording.value.state in IN_SESSION:
            raise UserFacingError(
                tr("A recording is in progress: the interrupted trial cannot be resumed."),
                tr("Nothing was changed."), tr("End the recording first."),
            )  # fmt: skip
        # Anyone about to move when the program crashed may be anywhere now.
        if not self._state.drive.value.emergency_stop:
            self._do(intents.EmergencyStop(actor=intent.actor))
        here, connection = self._scenario, self._robot.connection
        if trial.scenario and str(here.path) != trial.scenario:
            self._do(intents.OpenScenario(Path(trial.scenario), actor=intent.actor))
        if trial.robot and (connection is None or connection.profile.name != trial.robot):
            self._do(intents.UseRobot(trial.robot, actor=intent.actor))
        if trial.attended:
            self._do(intents.AttendPerson(trial.attended, actor=intent.actor))
        self._offered, self.step = None, trial.step
        self._do_slowly(lambda: self._parts.conversation(trial.session), self._on_conversation)
        self._resumed = TrialResumed(clock.now_ns(), trial.session.name, intent.actor)
        self._bus.publish(self._resumed)
        self._state.going_on.set(
            replace(
                status,
                state="unconfirmed",
                unconfirmed=get_args(intents.AsBefore),
                people=trial.people,
                unconfirmed_people=trial.people,
            )
        )

    def _on_conversation(self, turns: tuple[Turn, ...]) -> None:
        if self._resumed is not None:
            self._show_conversation(turns)

    def _leave(self, intent: intents.LeaveTrial) -> None:
        if self._resumed is not None:
            self._show_conversation(())
        self._offered, self._resumed, self._confirmed, self.step = None, None, [], ""
        self._state.going_on.set(CrashRecoveryStatus())
        _log.info("the trial is not gone on with, says %s", intent.actor)

    def _confirm(self, intent: intents.ConfirmAsBefore) -> None:
        status: CrashRecoveryStatus = self._state.going_on.value
        if intent.what not in status.unconfirmed:
            return
        if intent.person_id:
            if intent.person_id not in status.unconfirmed_people:
                return
            self._note(ConfirmedAsBefore(clock.now_ns(), intent.what, intent.actor, intent.person_id))
            people = tuple(person for person in status.unconfirmed_people if person != intent.person_id)
            status = replace(status, unconfirmed_people=people)
            rows = (*self._state.persons.value, *self._state.everybody.value)
            if any(row.person_id in people for row in rows):
                self._state.going_on.set(status)
                return
        # Confirming the last existing row covers everyone.
        self._note(ConfirmedAsBefore(clock.now_ns(), intent.what, intent.actor))
        left = tuple(what for what in status.unconfirmed if what != intent.what)
        people = status.unconfirmed_people if "people" in left else ()
        self._state.going_on.set(
            replace(status, unconfirmed=left, unconfirmed_people=people, state="unconfirmed" if left else "confirmed")
        )

    def _note(self, event: ConfirmedAsBefore) -> None:
        self._confirmed.append(event)
        self._bus.publish(event)


def _recording_permissions(scenario: Scenario) -> tuple[object, ...]:
    """Permissions to record, and to pass data to a model."""
    return scenario.permissions, scenario.blur, scenario.assistance
