"""A slow disk blocks neither window nor driving, and every request to it is executed."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from caris_desktop.app import composition
from caris_desktop.domain import clock, intents
from caris_desktop.domain.events import Marked, PlacesChanged, Problem, ScenarioOpened, TrialDetails
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.link_commands import Drive, Release, RenewLease
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.console import Console
from caris_desktop.live.services.robot_service import RobotConnection
from caris_desktop.live.wizard_console import BeforeRecording
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.scenario.scenario_file import load_scenario, save_scenario
from tests.live import bodies
from tests.support.slow_disk import SlowDisk

HERE = Pose2D(1.0, 2.0, 0.5)
FULL = UserFacingError("The disk is full.", "Nothing was kept.", "Make room.")


class Bench:
    """Console with a slow disk, a robot that accepts every command, and a real recorder."""

    def __init__(self, folder: Path) -> None:
        self.disk = SlowDisk()
        self.sent: list[Any] = []
        self.happened: list[Any] = []
        shipped = composition.find_scenario("tour-guide")
        permitted = replace(shipped.permissions, audio_recording=False, assistant=False)
        self.scenario = save_scenario(replace(shipped, permissions=permitted), folder / "first.yaml")
        self.other = save_scenario(replace(self.scenario, title="Second tour"), folder / "second.yaml")
        parts = composition.parts(study=composition.open_study(folder / "study"))
        slow = self.disk.delayed
        self.console = Console(
            replace(
                parts,
                people=replace(parts.people, inference=None),
                speech=ProcessSpec("speech", bodies.silent_link),
                session=replace(
                    parts.session,
                    new_session=slow(parts.session.new_session),
                    suggested_details=slow(parts.session.suggested_details),
                ),
                scenario=replace(
                    parts.scenario, load=slow(parts.scenario.load), save_places=slow(parts.scenario.save_places)
                ),
                robots=replace(parts.robots, choices=slow(parts.robots.choices), connect_to=slow(_silent_robot)),
            ),
            self.scenario,
        )
        self.state = self.console.state
        self.state.event_happened.connect(self.happened.append)

    def connect(self) -> None:
        """Set the state of a connected robot."""
        self.console._robot.send = lambda command: not self.sent.append(command)  # type: ignore[method-assign]
        self.state.link.set(replace(self.state.link.value, state="connected"))

    def goes_on(self, qtbot: QtBot) -> None:
        """Assert that the event loop runs, and a key drives as long as it is held."""
        ticks: list[int] = []
        timer = QTimer(interval=1)
        timer.timeout.connect(lambda: ticks.append(1))
        timer.start()
        self.connect()
        self.sent.clear()

        def driven() -> bool:
            if not self.state.drive.value.target_forward_mps:  # pressed again in case the machine was too busy
                assert self.console.do(intents.Drive(1.0, 0.0, 0.0, "keyboard")) == ""
            return len(self.all_sent(RenewLease)) >= 3

        qtbot.waitUntil(driven, timeout=20_000)
        self.console.do(intents.ReleaseDrive(""))
        timer.stop()
        assert self.all_sent(Drive) and self.all_sent(Release)
        assert len(ticks) >= 3

    def all_sent(self, kind: type[Any]) -> list[Any]:
        return [command for command in self.sent if isinstance(command, kind)]

    def all_of(self, kind: type[Any]) -> list[Any]:
        return [event for event in self.happened if isinstance(event, kind)]

    def told(self) -> list[str]:
        return [problem.what for problem in self.all_of(Problem)]

    def place_names(self) -> list[str]:
        return [place.name for place in self.state.places.value]

    def close(self, during: Callable[[str, Callable[[], None]], None] = lambda _what, work: work()) -> None:
        self.state.link.set(replace(self.state.link.value, state="closed"))
        self.console.shutdown(during)


def _silent_robot(name: str) -> RobotConnection:
    body = ProcessSpec("control", bodies.silent_link)
    return RobotConnection(name, "ws://127.0.0.1:9", RobotProfile(name, name), body, None)


def _marks(session: Session) -> list[str]:
    return [event.label for _, event in session.values("event/marked")]


@pytest.fixture
def bench(qapp: QApplication, tmp_path: Path) -> Iterator[Bench]:
    """Without child processes; a recording starts its own."""
    bench = Bench(tmp_path)
    bench.disk.hold()
    yield bench
    bench.disk.release()
    bench.close()


def _close_as_the_disk_answers(bench: Bench) -> list[str]:
    named: list[str] = []

    def during(what: str, work: Callable[[], None]) -> None:
        named.append(what)
        bench.disk.release()
        work()

    bench.close(during)
    return named


def test_events_before_the_session_folder_exists_are_recorded(bench: Bench, qtbot: QtBot) -> None:
    console, state = bench.console, bench.state
    console.start()
    console.do(intents.StartRecording(TrialDetails(participant="P1"), anyway=True))
    assert (state.recording.value.state, state.recording.value.folder) == ("starting", None)
    qtbot.waitUntil(bench.disk.waiting.is_set, timeout=20_000)
    before_ns = clock.now_ns()
    console.do(intents.Mark("meanwhile"))
    console.do(intents.StartRecording(TrialDetails(participant="P2"), anyway=True))
    bench.goes_on(qtbot)
    assert (state.recording.value.state, state.recording.value.folder) == ("starting", None)
    bench.disk.release()
    qtbot.waitUntil(lambda: state.recording.value.state == "recording", timeout=60_000)
    console.do(intents.Mark("afterwards"))
    console.do(intents.StopRecording())
    qtbot.waitUntil(lambda: state.recording.value.state == "idle", timeout=60_000)
    session = open_session(Path(state.recording.value.folder))
    assert session.trial["participant"] == "P1", "the second wish was none: a recording was starting"
    assert session.started_ns < before_ns, "it began when it was asked for"
    assert _marks(session) == ["meanwhile", "afterwards"]
    assert [event.title for _, event in session.values("event/scenario_opened")] == [bench.scenario.title]
    assert len(list(Path(state.recording.value.folder).parent.iterdir())) == 1
    assert bench.told() == []


def test_a_recording_that_is_ended_while_its_folder_is_made_holds_what_was_until_then(
    bench: Bench, qtbot: QtBot
) -> None:
    console, state = bench.console, bench.state
    console.start()
    console.do(intents.StartRecording(TrialDetails(participant="P3"), anyway=True))
    console.do(intents.Mark("inside"))
    console.do(intents.StopRecording())
    console._bus.publish(Marked(clock.now_ns(), "outside"))
    assert state.recording.value.state == "stopping"
    bench.disk.release()
    qtbot.waitUntil(lambda: state.recording.value.state == "idle", timeout=60_000)
    assert console.session_folder is not None
    session = open_session(console.session_folder)
    assert (session.reason, _marks(session)) == ("wizard", ["inside"])


@pytest.mark.logs(r"live\.bus: The disk is full\.")
def test_a_missing_folder_is_reported_and_nothing_is_recorded(bench: Bench, qtbot: QtBot) -> None:
    console, state = bench.console, bench.state
    bench.disk.error = FULL
    console.do(intents.StartRecording(TrialDetails(), anyway=True))
    assert state.recording.value.state == "starting"
    bench.disk.release()
    qtbot.waitUntil(lambda: state.recording.value.state == "failed", timeout=20_000)
    qtbot.waitUntil(lambda: bench.told() == ["The disk is full."], timeout=20_000)
    assert state.recording.value.detail == "The disk is full."
    assert console.session_folder is None


def test_places_are_saved_one_after_the_other_and_another_scenario_is_the_last_word(bench: Bench, qtbot: QtBot) -> None:
    console, before = bench.console, bench.place_names()
    assert bench.scenario.path is not None and bench.other.path is not None
    console.do(intents.SavePlace("Lift", HERE))
    console.do(intents.SavePlace("Stairs", HERE))
    console.do(intents.RemovePlace(before[0]))
    console.do(intents.OpenScenario(bench.other.path))
    qtbot.waitUntil(bench.disk.waiting.is_set, timeout=20_000)
    bench.goes_on(qtbot)
    assert bench.place_names() == before
    assert bench.all_of(PlacesChanged) == []
    bench.disk.release()
    qtbot.waitUntil(lambda: console.scenario.title == "Second tour", timeout=20_000)
    assert [place.name for place in load_scenario(bench.scenario.path).places] == [*before[1:], "Lift", "Stairs"]
    assert bench.place_names() == before
    qtbot.waitUntil(lambda: bench.all_of(ScenarioOpened)[-1].title == "Second tour", timeout=20_000)
    assert [(event.name, event.pose_in_map) for event in bench.all_of(PlacesChanged)] == [
        ("Lift", HERE),
        ("Stairs", HERE),
        (before[0], None),
    ]
    qtbot.waitUntil(lambda: console.state.scenario.value == console.scenario)
    assert bench.told() == []


@pytest.mark.logs(r"live\.bus: The disk is full\.")
def test_a_place_that_cannot_be_saved_is_reported_and_does_not_take_the_next_along(bench: Bench, qtbot: QtBot) -> None:
    console, before = bench.console, bench.place_names()
    bench.disk.error = FULL
    console.do(intents.SavePlace("Lift", HERE))
    console.do(intents.SavePlace("Stairs", HERE))
    bench.disk.release()
    qtbot.waitUntil(lambda: bench.place_names() == [*before, "Stairs"], timeout=20_000)
    qtbot.waitUntil(lambda: bench.told() == ["The disk is full."], timeout=20_000)
    assert bench.scenario.path is not None
    assert [place.name for place in load_scenario(bench.scenario.path).places] == [*before, "Stairs"]


def test_the_present_robot_is_driven_until_the_last_one_requested_is_found(bench: Bench, qtbot: QtBot) -> None:
    bench.console.do(intents.UseRobot("first"))
    bench.console.do(intents.UseRobot("last"))
    qtbot.waitUntil(bench.disk.waiting.is_set, timeout=20_000)
    bench.goes_on(qtbot)
    robots: list[str] = []
    bench.state.link.changed.connect(lambda link: robots.append(link.robot))
    bench.disk.release()
    qtbot.waitUntil(
        lambda: bench.state.robot.value is not None and bench.state.robot.value.name == "last", timeout=20_000
    )
    assert "control" in bench.console._robot.links
    assert "first" not in robots


@pytest.mark.logs(r"live\.bus: The disk is full\.")
def test_a_robot_that_cannot_be_read_leaves_the_present_one(bench: Bench, qtbot: QtBot) -> None:
    bench.connect()
    bench.disk.error = FULL
    bench.console.do(intents.UseRobot("unreadable"))
    bench.disk.release()
    qtbot.waitUntil(lambda: bench.told() == ["The disk is full."], timeout=20_000)
    assert bench.state.link.value.state == "connected"


def test_the_start_of_a_recording_is_reported_once_the_disk_responds(bench: Bench, qtbot: QtBot) -> None:
    told: list[BeforeRecording] = []
    bench.console.check_before_recording(told.append)
    qtbot.waitUntil(bench.disk.waiting.is_set, timeout=20_000)
    bench.goes_on(qtbot)
    assert told == []
    bench.disk.release()
    qtbot.waitUntil(lambda: bool(told), timeout=20_000)
    assert told[0].suggested == TrialDetails()
    assert (told[0].free_bytes or 0) > 0 and (told[0].bytes_per_hour or 0) > 0


@pytest.mark.logs("live.background_worker: ")
def test_a_disk_that_reports_nothing_keeps_nobody_from_recording(bench: Bench, qtbot: QtBot) -> None:
    told: list[BeforeRecording] = []
    bench.disk.error = OSError("gone")
    bench.console.check_before_recording(told.append)
    bench.disk.release()
    qtbot.waitUntil(lambda: told == [BeforeRecording()], timeout=20_000)


def test_the_list_of_robots_is_reported_when_the_disk_has_reported(bench: Bench, qtbot: QtBot) -> None:
    told: list[str] = []
    console = bench.console
    console.run_in_background(console.robots, lambda robots: told.extend(robot.name for robot in robots))
    qtbot.waitUntil(bench.disk.waiting.is_set, timeout=20_000)
    bench.goes_on(qtbot)
    assert told == []
    bench.disk.release()
    qtbot.waitUntil(lambda: "simulated" in told, timeout=20_000)


def test_a_session_whose_folder_is_made_while_the_window_closes_is_saved(bench: Bench, qtbot: QtBot) -> None:
    bench.console.start()
    bench.console.do(intents.StartRecording(TrialDetails(participant="P4"), anyway=True))
    bench.console.do(intents.Mark("last"))
    named = _close_as_the_disk_answers(bench)
    assert "The last changes are being written to disk." in named
    assert bench.console.session_folder is not None
    session = open_session(bench.console.session_folder)
    assert (session.reason, _marks(session)) == ("console_closed", ["last"])


def test_a_place_that_is_saved_while_the_window_closes_is_saved(bench: Bench, qtbot: QtBot) -> None:
    assert bench.scenario.path is not None
    bench.console.do(intents.SavePlace("Lift", HERE))
    bench.console.do(intents.UseRobot("late"))
    _close_as_the_disk_answers(bench)
    assert load_scenario(bench.scenario.path).places[-1].name == "Lift"
    assert bench.state.robot.value is None, "no robot is connected any more"
