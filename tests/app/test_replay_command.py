"""Replay of a session or a bag from the command line, without controls for missing data."""

import argparse
import json
import os
import sqlite3
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtWidgets import QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.app import composition, console_command, replay_command
from caris_desktop.app.composition import find_scenario
from caris_desktop.app.console_command import ConsoleRun
from caris_desktop.app.replay_command import ReplayRun, parts_of
from caris_desktop.app.user_settings import own_settings
from caris_desktop.domain import clock
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import LayoutChanged, RobotChosen, ScenarioOpened
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import StatusShown
from caris_desktop.live.frame_ring import FrameRings
from caris_desktop.live.replay_console import ReplayConsole
from caris_desktop.live.status import AssistantStatus
from caris_desktop.people.people_store import PeopleStore
from caris_desktop.recording.foreign.bag_import import ImportReport
from caris_desktop.recording.recorder.disk_watch import DiskLimits
from caris_desktop.recording.recorder.recorder_messages import StartRecording
from caris_desktop.recording.recorder.session_recorder import SessionRecorder
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session.session_header import SessionError, SessionHeader
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.robot.profile import load_profile
from caris_desktop.scenario.scenario_file import scenario_text
from caris_desktop.scenario.scenario_model import Place, Scenario

S = 1_000_000_000
NEWER = "version: 99\ntitle: From a newer program\nlayout: {panel: video}\n"


def _opened(at_ns: int, scenario: Scenario, **changed: Any) -> ScenarioOpened:
    name = scenario.path.name if scenario.path else ""
    told = {"file_name": name, "title": scenario.title, "sha256": scenario.sha256, "content": scenario_text(scenario)}
    return ScenarioOpened(at_ns, **{**told, **changed})


def _arguments(path: Path, *more: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    replay_command.add_arguments(parser)
    return parser.parse_args([str(path), *more])


def _record(folder: Path, timed: Sequence[tuple[float, Callable[[int], Any]]]) -> int:
    """Record a session of a minute; returns its start."""
    begin_ns = clock.now_ns()
    folder.parent.mkdir(exist_ok=True)
    start = StartRecording(folder, SessionHeader(ClockAnchor.take(), program_version="0.test"))
    recorder = SessionRecorder(
        start, frames=FrameRings(()), report=lambda _: None, limits=DiskLimits(reserve_bytes=4096)
    )
    for second, make in timed:
        at_ns = begin_ns + round(second * S)
        recorder.write(make(at_ns), at_ns)
    recorder.close("wizard")
    recorder.finish()
    head = folder / "session.json"
    head.write_text(json.dumps({**json.loads(head.read_text()), "started_ns": begin_ns, "ended_ns": begin_ns + 60 * S}))
    return begin_ns


class Replays:
    """Replays of sessions that last a minute and contain the given values, without windows."""

    def __init__(self, folder: Path, qtbot: QtBot) -> None:
        self._folder, self._qtbot = folder, qtbot
        self._rest = ExitStack()
        self.begin_ns = 0

    def __call__(self, *timed: tuple[float, Callable[[int], Any]]) -> ReplayConsole:
        """``timed`` are seconds and functions that create an event for a time."""
        self.begin_ns = _record(self._folder / "session", timed)
        session = open_session(self._folder / "session")
        videos = VideoReader(session)
        self._rest.callback(videos.close)
        console = ReplayConsole(parts_of(session, videos, lambda _person: None), session)
        self._rest.callback(console.shutdown)
        console.start()
        return console

    def at(self, console: ReplayConsole, second: float) -> Scenario:
        console.seek(self.begin_ns + round(second * S))
        self._qtbot.waitUntil(lambda: console.settled)
        shown: Scenario = console.state.scenario.value
        return shown

    def close(self) -> None:
        self._rest.close()


@pytest.fixture
def replays(tmp_path: Path, qtbot: QtBot) -> Iterator[Replays]:
    made = Replays(tmp_path, qtbot)
    yield made
    made.close()


@pytest.mark.logs(r"app\.replay_command: ", "of the session is not shown", r"live\.replay_player: ")
def test_recordings_of_a_newer_version_are_left_out(replays: Replays, caplog: pytest.LogCaptureFixture) -> None:
    tour = find_scenario("tour-guide")
    run = replays(
        (1.0, lambda at_ns: ScenarioOpened(at_ns, "new.yaml", "From a newer program", "", NEWER)),
        (5.0, lambda at_ns: _opened(at_ns, tour)),
        (20.0, lambda at_ns: ScenarioOpened(at_ns, "new.yaml", "From a newer program", "", NEWER)),
        (21.0, lambda at_ns: RobotChosen(at_ns, "robot", "Robot", "ws://robot:9090", "version: 99\n")),
        (22.0, lambda at_ns: LayoutChanged(at_ns, "[" * 100_000)),
        (23.0, lambda at_ns: LayoutChanged(at_ns, '{"panel": "no such panel"}')),
        (24.0, lambda at_ns: StatusShown(at_ns, "recording", ["of another shape"])),
    )
    assert replays.at(run, 2.0).title == tour.title
    assert replays.at(run, 30.0).title == tour.title
    assert replays.at(run, 10.0).title == tour.title
    assert replays.at(run, 40.0).layout == tour.layout
    told = [record.message for record in caplog.records if "of the session is not shown" in record.message]
    assert [words.split()[0] for words in told].count("RobotChosen") == 1, "told once, not at every jump"
    assert any("recorded status recording" in record.message for record in caplog.records)


def test_panels_lie_as_they_lay_at_that_time(replays: Replays) -> None:
    tour, health = find_scenario("tour-guide"), find_scenario("mental-health-check")
    moved = scenario_text(replace(tour, places=(*tour.places, Place("Tree", Pose2D(1.0, 2.0, 0.0))), path=None))
    run = replays(
        (0.0, lambda at_ns: _opened(at_ns, tour)),
        (10.0, lambda at_ns: LayoutChanged(at_ns, json.dumps({"panel": "video"}))),
        (20.0, lambda at_ns: _opened(at_ns, tour, content=moved, sha256="2" * 64)),
        (30.0, lambda at_ns: _opened(at_ns, health)),
        (40.0, lambda at_ns: _opened(at_ns, tour)),
    )
    arranged = replays.at(run, 15.0).layout
    assert arranged != tour.layout
    assert replays.at(run, 5.0).layout == tour.layout, "before it was arranged"
    with_place = replays.at(run, 25.0)
    assert "Tree" in [place.name for place in with_place.places]
    assert with_place.layout == arranged, "a place that is saved moves no panel"
    assert replays.at(run, 35.0).layout == health.layout
    assert replays.at(run, 45.0).layout == tour.layout, "it was opened anew"


def test_playing_shows_a_scenario_that_is_opened_as_its_file_has_it(replays: Replays, qtbot: QtBot) -> None:
    tour, health = find_scenario("tour-guide"), find_scenario("mental-health-check")
    run = replays(
        (0.0, lambda at_ns: _opened(at_ns, tour)),
        (1.0, lambda at_ns: LayoutChanged(at_ns, json.dumps({"panel": "video"}))),
        (2.0, lambda at_ns: _opened(at_ns, health)),
    )
    run.set_rate(16.0)
    run.play()
    qtbot.waitUntil(lambda: run.scenario.title == health.title, timeout=10_000)
    assert run.scenario.layout == health.layout


@pytest.mark.logs("of the session is not shown")
def test_a_text_is_read_once(replays: Replays, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[str] = []
    parse = replay_command.parse_scenario
    monkeypatch.setattr(
        replay_command, "parse_scenario", lambda text, **given: (read.append(text), parse(text, **given))[1]
    )
    replay_command._scenario_in.cache_clear()
    tour = find_scenario("tour-guide")
    newer = ScenarioOpened(0, "new.yaml", "", "", NEWER)
    run = replays((0.0, lambda at_ns: _opened(at_ns, tour)), (30.0, lambda _at_ns: newer))
    for second in (10.0, 40.0, 20.0, 50.0):
        replays.at(run, second)
    assert sorted(read) == sorted([scenario_text(tour), NEWER])


def _part(run: ReplayRun, name: str) -> QWidget:
    part: QWidget | None = run.window.findChild(QWidget, name)
    assert part is not None, name
    return part


@pytest.mark.logs(r"app\.replay_command: ")
def test_a_replay_looks_like_one_shares_the_settings_and_releases_the_names(tmp_path: Path, qtbot: QtBot) -> None:
    _record(tmp_path / "sessions" / "one", [(0.0, lambda at_ns: ScenarioOpened(at_ns, "new.yaml", "", "", NEWER))])
    PeopleStore(tmp_path / "people.sqlite").close()
    run = ReplayRun(_arguments(tmp_path / "sessions" / "one"))
    qtbot.addWidget(run.window)
    assert run.window.windowTitle().startswith("Replay of one · Tour guide"), "what it cannot read stands in for it"
    assert run.settings.file == own_settings().fileName()
    run.console.state.robot.set(load_profile("simulated"))
    run.console.state.assistant.set(AssistantStatus("ready", "a model", "1", "Why?", "Therefore."))
    offered = {action.objectName() for action in run.window.panels["map"].fill_menu().actions()}  # type: ignore[attr-defined]
    assert not offered & {"map_tool_goal", "map_tool_place", "map_tool_pose"}, "they would do nothing"
    assert _part(run, "map_go_button").isHidden(), "it would do nothing"
    for name in ("assistant_ask", "assistant_say"):
        assert not _part(run, name).isEnabled(), f"{name} would do nothing"
    people = run._people
    assert people is not None
    run.close()
    with pytest.raises(sqlite3.ProgrammingError, match="closed"):
        people._database.execute("SELECT 1")


class Ends:
    """Double of objects that are closed with the console."""

    def __init__(self, name: str, ended: list[str], *, fails: bool = False) -> None:
        self._name, self._ended, self._fails = name, ended, fails

    during = None  # of the closing window

    def shutdown(self, _during: object = None) -> None:
        self._ended.append(self._name)
        if self._fails:
            raise OSError(f"{self._name} does not end")

    close = stop = finish = shutdown


def test_the_robot_is_stopped_first_and_any_failure_lets_the_rest_end(monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[str] = []
    monkeypatch.setattr(console_command, "ClosingWindow", lambda: Ends("closing window", ended))
    run = ConsoleRun.__new__(ConsoleRun)
    run._theme = None  # type: ignore[assignment]
    for name in ("window", "console", "host", "library", "settings"):
        setattr(run, name, Ends(name, ended, fails=name == "console"))
    run._garbage, run.demo_robot = Ends("garbage", ended), Ends("robot", ended)  # type: ignore[assignment]
    run._to_start = deque()
    with pytest.raises(OSError, match="console"):
        run.close()
    assert ended == ["window", "console", "closing window", "host", "library", "garbage", "robot", "settings"]


# A bag


@pytest.fixture
def bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(composition, "imports_dir", lambda: tmp_path / "imports")
    path = tmp_path / "drive.bag"
    path.write_bytes(b"#ROSBAG V2.0\n")
    return path


def _import(path: Path, folder: Path) -> ImportReport:
    """Double of the import with the attributes used by the command."""
    folder.mkdir()
    (folder / "session.json").write_text("{}")
    return ImportReport(folder, "ROS 1 bag", "", 0.0, {}, ())


@pytest.mark.logs(r"app\.replay_command: ")
def test_a_cache_that_takes_nothing_is_reported(bag: Path, tmp_path: Path) -> None:
    (tmp_path / "imports").write_text("a file where the folder should be")
    with pytest.raises(SessionError, match=r"drive\.bag cannot be opened: .*imports"):
        replay_command._session_folder(bag)


def test_of_two_replays_of_one_bag_the_slower_uses_what_the_other_made(
    bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def slow(path: Path, folder: Path) -> ImportReport:
        _import(path, folder.parent.parent / folder.name)
        return _import(path, folder)

    monkeypatch.setattr(replay_command, "import_bag", slow)
    folder = replay_command._session_folder(bag)
    assert (folder / "session.json").is_file()
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]


def test_leftovers_of_a_killed_import_are_removed_after_a_day(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replay_command, "import_bag", _import)
    old_s = time.time() - 25 * 3600
    for name in (".import-old", ".drive.x.importing", ".import-new", "session-old"):
        left = tmp_path / "imports" / name
        left.mkdir(parents=True)
        (left / "events.mcap").touch()
        if not name.endswith("new"):
            os.utime(left, (old_s, old_s))
    folder = replay_command._session_folder(bag)
    assert {path.name for path in folder.parent.iterdir()} == {folder.name, ".import-new", "session-old"}


@pytest.mark.usefixtures("trial_language")
def test_the_reason_of_a_failed_opening_is_translated_in_the_window_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(replay_command, "configure_logging", lambda *_args, **_options: None)
    monkeypatch.setattr(replay_command, "check_screen", lambda: None)
    monkeypatch.setattr(replay_command, "ReplayRun", lambda arguments: open_session(arguments.session))
    assert replay_command.run(_arguments(tmp_path)) == 2
    assert capsys.readouterr().err == f"{tmp_path} is not a session: session.json is missing.\n"
    assert replay_command.run(_arguments(tmp_path, "--told-in-window")) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"[{tmp_path} îš ñöt à šéššîöñ: "), told
