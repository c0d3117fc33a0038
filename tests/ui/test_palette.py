"""Find anything: what is in it, and what it never does by a guess or a slip."""

import dataclasses

import pytest
from PySide6.QtCore import QEvent, QPoint, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QWidget

from caris_desktop.domain.controls import CallService, RobotControl
from caris_desktop.live.status import LiveRobotsStatus, RecordingStatus
from caris_desktop.ui.actions import go_to_nth_place
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.overlays import CommandPalette, Entry, matching
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole
from tests.ui.fake_replay import FakeReplay

RELEASE = "Release emergency stop"


def palette_of(window: MainWindow, typed: str = "") -> CommandPalette:
    """Open, with something typed."""
    window.show_command_palette()
    palette = window.findChild(CommandPalette)
    assert palette is not None
    QTest.keyClicks(palette.field, typed)
    return palette


def texts(palette: CommandPalette) -> list[str]:
    return [entry.text for entry in palette.list.entries]


@pytest.mark.parametrize("typed", ["release", "pleese", "navigate to the kichen", "go to the recepshun", "helo"])
def test_a_guess_never_speaks_or_moves(window: MainWindow, console: FakeConsole, typed: str) -> None:
    palette = palette_of(window, typed)
    assert not [entry.text for entry in palette.list.entries if entry.acts]
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    assert console.named("say") == []
    assert console.named("go_to_place") == []


def test_whatever_speaks_or_moves_is_found_by_its_own_words_only(window: MainWindow, console: FakeConsole) -> None:
    call = CallService("/do", "std_srvs/Trigger", {})
    console.state.controls.set((RobotControl("wave", "Wave", "button", call),))
    acting = {entry.text for entry in window.palette_entries() if entry.acts}
    assert {"Please follow me.", "Hmm, good question.", "Go to Kitchen", "Robot: Wave"} <= acting
    for entry in window.palette_entries():
        before = list(console.calls)
        if entry.acts or entry.text in (RELEASE, "Start recording", "All shortcuts"):
            continue
        entry.do()
        moved = [name for name, _ in console.calls[len(before) :] if name in ("say", "go_to_place", "use_control")]
        assert moved == [], f"{entry.text} says or moves something and can be found by a guess"
        window.hold.escape_pressed.emit()


def test_other_things_are_still_found_where_they_are_misspelt(window: MainWindow) -> None:
    assert texts(palette_of(window, "diagnotics")) == ["Diagnostics"]
    guess = Entry("Kitchen", "Panel", "", "", lambda: None)
    assert matching([guess], "kichen") == [guess]
    assert matching([dataclasses.replace(guess, acts=True)], "kichen") == []
    assert matching([dataclasses.replace(guess, acts=True)], "kitch")


def test_the_release_stands_first_and_is_never_chosen_beforehand(window: MainWindow, console: FakeConsole) -> None:
    assert RELEASE not in texts(palette_of(window))
    window.hold.escape_pressed.emit()
    console.emergency_stop()
    for typed in ("", "release", "emergency stop", "rel"):
        palette = palette_of(window, typed)
        assert texts(palette)[0] == RELEASE, typed
        assert palette.list.current is None, typed
        for _ in range(3):
            QTest.keyClick(palette.field, Qt.Key.Key_Return)
        assert palette.isVisible(), "Enter alone does nothing"
        assert console.state.drive.value.emergency_stop
        window.hold.escape_pressed.emit()


def test_the_release_wants_to_be_chosen_and_enter_twice(window: MainWindow, console: FakeConsole) -> None:
    console.emergency_stop()
    palette = palette_of(window, "release")
    QTest.keyClick(palette.field, Qt.Key.Key_Down)
    assert palette.list.current is not None
    QTest.keyPress(palette.field, Qt.Key.Key_Return)
    for _ in range(5):  # held: some systems tell it as presses
        QApplication.sendEvent(
            palette.field, QKeyEvent(QEvent.Type.KeyPress, Qt.Key.Key_Return, Qt.KeyboardModifier.NoModifier)
        )
    assert console.state.drive.value.emergency_stop
    QTest.keyRelease(palette.field, Qt.Key.Key_Return)
    # Whatever comes between takes it back.
    QTest.keyClick(palette.field, Qt.Key.Key_Backspace)
    QTest.keyClick(palette.field, Qt.Key.Key_Down)
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    assert console.state.drive.value.emergency_stop
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    assert not console.state.drive.value.emergency_stop
    assert not palette.isVisible()


def test_a_double_click_is_one_act(window: MainWindow, console: FakeConsole) -> None:
    console.emergency_stop()
    palette = palette_of(window, "release")
    first = QPoint(60, 20)
    QTest.mouseClick(palette.list, Qt.MouseButton.LeftButton, pos=first)
    QTest.mouseDClick(palette.list, Qt.MouseButton.LeftButton, pos=first)
    QTest.mouseRelease(palette.list, Qt.MouseButton.LeftButton, pos=first)
    assert console.state.drive.value.emergency_stop
    assert palette.isVisible()
    QTest.mouseClick(palette.list, Qt.MouseButton.LeftButton, pos=first)
    assert not console.state.drive.value.emergency_stop


def test_a_stop_while_the_palette_is_open_shows_in_it(window: MainWindow, console: FakeConsole) -> None:
    palette = palette_of(window)
    assert RELEASE not in texts(palette)
    console.emergency_stop()
    assert texts(palette)[0] == RELEASE
    assert palette.list.current is None
    console.clear_emergency_stop()
    assert RELEASE not in texts(palette)


def test_everything_that_can_be_done_now_is_in_it_and_nothing_else(window: MainWindow, console: FakeConsole) -> None:
    state = console.state
    state.goal.set(None)
    state.recording.set(RecordingStatus())
    shown = {entry.text for entry in window.palette_entries()}
    assert not {text for text in shown if text.startswith(("Mark", "Write a note", "Wizard error"))}, "nothing records"
    assert "Start recording" in shown
    console.go_to_place("Kitchen")
    state.recording.set(RecordingStatus("recording"))
    state.cameras.set(("front", "rear"))
    state.camera.set("front")
    drive = state.drive.value
    state.drive.set(dataclasses.replace(drive, guard="clear", emergency_stop=True))
    shown = {entry.text for entry in window.palette_entries()}
    for spec in window.actions_table.specs:
        if spec.runs and spec.intent is not go_to_nth_place and spec.id != "find":
            assert (spec.text in shown) == window.actions_table.available(spec.id), spec.text
    assert shown >= {
        RELEASE, "Stop going to Kitchen", "Show the camera rear", "Put the panels back", "Save this panel layout",
        "Pause recording", "Stop recording", "Switch the obstacle guard off", "Close Map",
    }  # fmt: skip
    assert "Show the camera front" not in shown
    for text in ("Stop going to Kitchen", "Show the camera rear"):
        next(entry for entry in window.palette_entries() if entry.text == text).do()
    assert console.named("cancel_goal") == [None]
    assert state.camera.value == "rear"
    off = next(entry for entry in window.palette_entries() if entry.text == "Switch the obstacle guard off")
    assert off.deliberate, "as the button, which has to be held"


def test_a_replay_finds_what_a_replay_can_do(window: MainWindow, console: FakeConsole) -> None:
    replay = FakeReplay()
    window.use_replay(replay)
    console.emergency_stop()  # as the record says
    entries = window.palette_entries()
    assert not [entry.text for entry in entries if entry.acts or entry.deliberate]
    shown = {entry.text for entry in entries}
    assert {"Play or pause", "Map"} <= shown
    assert not {"Stop the robot", "Emergency stop", "Silence"} & shown, "there is no robot"
    replay.live_robots.set(LiveRobotsStatus(("Simulated robot",)))
    assert {"Stop the robot", "Emergency stop"} <= {entry.text for entry in window.palette_entries()}
    assert not {text for text in shown if "record" in text or text.startswith(("Open scenario", "Save", "Connect to"))}


def test_the_palette_lies_below_the_red_button(window: MainWindow, console: FakeConsole) -> None:
    console.emergency_stop()
    palette = palette_of(window)
    button = find(window, "emergency_stop")
    place = button.mapTo(window, QPoint()) + QPoint(button.width() // 2, button.height() // 2)
    assert window.childAt(place) is button
    assert isinstance(palette, QWidget)
