"""Gamepad dialog: live values, and each binding changed by pressing the new input."""

from collections.abc import Iterator

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLabel, QSlider, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.live.gamepad import Gamepads, mappings_from_text
from caris_desktop.ui.gamepad_dialog import BindingRow, GamepadDialog
from caris_desktop.ui.main_window import MainWindow
from tests.support.virtual_gamepad import VirtualGamepad
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("drive")


@pytest.fixture
def gamepads(window: MainWindow, console: FakeConsole) -> Iterator[Gamepads]:
    gamepads = Gamepads(console.state, lambda _event: None)
    window.use_gamepads(gamepads)
    gamepads.start()
    yield gamepads
    gamepads.stop()


@pytest.fixture
def pad(qtbot: QtBot, gamepads: Gamepads) -> Iterator[VirtualGamepad]:
    plugged: list[VirtualGamepad] = []

    def plug_in() -> bool:
        try:
            plugged.append(VirtualGamepad())
        except RuntimeError:
            return False  # SDL is still starting
        return True

    qtbot.waitUntil(plug_in)
    qtbot.waitUntil(lambda: gamepads.device is not None and bool(gamepads.sample.raw.axes))
    yield plugged[0]
    plugged[0].unplug()


@pytest.fixture
def dialog(window: MainWindow, gamepads: Gamepads) -> GamepadDialog:
    window.gamepad.open()
    dialog = window.findChild(GamepadDialog)
    assert dialog is not None
    return dialog


def test_escape_closes_it_and_stops(qtbot: QtBot, dialog: GamepadDialog, console: FakeConsole) -> None:
    dialog.activateWindow()
    qtbot.waitUntil(lambda: QApplication.activeWindow() is dialog)
    QTest.keyClick(dialog, Qt.Key.Key_Escape)
    assert console.named("stop") == [None]
    assert not dialog.isVisible()


def row(dialog: QWidget, action: str) -> BindingRow:
    found = dialog.findChild(BindingRow, f"binding_{action}")
    assert found is not None
    return found


def text_of(dialog: QWidget, name: str) -> str:
    label = dialog.findChild(QLabel, name)
    assert label is not None
    return label.text()


def test_it_says_when_there_is_none(dialog: GamepadDialog) -> None:
    assert text_of(dialog, "gamepad_name") == "No gamepad is plugged in"
    assert not row(dialog, "mark").isEnabled()
    assert not dialog.isModal(), "the red button must stay within reach"


def test_the_device_is_on_show_live(
    qtbot: QtBot, pad: VirtualGamepad, dialog: GamepadDialog, gamepads: Gamepads
) -> None:
    assert text_of(dialog, "gamepad_name") == "Virtual Controller"
    assert row(dialog, "stop").bound_text == "B"
    assert row(dialog, "left").bound_text == "Left shoulder or Right shoulder"
    view = find(dialog, "gamepad_view")
    before = view.grab().toImage()
    pad.press(2)
    qtbot.waitUntil(lambda: gamepads.sample.raw.buttons[2])
    assert view.grab().toImage() != before


def test_a_button_is_learned_by_pressing_it(
    qtbot: QtBot, pad: VirtualGamepad, dialog: GamepadDialog, gamepads: Gamepads, console: FakeConsole
) -> None:
    kept: list[str] = []
    gamepads.mappings_changed.connect(kept.append)
    click(qtbot, row(dialog, "mark").change)
    assert text_of(dialog, "gamepad_hint") == "Mark: press a button to assign it."
    console.calls.clear()
    pad.press(3)
    qtbot.waitUntil(lambda: dialog.learned_action == "")
    assert row(dialog, "mark").bound_text == "Y"
    assert row(dialog, "photo").bound_text == "none", "one button, one meaning"
    assert console.calls == [], "a button that is being learned does nothing"
    pad.release(3)
    assert gamepads.device is not None
    assert mappings_from_text(kept[-1])[gamepads.device.device].bound("mark") == "b3"
    click(qtbot, find(dialog, "gamepad_reset"))
    assert row(dialog, "photo").bound_text == "Y"


def test_a_stick_is_learned_in_the_direction_it_is_pushed(
    qtbot: QtBot, pad: VirtualGamepad, dialog: GamepadDialog, gamepads: Gamepads
) -> None:
    # A stick reports values before its end position; a first report at the end is a trigger at rest.
    pad.push(2, 0.2)
    qtbot.waitUntil(lambda: (gamepads.sample.raw.axes[2] or 0.0) > 0.1)
    pad.push(2, 0.0)
    qtbot.waitUntil(lambda: abs(gamepads.sample.raw.axes[2] or 0.0) < 0.1)
    click(qtbot, row(dialog, "turn").change)
    pad.push(2, -1.0)
    qtbot.waitUntil(lambda: dialog.learned_action == "")
    assert gamepads.mapping.bound("turn") == "a2~"
    pad.push(2, 0.0)
    qtbot.waitUntil(lambda: abs(gamepads.sample.raw.axes[2]) < 0.1)
    click(qtbot, row(dialog, "left").change)
    pad.press(0)
    qtbot.waitUntil(lambda: "opposite direction" in text_of(dialog, "gamepad_hint"))
    pad.release(0)
    qtbot.waitUntil(lambda: not gamepads.sample.raw.buttons[0])
    pad.press(1)
    qtbot.waitUntil(lambda: dialog.learned_action == "")
    assert gamepads.mapping.bound("left") == "b0|b1"
    click(qtbot, row(dialog, "boost").change)
    pad.push(4, 1.0)
    qtbot.waitUntil(lambda: dialog.learned_action == "")
    assert gamepads.mapping.bound("boost") == "a4"


def test_the_sliders_set_dead_zone_and_speed(pad: VirtualGamepad, dialog: GamepadDialog, gamepads: Gamepads) -> None:
    for name, value in (("gamepad_dead_zone", 25), ("gamepad_speed", 80)):
        slider = dialog.findChild(QSlider, name)
        assert slider is not None
        slider.setValue(value)
    assert (gamepads.mapping.dead_zone, gamepads.mapping.speed) == (0.25, 0.8)


def test_closing_it_ends_the_learning(
    qtbot: QtBot, pad: VirtualGamepad, dialog: GamepadDialog, gamepads: Gamepads
) -> None:
    click(qtbot, row(dialog, "mark").change)
    dialog.close()
    mapping = gamepads.mapping
    pad.press(3)
    qtbot.waitUntil(lambda: gamepads.sample.raw.buttons[3])
    assert gamepads.mapping == mapping


def test_the_window_menu_opens_it(window: MainWindow, gamepads: Gamepads, qtbot: QtBot) -> None:
    qtbot.mouseClick(find(window, "window_menu_button"), Qt.MouseButton.LeftButton)
    menu = find(window, "window_menu")
    action = next(action for action in menu.actions() if action.text() == "Gamepad…")
    action.trigger()
    menu.close()
    assert window.findChild(GamepadDialog) is not None
