"""Gestures of the scenario by key, click and palette, if the robot supports them."""

import dataclasses
from pathlib import Path

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QLabel, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import intents
from caris_desktop.domain.control_definitions import CallService, RobotControl
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.speech_queue import addressee
from caris_desktop.robot.profile import load_profile
from caris_desktop.scenario.phrases import Gesture
from caris_desktop.scenario.scenario_file import ScenarioError, load_scenario, parse_scenario
from caris_desktop.scenario.scenario_model import Permissions
from caris_desktop.ui.action_rows import perform_nth_gesture
from caris_desktop.ui.main_window import MainWindow
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole

GESTURES = (Gesture("Wave", "wave"), Gesture("Nod", "nod"), Gesture("Look at them", "look"))
WAVE = RobotControl("wave", "Wave", "button", CallService("/do", "std_srvs/Trigger", {}))

pytestmark = pytest.mark.panels("speak", "map")


@pytest.fixture
def gestured(window: MainWindow, console: FakeConsole) -> MainWindow:
    """Robot with a head and with arms to wave."""
    console.state.robot.set(load_profile("simulated"))
    console.state.controls.set((WAVE,))
    use(window, console, Permissions())
    return window


def use(window: MainWindow, console: FakeConsole, permissions: Permissions) -> None:
    console.scenario = dataclasses.replace(console.scenario, gestures=GESTURES, permissions=permissions)
    console.state.scenario.reset_value(console.scenario)


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


def test_one_with_a_key_of_its_own_has_that_wherever_it_stands(
    qtbot: QtBot, gestured: MainWindow, console: FakeConsole
) -> None:
    nod = dataclasses.replace(GESTURES[1], key="Ctrl+Shift+W")
    for gestures in ((GESTURES[0], nod, GESTURES[2]), (nod, GESTURES[0], GESTURES[2])):
        console.scenario = dataclasses.replace(console.scenario, gestures=gestures)
        console.state.scenario.reset_value(console.scenario)
        keys = {spec.text: gestured.actions_table.key_text(spec.id) for spec in gestured.actions_table.specs}
        assert keys["Gesture: Nod"] == "⇧Ctrl W"
        place = gestures.index(GESTURES[0])
        assert keys["Gesture: Wave"] == f"Ctrl {4 + place}", "the others keep that of their place"
        before = len(done(console))
        QTest.keyClick(gestured, Qt.Key.Key_W, Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier)
        assert [name.casefold() for name, _ in done(console)[before:]] == ["nod"]
    before = len(done(console))
    QTest.keyClick(gestured, Qt.Key.Key_4, Qt.KeyboardModifier.ControlModifier)
    assert len(done(console)) == before, "nothing is on the place's key"


def test_a_key_that_does_something_else_continues_doing_that(gestured: MainWindow, console: FakeConsole) -> None:
    nod = dataclasses.replace(GESTURES[1], key="Ctrl+P")
    console.scenario = dataclasses.replace(console.scenario, gestures=(nod,))
    console.state.scenario.reset_value(console.scenario)
    table = gestured.actions_table
    keys = {spec.id: spec.keys for spec in table.specs}
    assert (keys["gesture_1"], keys["photo"]) == ((), ("Ctrl+P",))
    assert [(lost.text, other.id) for lost, other in table.settled.clashes] == [("Gesture: Nod", "photo")]
    told = [label.text() for label in gestured.board.panels["speak"].findChildren(QLabel) if label.isVisible()]
    assert any("the gesture “Nod” has no key" in text for text in told)


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        (
            "  - {title: A, does: nod, key: Ctrl+G}\n  - {title: B, does: look, key: Ctrl+G}\n",
            "to the gesture 'A'",
        ),
        ("  - {title: A, does: nod}\n  - {title: B, does: look, key: Ctrl+4}\n", "'A' by its position"),
        ("  - {title: A, does: nod, key: Ctrl+H}\n", "already assigned to a phrase"),
        ("  - {title: A, does: nod, key: Ctrl+C}\n", "key"),
        ("  - {title: A, does: nod, key: G}\n", "key"),
    ],
)
def test_a_key_that_two_would_have_is_refused_with_its_line(lines: str, told: str) -> None:
    text = "version: 1\ntitle: Visit\nlayout: {panel: speak}\nphrases:\n  - {say: Hello, key: Ctrl+H}\ngestures:\n"
    with pytest.raises(ScenarioError, match=told) as refused:
        parse_scenario(text + lines, path=Path("visit.yaml"))
    assert "line" in str(refused.value)
    fine = "  - {title: A, does: nod, key: Ctrl+4}\n  - {title: B, does: look, key: Ctrl+Shift+W}\n"
    keys = [gesture.key for gesture in parse_scenario(text + fine, path=Path("visit.yaml")).gestures]
    assert keys == ["Ctrl+4", "Ctrl+Shift+W"]


def test_the_addressee_is_looked_at(gestured: MainWindow, console: FakeConsole) -> None:
    state = console.state
    asked = [perform_nth_gesture(console.scenario, state, number) for number in (1, 2, 3, 4)]
    whom = addressee(state)
    bearing = next((row.bearing_rad for row in state.persons.value if row.person_id == whom), None)
    assert asked == [intents.UseControl("wave", True), intents.Nod(), intents.LookAt(bearing or 0.0, 0.0), None]
    state.persons.set(())
    assert perform_nth_gesture(console.scenario, state, 3) == intents.LookAt(0.0, 0.0), "ahead, where nobody is"


def test_impossible_and_forbidden_gestures_are_not_there(gestured: MainWindow, console: FakeConsole) -> None:
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
