"""The protocol over a session: start, recorded header, pauses, and a change of scenario."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, WIZARD
from caris_desktop.domain.events import ProtocolOpened, StepEntered
from caris_desktop.domain.intents import Intent
from caris_desktop.live.services.protocol_service import ProtocolService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import ProtocolStatus
from caris_desktop.scenario.protocol_steps import ProtocolSettings, ProtocolStep
from caris_desktop.scenario.scenario_model import PanelLeaf, Scenario

pytestmark = pytest.mark.usefixtures("qapp")

STEPS = (ProtocolStep("Greet"), ProtocolStep("Ask"), ProtocolStep("Close"))
STUDY = Scenario("Study", PanelLeaf("video"), protocol=ProtocolSettings(STEPS), path=Path("study.yaml"))
OTHER = Scenario("Other", PanelLeaf("video"), protocol=ProtocolSettings(STEPS[::-1]), path=Path("other.yaml"))


class Desk:
    def __init__(self) -> None:
        self.state = LiveState()
        self.told: list[Any] = []
        self.protocol = ProtocolService(self.state, self.told.append)
        self.protocol.use_scenario(STUDY)

    def do(self, *asked: Intent) -> None:
        for intent in asked:
            self.protocol.handlers()[type(intent)](intent)

    def standing(self, *, resumed: bool = False) -> list[Any]:
        return self.protocol.state_events(clock.now_ns(), resumed=resumed)

    @property
    def status(self) -> ProtocolStatus:
        status: ProtocolStatus = self.state.protocol.value
        return status

    @property
    def step(self) -> str:
        return self.status.step_id


@pytest.fixture
def desk() -> Desk:
    return Desk()


def test_a_recording_begins_with_the_first_step_despite_a_rehearsal(desk: Desk) -> None:
    desk.do(intents.NextStep(), intents.NextStep())
    assert desk.step == "ask"
    desk.protocol.begin_session("wizard:b")
    assert (desk.step, desk.status.done, desk.told[-1].how, desk.told[-1].actor) == ("greet", (), "started", "wizard:b")
    opened, entered = desk.standing()
    assert isinstance(opened, ProtocolOpened) and [step.title for step in opened.steps] == ["Greet", "Ask", "Close"]
    assert entered == replace(desk.told[-1], stamp_ns=entered.stamp_ns)
    desk.do(intents.NextStep())
    desk.protocol.end_session()
    assert (desk.step, desk.status.steps, desk.status.done) == ("", 3, ())


def test_a_trial_that_broke_off_continues_in_its_step(desk: Desk) -> None:
    desk.protocol.begin_session(WIZARD, step_id="ask")
    assert (desk.step, desk.told[-1].how, desk.told[-1].left_step_id, desk.status.done) == ("ask", "chosen", "", ())
    assert desk.standing()[1].step_id == "ask"
    desk.protocol.end_session()
    desk.protocol.begin_session(WIZARD, step_id="gone")
    assert desk.step == "greet", "an edited protocol may not have it any more"


def test_without_a_recording_its_end_takes_nothing_away(desk: Desk) -> None:
    desk.do(intents.GoToStep("close"))
    desk.protocol.end_session()
    assert desk.step == "close"


def test_a_manual_start_keeps_its_step(desk: Desk) -> None:
    desk.protocol.use_scenario(replace(STUDY, protocol=replace(STUDY.protocol, begins="by_hand")))
    desk.protocol.begin_session(WIZARD)
    assert desk.step == "" and [type(event) for event in desk.standing()] == [ProtocolOpened]
    desk.protocol.end_session()
    desk.do(intents.GoToStep("ask"))
    desk.protocol.begin_session(WIZARD)
    assert desk.step == "ask" and desk.standing()[1].step_id == "ask"


def test_events_of_a_pause_are_reported_as_the_recording_continues(desk: Desk) -> None:
    desk.protocol.begin_session(WIZARD)
    desk.protocol.pause(True)
    desk.do(intents.NextStep(), intents.SkipStep())
    assert desk.status.paused_ns is not None
    after = desk.standing(resumed=True)
    assert [(event.step_id, event.how) for event in after] == [("ask", "next"), ("close", "skipped")]
    assert all(event.stamp_ns > told.stamp_ns for event, told in zip(after, desk.told[-2:], strict=True))
    desk.protocol.pause(False)
    assert desk.status.paused_ns is None
    desk.protocol.pause(True)
    assert desk.standing(resumed=True) == [], "nothing happened in this one"


def test_an_edited_scenario_keeps_the_step_and_reports_the_new_plan(desk: Desk) -> None:
    desk.protocol.begin_session(WIZARD)
    desk.do(intents.NextStep())
    since_ns = desk.status.since_ns
    desk.protocol.use_scenario(replace(STUDY, protocol=ProtocolSettings((ProtocolStep("Prepare"), *STEPS))))
    assert (desk.step, desk.status.number, desk.status.since_ns) == ("ask", 3, since_ns)
    assert isinstance(desk.told[-1], ProtocolOpened) and len(desk.told[-1].steps) == 4
    told = len(desk.told)
    desk.protocol.use_scenario(replace(desk.protocol._scenario or STUDY, description="Another text"))
    assert desk.step == "ask" and len(desk.told) == told


def test_a_step_that_gets_another_name_meanwhile_is_still_the_present_one(desk: Desk) -> None:
    ticked = ProtocolStep("Ask", tick=("Heard",))
    desk.protocol.use_scenario(replace(STUDY, protocol=ProtocolSettings((STEPS[0], ticked, STEPS[2]))))
    desk.protocol.begin_session(WIZARD)
    desk.do(intents.NextStep(), intents.TickItem("Heard", True))
    since_ns = desk.status.since_ns
    renamed = replace(ticked, title="Question")
    desk.protocol.use_scenario(replace(STUDY, protocol=ProtocolSettings((STEPS[0], renamed, STEPS[2]))))
    assert (desk.step, desk.status.since_ns, desk.status.ticked) == ("question", since_ns, ("Heard",))
    desk.do(intents.NextStep())
    assert (desk.step, desk.told[-1].left_step_id) == ("close", "question")
    # A step at another position is another step.
    desk.protocol.use_scenario(replace(STUDY, protocol=ProtocolSettings((ProtocolStep("Wait"), *STEPS[:2]))))
    assert desk.step == ""


def test_another_scenario_has_a_protocol_of_its_own_which_begins_in_a_recording(desk: Desk) -> None:
    desk.do(intents.GoToStep("ask"))
    desk.protocol.use_scenario(OTHER)
    assert desk.step == ""
    desk.protocol.begin_session(WIZARD)
    desk.protocol.use_scenario(STUDY)
    entered = desk.told[-1]
    assert isinstance(entered, StepEntered)
    assert (entered.step_id, entered.how, entered.left_step_id, entered.actor) == ("greet", "started", "", CONSOLE)
    desk.protocol.use_scenario(replace(OTHER, protocol=ProtocolSettings()))
    assert (desk.status, desk.told[-1].steps) == (ProtocolStatus(), ())


def test_the_same_is_not_ticked_off_twice(desk: Desk) -> None:
    desk.protocol.use_scenario(
        replace(STUDY, protocol=ProtocolSettings((replace(STEPS[0], tick=("Coat",)), *STEPS[1:])))
    )
    desk.do(intents.NextStep(), intents.TickItem("Coat"))
    told = len(desk.told)
    desk.do(intents.TickItem("Coat"))
    assert desk.status.ticked == ("Coat",) and len(desk.told) == told
