"""Practice: robot, scenario and recording first, then step by step to a result."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtWidgets import QApplication

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import Marked, PhotoTaken, PracticeEnded, PracticeStepEnded, UtteranceChanged
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.live.bus import Bus
from caris_desktop.live.services.practice_service import STEPS, PracticeAdapters, PracticeService
from caris_desktop.live.state import LiveState
from caris_desktop.robot.profile import load_profile
from caris_desktop.scenario.scenario_file import find_scenario, load_scenario
from caris_desktop.scenario.scenario_model import Scenario
from tests.support.service_context import context_of

OTHER: Actor = "wizard:other"


class Stage:
    """The practice with a robot that is available at once, and its requests to the console."""

    def __init__(self) -> None:
        self.state = LiveState()
        self.told: list[Any] = []
        self.asked: list[intents.Intent] = []
        self.cut_s: list[float] = []
        self.robots: list[str] = []
        bus = Bus(self.state, self.state)
        bus.tap(lambda value, _raw: self.told.append(value), (PracticeStepEnded, PracticeEnded, UtteranceChanged))
        self.scenario = load_scenario(find_scenario("tour-guide"))
        assert self.scenario.path is not None
        parts = PracticeAdapters(self.scenario.path, self._robot, self.cut_s.append)
        self.service = PracticeService(context_of(self.state, bus, self.state), parts, do=self.do)

    def _robot(self, actor: Actor) -> None:
        self.robots.append(actor)

    def do(self, intent: intents.Intent) -> str:
        self.asked.append(intent)
        recording = self.state.recording
        if isinstance(intent, intents.StartRecording):
            recording.set(replace(recording.value, state="recording"))
        elif isinstance(intent, intents.StopRecording):
            recording.set(replace(recording.value, state="idle"))
        elif isinstance(intent, intents.OpenScenario):
            self.open(self.scenario if intent.path == self.scenario.path else load_scenario(intent.path))
        return ""

    def open(self, scenario: Scenario) -> None:
        self.state.scenario.set(scenario)

    def ask(self, intent: intents.Intent) -> None:
        self.service.handlers()[type(intent)](intent)

    def happens(self, event: Any) -> None:
        self.service.follows()[type(event)](event)

    def begin(self) -> None:
        self.ask(intents.BeginPractice("Ana"))
        self.state.drive.set(replace(self.state.drive.value, allowed=True))
        for _ in range(2):
            self.service._begin_when_ready()

    def skip_to(self, step_id: str) -> None:
        while next(step for step in self.state.practice.value.steps if step.state == "now").step_id != step_id:
            self.ask(intents.SkipPracticeStep())


@pytest.fixture
def stage(qapp: QApplication) -> Iterator[Stage]:
    stage = Stage()
    yield stage
    stage.service.stop()
    stage.state.close()


def test_it_begins_once_the_stage_is_set(stage: Stage) -> None:
    stage.open(replace(stage.scenario, path=Path("another.yaml")))
    stage.ask(intents.BeginPractice("Ana", actor=OTHER))
    assert stage.robots == [OTHER] and isinstance(stage.asked[0], intents.OpenScenario)
    stage.service._begin_when_ready()
    assert stage.state.practice.value.state == "preparing", "the robot is not there yet"
    stage.state.drive.set(replace(stage.state.drive.value, allowed=True))
    stage.service._begin_when_ready()
    recorded = stage.asked[-1]
    assert isinstance(recorded, intents.StartRecording)
    assert (recorded.details.wizard, recorded.details.purpose) == ("Ana", "practice")
    assert recorded.anyway, "a check that is open keeps nobody from practising"
    stage.service._begin_when_ready()
    status = stage.state.practice.value
    assert status.state == "running" and [step.step_id for step in status.steps] == [step.id for step in STEPS]


def test_it_does_not_begin_in_a_recording(stage: Stage) -> None:
    stage.state.recording.set(replace(stage.state.recording.value, state="recording"))
    with pytest.raises(UserFacingError):
        stage.ask(intents.BeginPractice())
    assert stage.asked == [] and stage.robots == []


def test_events_end_steps_and_are_reported(stage: Stage) -> None:
    stage.begin()
    stage.skip_to("photo")
    stage.happens(PhotoTaken(clock.now_ns(), "front", 1, "photos/1.png", actor="wizard"))
    ended = stage.told[-1]
    assert (ended.step_id, ended.number, ended.done, ended.actor) == ("photo", 5, True, "wizard")
    assert stage.state.practice.value.done == 1


def test_a_person_asks_something_and_later_the_link_is_cut(stage: Stage) -> None:
    stage.begin()
    stage.skip_to("suggestion")
    utterances = [event for event in stage.told if isinstance(event, UtteranceChanged)]
    assert [(event.speaker, event.state, event.source) for event in utterances] == [
        ("participant", "started", "practice"), ("participant", "finished", "practice"),
    ]  # fmt: skip
    stage.state.suggestions.set(replace(stage.state.suggestions.value, state="shown"))
    stage.service._ask_again.timeout.emit()
    assert [event for event in stage.told if isinstance(event, UtteranceChanged)] == utterances, "the replies stay"
    stage.state.suggestions.set(replace(stage.state.suggestions.value, state="failed"))
    stage.service._ask_again.timeout.emit()
    assert len([event for event in stage.told if isinstance(event, UtteranceChanged)]) == 4
    assert stage.cut_s == []
    stage.skip_to("link")
    assert stage.cut_s == [4.0]


def test_the_end_has_a_result_and_ends_the_recording(stage: Stage) -> None:
    stage.begin()
    stage.skip_to("mark")
    stage.happens(Marked(clock.now_ns(), "", actor="wizard"))
    stage.ask(intents.EndPractice())
    status, ended = stage.state.practice.value, stage.told[-1]
    assert isinstance(ended, PracticeEnded) and (ended.done, ended.steps, ended.score) == (1, 10, 10)
    assert (status.state, status.done, status.score, status.wizard) == ("ended", 1, 10, "Ana")
    assert isinstance(stage.asked[-1], intents.StopRecording)
    stage.ask(intents.EndPractice())
    assert stage.state.practice.value.state == ""


def test_stopping_the_recording_ends_the_practice(stage: Stage) -> None:
    stage.begin()
    stage.state.recording.set(replace(stage.state.recording.value, state="stopping"))
    assert stage.state.practice.value.state == "ended" and isinstance(stage.told[-1], PracticeEnded)


@pytest.mark.parametrize("again", [False, True])
def test_the_scenario_and_the_robot_from_before_come_back(stage: Stage, again: bool) -> None:
    study = load_scenario(find_scenario("reception"))
    stage.open(study)
    stage.state.robot.set(replace(load_profile("turtlebot4"), name="lab-robot"))
    stage.begin()
    assert stage.state.scenario.value == stage.scenario
    stage.state.robot.set(load_profile("simulated"))
    for _ in range(2 if again else 1):
        stage.ask(intents.EndPractice())
        assert stage.state.practice.value.back_to == study.title
        if again:
            stage.begin()
    if again:
        stage.ask(intents.EndPractice())
    stage.asked.clear()
    stage.ask(intents.EndPractice(actor=OTHER))
    assert study.path is not None
    assert stage.asked == [
        intents.OpenScenario(study.path, actor=OTHER), intents.UseRobot("lab-robot", actor=OTHER)
    ]  # fmt: skip
    assert not stage.state.practice.value.state


def test_choices_after_the_practice_stay(stage: Stage) -> None:
    stage.open(load_scenario(find_scenario("reception")))
    stage.state.robot.set(replace(load_profile("turtlebot4"), name="lab-robot"))
    stage.begin()
    stage.ask(intents.EndPractice())
    stage.open(load_scenario(find_scenario("blank")))
    stage.state.robot.set(load_profile("pepper"))
    stage.asked.clear()
    stage.ask(intents.EndPractice())
    assert stage.asked == []
