"""Hold-to-drive and the stop keys, with real key and mouse events."""

import dataclasses
import sys

import pytest
from PySide6.QtCore import QEvent, QObject, QPoint, QRect, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QMenu, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.events import DriveEnded
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.live.gamepad import TeleopCommand, merged
from caris_desktop.robot.profile_model import HeadInterface, MotionLimits, RobotProfile
from caris_desktop.scenario.scenario_model import Place
from caris_desktop.ui.action_bindings import cap_text
from caris_desktop.ui.input.teleop_input import command_of
from caris_desktop.ui.key_choices import key_code, position_codes, position_of
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.widgets.buttons import ActionButton
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("video", "speak", "drive")

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


class KeysHeldBack(QObject):
    """Key handling of Qt with a screen reader: each key is intercepted and posted again after the answer.

    This happens at the window, before the focus widget is known.
    """

    def __init__(self, window: QWidget) -> None:
        super().__init__(window)
        self.held: list[tuple[QObject, QKeyEvent]] = []
        app = QApplication.instance()
        assert app is not None
        app.installEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if not isinstance(event, QKeyEvent) or event.type() == QEvent.Type.ShortcutOverride or not event.spontaneous():
            return False
        self.held.append((watched, QKeyEvent(event.type(), event.key(), event.modifiers(), event.text())))
        return True

    def answer(self) -> None:
        for watched, event in self.held:
            QApplication.sendEvent(watched, event)
        self.held.clear()


@pytest.mark.usefixtures("screen_reader")
def test_keys_that_drive_and_stop_do_not_wait_for_a_screen_reader(
    window: MainWindow, view: QWidget, console: FakeConsole
) -> None:
    KeysHeldBack(window)
    QTest.keyPress(view, Qt.Key.Key_W)
    assert drives(console) == [(1, 0)]
    QTest.keyRelease(view, Qt.Key.Key_W)
    assert console.calls[-1] == ("release_drive", "")
    KeysHeldBack(window)
    QTest.keyPress(view, Qt.Key.Key_Escape)
    assert console.named("stop")


@pytest.mark.usefixtures("screen_reader")
def test_a_release_that_waited_for_a_screen_reader_was_the_last_that_did(
    window: MainWindow, view: QWidget, console: FakeConsole
) -> None:
    """The screen reader starts while the key is down, and no press overtakes a release."""
    QTest.keyPress(view, Qt.Key.Key_W)
    QTest.keyPress(view, Qt.Key.Key_A)
    bridge = KeysHeldBack(window)
    QTest.keyRelease(view, Qt.Key.Key_A)
    bridge.answer()
    QTest.keyRelease(view, Qt.Key.Key_W)
    assert console.calls[-1] == ("release_drive", "")


def test_directions_add_up_and_opposites_cancel() -> None:
    assert command_of(("drive_forward", "turn_left")) == TeleopCommand(forward=1.0, turn=1.0)
    assert command_of(("drive_forward", "drive_back", "turn_right")) == TeleopCommand(turn=-1.0)
    assert command_of(()) == TeleopCommand()
    assert merged((TeleopCommand(forward=1.0), TeleopCommand(forward=0.5, pan=-0.2))) == TeleopCommand(
        forward=1.0, pan=-0.2
    )


@pytest.mark.panels()
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


@pytest.mark.panels("video", "speak", "drive", "assistant")
def test_letters_typed_into_fields_never_drive(window: MainWindow, console: FakeConsole) -> None:
    for name in ("speak_field", "assistant_field"):
        field = find(window, name)
        field.setFocus()
        QTest.keyClicks(field, "wasd we saw a seed")
        QTest.keyClick(field, Qt.Key.Key_Left)
        assert field.property("text") == "wasd we saw a seed"
    assert console.calls == []


def test_alt_drives_while_typing_and_types_nothing(window: MainWindow, console: FakeConsole) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    QTest.keyClicks(field, "hello")
    send(field, QEvent.Type.KeyPress, Qt.Key.Key_W, ALT, text="w")
    QTest.keyClicks(field, " there")
    # Alt is released first: W still drives, its repeats type nothing, and its release stops.
    for _ in range(13):
        send(field, QEvent.Type.KeyPress, Qt.Key.Key_W, BARE, text="w", repeat=True)
    assert drives(console) == [(1, 0)]
    send(field, QEvent.Type.KeyRelease, Qt.Key.Key_W, BARE)
    assert console.calls[-1] == ("release_drive", "")
    assert field.property("text") == "hello there"


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
    assert field.property("text") == ""


@pytest.mark.panels()
def test_moving_between_driving_panels_keeps_driving(window: MainWindow, view: QWidget, console: FakeConsole) -> None:
    QTest.keyPress(view, Qt.Key.Key_W)
    find(window, "map_view").setFocus()
    assert console.named("release_drive") == []


def test_a_dialog_releases(window: MainWindow, view: QWidget, console: FakeConsole, qtbot: QtBot) -> None:
    QTest.keyPress(view, Qt.Key.Key_W)
    window.sessions.open_start_dialog()
    qtbot.waitUntil(lambda: bool(console.named("release_drive")))
    dialog = find(window, "start_dialog")
    QTest.keyPress(dialog, Qt.Key.Key_S, ALT)
    assert drives(console) == [(1, 0)]
    dialog.close()


def test_start_recording_leaves_the_red_button_free(window: MainWindow) -> None:
    """At 1366x768 it lay over half of the button, whose copy the dialog owns."""
    window.setGeometry(0, 0, 640, 500)
    window.sessions.open_start_dialog()
    dialog, red = find(window, "start_dialog"), find(window, "emergency_stop")
    assert dialog.windowModality() == Qt.WindowModality.WindowModal
    assert not dialog.geometry().intersects(QRect(red.mapToGlobal(QPoint()), red.size()))
    dialog.close()


def test_a_menu_releases(window: MainWindow, view: QWidget, console: FakeConsole) -> None:
    QTest.keyPress(view, Qt.Key.Key_W)
    window.menus.open_scenario_menu()
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


@pytest.mark.panels("video", "speak", "drive", "assistant")
def test_escape_stops_from_anywhere(window: MainWindow, console: FakeConsole, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [100.0]
    monkeypatch.setattr("caris_desktop.ui.input.drive_input_filter.time.monotonic", lambda: now_s[0])
    for name in ("video_view", "speak_field", "assistant_answer"):
        widget = find(window, name)
        widget.setFocus()
        for modifiers in (BARE, ALT, Qt.KeyboardModifier.ShiftModifier, Qt.KeyboardModifier.ControlModifier):
            now_s[0] += 1.0
            console.calls.clear()
            QTest.keyClick(widget, Qt.Key.Key_Escape, modifiers)
            assert console.calls == [("stop", None)]


def test_escape_twice_latches_the_emergency_stop(
    view: QWidget, console: FakeConsole, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("caris_desktop.ui.input.drive_input_filter.time.monotonic", lambda: 100.0)
    QTest.keyClick(view, Qt.Key.Key_Escape)
    QTest.keyClick(view, Qt.Key.Key_Escape)
    assert [name for name, _ in console.calls] == ["stop", "emergency_stop"]


def test_slow_escapes_are_two_stops(view: QWidget, console: FakeConsole, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [100.0]
    monkeypatch.setattr("caris_desktop.ui.input.drive_input_filter.time.monotonic", lambda: now_s[0])
    QTest.keyClick(view, Qt.Key.Key_Escape)
    now_s[0] += 0.7
    QTest.keyClick(view, Qt.Key.Key_Escape)
    assert [name for name, _ in console.calls] == ["stop", "stop"]


@pytest.mark.parametrize(("apart_ms", "second"), [(600, "emergency_stop"), (700, "stop")])
def test_escapes_are_twice_by_when_they_were_pressed_however_late_they_are_seen(
    view: QWidget, console: FakeConsole, monkeypatch: pytest.MonkeyPatch, apart_ms: int, second: str
) -> None:
    now_s = [100.0]
    monkeypatch.setattr("caris_desktop.ui.input.drive_input_filter.time.monotonic", lambda: now_s[0])
    for pressed_ms in (5000, 5000 + apart_ms):
        press = QKeyEvent(QEvent.Type.KeyPress, Qt.Key.Key_Escape, BARE)
        press.setTimestamp(pressed_ms)
        QApplication.sendEvent(view, press)
        now_s[0] += 3.0
    assert [name for name, _ in console.calls] == ["stop", second]


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
    window.sessions.open_start_dialog()
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


def test_one_escape_closes_a_menu_with_its_submenus_and_the_second_latches_the_emergency_stop(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    qtbot.mouseClick(find(window, "window_menu_button"), Qt.MouseButton.LeftButton)
    menu = window.findChild(QMenu, "window_menu")
    assert menu is not None
    entry = next(action for action in menu.actions() if action.menu() is not None and action.isEnabled())
    menu.setActiveAction(entry)
    below = entry.menu()
    assert isinstance(below, QMenu)
    if not below.isVisible():
        below.popup(menu.mapToGlobal(menu.actionGeometry(entry).topRight()))
    assert QApplication.activePopupWidget() is below
    QTest.keyClick(below, Qt.Key.Key_Escape)
    assert not menu.isVisible() and not below.isVisible() and QApplication.activePopupWidget() is None
    assert console.calls == [("stop", None)]
    QTest.keyClick(window, Qt.Key.Key_Escape)
    assert console.calls[-1] == ("emergency_stop", None)


def test_buttons_with_the_key_esc_say_that_it_also_stops_the_robot(window: MainWindow) -> None:
    window.show_preflight()
    window._alarms.show_alarms()
    keyed = [button for button in window.findChildren(ActionButton) if button.key == "Esc"]
    closing = [button for button in keyed if button.objectName() not in ("stop_button",)]
    assert len(closing) >= 3
    assert {button.toolTip() for button in closing} == {"Esc closes this and stops the robot"}


def test_a_drive_that_the_link_ended_needs_a_new_press(view: QWidget, console: FakeConsole) -> None:
    QTest.keyPress(view, Qt.Key.Key_W)
    console.state.add(DriveEnded(clock.now_ns(), "The console stopped responding for a moment"))
    console.calls.clear()
    QTest.keyPress(view, Qt.Key.Key_A)
    QTest.keyRelease(view, Qt.Key.Key_A)
    QTest.keyRelease(view, Qt.Key.Key_W)
    assert drives(console) == [(0, 1)]
    QTest.keyPress(view, Qt.Key.Key_W)
    assert drives(console)[-1] == (1, 0)


def chips(view: QWidget) -> list[str]:
    return [text for text, _role in view.chips]  # type: ignore[attr-defined]


def test_a_key_that_is_still_down_after_the_end_is_to_be_let_go(
    window: MainWindow, view: QWidget, console: FakeConsole
) -> None:
    reason = find(window, "drive_reason")
    QTest.keyPress(view, Qt.Key.Key_W)
    assert not window.hold.must_let_go
    console.state.add(DriveEnded(clock.now_ns(), "The console stopped responding for a moment"))
    assert window.hold.must_let_go
    assert "Release and press again to drive" in chips(view)
    assert not any("W A S D" in text for text in chips(view))
    assert reason.text() == "Release and press again to drive."  # type: ignore[attr-defined]
    QTest.keyRelease(view, Qt.Key.Key_W)
    assert not window.hold.must_let_go
    assert "Release" not in reason.text()  # type: ignore[attr-defined]
    QTest.keyPress(view, Qt.Key.Key_W)
    assert drives(console)[-1] == (1, 0)
    assert not window.hold.must_let_go


def test_an_arrow_and_a_stick_are_to_be_let_go_too(window: MainWindow, console: FakeConsole) -> None:
    window.hold.motion.hold_onscreen("turn_left")
    window.hold.motion.push_onscreen("base", TeleopCommand(forward=0.5))
    window.hold.motion.push_gamepad(TeleopCommand(forward=0.5))
    console.state.add(DriveEnded(clock.now_ns(), "The console stopped responding for a moment"))
    for let_go in (
        lambda: window.hold.motion.let_go_onscreen("turn_left"),
        lambda: window.hold.motion.push_onscreen("base", TeleopCommand()),
        lambda: window.hold.motion.push_gamepad(TeleopCommand()),
    ):
        assert window.hold.must_let_go
        let_go()
    assert not window.hold.must_let_go


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


# Key positions


def send_at(
    widget: QWidget,
    kind: QEvent.Type,
    scan_code: int,
    key: int,
) -> None:
    """Key event by position; ``key`` is the key of the layout."""
    QApplication.sendEvent(widget, QKeyEvent(kind, key, BARE, scan_code, 0, 0, ""))


@pytest.mark.skipif(sys.platform != "linux", reason="the codes are those of Linux")
@pytest.mark.parametrize(
    ("scan_code", "key", "expected"),
    [
        (25, Qt.Key.Key_Z, (1, 0)),  # AZERTY: Z, Q, S, D
        (38, Qt.Key.Key_Q, (0, 1)),
        (25, Qt.Key.Key_Comma, (1, 0)),  # Dvorak
        (25, 0x426, (1, 0)),  # Russian
    ],
)
def test_a_layout_moves_no_drive_key(
    view: QWidget, console: FakeConsole, scan_code: int, key: int, expected: tuple[float, float]
) -> None:
    send_at(view, QEvent.Type.KeyPress, scan_code, key)
    send_at(view, QEvent.Type.KeyRelease, scan_code, key)
    assert drives(console) == [expected]
    assert console.calls[-1] == ("release_drive", "")


@pytest.mark.skipif(sys.platform != "linux", reason="the codes are those of Linux")
def test_a_letter_elsewhere_is_no_drive_key(window: MainWindow, view: QWidget, console: FakeConsole) -> None:
    send_at(view, QEvent.Type.KeyPress, 52, Qt.Key.Key_W)  # W of AZERTY is in the lowest row
    send_at(view, QEvent.Type.KeyRelease, 52, Qt.Key.Key_W)
    send_at(view, QEvent.Type.KeyPress, 24, Qt.Key.Key_A)  # and its A is at the position of Q: slower
    send_at(view, QEvent.Type.KeyRelease, 24, Qt.Key.Key_A)
    assert console.calls == [("set_speed_fraction", 0.3)]
    assert window.actions_table.key_text("slower") == "A", "the cap shows what is printed on the key"
    send_at(view, QEvent.Type.KeyPress, 11, Qt.Key.Key_Eacute)
    assert console.named("go_to_place") == ["Lab bench"]


def test_the_tables_of_key_codes_agree() -> None:
    tables = [position_codes(platform) for platform in ("linux", "win32", "darwin")]
    assert len({tuple(sorted(table)) for table in tables}) == 1
    assert all(len(set(table.values())) == len(table) for table in tables)
    assert position_codes("plan9") == {}
    assert position_of("linux", 25) == position_of("win32", 17) == position_of("darwin", 13) == "W"
    assert position_of("linux", 111) is None


def test_a_mac_knows_keys_by_their_virtual_code() -> None:
    # Option+W types ∑, and Option+A types å; the virtual code identifies the key. There are no scan codes.
    code = key_code("darwin", scan_code=0, virtual_key=13)
    assert position_of("darwin", code) == "W"
    assert position_of("darwin", key_code("darwin", scan_code=0, virtual_key=0)) == "A"
    assert key_code("linux", scan_code=0, virtual_key=0) is None
    assert cap_text("Alt+W", platform="darwin") == "⌥ W"
    assert cap_text("Ctrl+Shift+M", platform="darwin") == "⇧⌘ M"
    assert cap_text("Alt+W", {"W": "Z"}, platform="linux") == "Alt Z"


# Controls of some robots


HEAD = HeadInterface("joint_trajectory", "/head", "pan", "tilt")


def test_sideways_and_head_keys_need_a_robot_that_can(window: MainWindow, view: QWidget, console: FakeConsole) -> None:
    for key in (Qt.Key.Key_Z, Qt.Key.Key_I, Qt.Key.Key_O):
        QTest.keyClick(view, key)
    assert console.calls == []
    console.state.robot.set(RobotProfile("arm", "Arm", limits=MotionLimits(left_mps=0.3), head=HEAD))
    QTest.keyPress(view, Qt.Key.Key_Z)
    QTest.keyPress(view, Qt.Key.Key_W)
    QTest.keyRelease(view, Qt.Key.Key_W)
    QTest.keyRelease(view, Qt.Key.Key_Z)
    assert [call[:3] for call in console.named("drive")] == [(0, 1, 0), (1, 1, 0), (0, 1, 0)]
    console.calls.clear()
    QTest.keyPress(view, Qt.Key.Key_J)
    QTest.keyPress(view, Qt.Key.Key_K)
    QTest.keyRelease(view, Qt.Key.Key_J)
    QTest.keyRelease(view, Qt.Key.Key_K)
    QTest.keyClick(view, Qt.Key.Key_O)
    assert console.calls == [
        ("turn_head", (1, 0)), ("turn_head", (1, 1)), ("turn_head", (0, 1)), ("turn_head", (0, 0)),
        ("look_at", (0, 0)),
    ]  # fmt: skip


def test_the_head_stops_with_everything_else(window: MainWindow, view: QWidget, console: FakeConsole) -> None:
    console.state.robot.set(RobotProfile("arm", "Arm", head=HEAD))
    for key in (Qt.Key.Key_W, Qt.Key.Key_L):
        QTest.keyPress(view, key)
    console.calls.clear()
    find(window, "speak_field").setFocus()
    assert console.calls == [("release_drive", "The driving panels lost focus"), ("turn_head", (0, 0))]


def test_places_are_one_key_away(window: MainWindow, view: QWidget, console: FakeConsole) -> None:
    QTest.keyClick(view, Qt.Key.Key_2)
    field = find(window, "speak_field")
    field.setFocus()
    QTest.keyClick(field, Qt.Key.Key_1, ALT)
    QTest.keyClick(field, Qt.Key.Key_2)
    QTest.keyClick(field, Qt.Key.Key_9, ALT)  # there are only four
    assert console.named("go_to_place") == ["Lab bench", "Reception"]
    assert field.property("text") == "2"
    console.scenario = dataclasses.replace(
        console.scenario, places=(*console.scenario.places, Place("Stairs", Pose2D(1, 1, 0)))
    )
    console.state.places.set(console.scenario.places)
    console.state.scenario.set(console.scenario)
    QTest.keyClick(field, Qt.Key.Key_5, ALT)
    assert console.named("go_to_place")[-1] == "Stairs"
    assert window.actions_table.spec("place_5") is not None
    assert window.actions_table.spec("place_6") is None


def test_alt_next_to_a_drive_key_types_nothing(window: MainWindow, console: FakeConsole) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    send(field, QEvent.Type.KeyPress, Qt.Key.Key_R, ALT, text="r")
    send(field, QEvent.Type.KeyPress, Qt.Key.Key_R, BARE, text="r", repeat=True)
    send(field, QEvent.Type.KeyRelease, Qt.Key.Key_R)
    assert field.property("text") == ""
    assert console.calls == []


# Several sources at once


def test_sources_add_up_and_the_mover_is_named(window: MainWindow, view: QWidget, console: FakeConsole) -> None:
    hold = window.hold
    hold.motion.push_gamepad(TeleopCommand(forward=0.5))
    QTest.keyPress(view, Qt.Key.Key_A)
    hold.motion.push_onscreen("base", TeleopCommand(forward=0.8))
    QTest.keyRelease(view, Qt.Key.Key_A)
    hold.motion.push_gamepad(TeleopCommand())
    hold.motion.push_onscreen("base", TeleopCommand())
    assert console.calls == [
        ("drive", (0.5, 0, 0, "gamepad")), ("drive", (0.5, 0, 1, "keyboard")), ("drive", (1, 0, 1, "onscreen")),
        ("drive", (1, 0, 0, "gamepad")), ("drive", (0.8, 0, 0, "onscreen")), ("release_drive", ""),
    ]  # fmt: skip


def test_a_stick_that_was_ended_has_to_come_to_rest(window: MainWindow, view: QWidget, console: FakeConsole) -> None:
    hold = window.hold
    for push in (hold.motion.push_gamepad, lambda wish: hold.motion.push_onscreen("base", wish)):
        console.calls.clear()
        push(TeleopCommand(turn=0.4))
        hold.release_all("The window was minimised")
        push(TeleopCommand(turn=0.5))
        assert console.calls[1:] == [("release_drive", "The window was minimised")]
        push(TeleopCommand())
        push(TeleopCommand(turn=0.5))
        assert len(console.named("drive")) == 2
        push(TeleopCommand())


def test_the_holder_of_the_keys_is_displayed(
    window: MainWindow, view: QWidget, console: FakeConsole, qtbot: QtBot
) -> None:
    chip, reason = find(window, "key_owner"), find(window, "drive_reason")
    console.cancel_goal()
    assert (chip.property("text") or chip.accessibleName()) == "Keys drive"
    assert reason.property("text") == "Hold W A S D or arrows"
    find(window, "speak_field").setFocus()
    assert chip.accessibleName() == "You type · Alt drives"
    assert reason.property("text") == "Alt+W A S D while you type"
    find(window, "phrase_1").setFocus()
    assert chip.accessibleName() == "Alt drives"
    window.sessions.open_start_dialog()
    qtbot.waitUntil(lambda: chip.accessibleName() == "No keys: dialog open")
    assert reason.property("text") == "No keys: dialog open"
    find(window, "start_dialog").close()
    window.activateWindow()
    qtbot.waitUntil(lambda: window.hold.key_owner in ("window", "driving", "typing"))
    qtbot.mouseClick(find(window, "window_menu_button"), Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: chip.accessibleName() == "No keys: menu open")
    QApplication.activePopupWidget().close()


@pytest.mark.skipif(sys.platform != "linux", reason="the codes are those of Linux")
def test_a_key_cap_has_what_the_key_types_alone(window: MainWindow, view: QWidget) -> None:
    """AltGr selects another level, not another layout: the Drive panel once showed "Hold Œ A Ś D"."""
    table = window.actions_table
    field = find(window, "speak_field")
    field.setFocus()
    for modifiers, before in (
        (BARE, Qt.Key.Key_AltGr), (Qt.KeyboardModifier.GroupSwitchModifier, None),
        (ALT | Qt.KeyboardModifier.ControlModifier, None), (Qt.KeyboardModifier.ShiftModifier, None),
    ):  # fmt: skip
        if before is not None:
            send(field, QEvent.Type.KeyPress, before)
        for scan_code, key in ((25, 0x152), (39, 0x15A), (24, 0x40)):
            send(field, QEvent.Type.KeyPress, Qt.Key(key), modifiers, text=chr(key), scan_code=scan_code)
            send(field, QEvent.Type.KeyRelease, Qt.Key(key), modifiers, text=chr(key), scan_code=scan_code)
        if before is not None:
            send(field, QEvent.Type.KeyRelease, before)
        assert [table.letter(position) for position in "WSQ"] == ["W", "S", "Q"]
    send_at(view, QEvent.Type.KeyPress, 25, Qt.Key.Key_Z)
    send_at(view, QEvent.Type.KeyRelease, 25, Qt.Key.Key_Z)
    assert table.letter("W") == "Z", "another layout"


CTRL = Qt.KeyboardModifier.ControlModifier


@pytest.mark.skipif(sys.platform != "linux", reason="the codes are those of Linux")
def test_chords_work_by_position_where_the_layout_has_no_latin_letters(
    window: MainWindow, view: QWidget, console: FakeConsole
) -> None:
    def press(scan_code: int, key: int, modifiers: Qt.KeyboardModifier, text: str = "") -> None:
        target = QApplication.focusWidget()
        assert target is not None
        for kind in (QEvent.Type.ShortcutOverride, QEvent.Type.KeyPress, QEvent.Type.KeyRelease):
            send(target, kind, Qt.Key(key), modifiers, text=text, scan_code=scan_code)

    view.setFocus()
    press(46, 0x414, CTRL)  # Ctrl+L: Д
    field = find(window, "speak_field")
    assert field.hasFocus()
    press(38, 0x424, BARE, "ф")
    assert field.property("plainText") == "ф", "letters are typed as they are printed"
    press(38, 0x424, CTRL)  # Ctrl+A and Ctrl+X of the text field
    press(53, 0x427, CTRL)
    assert field.property("plainText") == ""
    press(45, 0x41B, CTRL)  # Ctrl+K: Л
    assert find(window, "command_palette").isVisible()
    QTest.keyClick(find(window, "palette_field"), Qt.Key.Key_Escape)
    console.calls.clear()
    press(58, 0x42C, CTRL)  # Ctrl+M: Ь
    assert console.named("mark") == [("", "mark")]
    view.setFocus()
    press(33, 0x417, BARE, "з")  # P
    assert console.named("take_photo")
    assert not console.named("drive")


@pytest.mark.skipif(sys.platform != "linux", reason="the codes are those of Linux")
def test_ctrl_with_a_digit_key_counts_where_the_layout_types_a_digit_only_with_shift(
    window: MainWindow, console: FakeConsole
) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    refused: list[str] = []
    window.actions_table.not_done.connect(lambda reason, _opens: refused.append(reason))
    for scan_code, key in ((10, Qt.Key.Key_Ampersand), (11, Qt.Key.Key_Eacute), (12, Qt.Key.Key_QuoteDbl)):  # AZERTY
        send(field, QEvent.Type.KeyPress, key, CTRL, scan_code=scan_code)
        send(field, QEvent.Type.KeyRelease, key, CTRL, scan_code=scan_code)
    assert refused == ["This suggestion is not available now."] * 3


@pytest.mark.skipif(sys.platform != "linux", reason="the codes are those of Linux")
def test_a_slash_on_a_digit_key_goes_to_no_place(window: MainWindow, view: QWidget, console: FakeConsole) -> None:
    """On many keyboards the slash, which opens Find anything, is Shift+7."""
    places = tuple(Place(f"Place {number}", Pose2D(1, 1, 0)) for number in range(1, 10))
    console.scenario = dataclasses.replace(console.scenario, places=places)
    console.state.places.set(places)
    console.state.scenario.set(console.scenario)
    shift = Qt.KeyboardModifier.ShiftModifier
    send(view, QEvent.Type.KeyPress, Qt.Key.Key_Slash, shift, text="/", scan_code=16)
    send(view, QEvent.Type.KeyRelease, Qt.Key.Key_Slash, shift, scan_code=16)
    assert not console.named("go_to_place")
    send(view, QEvent.Type.KeyPress, Qt.Key.Key_7, shift, text="7", scan_code=16)  # AZERTY
    assert console.named("go_to_place") == ["Place 7"]


def test_a_key_cap_names_no_key_that_drives_in_this_layout(
    window: MainWindow, view: QWidget, console: FakeConsole
) -> None:
    """On QWERTZ, Y is the key that moves sideways."""
    table = window.actions_table
    console.state.robot.set(RobotProfile("omni", "Omni", limits=MotionLimits(left_mps=0.3)))
    assert table.key_text("answer_yes") == "Y"
    table.use_letters({"Z": "Y", "Y": "Z"})
    assert table.key_text("strafe_left") == "Y"
    assert table.key_text("answer_yes") == "Ctrl Enter" and table.key_text("answer_no") == "⇧Ctrl Enter"


def test_enter_of_the_number_pad_is_enter(window: MainWindow, view: QWidget, console: FakeConsole) -> None:
    refused: list[str] = []
    window.actions_table.not_done.connect(lambda reason, _opens: refused.append(reason))
    pad = Qt.KeyboardModifier.KeypadModifier
    QTest.keyClick(view, Qt.Key.Key_Enter, pad | CTRL)
    assert refused == ["No question is pending."]
    view.setFocus()
    QTest.keyClick(view, Qt.Key.Key_Escape)
    QTest.keyClick(view, Qt.Key.Key_Enter, pad)
    assert find(window, "speak_field").hasFocus()
