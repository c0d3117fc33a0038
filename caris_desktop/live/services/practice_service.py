"""Practice service: prepares the simulated robot, detects completed steps, and reports the result."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

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
    TrialDetails,
    UtteranceChanged,
)
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.sensing import Odometry
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import new_timer
from caris_desktop.live.service import ContextService, Follows, Handlers, ServiceContext
from caris_desktop.live.status import IN_SESSION, PracticeStatus, PracticeStepStatus, RecordingStatus
from caris_desktop.scenario.scenario_model import Scenario

# Steps of the guided practice, and detection of their completion. With injected time, without Qt.

_DRIVEN_M, _DRIVEN_AGAIN_M = 1.0, 0.3
_MOST_POINTS, _FEWEST_POINTS = 10.0, 5.0
_SLOW = 3.0
"""Factor of the usual time at which a step gets the fewest points."""


class PracticeStep(Value):
    """``how``: instruction, with ``{key}`` for the key of ``action_id`` in the action table. ``usual_s``: duration with
    experience.
    """

    id: str
    title: str
    how: str
    usual_s: float
    action_id: str = ""


STEPS = (
    PracticeStep(
        "drive", QT_TR_NOOP("Drive one metre"),
        QT_TR_NOOP("Hold {key}, or Alt and the up arrow key: the robot drives as long as you hold them. The other "
            "arrow keys turn and reverse."),
        40.0, "drive_forward",
    ),
    PracticeStep(
        "type", QT_TR_NOOP("Type while driving"),
        QT_TR_NOOP("Press {key} and type something. Hold Alt and an arrow key so that the robot drives, then press "
            "Enter while driving."),
        60.0, "focus_speak",
    ),
    PracticeStep(
        "phrase", QT_TR_NOOP("Say a phrase"),
        QT_TR_NOOP("Press {key}, or click one of the phrases below the Speak field."), 20.0, "phrase_1",
    ),
    PracticeStep(
        "name", QT_TR_NOOP("Name a person"),
        QT_TR_NOOP(
            "Press {key}, or Name next to a person in People. Type a name and press "
            "Enter."), 40.0, "name_person",
    ),
    PracticeStep(
        "photo", QT_TR_NOOP("Take a photo"),
        QT_TR_NOOP("Press {key}, or Photo on the picture."), 20.0, "photo",
    ),
    PracticeStep(
        "ask", QT_TR_NOOP("Ask the assistant"),
        QT_TR_NOOP(
            "Click Assistant, or press {key} and type its name. Type a question, press Enter, and wait for "
                "the answer."
        ),
        60.0, "find",
    ),
    PracticeStep(
        "suggestion", QT_TR_NOOP("Use a suggestion"),
        QT_TR_NOOP("A participant has asked a question. When Conversation shows suggested replies, press {key} to say "
            "one."),
        40.0, "suggestion_1",
    ),
    PracticeStep(
        "mark", QT_TR_NOOP("Mark a moment"),
        QT_TR_NOOP("Press {key}, or Mark at the top. The mark is recorded for later analysis."), 20.0, "mark",
    ),
    PracticeStep(
        "link", QT_TR_NOOP("Recover from a lost connection"),
        QT_TR_NOOP(
            "The connection was interrupted. Note how the window shows this. It reconnects automatically: "
                "then drive a little further."
        ),
        40.0,
    ),
    PracticeStep(
        "emergency", QT_TR_NOOP("Stop in an emergency"),
        QT_TR_NOOP(
            "Press Esc twice, or the red button. Then release the stop with the button in the red banner, or "
                "in Find anything."
        ),
        30.0,
        "emergency_stop",
    ),
)  # fmt: skip


class EndedStep(Value):
    """``took_s``: from the end of the previous step."""

    step: PracticeStep
    done: bool
    took_s: float

    @property
    def points(self) -> float:
        if not self.done:
            return 0.0
        late = (self.took_s / self.step.usual_s - 1.0) / (_SLOW - 1.0)
        return _MOST_POINTS - (_MOST_POINTS - _FEWEST_POINTS) * min(1.0, max(0.0, late))


class Practice:
    """One run of the practice; detects completed steps from events."""

    def __init__(self, now_s: float) -> None:
        self.began_s = now_s
        self.ended: list[EndedStep] = []
        self.since_s = now_s
        self._moving = self._moved = self._lost = self._latched = False
        self._driven_m = 0.0
        self._at: tuple[float, float] | None = None
        self._happened: Mapping[str, Callable[[Any], bool]] = {
            "drive": lambda _event: self._driven_m >= _DRIVEN_M,
            "type": lambda event: self._moving and isinstance(event, UtteranceChanged) and event.origin == "typed",
            "phrase": lambda event: (
                isinstance(event, UtteranceChanged)
                and event.origin == "phrase"
                and event.state in ("started", "finished")
            ),
            "name": lambda event: isinstance(event, PersonRenamed) and bool(event.actor),
            "photo": lambda event: isinstance(event, PhotoTaken),
            "ask": lambda event: (
                isinstance(event, LlmExchange) and (event.purpose, event.outcome) == ("question", "answered")
            ),
            "suggestion": lambda event: isinstance(event, SuggestionChanged) and event.state in ("taken", "edited"),
            "mark": lambda event: isinstance(event, Marked) and event.kind == "mark" and event.state != "withdrawn",
            "link": lambda _event: self._lost and self._driven_m >= _DRIVEN_AGAIN_M,
            "emergency": lambda event: self._latched and isinstance(event, EmergencyStopChanged) and not event.latched,
        }

    @property
    def now(self) -> PracticeStep | None:
        """Current step; None after the last."""
        return STEPS[len(self.ended)] if len(self.ended) < len(STEPS) else None

    @property
    def done(self) -> int:
        return sum(step.done for step in self.ended)

    @property
    def score(self) -> int:
        """Score of 100: ten for a step in its usual time, five at three times that, none if skipped."""
        return round(sum(step.points for step in self.ended))

    def minutes(self, now_s: float) -> float:
        return (now_s - self.began_s) / 60.0

    def add(self, value: Any, now_s: float) -> EndedStep | None:
        """Process an event or robot motion; returns the step that it completed."""
        if isinstance(value, CommandSent):
            self._moving = value.twist.moving
            self._moved = self._moved or self._moving
        elif isinstance(value, Odometry):
            self._drove(value)
        elif isinstance(value, LinkChanged) and value.link == "control":
            if value.state == "lost":
                self._lost, self._driven_m = True, 0.0
        elif isinstance(value, EmergencyStopChanged) and value.latched:
            self._latched = True
        step = self.now
        if step is None or not self._happened[step.id](value):
            return None
        return self._end(step, now_s, done=True)

    def skip(self, now_s: float) -> EndedStep | None:
        return None if self.now is None else self._end(self.now, now_s, done=False)

    def _end(self, step: PracticeStep, now_s: float, *, done: bool) -> EndedStep:
        ended = EndedStep(step, done, now_s - self.since_s)
        self.ended.append(ended)
        self.since_s = now_s
        self._lost = self._latched = False
        self._driven_m = 0.0
        return ended

    def _drove(self, odometry: Odometry) -> None:
        """Count manually driven distance only, not navigation or pushing. Odometry may arrive less often than commands:
        the last part arrives after the key was released.
        """
        pose = odometry.pose_in_odom
        before, self._at = self._at, (pose.x_m, pose.y_m)
        if before is not None and self._moved:
            self._driven_m += math.dist(before, self._at)
        self._moved = self._moving


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


class PracticeService(ContextService):
    """Maintains ``state.practice``. The practice is recorded as a session that is excluded from the data."""

    def __init__(
        self, context: ServiceContext, parts: PracticeAdapters, *, do: Callable[[intents.Intent], str]
    ) -> None:
        super().__init__(context)
        self._parts = parts
        self._do = do
        self._practice: Practice | None = None
        self._wizard = ""
        self._scenario_before: Scenario | None = None
        self._robot_before = ""
        self._question_count = 0
        self._ask_again = new_timer(self, self._repeat_question, _REPEAT_AFTER_MS)
        self._stage = new_timer(self, self._begin_when_ready, _STAGE_EVERY_MS)
        self._state.odometry.changed.connect(self._take)
        self._state.recording.changed.connect(self._on_recording_changed)

    def handlers(self) -> Handlers:
        return {
            intents.BeginPractice: self._begin,
            intents.SkipPracticeStep: self._skip,
            intents.EndPractice: lambda intent: self._end(intent.actor),
        }

    def follows(self) -> Follows:
        return dict.fromkeys(_WATCHED, self._take)

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
            self._show(self._practice)

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

    def _take(self, value: Any) -> None:
        """Process an event, or odometry, which is None without a robot."""
        if self._practice is None or value is None:
            return
        ended = self._practice.add(value, self._now_s())
        if ended is not None:
            self._notify(self._practice, ended, getattr(value, "actor", "") or CONSOLE)

    def _skip(self, intent: intents.SkipPracticeStep) -> None:
        if self._practice is not None and (ended := self._practice.skip(self._now_s())) is not None:
            self._notify(self._practice, ended, intent.actor)

    def _notify(self, practice: Practice, ended: EndedStep, actor: Actor) -> None:
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
        self._show(practice)

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

    def _show(self, practice: Practice) -> None:
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
