"""First start of the program."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import QSettings
from pytestqt.qtbot import QtBot

from caris_desktop.app import composition, console_command
from caris_desktop.app.console_command import ConsoleRun, default_arguments
from caris_desktop.app.demo_robot import DemoRobot
from caris_desktop.domain.actor import WIZARD
from caris_desktop.live.console import Console
from caris_desktop.live.services.robot_service import RobotConnection
from caris_desktop.live.status import LinkStatus
from caris_desktop.ui.first_use import SET_UP_KEY
from caris_desktop.ui.set_up_page import SetUpPage

Start = Callable[..., ConsoleRun]


@pytest.fixture
def settings(tmp_path: Path) -> QSettings:
    return QSettings(str(tmp_path / "settings.ini"), QSettings.Format.IniFormat)


@pytest.fixture
def start(qtbot: QtBot, tmp_path: Path, settings: QSettings) -> Iterator[Start]:
    """The window is shown without background services."""
    runs: list[ConsoleRun] = []

    def start(**arguments: Any) -> ConsoleRun:
        run = ConsoleRun(default_arguments(study=tmp_path / "study", **arguments), settings=settings)
        runs.append(run)
        qtbot.addWidget(run.window)
        run.window.show()
        run.begin_first_use()
        return run

    yield start
    for run in runs:
        run.close()


def test_the_page_comes_and_its_first_choice_starts_the_simulated_robot(
    start: Start, settings: QSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[DemoRobot] = []
    monkeypatch.setattr(DemoRobot, "start", lambda robot: started.append(robot))
    run = start()
    page = run.window.findChild(SetUpPage)
    assert page is not None and page.isVisible()
    page.simulated_requested.emit()
    assert started == [run.demo_robot]
    assert run.window.first_use.hint.isVisible()
    page.close_overlay()
    assert settings.value(SET_UP_KEY) == "skipped"


def test_no_page_blocks_a_demonstration(start: Start) -> None:
    run = start(demo=True)
    assert run.window.findChild(SetUpPage) is None
    assert run.window.first_use.hint.isVisible()


@pytest.mark.parametrize(
    ("named", "last", "connected"),
    [(None, "turtlebot3", "turtlebot3"), (None, "no-more", "simulated"), ("pepper", "turtlebot3", "pepper")],
    ids=["there", "gone", "another is named"],
)
@pytest.mark.long("gone", "another*")
def test_the_robot_of_last_time_is_connected_unless_it_is_gone_or_another_is_named(
    start: Start, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, *, named: str | None, last: str, connected: str
) -> None:
    asked: list[Callable[[], RobotConnection]] = []
    monkeypatch.setattr(Console, "start", lambda _console: None)
    monkeypatch.setattr(Console, "use_robot", lambda _console, find, **_told: asked.append(find))
    before = start(scenario="tour-guide")
    assert before.console.scenario.robot == "simulated"
    profile = composition.robot_connection("turtlebot3").profile
    before.console.state.robot.set(replace(profile, name=last))
    run = start(scenario="tour-guide", robot=named)
    run._start_rest()
    qtbot.waitUntil(lambda: bool(asked))
    assert asked[0]().profile.name == connected


@pytest.mark.parametrize(
    "scenario",
    [pytest.param("tour-guide", marks=pytest.mark.long), "reception"],
    ids=["the same scenario", "another"],
)
@pytest.mark.parametrize("own", [True, False], ids=["its own", "one that was there"])
@pytest.mark.long
def test_a_simulated_robot_of_the_consoles_own_comes_back_with_the_console(
    start: Start, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, *, own: bool, scenario: str
) -> None:
    """A simulated robot of the console ended with it: its old address would cause an error at the start."""
    address, asked, started = "ws://127.0.0.1:41234", [], []
    monkeypatch.setattr(Console, "start", lambda _console: None)
    monkeypatch.setattr(Console, "use_robot", lambda _console, _find, *_by, **_told: asked.append(1))
    monkeypatch.setattr(DemoRobot, "start", lambda robot: started.append(robot))
    before = start(scenario="tour-guide")
    before.console.state.robot.set(composition.robot_connection("simulated").profile)
    if own:
        before._use_simulated_robot(WIZARD)
        before.demo_robot._on_ready(address)  # type: ignore[union-attr]
    before.console.state.link.set(LinkStatus("connected", "Simulated robot", address))
    before.console.state.link.set(LinkStatus("lost", "Simulated robot", address))
    before.settings.finish()
    started.clear()
    asked.clear()
    run = start(scenario=scenario)
    run._start_rest()
    qtbot.waitUntil(lambda: bool(asked or started))
    assert (len(started), len(asked)) == ((1, 0) if own else (0, 1))


@pytest.mark.parametrize("seen", [True, False], ids=["seen", "on another desktop"])
def test_background_work_starts_after_the_first_paint_with_all_panels(
    start: Start, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, *, seen: bool
) -> None:
    started: list[tuple[bool, bool]] = []
    monkeypatch.setattr(console_command, "_REST_AT_LATEST_MS", 60_000 if seen else 20)
    run = start(scenario="tour-guide")
    run.window.hide()
    painted: list[bool] = []
    run.window._painted = False
    run.window.painted.connect(lambda: painted.append(True))
    monkeypatch.setattr(run.console, "start", lambda: started.append((bool(painted), run.window.board.whole)))
    monkeypatch.setattr(run.console, "use_robot", lambda _find, **_told: started.append((True, True)))
    if not seen:
        monkeypatch.setattr(run.window, "show_in_place", lambda: None)
    run.show()
    assert not started
    qtbot.waitUntil(lambda: len(started) == 2)
    assert not seen or started[0] == (True, True)
    qtbot.wait(50)
    assert len(started) == 2, "once"
