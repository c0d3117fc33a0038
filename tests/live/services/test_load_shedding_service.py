"""Load shedding in levels, with a delay before each recovery."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from dataclasses import replace
from typing import Any

import pytest
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication

from caris_desktop.app.composition import find_scenario
from caris_desktop.conversation.models.endpoint import ModelEndpoint
from caris_desktop.domain.events import ChatMessage
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.sensing import People as PeopleSeen
from caris_desktop.domain.sound_values import MICROPHONE, Hearing
from caris_desktop.live.background_worker import AsyncioThread
from caris_desktop.live.bus import Bus
from caris_desktop.live.model_client import ModelClient, Purpose
from caris_desktop.live.services.load_shedding_service import (
    POLL_EVERY_MS,
    STEPS,
    STEPS_WITH_BLUR,
    LoadLevels,
    LoadSheddingService,
    Step,
)
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import LoadStatus, PerceptionStatus
from caris_desktop.scenario.scenario_model import BlurSettings
from tests.support.service_context import context_of

SECOND_NS = 1_000_000_000


class Machine:
    """Evaluates the levels ten times a second of a simulated clock."""

    def __init__(self) -> None:
        self.steps = LoadLevels()
        self.now_ns = 100 * SECOND_NS

    def run(
        self,
        seconds: float,
        *,
        late_ms: float = 2.0,
        once_in: int = 1,
        frame_age_ms: float | None = 12.0,
        detection_ms: float | None = 60.0,
    ) -> int:
        for number in range(round(seconds * 1000 / POLL_EVERY_MS)):
            self.now_ns += POLL_EVERY_MS * 1_000_000
            self.steps.add_samples(
                late_ms if number % once_in == 0 else 0.0, self.now_ns,
                frame_age_ms=frame_age_ms, detection_ms=detection_ms,
            )  # fmt: skip
        return self.steps.step


LAST = len(STEPS) - 1


def test_a_machine_that_keeps_up_gives_nothing_up() -> None:
    machine = Machine()
    assert machine.run(60.0, late_ms=8.0) == 0
    assert machine.run(60.0, late_ms=200.0, once_in=100) == 0, "one stall is no load"
    assert machine.run(60.0, frame_age_ms=None, detection_ms=None) == 0, "no camera, and nobody is looked for"


def test_a_busy_machine_gives_up_one_step_after_another_and_no_more_than_there_are() -> None:
    machine = Machine()
    assert machine.run(2.5, late_ms=60.0) == 1
    assert machine.run(2.5, late_ms=60.0) == 2
    assert machine.run(60.0, late_ms=60.0) == LAST


def test_load_levels_return_slowly_and_only_where_there_is_room() -> None:
    machine = Machine()
    machine.run(60.0, late_ms=60.0)
    assert machine.run(60.0, late_ms=18.0) == LAST, "neither late nor in time: stay"
    assert machine.run(9.0) == LAST - 1
    assert machine.run(9.0) == LAST - 2
    assert machine.run(4.0) == LAST - 3
    assert machine.run(30.0) == 0


def test_pictures_that_come_late_are_load_where_the_window_keeps_up() -> None:
    machine = Machine()
    assert machine.run(2.5, frame_age_ms=300.0) == 1
    assert machine.run(60.0, frame_age_ms=300.0) == LAST
    assert machine.run(60.0, frame_age_ms=100.0) == LAST, "neither late nor in time: stay"
    assert machine.run(60.0, frame_age_ms=None) == 0, "the camera is gone, and says nothing of the machine"


def test_a_starved_detector_is_load_but_takes_nothing_of_what_ranks_before_boxes() -> None:
    machine = Machine()
    assert machine.run(2.5, detection_ms=900.0) == 1
    assert machine.run(60.0, detection_ms=900.0) == 2
    assert STEPS[2].detection_interval_s > 0.0 and (STEPS[2].panels_every_s, STEPS[2].picture_every_s) == (0.0, 0.0)
    assert machine.run(60.0, late_ms=60.0, detection_ms=900.0) == LAST
    assert machine.run(60.0, detection_ms=400.0) == 2, "what others took comes back, boxes are neither late nor in time"
    assert machine.run(60.0) == 0


def test_one_slow_look_for_people_is_no_load() -> None:
    machine = Machine()
    for _ in range(30):
        machine.run(0.8)
        assert machine.run(0.2, detection_ms=2000.0) == 0


def test_with_blurring_all_else_is_reduced_for_a_starved_detector() -> None:
    machine = Machine()
    machine.steps.covers = True
    assert machine.run(60.0, detection_ms=900.0) == LAST
    assert machine.run(60.0, detection_ms=400.0) == LAST
    assert machine.run(60.0) == 0


def test_small_pictures_pay_first_then_people_then_panels_and_the_picture_last() -> None:
    looks, panels, pictures = (
        [getattr(step, what) > 0.0 for step in STEPS]
        for what in ("detection_interval_s", "panels_every_s", "picture_every_s")
    )
    assert looks == [False, False, True, True, True]
    assert panels == [False, False, False, True, True]
    assert pictures == [False, False, False, False, True]
    assert [LoadStatus(number).pays_small for number in range(len(STEPS))] == [False, True, True, True, True]


@pytest.mark.parametrize("steps", [STEPS, STEPS_WITH_BLUR])
def test_the_words_say_what_is_abandoned(steps: tuple[Step, ...]) -> None:
    assert len(steps) == len(STEPS)
    for number, (step, before) in enumerate(zip(steps[1:], steps, strict=False), start=1):
        assert step.detection_interval_s >= before.detection_interval_s
        assert step.panels_every_s >= before.panels_every_s
        assert step.picture_every_s >= before.picture_every_s
        assert ("people" in step.detail) == (step.detection_interval_s > 0.0), step
        assert ("panels" in step.detail) == (step.panels_every_s > 0.0), step
        assert ("video and" in step.detail) == (step.picture_every_s > 0.0), step
        assert ("thumbnails" in step.detail) == (number == 1), step
        assert 0.1 + step.panels_every_s < 0.5, "a scan that is older than that would slow driving down"


class People:
    """Records the detection rates."""

    every_s = 0.0

    def limit_detection_rate(self, seconds: float) -> None:
        self.every_s = seconds


async def answers_for_ever(*_: object, **__: object) -> AsyncIterator[str]:
    yield "Well"
    await asyncio.Event().wait()


async def no_version(_endpoint: ModelEndpoint, *, local_only: bool) -> str:
    return ""


EMBEDDED = ModelEndpoint("embedded", "http://127.0.0.1:9", "embedded")
OLLAMA_HERE = ModelEndpoint("ollama", "http://127.0.0.1:9", "small")
ELSEWHERE = ModelEndpoint("openai", "https://models.example.org/v1", "large")


class Governed:
    def __init__(self, asyncio_thread: AsyncioThread | None = None) -> None:
        self.owner = QObject()
        self.state = LiveState(self.owner)
        self.people = People()
        self.now_ns = 0
        self.bus = Bus(self.state, self.owner)
        self.passes: list[tuple[float, float]] = []
        self.bus.pass_at_most_every = lambda *, panels_s, picture_s: self.passes.append(  # type: ignore[method-assign]
            (panels_s, picture_s)
        )
        nobody: Any = None
        self.models = ModelClient(
            asyncio_thread or nobody, answers_for_ever, lambda _: None, self.owner, ask_version=no_version
        )
        self.governor = LoadSheddingService(
            context_of(self.state, self.bus, self.owner), self.people, self.models,  # type: ignore[arg-type]
            now_ns=lambda: self.now_ns,
        )  # fmt: skip

    def ask(self, purpose: Purpose) -> str:
        return self.models.ask(
            [ChatMessage("user", "Where?")], purpose=purpose, max_tokens=9, temperature=0.0,
            on_text=lambda _: None, on_end=lambda _: None,
        )  # fmt: skip

    def run(
        self, seconds: float, *, late_ms: float = 0.0, frame_age_ms: float | None = None, detection_ms: float = 0.0
    ) -> None:
        for number in range(round(seconds * 1000 / (POLL_EVERY_MS + late_ms))):
            self.now_ns += round((POLL_EVERY_MS + late_ms) * 1e6)
            if frame_age_ms is not None:
                stamp_ns = self.now_ns - round(frame_age_ms * 1e6)
                self.bus.publish(FrameRef(stamp_ns, None, "front", "ring", 0, number, 4, 3))
            if detection_ms and number % 10 == 0:
                self.bus.publish(PeopleSeen(self.now_ns, "front", number, 4, 3, (), detection_ms))
            self.governor._measure()


@pytest.mark.usefixtures("trial_language")
def test_shed_load_is_applied_and_reported(qapp: QApplication) -> None:
    governed = Governed()
    governed.run(3.0, late_ms=60.0)
    assert (governed.people.every_s, governed.passes[-1]) == (0.0, (0.0, 0.0))
    assert governed.state.load.value == LoadStatus(1, "thumbnails less often"), "English, as the record has it"
    governed.run(3.0, late_ms=60.0)
    assert governed.people.every_s == STEPS[2].detection_interval_s > 0.0
    assert governed.state.load.value == LoadStatus(2, "people detection less often")
    governed.run(3.0, late_ms=60.0)
    assert governed.passes[-1] == (STEPS[3].panels_every_s, 0.0)
    governed.run(60.0, late_ms=60.0)
    last = STEPS[-1]
    assert (governed.people.every_s, governed.passes[-1]) == (
        last.detection_interval_s, (last.panels_every_s, last.picture_every_s)
    )  # fmt: skip
    governed.run(60.0)
    assert (governed.people.every_s, governed.passes[-1]) == (0.0, (0.0, 0.0))
    assert governed.state.load.value == LoadStatus()


def test_pictures_that_get_here_late_are_reported_as_load(qapp: QApplication) -> None:
    governed = Governed()
    governed.run(10.0, frame_age_ms=20.0)
    assert governed.state.load.value == LoadStatus()
    governed.run(60.0, frame_age_ms=400.0)
    assert governed.state.load.value == LoadStatus(4, "people detection much less often, video and panels slower")


def test_a_starved_detector_is_reported_as_load_where_it_is_on_this_computer(qapp: QApplication) -> None:
    governed = Governed()
    governed.run(10.0, detection_ms=80.0)
    assert governed.state.load.value == LoadStatus()
    governed.run(20.0, detection_ms=900.0)
    assert governed.state.load.value == LoadStatus(2, "people detection less often")
    governed.state.perception.set(PerceptionStatus("ready", server="wss://lab:8768"))
    governed.run(20.0, detection_ms=900.0)
    assert governed.state.load.value == LoadStatus(), "another computer would have nothing of it"


def test_a_stopped_detector_is_no_load(qapp: QApplication) -> None:
    governed = Governed()
    governed.run(20.0, detection_ms=900.0)
    governed.run(30.0)
    assert governed.state.load.value == LoadStatus()


def test_with_blurring_the_detection_is_not_reduced(qapp: QApplication) -> None:
    governed = Governed()
    tour = find_scenario("tour-guide")
    governed.governor.use_scenario(replace(tour, blur=BlurSettings("everybody")))
    governed.run(60.0, detection_ms=900.0)
    last = STEPS_WITH_BLUR[-1]
    assert (governed.people.every_s, governed.passes[-1]) == (0.0, (last.panels_every_s, last.picture_every_s))
    no_pictures = replace(tour.permissions, video_recording=False, photos=False)
    assert not replace(tour, blur=BlurSettings("everybody"), permissions=no_pictures).covers_people
    assert governed.state.load.value == LoadStatus(4, "video and panels slower")


@pytest.fixture
def asyncio_thread() -> Iterator[AsyncioThread]:
    thread = AsyncioThread()
    yield thread
    thread.stop()


@pytest.mark.parametrize("purpose", ["question", "replies", "actions"])
def test_an_answer_of_a_model_on_this_computer_comes_before_boxes(
    qapp: QApplication, asyncio_thread: AsyncioThread, purpose: Purpose
) -> None:
    governed = Governed(asyncio_thread)
    for endpoint, every_s in (
        (EMBEDDED, STEPS[3].detection_interval_s),
        (OLLAMA_HERE, STEPS[3].detection_interval_s),
        (ELSEWHERE, 0.0),
    ):
        governed.models.use(endpoint, display_name="Small", local_only=False)
        first, second = governed.ask(purpose), governed.ask(purpose)
        assert governed.people.every_s == every_s
        assert governed.state.load.value == LoadStatus(), "the machine keeps up all the same"
        governed.models.cancel(first, "")
        assert governed.people.every_s == every_s, "another one is still waited for"
        governed.models.cancel(second, "")
        assert governed.people.every_s == 0.0


def test_the_last_words_of_a_participant_come_before_boxes(qapp: QApplication) -> None:
    governed = Governed()
    governed.governor.use_scenario(tour := find_scenario("tour-guide"))
    governed.run(1.0, late_ms=0.0)
    pause = Hearing(0, MICROPHONE, speaking=False, speaker="participant", utterance_id="u-1", silent_since_ns=0)

    def hear(hearing: Hearing) -> float:
        governed.state.add(hearing)
        return governed.people.every_s

    assert hear(pause) == STEPS[3].detection_interval_s > 0.0
    assert hear(replace(pause, speaking=True, silent_since_ns=None)) == 0.0, "whose mouth moves is looked at"
    assert hear(pause) == STEPS[3].detection_interval_s
    assert hear(replace(pause, utterance_id="")) == 0.0, "the turn is over"
    assert hear(replace(pause, speaker="robot")) == 0.0
    assert hear(pause) > 0.0
    governed.run(6.0, late_ms=0.0)
    assert governed.people.every_s == 0.0, "whoever listened is gone"
    assert governed.state.load.value == LoadStatus()
    governed.governor.use_scenario(replace(tour, listening=replace(tour.listening, engine="server")))
    governed.run(1.0, late_ms=0.0)
    assert hear(replace(pause, stamp_ns=governed.now_ns)) == 0.0, "another computer makes them out"


def test_the_panels_of_another_scenario_come_before_boxes(qapp: QApplication) -> None:
    governed = Governed()
    governed.governor.use_scenario(find_scenario("tour-guide"))
    assert governed.people.every_s == STEPS[3].detection_interval_s > 0.0
    governed.run(1.0, late_ms=0.0)
    assert (governed.people.every_s, governed.state.load.value) == (0.0, LoadStatus())


def test_with_blurring_an_answer_does_not_reduce_their_embeddings(
    qapp: QApplication, asyncio_thread: AsyncioThread
) -> None:
    governed = Governed(asyncio_thread)
    governed.governor.use_scenario(replace(find_scenario("tour-guide"), blur=BlurSettings("everybody")))
    governed.models.use(EMBEDDED, display_name="Small", local_only=True)
    asking = governed.ask("replies")
    assert governed.people.every_s == 0.0
    governed.models.cancel(asking, "")
