"""Robot speech of the wizard: gaps, queue, gestures and fillers."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import GoalChanged, UtteranceChanged
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.sensing import RobotPose
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.bus import Bus
from caris_desktop.live.services.speaking_service import SpeakingService
from caris_desktop.live.speech_queue import SpeechQueue
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import OpenGap
from caris_desktop.people.presence import PersonRow
from caris_desktop.scenario.scenario_model import PanelLeaf, Permissions, Place, Scenario
from tests.support.service_context import context_of

SCENARIO = Scenario(
    "Test", PanelLeaf("speak"), filler="Hm.", fillers=("Well.", "Let me see."),
    places=(Place("Kitchen", Pose2D(1.0, 1.0, 0.0)), Place("Lab", Pose2D(8.0, 1.0, 0.0))),
)  # fmt: skip
LUIS = PersonRow("p-1", 1, "Luis", True, 0, 0, distance_m=1.5, bearing_rad=0.4)
NAMELESS = PersonRow("p-2", 2, "Person 2", True, 0, 0, distance_m=1.0)


class Voice:
    """Speech backend controlled by the test."""

    held_up = False

    def __init__(self) -> None:
        self.said: list[tuple[UtteranceChanged, str]] = []

    def say(self, utterance: UtteranceChanged, spoken: str) -> bool:
        self.said.append((utterance, spoken))
        return True

    def silence(self, _actor: Actor) -> bool:
        return True


@dataclass
class Desk:
    """The service with its environment."""

    state: LiveState
    service: SpeakingService
    queue: SpeechQueue
    voice: Voice
    events: list[UtteranceChanged]
    done: list[Intent]
    refused: str = ""

    def ask(self, intent: Intent) -> None:
        self.service.handlers()[type(intent)](intent)

    def say(self, text: str, **more: Any) -> None:
        self.ask(intents.Say(text, "typed", **more))

    @property
    def spoken(self) -> list[str]:
        return [spoken for _, spoken in self.voice.said]

    def tell(self, utterance: UtteranceChanged, what: Any) -> None:
        """Report of the speech backend to all receivers."""
        event = replace(utterance, stamp_ns=clock.now_ns(), state=what, gesture="")
        self.queue.report(event)
        self.queue.on_utterance(event)

    def be_at(self, x_m: float) -> None:
        self.state.add(RobotPose(clock.now_ns(), None, Pose2D(x_m, 1.0, 0.0)))


@pytest.fixture
def desk(qtbot: QtBot, tmp_path: Path) -> Iterator[Desk]:
    state = LiveState()
    bus = Bus(state, state)
    voice, events, done = Voice(), [], []
    slow_work = BackgroundWorker(state)
    handlers: list[Any] = []

    def publish(event: UtteranceChanged, _raw: bytes | None) -> None:
        events.append(event)
        for follow in handlers:
            follow(event)

    queue = SpeechQueue(state, {"robot": voice, "computer": voice}, publish, state)

    def do(intent: Intent) -> str:
        done.append(intent)
        return "refused"

    service = SpeakingService(context_of(state, bus, state, slow_work=slow_work), queue, tmp_path / "said.jsonl", do=do)
    handlers.append(service.follows()[UtteranceChanged])
    state.scenario.set(SCENARIO)
    state.places.set(SCENARIO.places)
    service.use_scenario(SCENARIO)
    yield Desk(state, service, queue, voice, events, done)
    slow_work.finish(lambda _what, wait: wait())
    bus.end()
    state.close()
    state.deleteLater()


def test_name_and_place_are_filled_in_and_no_name_is_recorded(desk: Desk) -> None:
    desk.state.persons.set((LUIS,))
    desk.be_at(7.5)
    desk.say("Hello, {name}! This is {place}.", gesture="nod")
    assert desk.spoken == ["Hello, Luis! This is Lab."]
    assert {event.text for event in desk.events} == {"Hello, {p-1}! This is Lab."}
    assert desk.events[0].person_id == "p-1"


def test_the_selected_person_and_the_goal_come_first(desk: Desk) -> None:
    desk.state.persons.set((LUIS, replace(NAMELESS, name="Ana")))
    desk.state.selected_person.set("p-1")
    desk.be_at(7.5)
    desk.state.goal.set(GoalChanged(clock.now_ns(), "g", "active", Pose2D(1.0, 1.0, 0.0), place="Kitchen"))
    desk.say("{name}, to {place}!")
    assert desk.spoken == ["Luis, to Kitchen!"]


@pytest.mark.parametrize(
    ("rows", "naming"), [((), True), ((NAMELESS,), True), ((LUIS,), False)], ids=["nobody", "nameless", "not permitted"]
)
def test_a_gap_is_requested_and_never_spoken(desk: Desk, rows: tuple[PersonRow, ...], naming: bool) -> None:
    desk.service.use_scenario(replace(SCENARIO, permissions=Permissions(naming_people=naming)))
    desk.state.persons.set(rows)
    desk.say("Hello, {name}!")
    assert desk.spoken == [] and desk.events == []
    assert desk.state.speech.value.gap == OpenGap("Hello, {name}!", "name")
    desk.ask(intents.FillGap("  Ada  "))
    assert desk.spoken == ["Hello, Ada!"] and desk.state.speech.value.gap is None
    recorded = {event.text for event in desk.events}
    assert recorded == {f"Hello, {{{rows[0].person_id}}}!" if rows else "Hello, {name}!"}


def test_several_gaps_are_requested_one_after_the_other(desk: Desk) -> None:
    desk.say("On {day} in {place}.", face="happy")
    assert desk.state.speech.value.gap.gap == "day"
    desk.ask(intents.FillGap("Monday"))
    assert desk.state.speech.value.gap.gap == "place"
    desk.ask(intents.FillGap("Rome"))
    assert desk.spoken == ["On Monday in Rome."] and desk.events[0].text == "On Monday in Rome."


def test_a_cancelled_gap_is_not_spoken_after_all(desk: Desk) -> None:
    desk.say("On {day}.")
    desk.ask(intents.FillGap(""))
    assert desk.state.speech.value.gap is None and desk.events == []
    desk.ask(intents.FillGap("Monday"))
    assert desk.events == []


def test_an_absent_person_is_refused(desk: Desk) -> None:
    with pytest.raises(UserFacingError, match="No person here has a name"):
        desk.say("Hello, {name}!", actor="model")
    assert desk.events == [] and desk.state.speech.value.gap is None


def test_another_scenario_forgets_what_was_requested(desk: Desk) -> None:
    desk.say("On {day}.")
    desk.service.use_scenario(replace(SCENARIO, title="Places were saved"))
    assert desk.state.speech.value.gap is not None
    desk.service.use_scenario(replace(SCENARIO, phrases=("Other",)))
    assert desk.state.speech.value.gap is None


def test_a_queued_sentence_is_changed_with_its_gaps_filled(desk: Desk) -> None:
    desk.state.persons.set((LUIS,))
    desk.say("One")
    desk.say("Two")
    (waiting,) = desk.state.speech.value.waiting
    desk.ask(intents.EditQueued(waiting.utterance_id, "Bye, {name}."))
    assert [event.text for event in desk.state.speech.value.waiting] == ["Bye, {p-1}."]
    with pytest.raises(UserFacingError):
        desk.ask(intents.EditQueued(waiting.utterance_id, "On {day}."))
    desk.tell(desk.voice.said[0][0], "finished")
    assert desk.spoken == ["One", "Bye, Luis."]
    for late in (
        intents.EditQueued(waiting.utterance_id, "x"), intents.MoveQueued(waiting.utterance_id, 0),
        intents.CancelQueued(waiting.utterance_id),
    ):  # fmt: skip
        with pytest.raises(UserFacingError, match="has already started or ended"):
            desk.ask(late)


@pytest.mark.parametrize(
    ("gesture", "asked"),
    [
        ("nod", intents.Nod()), ("look", intents.LookAt(0.4, 0.0)), ("wave", intents.UseControl("wave", True)),
    ],
)  # fmt: skip
def test_a_gesture_is_requested_as_the_sentence_begins_and_holds_nothing_up(
    desk: Desk, gesture: str, asked: Intent
) -> None:
    desk.state.persons.set((LUIS,))
    desk.say("Hello.", gesture=gesture)
    desk.say("And more.")
    assert desk.done == []
    desk.tell(desk.voice.said[0][0], "started")
    desk.tell(desk.voice.said[0][0], "started")
    desk.tell(desk.voice.said[0][0], "finished")
    assert desk.done == [asked]
    desk.tell(desk.voice.said[1][0], "started")
    assert desk.done == [asked] and desk.spoken == ["Hello.", "And more."]


def test_the_face_changes_with_the_sentence(desk: Desk) -> None:
    desk.say("Hello.", face="happy", gesture="nod")
    desk.tell(desk.voice.said[0][0], "started")
    assert desk.done == [intents.Nod(), intents.ShowExpression("happy")]


def test_an_unspoken_text_has_no_gesture(desk: Desk) -> None:
    desk.say("Hello.", face="happy", gesture="nod")
    desk.tell(desk.voice.said[0][0], "failed")
    assert desk.done == []


def test_each_filler_takes_the_next_one(desk: Desk) -> None:
    fillers = []
    for _ in range(4):
        fillers.append(SCENARIO.next_filler(desk.state.fillers_spoken.value))
        desk.ask(intents.Say(fillers[-1], "filler"))
    assert fillers == ["Hm.", "Well.", "Let me see.", "Hm."]


def test_typed_text_is_remembered_as_it_was_typed(desk: Desk) -> None:
    desk.state.persons.set((LUIS,))
    desk.say("Hello, {name}!")
    desk.ask(intents.Say("A phrase", "phrase"))
    assert desk.state.speech_history.value == ("Hello, {name}!",)
