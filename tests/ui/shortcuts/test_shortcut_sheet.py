"""Shortcut sheet: a key changed in place applies everywhere at once."""

import dataclasses
from collections.abc import Iterator

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLabel, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import intents
from caris_desktop.scenario.phrases import Phrase
from caris_desktop.scenario.protocol_steps import Branch, ProtocolSettings, ProtocolStep
from caris_desktop.ui.input.drive_input_filter import _NEVER
from caris_desktop.ui.key_choices import Keys, as_text
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.shortcut_sheet import KeyCell, ShortcutRow, ShortcutSheet
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from tests.ui import samples
from tests.ui.conftest import MemorySettings, click, find, freshen
from tests.ui.fake_console import FakeConsole

Key = Qt.Key
NONE, CTRL, SHIFT, ALT = (
    Qt.KeyboardModifier.NoModifier,
    Qt.KeyboardModifier.ControlModifier,
    Qt.KeyboardModifier.ShiftModifier,
    Qt.KeyboardModifier.AltModifier,
)


def press(key: Qt.Key, modifiers: Qt.KeyboardModifier = NONE) -> None:
    focused = QApplication.focusWidget()
    assert isinstance(focused, QWidget)
    QTest.keyClick(focused, key, modifiers)


SCENARIO = dataclasses.replace(
    samples.TOUR,
    permissions=dataclasses.replace(samples.TOUR.permissions, own_voice=True),
    phrases=(*samples.TOUR.phrases, Phrase("Goodbye.", "Ctrl+6")),
    protocol=ProtocolSettings((ProtocolStep("Greet", branches=(Branch("Cries", "Close"),)), ProtocolStep("Close"))),
)


@pytest.fixture(scope="module")
def shared(theme: Theme) -> Iterator[MainWindow]:
    """One window for all tests of this file."""
    console = FakeConsole(SCENARIO)
    samples.fill_console(console)
    window = MainWindow(console, settings=MemorySettings(), theme=theme)
    window.resize(1366, 768)
    window.show()
    console.state.close()
    yield window
    window.close()
    window.deleteLater()


@pytest.fixture
def window(shared: MainWindow) -> MainWindow:
    return shared


class Desk:
    """The window with the sheet open."""

    def __init__(self, qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
        self.qtbot = qtbot
        self.window = window
        self.console = console
        press(Key.Key_Slash, CTRL)
        sheet = window.findChild(ShortcutSheet)
        assert sheet is not None
        self.sheet = sheet
        qtbot.waitUntil(lambda: sheet.is_built)

    def cell(self, action_id: str, column: str = "keys") -> KeyCell:
        cell = find(self.sheet, f"{action_id}_{column}")
        assert isinstance(cell, KeyCell)
        return cell

    def choose(self, action_id: str, key: Qt.Key, modifiers: Qt.KeyboardModifier = NONE, column: str = "keys") -> None:
        cell = self.cell(action_id, column)
        click(self.qtbot, cell)
        press(key, modifiers)

    @property
    def says(self) -> str:
        label = self.sheet.findChild(QLabel, "shortcut_says")
        assert label is not None
        return label.text()

    @property
    def called(self) -> list[str]:
        return [name for name, _arguments in self.console.calls]


@pytest.fixture
def desk(qtbot: QtBot, window: MainWindow) -> Iterator[Desk]:
    console = window._console
    assert isinstance(console, FakeConsole)
    window.activateWindow()
    qtbot.waitUntil(lambda: QApplication.activeWindow() is window)
    freshen(console)
    find(window, "speak_field").setFocus()
    desk = Desk(qtbot, window, console)
    window.hold._last_escape = _NEVER  # of the test before, with which one more would be the emergency stop
    console.calls.clear()
    yield desk
    desk.sheet.close_overlay()
    window.wizard_keys.reset_all()
    console.clear_emergency_stop()
    console.protocol.begin_session("wizard")  # outside any step
    console.protocol.end_session()
    window.marking.card.close_card()


@pytest.mark.long
def test_a_key_is_changed_and_its_cap_follows_where_it_acts(desk: Desk, window: MainWindow) -> None:
    photo = next(button for button in window.findChildren(ActionButton) if button.text() == "Photo" and button.key)
    assert photo.key in ("Ctrl P", "P")
    click(desk.qtbot, desk.cell("photo"))
    assert "Press the new key for “Photo”" in desk.says
    press(Key.Key_P)
    assert "P types in a text field" in desk.says
    assert desk.sheet.search.text() == "", "and it is typed nowhere"
    press(Key.Key_5, CTRL)
    assert desk.cell("photo").caps == ("Ctrl 5",)
    assert desk.cell("photo").accessibleName() == "Photo, anywhere: Ctrl 5"
    desk.choose("photo", Key.Key_X, column="driving_keys")
    desk.choose("push_to_talk", Key.Key_T, CTRL)
    desk.choose("mark", Key.Key_8, CTRL)
    desk.choose("phrase_1", Key.Key_F11, SHIFT)
    desk.choose("branch", Key.Key_E, CTRL)
    desk.choose("keyed_phrase_1", Key.Key_7, CTRL)
    assert desk.called == [], "while a key is chosen it does nothing"
    press(Key.Key_Escape)
    assert not desk.sheet.isVisible()
    desk.console.calls.clear()
    assert photo.key == "Ctrl 5"
    for key, modifiers in (
        (Key.Key_P, CTRL), (Key.Key_F1, NONE), (Key.Key_6, CTRL), (Key.Key_Space, CTRL), (Key.Key_M, CTRL),
    ):  # fmt: skip
        press(key, modifiers)
    assert desk.called == [], "the former keys do nothing"
    for key, modifiers, call in (
        (Key.Key_5, CTRL, ("take_photo", None)),
        (Key.Key_F11, SHIFT, ("say", (SCENARIO.phrases[0], "phrase"))),
        (Key.Key_7, CTRL, ("say", ("Goodbye.", "phrase"))),
        (Key.Key_8, CTRL, ("mark", ("", "mark"))),
        (Key.Key_T, CTRL, ("push_to_talk", (False, "robot"))),
    ):
        press(key, modifiers)
        assert desk.console.calls[-1] == call
    window.actions_table.run("next_step")
    press(Key.Key_E, CTRL)
    assert desk.console.calls[-1] == ("protocol", intents.TakeBranch("Cries"))
    find(window, "video_view").setFocus(Qt.FocusReason.ShortcutFocusReason)
    assert photo.key == "X"
    desk.console.calls.clear()
    press(Key.Key_X)
    assert desk.called == ["take_photo"]


def test_a_drive_key_is_changed_by_its_place_and_drives_from_then_on(desk: Desk, window: MainWindow) -> None:
    desk.choose("drive_forward", Key.Key_R, column="driving_keys")
    assert desk.cell("drive_forward").caps == ("Alt R", "Alt ↑")
    assert desk.cell("drive_forward", "driving_keys").caps == ("R", "↑")
    press(Key.Key_Escape)
    view = find(window, "video_view")
    view.setFocus(Qt.FocusReason.ShortcutFocusReason)
    desk.console.calls.clear()
    QTest.keyPress(view, Key.Key_W)
    assert "drive" not in desk.called
    QTest.keyRelease(view, Key.Key_W)
    QTest.keyPress(view, Key.Key_R)
    assert desk.called[0] == "drive"
    QTest.keyRelease(view, Key.Key_R)
    assert desk.called[-1] == "release_drive"


@pytest.mark.long
def test_a_key_of_another_act_is_shown_and_can_be_taken_over(desk: Desk, window: MainWindow) -> None:
    desk.choose("photo", Key.Key_M, CTRL)
    assert desk.says == "Ctrl M is already assigned to “Mark”. Reassigning removes it there."
    assert desk.cell("mark").caps == ("Ctrl M",), "nothing has happened yet"
    press(Key.Key_Return)
    assert (desk.cell("photo").caps, desk.cell("mark").caps) == (("Ctrl M",), ())
    desk.choose("mark", Key.Key_P, CTRL)
    assert desk.cell("mark").caps == ("Ctrl P",), "it is free now"
    click(desk.qtbot, find(desk.sheet, "photo_put_back"))
    assert (desk.cell("photo").caps, desk.cell("mark").caps) == (("Ctrl P",), ()), "the usual key comes back to it"
    desk.cell("silence").setFocus()  # by keyboard alone
    press(Key.Key_Space)
    press(Key.Key_9, CTRL)
    assert desk.cell("silence").caps == ("Ctrl 9",)
    click(desk.qtbot, desk.cell("silence"))
    click(desk.qtbot, find(desk.sheet, "shortcut_remove"))
    assert desk.cell("silence").caps == ()
    click(desk.qtbot, find(desk.sheet, "shortcut_reset_all"))
    assert [desk.cell(row).caps for row in ("photo", "mark", "silence")] == [("Ctrl P",), ("Ctrl M",), ("F12",)]
    assert not desk.sheet.findChild(QWidget, "shortcut_reset_all").isVisible()  # type: ignore[union-attr]


def test_escape_stops_the_robot_leaves_the_key_and_then_closes(desk: Desk) -> None:
    assert not desk.cell("stop").isEnabled()
    click(desk.qtbot, desk.cell("photo"))
    press(Key.Key_W, ALT)
    assert "Alt is for driving" in desk.says
    assert "drive" not in desk.called
    press(Key.Key_Escape)
    assert desk.called[-1] == "stop"
    assert desk.sheet.isVisible()
    assert desk.cell("photo").caps == ("Ctrl P",)
    QTest.qWait(0)
    press(Key.Key_Pause)
    assert desk.called[-1] == "emergency_stop"
    press(Key.Key_Escape)
    assert not desk.sheet.isVisible()


def test_acts_and_keys_are_found(desk: Desk) -> None:
    def shown() -> list[str]:
        return [row.spec.id for row in desk.sheet.findChildren(ShortcutRow) if row.isVisible()]

    assert len(shown()) > 50
    QTest.keyClicks(desk.sheet.search, "ctrl+p")
    assert "photo" in shown()
    assert "mark" not in shown()
    desk.sheet.search.setText("wizard err")
    assert shown() == ["wizard_error"]
    desk.sheet.search.setText("no such act")
    assert shown() == []
    assert find(desk.sheet, "shortcut_nothing").isVisible()


def test_a_phrase_whose_key_another_act_has_is_shown(desk: Desk, window: MainWindow) -> None:
    window.wizards.set_value("shortcuts", as_text({"photo": Keys(("Ctrl+6",))}))  # changed with another scenario
    window.wizard_keys.take_up()
    desk.qtbot.waitUntil(lambda: desk.sheet.is_built)
    words = find(desk.sheet, "shortcut_clashes")
    assert (
        words.property("text")
        == "“Goodbye.” is not on Ctrl 6, because “Photo” uses this key. Give one of them another key."
    )
    desk.choose("photo", Key.Key_7, CTRL)
    assert not words.isVisible()
    desk.qtbot.waitUntil(lambda: desk.sheet.is_built)
    assert desk.cell("keyed_phrase_1").caps == ("Ctrl 6",)


def test_a_phrase_that_lost_its_key_is_given_another_one(desk: Desk, window: MainWindow) -> None:
    window.wizards.set_value("shortcuts", as_text({"photo": Keys(("Ctrl+6",))}))  # changed with another scenario
    window.wizard_keys.take_up()
    desk.qtbot.waitUntil(lambda: desk.sheet.is_built)
    assert desk.cell("keyed_phrase_1").caps == ()
    desk.choose("keyed_phrase_1", Key.Key_7, CTRL)
    desk.qtbot.waitUntil(lambda: desk.sheet.is_built)
    assert desk.cell("keyed_phrase_1").caps == ("Ctrl 7",) and desk.cell("photo").caps[0] == "Ctrl 6"
    assert window.actions_table.settled.clashes == ()
