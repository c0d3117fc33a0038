"""Panel table: only shown panels are imported."""

import subprocess
import sys
from dataclasses import replace
from typing import get_args

import pytest
from pytestqt.qtbot import QtBot

from caris_desktop.scenario.scenario_model import BuiltInPanel, PanelName, Permissions
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panel import Panel
from caris_desktop.ui.panel_table import PANELS, possible_panels
from caris_desktop.ui.theme import Theme, icon_names
from tests.ui import samples
from tests.ui.conftest import MemorySettings
from tests.ui.fake_console import FakeConsole

LATE = (
    "ui.panels.", "ui.robot_dialog", "ui.sessions_window", "ui.export_dialog", "ui.gamepad_dialog", "ui.start_dialog",
    "ui.replay.timeline", "ui.replay.replay_bar",
)  # fmt: skip
"""Modules that no window imports before a scenario shows them or the user opens them."""


def test_every_panel_that_a_scenario_can_name_has_its_row() -> None:
    assert set(PANELS) == set(get_args(BuiltInPanel))
    assert {spec.icon for spec in PANELS.values()} <= icon_names()
    assert all(set(spec.neighbours) <= set(PANELS) - {name} for name, spec in PANELS.items())


@pytest.mark.parametrize("name", PANELS)
def test_a_row_says_what_its_panel_is_called(name: PanelName) -> None:
    panel = PANELS[name].load()
    assert issubclass(panel, Panel)
    assert panel.title == PANELS[name].title


def test_a_panel_without_its_permission_is_absent() -> None:
    everything = replace(samples.TOUR, permissions=Permissions(face=True))
    assert set(possible_panels(everything)) == set(PANELS)
    little = Permissions(driving=False, assistant=False, robot_controls=False, photos=False, speech=False)
    assert set(PANELS) - set(possible_panels(replace(everything, permissions=little))) == {
        "drive", "assistant", "robot", "photos", "face", "speak"
    }  # fmt: skip


def test_a_panel_that_the_scenario_does_not_offer_is_absent() -> None:
    without = replace(samples.TOUR, permissions=Permissions(face=True), panels_off=("map", "diagnostics"))
    assert set(PANELS) - set(possible_panels(without)) == {"map", "diagnostics"}


def test_the_window_brings_no_panel_and_no_dialog_along() -> None:
    assert imported("import caris_desktop.ui.main_window", [f"caris_desktop.{late}" for late in LATE]) == []


@pytest.mark.long
def test_editors_and_console_check_files_alike_but_apart() -> None:
    """JSON Schema takes a fifth of a second to import, before the first window is shown."""
    reads_both = (
        "import caris_desktop.app.composition, caris_desktop.ui.main_window\n"
        "from caris_desktop.robot.profile import list_profiles\n"
        "from caris_desktop.scenario.scenario_file import list_scenarios\n"
        "assert len(list_profiles()) > 5 and len(list_scenarios()) > 1"
    )
    assert imported(reads_both, ["jsonschema", "referencing", "rpds"]) == []


def imported(program: str, names: list[str]) -> list[str]:
    """Modules whose names start so that a separate program has imported."""
    tell = "import sys; late = tuple(sys.stdin.read().split())\nprint(*(n for n in sys.modules if n.startswith(late)))"
    told = subprocess.run(
        [sys.executable, "-c", f"{program}\n{tell}"], input="\n".join(names), capture_output=True, text=True, check=True
    )
    return told.stdout.split()


def test_panels_of_a_scenario_are_those_of_its_layout(window: MainWindow) -> None:
    assert {type(panel) for panel in window.panels.values()} == {PANELS[name].load() for name in window.panels}


def test_a_panel_whose_library_takes_long_comes_after_the_window(
    qtbot: QtBot, theme: Theme, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The map is in front, but its library is imported in the background once the window is painted."""
    monkeypatch.setattr("caris_desktop.ui.panel_table._imported", set())
    console = FakeConsole(samples.TOUR)
    console.disk_is_slow = True
    window = MainWindow(console, settings=MemorySettings(), theme=theme, all_panels=False)
    qtbot.addWidget(window)
    assert "speak" in window.board.made_so_far and "map" not in window.board.made_so_far
    window.show()
    qtbot.waitUntil(lambda: {"people", "drive"} <= set(window.board.made_so_far))
    assert "map" not in window.board.made_so_far
    console.disk_is_slow = False
    console.answer_of_disk()
    qtbot.waitUntil(lambda: "map" in window.board.made_so_far)
    qtbot.waitUntil(lambda: window.board.whole)
    assert window.panels["map"].isVisible()
    console.state.close()
