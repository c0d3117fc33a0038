"""Robot panel: every kind of control with real events, its result, and no unintended command."""

import time
from dataclasses import replace

import pytest
from PySide6.QtCore import QPoint, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLabel, QLineEdit, QSlider, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.control_definitions import CallService, Choice, PublishMessage, Reading, RobotControl
from caris_desktop.domain.sensing import ControlReadings
from caris_desktop.live.status import ControlStatus, LinkStatus
from caris_desktop.robot.profile import load_profile, shipped_profiles
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.robot_panel import ControlEntry, RobotPanel
from caris_desktop.ui.text_formatting import value_words
from caris_desktop.ui.widgets.inputs import DropDown
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("drive")

SERVICE = CallService("/do", "std_srvs/Trigger", {})
TOPIC = PublishMessage("/set", "std_msgs/Float32", {"data": "$value"})
TOLD = Reading("/told", "std_msgs/Float32", "data")
CONTROLS = (
    RobotControl("wave", "Wave", "button", SERVICE, group="Gestures"),
    RobotControl("dock", "Dock", "button", SERVICE, group="Gestures", confirm=True),
    RobotControl("eyes", "Eyes", "toggle", SERVICE, TOLD, group="Face"),
    RobotControl("volume", "Volume", "slider", TOPIC, TOLD, unit="%", range=(0, 100), step=5),
    RobotControl("mood", "Mood", "choice", TOPIC, choices=(Choice("Calm", "calm"), Choice("Glad", "glad"))),
    RobotControl("dance", "Dance", "choice", TOPIC, choices=tuple(Choice(f"Dance {n}", float(n)) for n in range(6))),
    RobotControl("screen", "Screen", "text", TOPIC, group="Screen"),
    RobotControl("warmth", "Battery temperature", "readout", reading=TOLD, unit="°C"),
)

LAMP = RobotControl("lamp", "Lamp", "button", PublishMessage("/lamp", "std_msgs/Bool", {}), moves=False)


@pytest.fixture
def panel(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> RobotPanel:
    console.state.controls.set(CONTROLS)
    window.open_panel("robot")
    panel = window.panels["robot"]
    assert isinstance(panel, RobotPanel)
    qtbot.waitUntil(panel.isVisible)
    return panel


def entry(panel: RobotPanel, control_id: str) -> ControlEntry:
    found = panel.entry(control_id)
    assert found is not None
    return found


def tell(console: FakeConsole, **values: bool | float | str) -> None:
    console.state.add(ControlReadings(clock.now_ns(), dict(values)))


def answer(console: FakeConsole, control_id: str, status: ControlStatus) -> None:
    console.state.control_states.set({**console.state.control_states.value, control_id: status})


def test_it_opens_inside_the_window(window: MainWindow, panel: RobotPanel) -> None:
    assert QApplication.activeWindow() is window, "a window of its own, be it for a moment, would end driving"


def test_a_button_is_used_with_one_click_and_its_panel_gets_the_keys(
    qtbot: QtBot, window: MainWindow, panel: RobotPanel, console: FakeConsole
) -> None:
    button = find(panel, "control_wave_button")
    click(qtbot, button)
    assert console.named("use_control") == [("wave", True)]
    assert window.focusWidget() is panel.focus_target()
    assert window.focusWidget() is not button, "a key that follows does not press it once more"
    QTest.keyClick(window.focusWidget(), Qt.Key.Key_Space)
    assert console.named("use_control") == [("wave", True)]
    assert panel.fact == ("Wave: requested", "blue")


def test_a_failure_is_described_next_to_it(panel: RobotPanel, console: FakeConsole) -> None:
    answer(console, "wave", ControlStatus("failed", True, "the service did not answer"))
    assert entry(panel, "wave").note_text == "Wave failed: the service did not answer"
    assert entry(panel, "wave").note.isVisible()
    assert panel.fact == ("1 failed", "amber")
    answer(console, "wave", ControlStatus("succeeded", True))
    assert entry(panel, "wave").note_text == ""
    assert panel.fact == ("8 controls", "dim")


def test_confirm_asks_in_place_and_only_yes_does_it(qtbot: QtBot, panel: RobotPanel, console: FakeConsole) -> None:
    click(qtbot, find(panel, "control_dock_button"))
    assert console.named("use_control") == []
    click(qtbot, find(panel, "control_cancel"))
    assert console.named("use_control") == []
    click(qtbot, find(panel, "control_dock_button"))
    click(qtbot, find(panel, "control_confirm"))
    assert console.named("use_control") == [("dock", True)]


def test_escape_stops_the_robot_and_takes_the_question_away(
    qtbot: QtBot, window: MainWindow, panel: RobotPanel, console: FakeConsole
) -> None:
    click(qtbot, find(panel, "control_dock_button"))
    QTest.keyClick(window, Qt.Key.Key_Escape)
    assert console.named("stop") == [None]
    assert find(panel, "control_dock_button").isVisible()
    assert console.named("use_control") == []


def test_many_controls_come_a_few_at_a_time_and_each_shows_how_it_stands(
    qtbot: QtBot, panel: RobotPanel, console: FakeConsole
) -> None:
    many = tuple(replace(LAMP, id=f"lamp{number}", title=f"Lamp {number}") for number in range(1, 12))
    console.state.control_states.set({"lamp11": ControlStatus("failed", True, "It is broken.")})
    console.state.controls.set(many)
    there = len(panel.findChildren(ControlEntry))
    assert 0 < there < len(many), "a key that is pressed now waits for a few"

    def shown() -> list[str]:
        return [entry.control.id for entry in panel.findChildren(ControlEntry) if entry.isVisible()]

    qtbot.waitUntil(lambda: shown() == [control.id for control in many])
    assert panel.fact == ("1 failed", "amber")


def test_under_the_emergency_stop_what_moves_is_off_and_says_why(
    qtbot: QtBot, window: MainWindow, panel: RobotPanel, console: FakeConsole
) -> None:
    console.state.controls.set((*CONTROLS, LAMP))
    panel.complete()
    QApplication.processEvents()  # display the new state
    click(qtbot, find(panel, "control_dock_button"))
    console.state.drive.set(replace(console.state.drive.value, emergency_stop=True))
    reason = find(panel, "robot_reason")
    assert isinstance(reason, QLabel)
    assert reason.isVisible()
    assert "when you release the emergency stop" in reason.text()
    assert not find(panel, "control_wave_button").isEnabled()
    assert reason.text() in find(panel, "control_wave_button").parentWidget().toolTip()
    assert panel.fact == ("motion is off", "amber")
    click(qtbot, find(panel, "control_wave_button"))
    click(qtbot, find(panel, "control_lamp_button"))
    assert console.named("use_control") == [("lamp", True)]
    found = {entry.text for entry in window.palette_entries()}
    assert "Robot: Lamp" in found
    assert "Robot: Wave" not in found
    console.state.drive.set(replace(console.state.drive.value, emergency_stop=False))
    assert reason.isHidden()
    assert find(panel, "control_wave_button").isEnabled()
    assert find(panel, "control_dock_button").isVisible(), "the question from before is not left open"


def test_a_toggle_shows_what_the_robot_reports(qtbot: QtBot, panel: RobotPanel, console: FakeConsole) -> None:
    eyes = entry(panel, "eyes")
    assert eyes.value_text == "unknown"
    tell(console, eyes=True)
    assert eyes.value_text == "on"
    click(qtbot, find(panel, "control_eyes_switch"))
    assert console.named("use_control") == [("eyes", False)]
    assert eyes.value_text == "off"
    answer(console, "eyes", ControlStatus("failed", False, "the robot refused"))
    assert eyes.value_text == "on", "it did not go off"


def test_a_slider_sends_ten_times_a_second_at_most_and_always_the_last_value(
    qtbot: QtBot, panel: RobotPanel, console: FakeConsole
) -> None:
    slider = panel.findChild(QSlider, "control_volume_slider")
    assert slider is not None
    panel.findChild(QWidget, "control_volume").setFocus()  # type: ignore[union-attr]
    y = slider.height() // 2
    QTest.mousePress(slider, Qt.MouseButton.LeftButton, pos=QPoint(6, y))
    began_s = time.monotonic()
    for x in range(6, slider.width() - 4, 3):
        QTest.mouseMove(slider, QPoint(x, y))
    QTest.mouseRelease(slider, Qt.MouseButton.LeftButton, pos=QPoint(slider.width() - 2, y))
    took_s = time.monotonic() - began_s
    final = slider.value() * 5.0
    qtbot.waitUntil(lambda: bool(console.named("use_control")) and console.named("use_control")[-1][1] == final)
    sent = [value for _, value in console.named("use_control")]
    assert final > 80.0
    assert len(sent) <= 10 * took_s + 3
    assert all(value % 5 == 0 for value in sent)
    QTest.qWait(150)
    assert len(console.named("use_control")) == len(sent), "nothing is said twice"


def test_a_slider_goes_where_the_robot_says_it_is(panel: RobotPanel, console: FakeConsole) -> None:
    assert entry(panel, "volume").value_text == "not set yet"
    tell(console, volume=35.0)
    assert entry(panel, "volume").value_text == "35 %"
    slider = panel.findChild(QSlider, "control_volume_slider")
    assert slider is not None
    assert slider.value() == 7
    assert console.named("use_control") == []


def test_few_choices_are_buttons_and_many_are_a_list(qtbot: QtBot, panel: RobotPanel, console: FakeConsole) -> None:
    click(qtbot, find(panel, "control_mood_choice_1"))
    assert console.named("use_control") == [("mood", "glad")]
    assert entry(panel, "mood").value_text == "Glad"
    box = panel.findChild(DropDown, "control_dance_list")
    assert box is not None
    box.setFocus()
    QTest.keyClick(box, Qt.Key.Key_Down)
    assert console.named("use_control")[-1] == ("dance", 0.0)


def test_a_text_is_sent_with_enter_and_the_rest_of_the_window_hears_nothing(
    panel: RobotPanel, console: FakeConsole
) -> None:
    field = panel.findChild(QLineEdit, "control_screen_field")
    assert field is not None
    field.setFocus()
    assert field.hasFocus()
    QTest.keyClicks(field, "Hello w")
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.calls == [("use_control", ("screen", "Hello w"))]
    assert field.hasFocus()


def test_a_readout_says_when_nothing_was_reported(panel: RobotPanel, console: FakeConsole) -> None:
    warmth = entry(panel, "warmth")
    labels = {label.text() for label in warmth.findChildren(QLabel)}
    assert "no value yet" in labels
    tell(console, warmth=31.25)
    assert warmth.value_text == "31.2 °C"
    console.state.clear_robot_streams()
    assert "no value yet" in {label.text() for label in warmth.findChildren(QLabel)}


def test_without_a_link_nothing_can_be_used_and_the_reason_is_there(
    qtbot: QtBot, panel: RobotPanel, console: FakeConsole
) -> None:
    console.state.link.set(LinkStatus("lost", "Simulated robot"))
    reason = find(panel, "robot_reason")
    assert isinstance(reason, QLabel)
    assert reason.text().startswith("The robot is out of reach.")
    button = find(panel, "control_wave_button")
    assert not button.isEnabled()
    click(qtbot, button)
    assert console.named("use_control") == []
    console.state.link.set(LinkStatus("connected", "Simulated robot"))
    click(qtbot, button)
    assert console.named("use_control") == [("wave", True)]


def test_it_fits_a_narrow_dock(qtbot: QtBot, window: MainWindow, panel: RobotPanel) -> None:
    panel.setParent(None)
    qtbot.addWidget(panel)
    panel.resize(240, 600)
    panel.show()
    body = find(panel, "control_wave").parentWidget()
    assert body is not None
    qtbot.waitUntil(lambda: body.width() <= 240)
    for control in CONTROLS:
        widget = find(panel, f"control_{control.id}")
        assert widget.mapTo(panel, QPoint(widget.width(), 0)).x() <= 240, control.id


@pytest.mark.long
def test_the_controls_of_every_shipped_robot_are_drawn(panel: RobotPanel, console: FakeConsole) -> None:
    for name in shipped_profiles():
        controls = load_profile(name).controls
        console.state.controls.set(controls)
        assert [panel.entry(control.id) is not None for control in controls] == [True] * len(controls), name
        if not controls:
            assert find(panel, "robot_empty").isVisible(), name


@pytest.mark.parametrize(
    ("control", "value", "expected"),
    [
        (CONTROLS[3], 62.0, "62 %"),
        (RobotControl("a", "A", "slider", TOPIC, range=(0, 1), step=0.1), 0.3, "0.3"),
        (RobotControl("a", "A", "slider", TOPIC, range=(-0.5, 0.5), unit="m"), 0.123, "0.12 m"),
        (CONTROLS[2], True, "on"),
        (CONTROLS[4], "calm", "Calm"),
        (CONTROLS[7], "", "empty"),
    ],
)
def test_values_are_words(control: RobotControl, value: bool | float | str, expected: str) -> None:
    assert value_words(control, value) == expected
