"""Panels of plug-ins: what they get, what they may request, and what happens when they fail."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from PySide6.QtWidgets import QLabel
from pytestqt.qtbot import QtBot
from shiboken6 import isValid

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import SCRIPT
from caris_desktop.domain.events import Marked
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.plugins import INTERFACES
from caris_desktop.domain.sensing import AudioChunk, Odometry
from caris_desktop.live.confirmed_files import scenario_references
from caris_desktop.scenario.scenario_file import ScenarioError, parse_scenario
from caris_desktop.scenario.scenario_model import PanelLeaf, SplitNode
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panel_table import possible_panels
from caris_desktop.ui.plugin_panel import PluginPanel
from caris_desktop.ui.theme import Theme
from tests.support.plugins import install
from tests.ui import samples
from tests.ui.conftest import MemorySettings
from tests.ui.fake_console import FakeConsole

SCENARIO = replace(
    samples.TOUR,
    layout=SplitNode("horizontal", (PanelLeaf("video"), PanelLeaf("plugin:speedometer")), (1.0, 1.0)),
    layout_compact=None, layout_large=None,
)  # fmt: skip
SOURCE = """
    from PySide6.QtWidgets import QLabel
    from caris_desktop.domain.events import Marked
    from caris_desktop.domain.sensing import Odometry

    class Plugin(QLabel):
        caris_interface = 1

        def __init__(self, console):
            super().__init__("no speed", objectName="speedometer")
            self.console = console
            console.follow(Odometry, self.show_speed)
            console.follow(Marked, lambda mark: self.setText(mark.label))
            {creation}

        def show_speed(self, odometry):
            {showing}
            self.setText(f"{{odometry.twist.forward_mps:.1f}} m/s")
"""


def odometry(forward_mps: float) -> Odometry:
    return Odometry(clock.now_ns(), None, Pose2D(0, 0, 0), Twist2D(forward_mps, 0, 0))


@pytest.fixture
def console() -> Iterator[FakeConsole]:
    console = FakeConsole(SCENARIO)
    yield console
    console.state.close()


Opened = Callable[..., tuple[MainWindow, PluginPanel]]


@pytest.fixture
def opened(qtbot: QtBot, console: FakeConsole, theme: Theme, installed: Callable[..., None]) -> Opened:
    """Window with the panel, whose plug-in does this when it is made, and when it shows a value."""

    def open_with(creation: str = "pass", showing: str = "pass") -> tuple[MainWindow, PluginPanel]:
        installed(creation, showing)
        window = MainWindow(console, settings=MemorySettings(), scenarios=list, theme=theme)
        qtbot.addWidget(window)
        window.show()
        panel = window.panels["plugin:speedometer"]
        assert isinstance(panel, PluginPanel)
        return window, panel

    return open_with


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    def with_source(creation: str = "pass", showing: str = "pass") -> None:
        source = SOURCE.format(creation=creation, showing=showing)
        install(tmp_path / "packages", "panels", "speedometer", source, monkeypatch)
        monkeypatch.delitem(sys.modules, "lab_speedometer", raising=False)

    return with_source


def test_it_shows_the_streams_that_it_follows(console: FakeConsole, opened: Opened) -> None:
    console.state.odometry.update_value(odometry(0.3))
    _window, panel = opened()
    content = panel.findChild(QLabel, "speedometer")
    assert content.text() == "0.3 m/s"
    console.state.odometry.update_value(odometry(0.5))
    assert content.text() == "0.5 m/s"
    panel.set_in_view(False)
    console.state.odometry.update_value(odometry(0.1))
    assert content.text() == "0.5 m/s"
    panel.set_in_view(True)
    assert content.text() == "0.1 m/s"


def test_a_former_panel_is_told_no_more(qtbot: QtBot, console: FakeConsole, opened: Opened) -> None:
    window, former = opened()
    window.show_scenario(replace(SCENARIO, title="Changed"))
    panel = window.panels["plugin:speedometer"]
    qtbot.waitUntil(lambda: panel is not former and not isValid(former))
    content = panel.findChild(QLabel, "speedometer")
    console.state.odometry.update_value(odometry(0.7))
    assert content.text() == "0.7 m/s"
    console.state.event_happened.emit(Marked(clock.now_ns(), "odd", mark_id="m1"))
    assert content.text() == "odd"
    assert console.state.alarms.value == ()


def test_sound_cannot_be_followed(opened: Opened) -> None:
    _window, panel = opened()
    with pytest.raises(ValueError, match="AudioChunk is no stream and no event"):
        panel.follow(AudioChunk, print)


def test_it_requests_as_a_script_and_moves_nothing(
    console: FakeConsole, opened: Opened, monkeypatch: pytest.MonkeyPatch
) -> None:
    _window, panel = opened()
    done: list[intents.Intent] = []
    monkeypatch.setattr(console, "do", lambda intent: done.append(intent) or "")
    for refused in (
        intents.Drive(forward=1, left=0, turn=0, source="keyboard"), intents.GoToPlace("Kitchen"),
        intents.ReleaseEmergencyStop(), intents.UseRobot("dot:"), intents.ForgetPerson("p-1"),
    ):  # fmt: skip
        assert panel.request(refused) and done == []
    assert panel.request(intents.Stop()) == ""
    assert panel.request(intents.Mark(label="odd")) == ""
    assert [(type(intent), intent.actor) for intent in done] == [(intents.Stop, SCRIPT), (intents.Mark, SCRIPT)]


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (("raise ValueError('no display')", "pass"), "it raised ValueError: no display"),
        (("import time; time.sleep(1.1)", "pass"), "it stopped the window for 1."),
        (("print('hello')", "pass"), "it printed “hello”"),
        (("pass", "1 / 0"), "it raised ZeroDivisionError"),
        (("pass", "import time; time.sleep(0.2)"), "it stopped the window for 0."),
        (("pass", "import sys; sys.exit(1)"), "it raised SystemExit"),
    ],
)  # fmt: skip
@pytest.mark.logs("caris_desktop.domain.plugins")
def test_one_that_fails_is_removed_and_named(
    console: FakeConsole, opened: Opened, body: tuple[str, str], reason: str
) -> None:
    window, panel = opened(*body)
    console.state.odometry.update_value(odometry(0.3))
    console.state.odometry.update_value(odometry(0.4))
    assert panel.findChild(QLabel, "speedometer") is None or not panel.findChild(QLabel, "speedometer").isVisible()
    (alarm,) = [one for one in console.state.alarms.value if "speedometer" in one.what]
    assert reason in alarm.what and "lab-speedometer 2.1" in alarm.what
    assert any(reason in one.text() for one in panel.findChildren(QLabel))
    assert set(window.panels) == {"video", "plugin:speedometer"}


@pytest.mark.logs("caris_desktop.domain.plugins")
def test_one_of_another_version_is_not_used(
    console: FakeConsole, opened: Opened, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(INTERFACES, "panels", 2)
    _window, panel = opened()
    assert "version 1 of the interface" in panel.findChildren(QLabel)[-1].text()


def test_a_scenario_names_installed_ones_only_and_asks_first(tmp_path: Path, installed: Callable[..., None]) -> None:
    text = 'version: 1\ntitle: Test\nlayout: {tabs: [video, "plugin:speedometer"]}\n'
    path = tmp_path / "test.yaml"
    with pytest.raises(ScenarioError, match="unknown plug-in 'speedometer'"):
        parse_scenario(text, path=path)
    installed()
    scenario = parse_scenario(text, path=path)
    assert [(one.kind, one.text) for one in scenario_references(scenario)] == [
        ("plugin", "speedometer (lab-speedometer 2.1)")
    ]
    assert "plugin:speedometer" in possible_panels(scenario)
    assert "plugin:speedometer" not in possible_panels(replace(scenario, panels_off=("plugin:speedometer",)))
    with pytest.raises(ScenarioError, match=r"unknown panel 'vidio'.*plugin:NAME.*Did you mean 'video'"):
        parse_scenario(text.replace("video", "vidio"), path=path)


def test_a_replay_runs_none(qtbot: QtBot, console: FakeConsole, theme: Theme, installed: Callable[..., None]) -> None:
    installed()
    console.state.present = replace(console.state.present, live=False)
    window = MainWindow(console, settings=MemorySettings(), scenarios=list, theme=theme)
    qtbot.addWidget(window)
    window.show()
    assert set(window.panels) == {"video"}
