"""After a crash the next run offers to resume the trial, holds the robot, and asks for every confirmation again."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import pytest
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from caris_desktop.conversation.conversation_transcript import Turn
from caris_desktop.domain import intents
from caris_desktop.domain.events import ConfirmedAsBefore, InitialPoseSet, TrialDetails, TrialResumed
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.bus import Bus
from caris_desktop.live.services.crash_recovery_service import CrashRecoveryAdapters, CrashRecoveryService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import PracticeStatus, ProtocolStatus
from caris_desktop.people.presence import PersonRow
from caris_desktop.scenario.scenario_file import find_scenario, load_scenario
from tests.support.crashed_trial import assign_to_ended_process
from tests.support.service_context import context_of

P07 = TrialDetails(participant="P07", trial="2")


def _connection(name: str, title: str) -> Any:
    return SimpleNamespace(name=title, profile=SimpleNamespace(name=name))


EARLIER = (Turn("u", "robot", "Hello.", "typed", "finished", started_ns=1, ended_ns=2),)


class Run:
    """One run of the program, reduced to this service."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.state = LiveState()
        self.bus = Bus(self.state, self.state)
        self.told: list[Any] = []
        self.asked: list[intents.Intent] = []
        self.conversation: list[tuple[Turn, ...]] = []
        self.bus.tap(lambda value, _raw: self.told.append(value), (TrialResumed, ConfirmedAsBefore))
        self.slow_work = BackgroundWorker(self.state)
        robot: Any = SimpleNamespace(connection=_connection("simulated", "Simulated robot"))
        self.service = CrashRecoveryService(
            context_of(self.state, self.bus, self.state, slow_work=self.slow_work),
            CrashRecoveryAdapters(folder / "trials", folder / "sessions", lambda _: P07, lambda _: EARLIER),
            robot=robot, do=self.do, show_conversation=self.conversation.append,
        )  # fmt: skip
        self.scenario = load_scenario(find_scenario("tour-guide"))
        self.service.use_scenario(self.scenario)

    def do(self, intent: intents.Intent) -> str:
        self.asked.append(intent)
        return ""

    def ask(self, intent: intents.Intent) -> None:
        self.service.handlers()[type(intent)](intent)

    def record(self, name: str) -> None:
        session = self.folder / "sessions" / name
        session.mkdir(parents=True, exist_ok=True)
        status = self.state.recording
        status.set(replace(status.value, state="recording", folder=session))

    def start(self) -> None:
        self.service.start()
        self.settle()

    def settle(self) -> None:
        self.slow_work.finish(lambda _what, work: work())
        self.slow_work = BackgroundWorker(self.state)
        self.service._slow_work = self.slow_work

    def crash(self) -> None:
        """End the run as a crash; its files belong to a process that has exited."""
        self.settle()
        assign_to_ended_process(self.folder / "trials")

    def end(self) -> None:
        self.service._soon.stop()
        self.slow_work.finish(lambda _what, work: work())
        self.state.close()


@pytest.fixture
def runs(tmp_path: Path, qapp: QApplication) -> Iterator[Callable[[], Run]]:
    """Each call starts another run of the program on the same computer."""
    begun: list[Run] = []

    def begin() -> Run:
        begun.append(Run(tmp_path))
        return begun[-1]

    yield begin
    for run in begun:
        run.end()


@pytest.fixture
def run(runs: Callable[[], Run]) -> Run:
    return runs()


@pytest.fixture
def after_a_crash(run: Run, runs: Callable[[], Run]) -> Run:
    run.state.selected_person.set("p-2")
    run.state.protocol.set(ProtocolStatus("kitchen", "Kitchen", 5, 6))
    run.record("one")
    run.crash()
    another = runs()
    another.start()
    return another


def test_the_trial_is_offered_with_who_took_part(after_a_crash: Run) -> None:
    status = after_a_crash.state.going_on.value
    assert (status.state, status.folder, status.details) == ("offered", "one", P07)
    assert after_a_crash.asked == [], "nothing is done before the wizard says so"


def test_going_on_holds_the_robot_and_asks_everything_again(after_a_crash: Run) -> None:
    run = after_a_crash
    run.ask(intents.GoOnWithTrial())
    assert [type(intent) for intent in run.asked] == [intents.EmergencyStop, intents.AttendPerson]
    assert run.asked[1] == intents.AttendPerson("p-2")
    assert run.state.going_on.value.unconfirmed == ("map", "people", "permissions", "consent")
    for what in ("people", "map", "map", "permissions"):
        run.ask(intents.ConfirmAsBefore(what))  # type: ignore[arg-type]
    assert run.state.going_on.value.state == "unconfirmed" and run.state.going_on.value.unconfirmed == ("consent",)
    run.ask(intents.ConfirmAsBefore("consent"))
    assert run.state.going_on.value.state == "confirmed"
    events = [(type(event), getattr(event, "what", "")) for event in run.told]
    assert events == [
        (TrialResumed, ""), (ConfirmedAsBefore, "people"), (ConfirmedAsBefore, "map"),
        (ConfirmedAsBefore, "permissions"), (ConfirmedAsBefore, "consent"),
    ]  # fmt: skip


def test_the_conversation_of_the_interrupted_session_is_shown_until_the_trial_is_left(after_a_crash: Run) -> None:
    assert after_a_crash.conversation == []
    after_a_crash.ask(intents.GoOnWithTrial())
    after_a_crash.settle()
    assert after_a_crash.conversation == [EARLIER]
    after_a_crash.ask(intents.LeaveTrial())
    assert after_a_crash.conversation == [EARLIER, ()]


def test_each_of_those_who_were_there_is_confirmed_for_themselves(run: Run, runs: Callable[[], Run]) -> None:
    there = tuple(PersonRow(f"p-{number}", number, "", since_ns=1, last_seen_ns=2, here=True) for number in (1, 2))
    run.state.persons.set(there)
    run.record("one")
    run.crash()
    another = runs()
    another.start()
    another.state.persons.set(there)
    another.ask(intents.GoOnWithTrial())
    assert another.state.going_on.value.unconfirmed_people == ("p-1", "p-2")
    another.ask(intents.ConfirmAsBefore("people", "p-2"))
    another.ask(intents.ConfirmAsBefore("people", "p-9"))
    status = another.state.going_on.value
    assert status.unconfirmed_people == ("p-1",) and "people" in status.unconfirmed
    another.ask(intents.ConfirmAsBefore("people", "p-1"))
    status = another.state.going_on.value
    assert status.unconfirmed_people == () and status.unconfirmed == ("map", "permissions", "consent")
    told = [event.person_id for event in another.told if isinstance(event, ConfirmedAsBefore)]
    assert told == ["p-2", "p-1", ""], "each is recorded, and that it was all of them"


def test_a_person_who_has_left_keeps_nothing_open(run: Run, runs: Callable[[], Run]) -> None:
    there = tuple(PersonRow(f"p-{number}", number, "", since_ns=1, last_seen_ns=2, here=True) for number in (1, 2))
    run.state.persons.set(there)
    run.record("one")
    run.crash()
    another = runs()
    another.start()
    another.state.persons.set(there[:1])
    another.ask(intents.GoOnWithTrial())
    another.ask(intents.ConfirmAsBefore("people", "p-1"))
    assert "people" not in another.state.going_on.value.unconfirmed


def test_saying_where_the_robot_is_confirms_the_map(after_a_crash: Run) -> None:
    run = after_a_crash
    pose_set = InitialPoseSet(1, Pose2D(1.0, 2.0, 0.0), "wizard")
    follow = run.service.follows()[InitialPoseSet]
    follow(pose_set)
    assert run.told == [], "nothing goes on yet"
    run.ask(intents.GoOnWithTrial())
    follow(pose_set)
    assert run.state.going_on.value.unconfirmed == ("people", "permissions", "consent")
    assert [event.what for event in run.told if isinstance(event, ConfirmedAsBefore)] == ["map"]


def test_the_next_recording_is_headed_by_it_and_ends_it(after_a_crash: Run) -> None:
    run = after_a_crash
    run.ask(intents.GoOnWithTrial())
    run.ask(intents.ConfirmAsBefore("consent"))
    assert run.service.step == "kitchen"
    heads = run.service.state_events(7)
    assert [(type(event), event.stamp_ns) for event in heads] == [(TrialResumed, 7), (ConfirmedAsBefore, 7)]
    run.record("two")
    assert run.state.going_on.value.state == "", "the card is gone while it is recorded"
    assert len(run.service.state_events(8)) == 2, "as for what goes on after a pause"
    run.state.recording.set(replace(run.state.recording.value, state="idle"))
    assert run.service.step == "" and run.service.state_events(9) == [] and run.state.going_on.value.state == ""


def test_consent_to_recording_is_asked_again_for_another_scenario(after_a_crash: Run) -> None:
    run = after_a_crash
    run.ask(intents.GoOnWithTrial())
    for what in get_args(intents.AsBefore):
        run.ask(intents.ConfirmAsBefore(what))
    assert run.state.going_on.value.state == "confirmed"
    run.service.use_scenario(replace(run.scenario, places=()))
    assert run.state.going_on.value.state == "confirmed", "nothing else is kept by that"
    run.service.use_scenario(load_scenario(find_scenario("mental-health-check")))
    assert (run.state.going_on.value.state, run.state.going_on.value.unconfirmed) == ("unconfirmed", ("permissions",))


def test_a_trial_does_not_continue_in_the_midst_of_another_recording(after_a_crash: Run) -> None:
    run = after_a_crash
    run.state.recording.set(replace(run.state.recording.value, state="starting"))
    with pytest.raises(UserFacingError, match="in progress"):
        run.ask(intents.GoOnWithTrial())
    assert run.asked == [] and run.told == []


def test_another_scenario_and_robot_of_that_trial_are_used_again(run: Run, runs: Callable[[], Run]) -> None:
    elsewhere: Any = _connection("pepper", "Pepper")
    run.service._robot.connection = elsewhere  # type: ignore[misc]
    run.service.use_scenario(load_scenario(find_scenario("mental-health-check")))
    run.record("one")
    run.crash()
    another = runs()
    another.start()
    another.ask(intents.GoOnWithTrial())
    asked = {type(intent): intent for intent in another.asked}
    opened, robot = asked[intents.OpenScenario], asked[intents.UseRobot]
    assert isinstance(opened, intents.OpenScenario) and opened.path.name == "mental-health-check.yaml"
    assert robot == intents.UseRobot("pepper")


def test_after_an_end_in_order_nothing_is_offered(run: Run, runs: Callable[[], Run]) -> None:
    run.record("one")
    run.settle()
    run.service.stop()
    run.service.end()
    another = runs()
    another.start()
    assert another.state.going_on.value.state == ""
    with pytest.raises(UserFacingError):
        another.ask(intents.GoOnWithTrial())


def test_a_terminated_program_offers_nothing_however_it_ends(run: Run, runs: Callable[[], Run]) -> None:
    run.record("one")
    run.settle()
    run.service.expect_end()
    run.state.selected_person.set("p-3")
    run.service._persist()
    run.settle()
    assert list((run.folder / "trials").iterdir()) == []
    another = runs()
    another.start()
    assert another.state.going_on.value.state == ""


def test_a_shutdown_that_is_called_off_takes_nothing_away(run: Run, qtbot: QtBot) -> None:
    run.record("one")
    run.settle()
    run.service.expect_shutdown()
    run.state.selected_person.set("p-3")
    run.service._persist()
    run.settle()
    assert list((run.folder / "trials").iterdir()) == [], "whoever shuts the computer down has ended their work"
    run.service._shut_down_soon.setInterval(0)
    qtbot.waitUntil(lambda: not run.service._shut_down_soon.isActive())
    run.settle()
    assert len(list((run.folder / "trials").iterdir())) == 1, "it is still recorded"


def test_a_recording_that_ended_is_not_unfinished(run: Run, tmp_path: Path) -> None:
    run.record("one")
    run.state.recording.set(replace(run.state.recording.value, state="idle"))
    run.settle()
    assert list((tmp_path / "trials").iterdir()) == []


def test_a_practice_is_no_trial_to_resume(run: Run, tmp_path: Path) -> None:
    run.state.practice.set(PracticeStatus("preparing"))
    run.record("one")
    run.settle()
    assert not (tmp_path / "trials").exists()


def test_a_wizard_who_does_not_resume_is_not_asked_again(after_a_crash: Run, runs: Callable[[], Run]) -> None:
    after_a_crash.ask(intents.LeaveTrial())
    assert after_a_crash.state.going_on.value.state == "" and after_a_crash.service.state_events(1) == []
    another = runs()
    another.start()
    assert another.state.going_on.value.state == ""
