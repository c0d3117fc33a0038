"""Hold-to-drive and the stop keys, with real key and mouse events."""

import dataclasses

import pytest
from PySide6.QtCore import QEvent, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLineEdit, QMenu, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.events import DriveEnded
from caris_desktop.live.motion_wish import MotionWish, merged
from caris_desktop.ui.drive_keys import wish_of
from caris_desktop.ui.main_window import MainWindow
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole

ALT = Qt.KeyboardModifier.AltModifier
BARE = Qt.KeyboardModifier.NoModifier


def drives(console: FakeConsole) -> list[tuple[float, float]]:
    """(forward, turn) of each drive call."""
    return [(forward, turn) for forward, _left, turn, _source in console.named("drive")]


def send(
    widget: QWidget,
    kind: QEvent.Type,
    key: Qt.Key,
    modifiers: Qt.KeyboardModifier = BARE,
    *,
    text: str = "",
    repeat: bool = False,
    scan_code: int = 0,
) -> None:
    QApplication.sendEvent(widget, QKeyEvent(kind, key, modifiers, scan_code, 0, 0, text, repeat))


@pytest.fixture
def view(window: MainWindow) -> QWidget:
    view = find(window, "video_view")
    view.setFocus()
    return view


def test_directions_add_up_and_opposites_cancel() -> None:
    assert wish_of(("drive_forward", "turn_left")) == MotionWish(forward=1.0, turn=1.0)
    assert wish_of(("drive_forward", "drive_back", "turn_right")) == MotionWish(turn=-1.0)
    assert wish_of(()) == MotionWish()
    assert merged((MotionWish(forward=1.0), MotionWish(forward=0.5, pan=-0.2))) == MotionWish(forward=1.0, pan=-0.2)


@pytest.mark.parametrize("panel", ["video_view", "map_view", "drive_panel"])
def test_bare_keys_drive_in_the_driving_panels(window: MainWindow, console: FakeConsole, panel: str) -> None:
    widget = find(window, panel)
    widget.setFocus()
    for keys, expected in (
        ((Qt.Key.Key_W, Qt.Key.Key_Up), (1, 0)),
        ((Qt.Key.Key_S, Qt.Key.Key_Down), (-1, 0)),
        ((Qt.Key.Key_A, Qt.Key.Key_Left), (0, 1)),
        ((Qt.Key.Key_D, Qt.Key.Key_Right), (0, -1)),
    ):
        for key in keys:
            console.calls.clear()
            QTest.keyPress(widget, key)
            assert drives(console) == [expected]
            QTest.keyRelease(widget, key)
            assert console.calls[-1] == ("release_drive", "")


def test_each_change_is_one_call(view: QWidget, console: FakeConsole) -> None:
    QTest.keyPress(view, Qt.Key.Key_W)
    for _ in range(5):
        send(view, QEvent.Type.KeyRelease, Qt.Key.Key_W, repeat=True)
        send(view, QEvent.Type.KeyPress, Qt.Key.Key_W, repeat=True, text="w")
    QTest.keyPress(view, Qt.Key.Key_A)
    QTest.keyPress(view, Qt.Key.Key_S)
    QTest.keyRelease(view, Qt.Key.Key_W)
    QTest.keyRelease(view, Qt.Key.Key_A)
    QTest.keyRelease(view, Qt.Key.Key_S)
    assert drives(console) == [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0)]
    assert console.calls[-1] == ("release_drive", "")
    assert len(console.calls) == 6


def test_letters_typed_into_fields_never_drive(window: MainWindow, console: FakeConsole) -> None:
    for name in ("speak_field", "assistant_field"):
        field = find(window, name)
        field.setFocus()
        QTest.keyClicks(field, "wasd we saw a seed")
        QTest.keyClick(field, Qt.Key.Key_Left)
        assert isinstance(field, QLineEdit)
        assert field.text() == "wasd we saw a seed"
    assert console.calls == []


def test_alt_drives_while_typing_and_types_nothing(window: MainWindow, console: FakeConsole) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    QTest.keyClicks(field, "hello")
    send(field, QEvent.Type.KeyPress, Qt.Key.Key_W, ALT, text="w")
    QTest.keyClicks(field, " there")
    # Alt goes up first: W still belongs to driving, its repeats are not typed and its release stops.
    for _ in range(13):
        send(field, QEvent.Type.KeyPress, Qt.Key.Key_W, BARE, text="w", repeat=True)
    assert drives(console) == [(1, 0)]
    send(field, QEvent.Type.KeyRelease, Qt.Key.Key_W, BARE)
    assert console.calls[-1] == ("release_drive", "")
    assert isinstance(field, QLineEdit)
    assert field.text() == "hello there"


def test_a_key_is_known_by_where_it_is(window: MainWindow, view: QWidget, console: FakeConsole) -> None:
    send(view, QEvent.Type.KeyPress, Qt.Key.Key_W, BARE, scan_code=25)
    send(view, QEvent.Type.KeyRelease, Qt.Key.Key_Z, BARE, scan_code=25)
    assert console.calls[-1] == ("release_drive", "")


def test_losing_the_driving_focus_releases(window: MainWindow, view: QWidget, console: FakeConsole) -> None:
    QTest.keyPress(view, Qt.Key.Key_W)
    field = find(window, "speak_field")
    field.setFocus()
    assert console.calls[-1][0] == "release_drive"
    count = len(console.calls)
    # The key is still down: its repeats neither drive nor type.
    send(field, QEvent.Type.KeyPress, Qt.Key.Key_W, text="w", repeat=True)
    send(field, QEvent.Type.KeyRelease, Qt.Key.Key_W)
    assert len(console.calls) == count
    assert isinstance(field, QLineEdit)
    assert field.text() == ""


def test_moving_between_driving_panels_keeps_driving(window: MainWindow, view: QWidget, console: FakeConsole) -> None:
    QTest.keyPress(view, Qt.Key.Key_W)
    find(window, "map_view").setFocus()
    assert console.named("release_drive") == []


def test_a_dialog_releases(window: MainWindow, view: QWidget, console: FakeConsole, qtbot: QtBot) -> None:
    QTest.keyPress(view, Qt.Key.Key_W)
    window.open_start_dialog()
    qtbot.waitUntil(lambda: bool(console.named("release_drive")))
    dialog = find(window, "start_dialog")
    QTest.keyPress(dialog, Qt.Key.Key_S, ALT)
    assert drives(console) == [(1, 0)]
    dialog.close()


def test_a_menu_releases(window: MainWindow, view: QWidget, console: FakeConsole, qtbot: QtBot) -> None:
    QTest.keyPress(view, Qt.Key.Key_W)
    qtbot.mouseClick(find(window, "scenario_button"), Qt.MouseButton.LeftButton)
    assert console.calls[-1] == ("release_drive", "A dialog or menu opened")
    menu = window.findChild(QMenu, "scenario_menu")
    assert menu is not None
    menu.close()


def test_the_window_losing_activation_releases(view: QWidget, console: FakeConsole, qtbot: QtBot) -> None:
    QTest.keyPress(view, Qt.Key.Key_W)
    other = QWidget()
    qtbot.addWidget(other)
    other.show()
    other.activateWindow()
    qtbot.waitUntil(lambda: bool(console.named("release_drive")))


def test_another_program_in_front_releases(
    window: MainWindow, view: QWidget, console: FakeConsole, qapp: QApplication
) -> None:
    QTest.keyPress(view, Qt.Key.Key_W)
    qapp.applicationStateChanged.emit(Qt.ApplicationState.ApplicationInactive)
    assert console.calls[-1] == ("release_drive", "Another program came to the front")


def test_closing_the_window_releases(window: MainWindow, view: QWidget, console: FakeConsole) -> None:
    QTest.keyPress(view, Qt.Key.Key_W)
    window.close()
    assert console.named("release_drive")
    count = len(console.calls)
    QTest.keyPress(view, Qt.Key.Key_A)
    assert len(console.calls) == count


def test_escape_stops_from_anywhere(window: MainWindow, console: FakeConsole, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [100.0]
    monkeypatch.setattr("caris_desktop.ui.drive_keys.time.monotonic", lambda: now_s[0])
    for name in ("video_view", "speak_field", "assistant_answer"):
        widget = find(window, name)
        widget.setFocus()
        for modifiers in (BARE, ALT, Qt.KeyboardModifier.ShiftModifier, Qt.KeyboardModifier.ControlModifier):
            now_s[0] += 1.0
            console.calls.clear()
            QTest.keyClick(widget, Qt.Key.Key_Escape, modifiers)
            assert console.calls == [("stop", None)]


def test_escape_twice_latches_the_emergency_stop(view: QWidget, console: FakeConsole) -> None:
    QTest.keyClick(view, Qt.Key.Key_Escape)
    QTest.keyClick(view, Qt.Key.Key_Escape)
    assert [name for name, _ in console.calls] == ["stop", "emergency_stop"]


def test_slow_escapes_are_two_stops(view: QWidget, console: FakeConsole, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [100.0]
    monkeypatch.setattr("caris_desktop.ui.drive_keys.time.monotonic", lambda: now_s[0])
    QTest.keyClick(view, Qt.Key.Key_Escape)
    now_s[0] += 0.7
    QTest.keyClick(view, Qt.Key.Key_Escape)
    assert [name for name, _ in console.calls] == ["stop", "stop"]


def test_pause_latches_the_emergency_stop(window: MainWindow, console: FakeConsole) -> None:
    QTest.keyClick(find(window, "speak_field"), Qt.Key.Key_Pause)
    assert console.calls == [("emergency_stop", None)]


def test_a_key_held_through_a_stop_does_not_drive_on(view: QWidget, console: FakeConsole) -> None:
    QTest.keyPress(view, Qt.Key.Key_W)
    QTest.keyClick(view, Qt.Key.Key_Escape)
    send(view, QEvent.Type.KeyPress, Qt.Key.Key_W, text="w", repeat=True)
    QTest.keyRelease(view, Qt.Key.Key_W)
    assert console.calls == [("drive", (1.0, 0.0, 0.0, "keyboard")), ("stop", None)]


def test_escape_stops_before_a_dialog_and_a_popup_see_it(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    window.open_start_dialog()
    dialog = find(window, "start_dialog")
    QTest.keyClick(dialog, Qt.Key.Key_Escape)
    assert console.calls == [("stop", None)]
    assert not dialog.isVisible()
    qtbot.mouseClick(find(window, "window_menu_button"), Qt.MouseButton.LeftButton)
    menu = window.findChild(QMenu, "window_menu")
    assert menu is not None
    assert menu.isVisible()
    QTest.keyClick(menu, Qt.Key.Key_Escape)
    assert [name for name, _ in console.calls] in (["stop", "stop"], ["stop", "emergency_stop"])
    assert not menu.isVisible()


def test_what_the_link_ended_needs_a_new_press(view: QWidget, console: FakeConsole) -> None:
    QTest.keyPress(view, Qt.Key.Key_W)
    console.state.take(DriveEnded(clock.now_ns(), "The console stopped answering for a moment"))
    console.calls.clear()
    QTest.keyPress(view, Qt.Key.Key_A)
    QTest.keyRelease(view, Qt.Key.Key_A)
    QTest.keyRelease(view, Qt.Key.Key_W)
    assert drives(console) == [(0, 1)]
    QTest.keyPress(view, Qt.Key.Key_W)
    assert drives(console)[-1] == (1, 0)


def test_a_lost_link_ends_what_is_held(window: MainWindow, view: QWidget, console: FakeConsole) -> None:
    window.dock_host.show_panel("drive")
    arrow = find(window, "hold_turn_left")
    QTest.mousePress(arrow, Qt.MouseButton.LeftButton)
    QTest.keyPress(view, Qt.Key.Key_W)
    connected = console.state.drive.value
    console.state.drive.set(dataclasses.replace(connected, allowed=False, reason="Not connected to the robot"))
    assert console.calls[-1] == ("release_drive", "Not connected to the robot")
    assert window.hold.held == frozenset()
    console.state.drive.set(connected)
    QTest.mouseRelease(arrow, Qt.MouseButton.LeftButton)
    QTest.keyPress(view, Qt.Key.Key_D)
    assert drives(console)[-1] == (0, -1)


def test_a_key_pressed_in_vain_does_not_drive_later(view: QWidget, console: FakeConsole) -> None:
    connected = console.state.drive.value
    console.state.drive.set(dataclasses.replace(connected, allowed=False, reason="Not connected to the robot"))
    QTest.keyPress(view, Qt.Key.Key_W)
    assert drives(console) == []
    console.state.drive.set(connected)
    QTest.keyPress(view, Qt.Key.Key_A)
    assert drives(console) == [(0, 1)]


def test_holding_an_arrow_with_the_mouse_drives(window: MainWindow, console: FakeConsole) -> None:
    window.dock_host.show_panel("drive")
    arrow = find(window, "hold_drive_forward")
    QTest.mousePress(arrow, Qt.MouseButton.LeftButton)
    QTest.mouseRelease(arrow, Qt.MouseButton.LeftButton)
    assert console.calls == [("drive", (1.0, 0.0, 0.0, "onscreen")), ("release_drive", "")]


def test_the_pad_shows_what_is_held(window: MainWindow, view: QWidget) -> None:
    arrow = find(window, "hold_turn_left")
    before = arrow.grab().toImage()
    QTest.keyPress(view, Qt.Key.Key_A)
    assert arrow.grab().toImage() != before
    QTest.keyRelease(view, Qt.Key.Key_A)
    assert arrow.grab().toImage() == before
