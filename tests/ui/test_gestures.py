"""Gestures: what the scenario lists is one key, click or line of Find anything away, where the robot can do it."""

import dataclasses
from pathlib import Path

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import intents
from caris_desktop.domain.controls import CallService, RobotControl
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.addressee import addressee
from caris_desktop.robot.profile import load_profile
from caris_desktop.scenario.file import ScenarioError, load_scenario, parse_scenario
from caris_desktop.scenario.gestures import Gesture
from caris_desktop.scenario.model import Permissions
from caris_desktop.ui.action_rows import perform_nth_gesture
from caris_desktop.ui.main_window import MainWindow
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole

GESTURES = (Gesture("Wave", "wave"), Gesture("Nod", "nod"), Gesture("Look at them", "look"))
WAVE = RobotControl("wave", "Wave", "button", CallService("/do", "std_srvs/Trigger", {}))

pytestmark = pytest.mark.panels("speak", "map")


@pytest.fixture
def gestured(window: MainWindow, console: FakeConsole) -> MainWindow:
    """A robot with a head and arms to wave with."""
    console.state.robot.set(load_profile("simulated"))
    console.state.controls.set((WAVE,))
    use(window, console, Permissions())
    return window


def use(window: MainWindow, console: FakeConsole, permissions: Permissions) -> None:
    console.scenario = dataclasses.replace(console.scenario, gestures=GESTURES, permissions=permissions)
    console.state.scenario.set_anew(console.scenario)


def shown(window: MainWindow) -> list[str]:
    return [spec.text for spec in window.actions_table.specs if spec.intent is perform_nth_gesture]


def done(console: FakeConsole) -> list[tuple[str, object]]:
    return [
        call for call in console.calls if call[0] in ("use_control", "look_at", "nod", "LookAt", "Nod", "UseControl")
    ]


def test_each_has_a_button_with_its_key_and_does_what_it_says(
    qtbot: QtBot, gestured: MainWindow, console: FakeConsole
) -> None:
    assert shown(gestured) == ["Gesture: Wave", "Gesture: Nod", "Gesture: Look at them"]
    panel = gestured.board.panels["speak"]
    buttons = [find(panel, f"gesture_{number}") for number in (1, 2, 3)]
    assert [button.accessibleName() for button in buttons] == shown(gestured)
    assert [gestured.actions_table.key_text(f"gesture_{n}") for n in (1, 2, 3)] == ["Ctrl 4", "Ctrl 5", "Ctrl 6"]
    click(qtbot, buttons[0])
    assert len(done(console)) == 1
    QTest.keyClick(gestured, Qt.Key.Key_5, Qt.KeyboardModifier.ControlModifier)
    assert len(done(console)) == 2
    QTest.keyClick(gestured, Qt.Key.Key_6, Qt.KeyboardModifier.ControlModifier)
    assert len(done(console)) == 3


def test_who_is_spoken_to_is_looked_at(gestured: MainWindow, console: FakeConsole) -> None:
    state = console.state
    asked = [perform_nth_gesture(console.scenario, state, number) for number in (1, 2, 3, 4)]
    whom = addressee(state)
    bearing = next((row.bearing_rad for row in state.persons.value if row.person_id == whom), None)
    assert asked == [intents.UseControl("wave", True), intents.Nod(), intents.LookAt(bearing or 0.0, 0.0), None]
    state.persons.set(())
    assert perform_nth_gesture(console.scenario, state, 3) == intents.LookAt(0.0, 0.0), "ahead, where nobody is"


def test_what_this_robot_cannot_do_or_the_scenario_does_not_allow_is_not_there(
    gestured: MainWindow, console: FakeConsole
) -> None:
    console.state.controls.set(())
    assert shown(gestured) == ["Gesture: Nod", "Gesture: Look at them"]
    console.state.robot.set(dataclasses.replace(load_profile("simulated"), head=None))
    assert shown(gestured) == []
    chip = gestured.board.panels["speak"].findChild(QWidget, "gesture_2")
    assert chip is not None and not chip.isVisible()
    console.state.robot.set(load_profile("simulated"))
    console.state.controls.set((WAVE,))
    use(gestured, console, Permissions(driving=False))
    assert shown(gestured) == ["Gesture: Wave"]
    use(gestured, console, Permissions(robot_controls=False))
    assert shown(gestured) == ["Gesture: Nod", "Gesture: Look at them"]


def test_find_anything_has_them_and_finds_none_by_a_guess(gestured: MainWindow) -> None:
    found = {entry.text: entry for entry in gestured.palette_entries()}
    for text in shown(gestured):
        assert found[text].acts, "what moves the robot is found by its own words only"
        assert found[text].key


def test_a_scenario_lists_them() -> None:
    tour = load_scenario(layouts_dir() / "tour-guide.yaml")
    assert [gesture.does for gesture in tour.gestures] == ["wave", "nod", "look"]
    text = "version: 1\ntitle: Visit\nlayout: {panel: map}\ngestures:\n"
    with pytest.raises(ScenarioError, match="gestures"):
        parse_scenario(text + "".join(f"  - {{title: G{n}, does: nod}}\n" for n in range(7)), path=Path("visit.yaml"))
    with pytest.raises(ScenarioError, match="does"):
        parse_scenario(text + "  - {title: Wave}\n", path=Path("visit.yaml"))


def test_the_next_scenario_may_have_fewer_while_these_buttons_are_still_there(
    gestured: MainWindow, console: FakeConsole
) -> None:
    buttons = [find(gestured.board.panels["speak"], f"gesture_{number}") for number in (1, 2, 3)]
    console.scenario = dataclasses.replace(console.scenario, gestures=GESTURES[:1])  # its keys follow a moment later
    gestured.actions_table.rows_changed.emit()
    assert [button.isVisibleTo(gestured) for button in buttons] == [True, False, False]
