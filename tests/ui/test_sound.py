"""Sound in the window: open microphones are visible, and push-to-talk lasts until its key is released."""

import dataclasses

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QDialog, QMenu, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.live.gamepad import Gamepads
from caris_desktop.live.status import MicrophoneStatus, SoundStatus
from caris_desktop.scenario.scenario_model import Permissions, SoundSettings
from caris_desktop.ui.input.drive_input_filter import HELD_TO_TALK_MS
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.menus import add_sound_menus
from caris_desktop.ui.speak.speak_field import SpeakField
from caris_desktop.ui.theme import Theme, icon_names
from tests.ui import samples
from tests.ui.conftest import MemorySettings, find, open_window
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("drive")

CTRL, SHIFT, ALT = (
    Qt.KeyboardModifier.ControlModifier,
    Qt.KeyboardModifier.ShiftModifier,
    Qt.KeyboardModifier.AltModifier,
)
PARTICIPANT = MicrophoneStatus("on", "Desk", source="microphone")
WIZARD = MicrophoneStatus("on", "Headset", role="wizard", source="wizard microphone")
TALKS = dataclasses.replace(
    samples.TOUR,
    permissions=dataclasses.replace(samples.TOUR.permissions, own_voice=True, transcription=True),
    sound=SoundSettings(hear=True),
)


@pytest.fixture
def console() -> FakeConsole:
    return FakeConsole(TALKS)


@pytest.fixture
def window(qtbot: QtBot, console: FakeConsole, settings: MemorySettings, theme: Theme) -> MainWindow:
    return open_window(qtbot, console, settings, theme)


@pytest.fixture
def field(window: MainWindow, console: FakeConsole) -> SpeakField:
    found = find(window, "speak_field")
    assert isinstance(found, SpeakField)
    found.setFocus()
    console.calls.clear()
    return found


def talked(console: FakeConsole) -> list[tuple[bool, str]]:
    return console.named("push_to_talk")


def test_an_open_microphone_is_reported_at_once_and_whose_it_is(window: MainWindow, console: FakeConsole) -> None:
    item = window.status_bar.items["microphone"]
    assert item.text == ""
    console.state.microphone.set(PARTICIPANT)
    assert (item.text, item.role) == ("microphone open", "text")
    console.state.sound.set(SoundStatus(talking="robot"))
    console.state.wizard_microphone.set(dataclasses.replace(WIZARD, state="starting"))
    assert (item.text, item.role) == ("your microphone opens…", "amber")
    console.state.wizard_microphone.set(WIZARD)
    assert (item.text, item.role) == ("the participant hears you", "green")
    assert item.toolTip() == "Desk is picking up the participant\nHeadset is picking you up"
    console.state.sound.set(SoundStatus())
    console.state.microphone.set(MicrophoneStatus())
    assert item.text == "your microphone is open", "also while nothing of it goes anywhere"
    console.state.wizard_microphone.set(MicrophoneStatus(role="wizard"))
    console.state.microphone.set(MicrophoneStatus("failed", "Desk", detail="It is unplugged."))
    assert (item.text, item.role) == ("microphone failed", "amber")
    console.state.microphone.set(MicrophoneStatus())
    assert item.text == ""


@pytest.mark.parametrize("name", ["microphone", "microphone-slash"])
def test_there_is_an_icon_of_it(name: str) -> None:
    assert name in icon_names()


def test_holding_the_key_transmits_while_typing_and_driving(console: FakeConsole, field: SpeakField) -> None:
    QTest.keyPress(field, Qt.Key.Key_W, ALT)
    console.calls.clear()
    QTest.keyPress(field, Qt.Key.Key_Space, CTRL | ALT)
    assert talked(console) == [(True, "robot")]
    QTest.keyClicks(field, "ab")
    assert field.toPlainText() == "ab" and console.named("release_drive") == []
    QTest.keyRelease(field, Qt.Key.Key_Space)
    assert talked(console) == [(True, "robot"), (False, "robot")]
    QTest.keyRelease(field, Qt.Key.Key_W)


def test_dictation_has_a_key_of_its_own_and_types_no_space(console: FakeConsole, field: SpeakField) -> None:
    QTest.keyPress(field, Qt.Key.Key_Space, CTRL | SHIFT)
    QTest.keyRelease(field, Qt.Key.Key_Space, CTRL | SHIFT)
    assert talked(console) == [(True, "dictation"), (False, "dictation")]
    assert field.toPlainText() == ""


@pytest.mark.parametrize(("shift", "to"), [(Qt.KeyboardModifier.NoModifier, "robot"), (SHIFT, "dictation")])
def test_with_focus_on_driving_a_bare_key_talks_once_it_is_held(
    qtbot: QtBot, window: MainWindow, console: FakeConsole, shift: Qt.KeyboardModifier, to: str
) -> None:
    view = find(window, "video_view")
    view.setFocus()
    QTest.keyPress(view, Qt.Key.Key_T, shift)
    QTest.keyRelease(view, Qt.Key.Key_T, shift)
    qtbot.wait(HELD_TO_TALK_MS + 100)
    assert talked(console) == [], "a tap opens no microphone"
    QTest.keyPress(view, Qt.Key.Key_T, shift)
    assert talked(console) == []
    qtbot.waitUntil(lambda: talked(console) == [(True, to)])
    QTest.keyRelease(view, Qt.Key.Key_T, shift)
    assert talked(console) == [(True, to), (False, to)]


def test_a_dialog_ends_it_until_the_key_is_pressed_again(
    qtbot: QtBot, window: MainWindow, console: FakeConsole, field: SpeakField
) -> None:
    QTest.keyPress(field, Qt.Key.Key_Space, CTRL)
    dialog = QDialog(window)
    dialog.setModal(True)
    dialog.show()
    qtbot.waitUntil(lambda: talked(console) == [(True, "robot"), (False, "robot")])
    dialog.close()
    QTest.keyRelease(field, Qt.Key.Key_Space, CTRL)
    assert len(talked(console)) == 2


def test_the_window_that_closes_and_a_scenario_that_changes_end_it(
    window: MainWindow, console: FakeConsole, field: SpeakField
) -> None:
    QTest.keyPress(field, Qt.Key.Key_Space, CTRL)
    window.actions_table.rebuild(samples.TOUR)
    assert talked(console)[-1] == (False, "robot")
    QTest.keyRelease(field, Qt.Key.Key_Space, CTRL)
    QTest.keyPress(field, Qt.Key.Key_Space, CTRL)
    assert len(talked(console)) == 2, "it is not permitted there"


def test_the_button_in_the_speak_panel_is_held_like_the_key(window: MainWindow, console: FakeConsole) -> None:
    button = find(window, "talk_button")
    QTest.mousePress(button, Qt.MouseButton.LeftButton)
    assert talked(console) == [(True, "robot")]
    QTest.mouseRelease(button, Qt.MouseButton.LeftButton)
    assert talked(console)[-1] == (False, "robot")
    QTest.mousePress(button, Qt.MouseButton.LeftButton)
    button.hide()
    assert talked(console)[-1] == (False, "robot"), "what is gone is not held"


def test_a_scenario_without_it_has_no_such_button(qtbot: QtBot, settings: MemorySettings, theme: Theme) -> None:
    console = FakeConsole(samples.TOUR)
    window = open_window(qtbot, console, settings, theme)
    assert not [button for button in window.findChildren(QWidget, "talk_button") if button.isVisible()]


def test_a_button_of_the_gamepad_is_held_as_well(window: MainWindow, console: FakeConsole, field: QWidget) -> None:
    gamepads = Gamepads(console.state, lambda _event: None)
    window.talking.use_gamepads(gamepads)
    gamepads.pressed.emit("push_to_talk")
    gamepads.pressed.emit("mark")
    gamepads.released.emit("mark")
    assert talked(console) == [(True, "robot")]
    gamepads.released.emit("push_to_talk")
    assert talked(console)[-1] == (False, "robot")


def test_hearing_along_is_switched_by_a_key(console: FakeConsole, field: SpeakField) -> None:
    QTest.keyClick(field, Qt.Key.Key_H, CTRL)
    QTest.keyClick(field, Qt.Key.Key_H, CTRL)
    assert console.named("hear_robot") == [(True, 1.0), (False, 1.0)]


def lines(menu: QMenu) -> dict[str, list[str]]:
    """Submenus with their items; the selected one has a star."""
    return {
        action.text(): [f"{'*' if line.isChecked() else ''}{line.text()}" for line in submenu.actions()]
        for action in menu.actions()
        if isinstance(submenu := action.menu(), QMenu)
    }


def test_microphones_and_loudness_are_chosen_in_the_menu(qtbot: QtBot, console: FakeConsole) -> None:
    console.inputs, console.input, console.wizard_input = ("Desk", "Headset"), "Desk", "Gone"
    console.state.sound.set(SoundStatus(hearing=True, volume=0.4))
    menu = QMenu()
    qtbot.addWidget(menu)
    add_sound_menus(console, menu)
    default = "System’s default microphone"
    assert lines(menu) == {
        "Participant’s microphone": ["No microphone", default, "*Desk", "Headset"],
        "Your microphone": ["No microphone", default, "Desk", "Headset", "*Gone"],
        "Hear the robot": ["Off", "100 %", "70 %", "*40 %", "20 %"],
    }
    for action in menu.actions():
        if isinstance(submenu := action.menu(), QMenu):
            submenu.actions()[0].trigger()
    assert console.calls == [
        ("use_microphone", (None, "participant")),
        ("use_microphone", (None, "wizard")),
        ("hear_robot", (False, 0.4)),
    ]
    console.scenario = dataclasses.replace(TALKS, permissions=Permissions(), sound=SoundSettings())
    silent = QMenu()
    qtbot.addWidget(silent)
    add_sound_menus(console, silent)
    assert silent.actions() == []
