"""Quit guard: no closing while Alt drives, and a question before something ends."""

import pytest
from PySide6.QtCore import QEvent, Qt
from PySide6.QtGui import QCloseEvent, QKeyEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.live.gamepad import AT_REST, TeleopCommand
from caris_desktop.live.status import DriveStatus, RecordingStatus
from caris_desktop.ui.main_window import MainWindow
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("video", "speak", "drive")

ALT = Qt.KeyboardModifier.AltModifier


class AskedByTheWindowManager(QCloseEvent):
    """Close event of a window's button or of Alt+F4."""

    def spontaneous(self) -> bool:
        return True


def refused(window: MainWindow, part: QWidget | None = None) -> bool:
    """True if the event filter blocks the close event of the window or of a floating part."""
    return window.hold.eventFilter(part or window, AskedByTheWindowManager())


def ask_to_close(window: MainWindow) -> bool:
    """True if the window closes."""
    event = AskedByTheWindowManager()
    if not window.hold.eventFilter(window, event):
        window.closeEvent(event)
    return event.isAccepted()


@pytest.fixture
def quiet(window: MainWindow, console: FakeConsole) -> MainWindow:
    """Without a recording, with the robot standing."""
    console.state.goal.set(None)
    console.state.recording.set(RecordingStatus())
    console.state.drive.set(DriveStatus(allowed=True, reason=""))
    return window


def test_at_rest_the_window_closes_at_once(quiet: MainWindow) -> None:
    assert ask_to_close(quiet)


def test_nothing_closes_while_something_drives(quiet: MainWindow, console: FakeConsole) -> None:
    view, field = find(quiet, "video_view"), find(quiet, "speak_field")
    view.setFocus()
    QTest.keyPress(view, Qt.Key.Key_W)
    assert not ask_to_close(quiet)
    assert refused(quiet, quiet.dock_host.docks["drive"])
    assert quiet.hold.held == {"drive_forward"}, "and driving goes on"
    assert find(quiet, "problem_cards").isVisible(), "it is told why"
    QTest.keyRelease(view, Qt.Key.Key_W)
    field.setFocus()
    QTest.keyPress(field, Qt.Key.Key_W, ALT)
    assert not ask_to_close(quiet)
    # The end of the drive does not release the keys.
    quiet.hold.release_all("The window manager took over the keyboard")
    assert not ask_to_close(quiet)
    QTest.keyRelease(field, Qt.Key.Key_W, ALT)
    QTest.keyRelease(field, Qt.Key.Key_Alt)
    quiet.hold.motion.push_gamepad(TeleopCommand(forward=0.5))
    assert not ask_to_close(quiet)
    quiet.hold.motion.push_gamepad(AT_REST)
    assert ask_to_close(quiet)


def test_alt_between_two_drive_keys_is_still_alt_to_drive(quiet: MainWindow, monkeypatch: pytest.MonkeyPatch) -> None:
    field = find(quiet, "speak_field")
    field.setFocus()
    monkeypatch.setattr(QApplication, "queryKeyboardModifiers", lambda: ALT)
    QTest.keyPress(field, Qt.Key.Key_Alt, ALT)
    assert not refused(quiet), "Alt+F4 closes where nobody drives"
    QTest.keyPress(field, Qt.Key.Key_W, ALT)
    # QTest would release Alt with it.
    QApplication.sendEvent(field, QKeyEvent(QEvent.Type.KeyRelease, Qt.Key.Key_W, ALT))
    assert quiet.hold.held == frozenset()
    assert refused(quiet)
    QTest.keyRelease(field, Qt.Key.Key_Alt)
    assert not refused(quiet)


def test_phrases_are_spoken_while_alt_drives(quiet: MainWindow, console: FakeConsole) -> None:
    field = find(quiet, "speak_field")
    field.setFocus()
    QTest.keyClick(field, Qt.Key.Key_F4, ALT)
    assert console.named("say") == [], "Alt alone makes another key of it"
    QTest.keyPress(field, Qt.Key.Key_W, ALT)
    QTest.keyClick(field, Qt.Key.Key_F4, ALT)
    QTest.keyClick(field, Qt.Key.Key_F12, ALT)
    assert [origin for _text, origin in console.named("say")] == ["phrase"]
    assert console.named("silence") == [None]
    assert quiet.hold.held == {"drive_forward"}
    QTest.keyRelease(field, Qt.Key.Key_W, ALT)


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ("recording", "The recording will stop and be saved."),
        ("paused", "The recording will stop and be saved."),
        ("", ""),
    ],
)
def test_closing_asks_while_recording_or_moving(
    qtbot: QtBot, window: MainWindow, console: FakeConsole, state: str, words: str
) -> None:
    if state:
        console.state.goal.set(None)
        console.state.recording.set(RecordingStatus(state))  # type: ignore[arg-type]
    else:
        console.state.recording.set(RecordingStatus())
        console.go_to_place("Kitchen")
        words = "on its way to Kitchen and will stop."
    assert not ask_to_close(window)
    band = find(window, "question_band")
    assert words in band.accessibleName()
    assert QApplication.activeModalWidget() is None, "a dialog would keep keys from the robot"
    click(qtbot, find(window, "question_no"))
    assert not band.isVisible()
    assert not ask_to_close(window)
    with qtbot.waitSignal(window.closed):
        click(qtbot, find(window, "question_yes"))


def test_escape_stops_the_robot_while_the_question_is_open(window: MainWindow, console: FakeConsole) -> None:
    view = find(window, "video_view")
    view.setFocus()
    assert not ask_to_close(window)
    console.calls.clear()
    QTest.keyPress(view, Qt.Key.Key_W)
    assert len(console.named("drive")) == 1, "the question takes no key"
    QTest.keyClick(view, Qt.Key.Key_Escape)
    assert console.calls[-1] == ("stop", None)
    assert window.findChild(QWidget, "question_band").isHidden()  # type: ignore[union-attr]
    QTest.keyRelease(view, Qt.Key.Key_W)
    assert window.isVisible()


def test_work_begun_after_the_question_is_asked_about_too(
    qtbot: QtBot, quiet: MainWindow, console: FakeConsole
) -> None:
    console.go_to_place("Kitchen")
    assert not ask_to_close(quiet)
    console.state.recording.set(RecordingStatus("recording"))
    click(qtbot, find(quiet, "question_yes"))
    assert quiet.isVisible()
    assert "The recording will stop" in find(quiet, "question_band").accessibleName()
    console.state.goal.set(None)
    with qtbot.waitSignal(quiet.closed):
        click(qtbot, find(quiet, "question_yes"))


def test_the_question_is_seen_over_the_palette(window: MainWindow) -> None:
    window.show_command_palette()
    assert not ask_to_close(window)
    assert window.findChild(QWidget, "command_palette").isHidden()  # type: ignore[union-attr]


def test_the_program_itself_closes_without_asking(qtbot: QtBot, window: MainWindow) -> None:
    with qtbot.waitSignal(window.closed):
        window.close()
