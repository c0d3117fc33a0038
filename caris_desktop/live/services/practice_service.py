"""Practice service: prepares the simulated robot, detects completed steps, and reports the result."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject, QTimer

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import (
    CommandSent,
    EmergencyStopChanged,
    LinkChanged,
    LlmExchange,
    Marked,
    PersonRenamed,
    PhotoTaken,
    PracticeEnded,
    PracticeStepEnded,
    SuggestionChanged,
    UtteranceChanged,
)
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.sensing import Odometry
from caris_desktop.domain.translation import tr
from caris_desktop.domain.trial_details import TrialDetails
from caris_desktop.domain.value_class import Value
from caris_desktop.live.bus import Bus
from caris_desktop.live.practice_steps import STEPS, EndedStep, Practice
from caris_desktop.live.service import Follows, Handlers, Service
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import IN_SESSION, PracticeStatus, PracticeStepStatus, RecordingStatus
from caris_desktop.scenario.scenario_model import Scenario

PURPOSE = "practice"
_SIMULATED = "simulated"
LINK_IS_CUT_S = 4.0
_QUESTION = "Could you tell me something about this place?"
_REPEAT_AFTER_MS = 20_000
_STAGE_EVERY_MS = 300
_WATCHED = (
    CommandSent, EmergencyStopChanged, LinkChanged, LlmExchange, Marked, PersonRenamed, PhotoTaken, SuggestionChanged,
    UtteranceChanged,
)  # fmt: skip


class PracticeAdapters(Value):
    """``robot`` connects the simulated robot for the actor once ready, and raises UserFacingError; ``cut_link``
    interrupts its link for this many seconds.
    """

    scenario: Path
    robot: Callable[[Actor], None]
    cut_link: Callable[[float], None]


class PracticeService(Service):
    """Maintains ``state.practice``. The practice is recorded as a session that is excluded from the data."""

    def __init__(
        self,
        state: LiveState,
        bus: Bus,
        parts: PracticeAdapters,
        *,
        do: Callable[[intents.Intent], str],
        parent: QObject,
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._bus = bus
        self._parts = parts
        self._do = do
        self._practice: Practice | None = None
        self._wizard = ""
        self._scenario_before: Scenario | None = None
        self._robot_before = ""
        self._question_count = 0
        self._ask_again = QTimer(self, interval=_REPEAT_AFTER_MS)
        self._ask_again.timeout.connect(self._repeat_question)
        self._stage = QTimer(self, interval=_STAGE_EVERY_MS)
        self._stage.timeout.connect(self._begin_when_ready)
        state.odometry.changed.connect(self._on_odometry)
        state.recording.changed.connect(self._on_recording_changed)

    def handlers(self) -> Handlers:
        return {
            intents.BeginPractice: self._begin,
            intents.SkipPracticeStep: lambda intent: self._skip(intent.actor),
            intents.EndPractice: lambda intent: self._end(intent.actor),
        }

    def follows(self) -> Follows:
        return dict.fromkeys(_WATCHED, self._on_event)

    def stop(self) -> None:
        self._ask_again.stop()
        self._stage.stop()

    # Start and end

    def _begin(self, intent: intents.BeginPractice) -> None:
        if self._state.practice.value.state in ("preparing", "running"):
            return
        if self._state.recording.value.state in IN_SESSION:
            raise UserFacingError(
                tr("The practice cannot start: a recording is in progress."),
                tr("The recording continues."),
                tr("Stop the recording first."),
            )
        scenario, robot = self._state.scenario.value, self._state.robot.value
        self._parts.robot(intent.actor)
        self._wizard = intent.wizard
        self._practice = None
        again = self._state.practice.value.state == "ended"
        # Set first: scenario and robot opened for the practice must not be saved as preferences.
        self._state.practice.set(PracticeStatus("preparing"))
        if not self._is_stage(scenario):
            self._scenario_before = scenario
            self._do(intents.OpenScenario(self._parts.scenario, actor=intent.actor))
        elif not again:
            self._scenario_before = None
        if robot is not None and robot.name != _SIMULATED:
            self._robot_before = robot.name
        elif not again:
            self._robot_before = ""
        self._stage.start()

    def _is_stage(self, scenario: Scenario | None) -> bool:
        if scenario is None or scenario.path is None:
            return False
        return scenario.path.absolute() == self._parts.scenario.absolute()

    def _go_back(self, actor: Actor) -> None:
        """Restore the former scenario and robot."""
        before, self._scenario_before = self._scenario_before, None
        robot, self._robot_before = self._robot_before, ""
        if before is not None and before.path is not None and self._is_stage(self._state.scenario.value):
            self._do(intents.OpenScenario(before.path, actor=actor))
        present, on_its_way = self._state.robot.value, self._state.practice.value.state == "preparing"
        if robot and (on_its_way or (present is not None and present.name == _SIMULATED)):
            self._do(intents.UseRobot(robot, actor=actor))

    def _begin_when_ready(self) -> None:
        """Begin once the scenario is open, the robot connected and the recording running."""
        state = self._state
        scenario, recording = state.scenario.value, state.recording.value.state
        if not self._is_stage(scenario) or not state.drive.value.allowed:
            return
        if recording in ("idle", "failed"):
            # No trial depends on it: open checks are recorded but do not prevent the practice.
            details = TrialDetails(wizard=self._wizard, purpose=PURPOSE)
            self._do(intents.StartRecording(details, anyway=True, actor=CONSOLE))
        elif recording == "recording":
            self._stage.stop()
            self._practice = Practice(self._now_s())
            self._show()

    def _end(self, actor: Actor) -> None:
        practice, self._practice = self._practice, None
        self._stage.stop()
        self._ask_again.stop()
        if practice is None:
            self._go_back(actor)
            self._state.practice.set(PracticeStatus())
            return
        minutes = practice.minutes(self._now_s())
        self._bus.publish(
            PracticeEnded(clock.now_ns(), practice.done, len(STEPS), round(minutes, 2), practice.score, actor)
        )
        self._do(intents.StopRecording(actor=CONSOLE))
        self._state.practice.set(
            PracticeStatus(
                "ended", _steps(practice), practice.done, minutes, practice.score, wizard=self._wizard,
                back_to=self._scenario_before.title if self._scenario_before is not None else "",
            )
        )  # fmt: skip

    def _on_recording_changed(self, status: RecordingStatus) -> None:
        if self._practice is not None and status.state in ("idle", "failed", "stopping"):
            self._end(CONSOLE)  # the recording was stopped, or the disk is full

    # Events

    def _on_event(self, event: Any) -> None:
        if self._practice is not None:
            self._take(event)

    def _on_odometry(self, odometry: Odometry | None) -> None:
        if self._practice is not None and odometry is not None:
            self._take(odometry)

    def _take(self, value: Any) -> None:
        if self._practice is None:
            return
        ended = self._practice.add(value, self._now_s())
        if ended is not None:
            self._notify(ended, getattr(value, "actor", "") or CONSOLE)

    def _skip(self, actor: Actor) -> None:
        ended = self._practice.skip(self._now_s()) if self._practice is not None else None
        if ended is not None:
            self._notify(ended, actor)

    def _notify(self, ended: EndedStep, actor: Actor) -> None:
        practice = self._practice
        if practice is None:
            return
        self._bus.publish(
            PracticeStepEnded(
                clock.now_ns(), ended.step.id, len(practice.ended), ended.done, round(ended.took_s, 2), actor
            )
        )
        self._ask_again.stop()
        step = practice.now
        if step is None:
            self._end(actor)
            return
        if step.id == "suggestion":
            self._ask()
            self._ask_again.start()
        elif step.id == "link":
            self._parts.cut_link(LINK_IS_CUT_S)
        self._show()

    def _repeat_question(self) -> None:
        """Repeat the participant's question, unless suggestions are shown, which it would replace."""
        if self._state.suggestions.value.state not in ("asking", "shown"):
            self._ask()

    def _ask(self) -> None:
        """Simulate a participant's question, so that replies are suggested."""
        self._question_count += 1
        turn, now_ns = f"practice-{self._question_count}", clock.now_ns()
        question = UtteranceChanged(now_ns, turn, "participant", _QUESTION, "heard", "started", source=PURPOSE)
        for event in (question, replace(question, state="finished")):
            self._bus.publish(event)

    def _show(self) -> None:
        practice = self._practice
        if practice is not None:
            self._state.practice.set(
                PracticeStatus(
                    "running", _steps(practice), practice.done, since_ns=round(practice.since_s * 1e9),
                    wizard=self._wizard,
                )
            )  # fmt: skip

    def _now_s(self) -> float:
        return clock.now_ns() / 1e9


def _steps(practice: Practice) -> tuple[PracticeStepStatus, ...]:
    ended = {one.step.id: one for one in practice.ended}
    now = practice.now
    steps = []
    for step in STEPS:
        one = ended.get(step.id)
        if one is not None:
            steps.append(PracticeStepStatus(step.id, "done" if one.done else "skipped", one.took_s))
        else:
            steps.append(PracticeStepStatus(step.id, "now" if now is step else "open"))
    return tuple(steps)
