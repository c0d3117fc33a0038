"""On-screen stick, with mouse and touch."""

import dataclasses

import pytest
from PySide6.QtCore import QEvent, QPoint, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from caris_desktop.live.gamepad import AT_REST, TeleopCommand
from caris_desktop.robot.profile_model import HeadInterface, MotionLimits, RobotProfile
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.drive_panel import Joystick, stick_command
from caris_desktop.ui.theme import Theme
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole

LEFT = Qt.MouseButton.LeftButton


def test_a_stick_is_proportional_beyond_its_dead_zone() -> None:
    assert stick_command(0.05, 0.05, use="base", sideways=False) == AT_REST
    assert stick_command(0.0, 1.0, use="base", sideways=False) == TeleopCommand(forward=1.0)
    assert stick_command(1.0, 0.0, use="base", sideways=False) == TeleopCommand(turn=-1.0)
    assert stick_command(-1.0, 0.0, use="base", sideways=True) == TeleopCommand(left=1.0)
    assert stick_command(-1.0, -1.0, use="head", sideways=False).pan > 0
    assert stick_command(0.0, -1.0, use="head", sideways=False) == TeleopCommand(tilt=1.0)
    half = stick_command(0.0, 0.54, use="base", sideways=False)
    assert half == TeleopCommand(forward=0.5)


@pytest.fixture
def stick(qtbot: QtBot, theme: Theme) -> Joystick:
    stick = Joystick(theme, use="base")
    qtbot.addWidget(stick)
    stick.resize(200, 200)
    stick.show()
    return stick


@pytest.fixture
def heard(stick: Joystick) -> list[TeleopCommand]:
    wishes: list[TeleopCommand] = []
    stick.moved.connect(wishes.append)
    return wishes


def test_it_springs_back_at_once(stick: Joystick, heard: list[TeleopCommand]) -> None:
    QTest.mousePress(stick, LEFT, pos=QPoint(100, 100))
    assert heard == []
    QTest.mouseMove(stick, QPoint(100, 0))
    assert heard[-1] == TeleopCommand(forward=1.0)
    QTest.mouseMove(stick, QPoint(100, -500))  # it keeps control far outside its edge
    assert heard[-1] == TeleopCommand(forward=1.0)
    QTest.mouseRelease(stick, LEFT, pos=QPoint(100, -500))
    assert heard[-1] == AT_REST


@pytest.mark.parametrize("end", ["hide", "disable", "leave"])
def test_it_ends_when_it_goes_away(stick: Joystick, heard: list[TeleopCommand], end: str) -> None:
    QTest.mousePress(stick, LEFT, pos=QPoint(40, 100))
    assert heard[-1].turn > 0
    if end == "hide":
        stick.hide()
    elif end == "disable":
        stick.setEnabled(False)
    else:
        QApplication.sendEvent(stick, QEvent(QEvent.Type.Leave))
    assert heard[-1] == AT_REST
    count = len(heard)
    if stick.isEnabled():
        QTest.mouseMove(stick, QPoint(30, 100))
    assert len(heard) == count


def test_the_ring_moves_sideways_where_the_base_can(stick: Joystick, heard: list[TeleopCommand]) -> None:
    QTest.mousePress(stick, LEFT, pos=QPoint(6, 100))
    assert heard[-1].turn > 0
    QTest.mouseRelease(stick, LEFT)
    stick.set_sideways(True)
    QTest.mousePress(stick, LEFT, pos=QPoint(6, 100))
    assert heard[-1] == TeleopCommand(left=1.0)
    QTest.mouseRelease(stick, LEFT)
    QTest.mousePress(stick, LEFT, Qt.KeyboardModifier.ShiftModifier, QPoint(150, 100))
    assert heard[-1].left < 0
    QTest.mouseRelease(stick, LEFT)
    QTest.mousePress(stick, LEFT, pos=QPoint(150, 100))
    assert heard[-1].turn < 0


def test_a_finger_drives_and_a_second_one_does_not_take_over(stick: Joystick, heard: list[TeleopCommand]) -> None:
    screen = QTest.createTouchDevice()
    top, bottom, middle = QPoint(100, 10), QPoint(100, 190), QPoint(100, 100)
    QTest.touchEvent(stick, screen).press(1, middle, stick).commit()
    QTest.touchEvent(stick, screen).move(1, top, stick).commit()
    assert heard[-1].forward > 0.9
    QTest.touchEvent(stick, screen).stationary(1).press(2, bottom, stick).commit()
    QTest.touchEvent(stick, screen).stationary(1).move(2, bottom + QPoint(5, 0), stick).commit()
    assert heard[-1].forward > 0.9
    QTest.touchEvent(stick, screen).release(1, top, stick).stationary(2).commit()
    assert heard[-1] == AT_REST
    QTest.touchEvent(stick, screen).release(2, bottom, stick).commit()
    QTest.touchEvent(stick, screen).press(3, top, stick).commit()
    assert heard[-1].forward > 0.5
    stick.hide()
    assert heard[-1] == AT_REST


def test_the_sticks_of_the_drive_panel_move_base_and_head(window: MainWindow, console: FakeConsole) -> None:
    window.resize(1920, 1000)
    console.state.robot.set(
        RobotProfile(
            "x", "X", limits=MotionLimits(left_mps=0.3), head=HeadInterface("joint_trajectory", "/h", "a", "b")
        )
    )
    window.dock_host.show_panel("drive")
    panel = window.panels["drive"]
    panel.resize(900, 300)
    for name, expected in (("drive_stick", "drive"), ("head_stick", "turn_head")):
        stick = panel.findChild(Joystick, name)
        assert stick is not None
        assert stick.isVisible()
        console.calls.clear()
        QTest.mousePress(stick, LEFT, pos=stick.rect().center())
        QTest.mouseMove(stick, stick.rect().center() - QPoint(0, 200))
        QTest.mouseRelease(stick, LEFT)
        assert console.calls[0][0] == expected
    assert console.calls == [("turn_head", (0.0, -1.0)), ("turn_head", (0.0, 0.0))]


def test_without_room_a_button_changes_between_arrows_and_stick(window: MainWindow) -> None:
    window.dock_host.show_panel("drive")
    panel = window.panels["drive"]
    panel.resize(300, 240)
    pad, stick = panel.findChild(object, "drive_pad"), panel.findChild(object, "drive_stick")
    other = window.findChild(object, "drive_other_view")
    assert (pad.isVisible(), stick.isVisible(), other.isVisible()) == (True, False, True)
    other.click()
    assert (pad.isVisible(), stick.isVisible()) == (False, True)
    panel.resize(700, 240)
    assert (pad.isVisible(), stick.isVisible(), other.isVisible()) == (True, True, False)


@pytest.mark.long
def test_the_guard_is_on_show_and_can_be_switched(window: MainWindow, console: FakeConsole, qtbot: QtBot) -> None:
    window.dock_host.show_panel("drive")
    button, reason = find(window, "drive_panel").findChild(object, "guard_button"), find(window, "drive_reason")
    assert not button.isVisible(), "this robot has none"
    drive = dataclasses.replace(console.state.drive.value, guard="slowing", guard_distance_m=0.42)
    console.state.drive.set(drive)
    assert reason.property("text") == "Obstacle 0.4 m away · slowing"
    console.state.drive.set(dataclasses.replace(drive, guard="blocked", guard_distance_m=0.1))
    assert reason.property("text") == "Blocked · obstacle 0.1 m away"
    assert button.text() == "Guard"
    qtbot.mouseClick(button, LEFT)
    assert console.calls == [], "one click is a slip"
    assert reason.property("text") == "Blocked · obstacle 0.1 m away", "what the guard does comes first"
    console.state.drive.set(dataclasses.replace(drive, guard="clear"))
    assert reason.property("text") == "Hold Guard for one second to turn it off."
    qtbot.mousePress(button, LEFT)
    QTest.keyClick(button, Qt.Key.Key_Escape)
    assert not button.holding
    assert console.calls == [("stop", None)], "Esc gives it up"
    qtbot.mouseRelease(button, LEFT)
    qtbot.mousePress(button, LEFT)
    qtbot.waitUntil(lambda: console.named("set_guard") == [False])
    qtbot.mouseMove(button)
    qtbot.mouseRelease(button, LEFT)
    assert console.named("set_guard") == [False], "letting go is no click"
    assert (button.text(), button.accessibleName()) == ("Guard off", "Guard is off")
    assert window.panels["drive"].fact == ("guard off", "amber")
    qtbot.mouseClick(button, LEFT)
    assert console.calls[-1] == ("set_guard", True)


def test_the_guard_is_labelled_also_where_the_panel_is_low(window: MainWindow, console: FakeConsole) -> None:
    window.dock_host.show_panel("drive")
    panel = window.panels["drive"]
    console.state.drive.set(dataclasses.replace(console.state.drive.value, guard="overridden"))
    panel.resize(480, 130)
    button = find(window, "guard_button")
    assert button.property("text") == "Guard off"
    assert button.width() >= button.sizeHint().width()
    steps = find(window, "speed_steps")
    assert not steps.geometry().intersects(button.geometry())
    assert steps.parentWidget().rect().contains(button.geometry())  # type: ignore[union-attr]
