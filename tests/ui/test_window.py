"""Main window: scenarios, permissions, start dialog, emergency stop, problems and command palette."""

import dataclasses
import itertools
import json
import math
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import QByteArray, QPoint, QRect, QSize, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QDialog, QLabel, QMenu, QPlainTextEdit, QScrollArea, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.control_definitions import CallService, RobotControl
from caris_desktop.domain.events import Problem, ProblemEnd, TrafficMeasured, TrialDetails
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import BatteryState, RobotPose
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.status import (
    AssistantSetup,
    AssistantStatus,
    DriveStatus,
    LinkStatus,
    ListeningStatus,
    MapStatus,
    MicrophoneStatus,
    PerceptionStatus,
    RecordingStatus,
)
from caris_desktop.robot.profile import ListedProfile
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.scenario.scenario_model import (
    LayoutNode,
    Permissions,
    SplitNode,
    TabNode,
    layout_from_data,
    panels_in,
)
from caris_desktop.ui import text_formatting
from caris_desktop.ui.action_rows import phrases_on_keys
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.notifications import SHOWN_AT_ONCE
from caris_desktop.ui.palette.command_palette import Finder, PaletteItem
from caris_desktop.ui.panels.video_panel import VideoPanel
from caris_desktop.ui.status_bar import ConnectionCard, StatusItem
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.window_place import WindowPlace
from tests.ui import samples
from tests.ui.conftest import MemorySettings, click, find, freshen, open_window
from tests.ui.fake_console import FakeConsole


def choose(menu_owner: QWidget, menu_name: str, text: str) -> None:
    menu = menu_owner.findChild(QMenu, menu_name)
    assert menu is not None
    action = next(action for action in menu.actions() if action.text() == text)
    QTest.mouseClick(menu, Qt.MouseButton.LeftButton, pos=menu.actionGeometry(action).center())


def test_everything_fits_a_small_laptop(window: MainWindow) -> None:
    assert (window.width(), window.height()) == (1366, 768)
    for button in window.findChildren(ActionButton):
        if button.isVisible() and button.parent().objectName() == "top_bar":
            assert button.width() >= button.sizeHint().width()


def test_a_first_window_is_no_larger_than_its_screen(
    qtbot: QtBot, console: FakeConsole, settings: MemorySettings, theme: Theme
) -> None:
    window = MainWindow(console, settings=settings, theme=theme)
    qtbot.addWidget(window)
    room = window.screen().availableSize()
    assert window.width() <= room.width()
    assert window.height() + 30 <= room.height(), "with its title bar the status bar would be below the edge"


def test_a_first_window_fills_a_small_screen(
    qtbot: QtBot, console: FakeConsole, settings: MemorySettings, theme: Theme
) -> None:
    first = MainWindow(console, settings=settings, theme=theme)
    qtbot.addWidget(first)
    assert first.screen().availableSize().width() < 1680, "this screen is a small one"
    first.show_in_place()
    assert first.isMaximized()
    first.showNormal()
    first.close()
    again = MainWindow(console, settings=settings, theme=theme)
    qtbot.addWidget(again)
    again.show_in_place()
    assert not again.isMaximized(), "from then on it is where it was left"


@pytest.fixture(params=["tour-guide", "mental-health-check"])
def laptop(
    request: pytest.FixtureRequest, qtbot: QtBot, console: FakeConsole, settings: MemorySettings, theme: Theme
) -> MainWindow:
    """Shipped scenario in a window on a screen of 1366 by 768 pixels."""
    console.scenario = load_scenario(layouts_dir() / f"{request.param}.yaml")
    window = MainWindow(console, settings=settings, theme=theme)
    qtbot.addWidget(window)
    window.resize(1350, 720)
    window.show()
    return window


def test_every_phrase_is_in_view_on_a_small_laptop(qtbot: QtBot, laptop: MainWindow, console: FakeConsole) -> None:
    area = laptop.panels["speak"].findChild(QScrollArea)
    assert isinstance(area, QScrollArea)
    count = len(phrases_on_keys(console.scenario, 0))
    chips = [find(laptop, f"phrase_{number}") for number in range(1, count + 1)]
    chips.append(find(laptop, "filler"))
    qtbot.waitUntil(
        lambda: all(chip.mapTo(area, chip.rect().bottomRight()).y() <= area.height() for chip in chips), timeout=2000
    )


def test_an_answer_can_be_read_on_a_small_laptop(qtbot: QtBot, laptop: MainWindow, console: FakeConsole) -> None:
    laptop.open_panel("assistant")
    text = "It lifts up to five kilos, and it stops at once as soon as it touches something or somebody."
    for state in ("answering", "ready"):
        console.state.assistant.set(AssistantStatus(state, "SmolLM2", "x9", "How much can it lift?", text))
    answer = find(laptop, "assistant_answer")
    assert isinstance(answer, QPlainTextEdit)
    qtbot.waitUntil(lambda: answer.viewport().height() >= 3 * answer.fontMetrics().height(), timeout=2000)
    assert answer.verticalScrollBar().value() == 0, "it is read from the beginning"


def test_switching_the_scenario_rebuilds_the_panels(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    sequence = console.state.frame.value.sequence
    log = window.panels["session"].log_lines()  # type: ignore[attr-defined]
    click(qtbot, find(window, "scenario_button"))
    choose(window, "scenario_menu", "Mental health check")
    assert console.calls == [("open_scenario", samples.MENTAL.path)]
    assert set(window.panels) == {"video", "people", "assistant", "speak", "drive", "session"}
    assert [widget for widget in window.findChildren(QWidget, "photo_button") if widget.isVisible()] == []
    assert find(window, "phrase_1").property("text") == "I’m listening."
    assert window.panels["session"].log_lines() == log  # type: ignore[attr-defined]
    assert console.state.frame.value.sequence == sequence
    assert console.named("stop_session") == []
    QTest.keyClick(find(window, "speak_field"), Qt.Key.Key_F1)
    assert console.calls[-1] == ("say", ("I’m listening.", "phrase"))


@pytest.mark.long
def test_switching_back_and_forth_leaves_nothing_behind(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    for _ in range(2):
        for scenario in (samples.MENTAL, samples.TOUR):
            assert scenario.path is not None
            console.open_scenario(scenario.path)
            window.show_scenario(console.scenario)
    qtbot.waitUntil(lambda: len(window.findChildren(QWidget, "speak_field")) == 1)
    console.calls.clear()
    view = find(window, "video_view")
    view.setFocus()
    QTest.keyClick(view, Qt.Key.Key_W)
    QTest.keyClick(view, Qt.Key.Key_F1)
    assert [name for name, _ in console.calls] == ["drive", "release_drive", "say"]


def test_without_driving_nothing_drives(qtbot: QtBot, settings: MemorySettings, theme: Theme) -> None:
    permissions = Permissions(driving=False, assistant=False)
    console = FakeConsole(dataclasses.replace(samples.TOUR, permissions=permissions))
    window = open_window(qtbot, console, settings, theme)
    assert not {"drive", "assistant"} & set(window.panels)
    view = find(window, "video_view")
    view.setFocus()
    for key in (Qt.Key.Key_W, Qt.Key.Key_Up):
        QTest.keyClick(view, key)
        QTest.keyClick(view, key, Qt.KeyboardModifier.AltModifier)
    assert console.named("drive") == []
    assert [widget for widget in window.findChildren(QWidget, "map_go_button") if widget.isVisible()] == []
    QTest.keyClick(view, Qt.Key.Key_Escape)
    assert console.calls[-1] == ("stop", None)


@pytest.mark.panels("video", "session")
def test_the_start_dialog_asks_and_is_prefilled_the_next_time(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    console.stop_session()
    console.calls.clear()
    click(qtbot, find(window, "record_button"))
    for name, text in (
        ("study", "Lab visit"),
        ("participant", "P07"),
        ("condition", "B"),
        ("trial", "2"),
        ("wizard", "Kim"),
    ):
        QTest.keyClicks(find(window, f"start_{name}"), text)
    click(qtbot, find(window, "start_dialog_begin"))
    assert console.calls == [("start_session", TrialDetails("Lab visit", "P07", "B", "2", "Kim"))]
    label = find(window, "trial_label")
    assert isinstance(label, QLabel)
    assert label.text() == "P07 · condition B · trial 2"
    console.stop_session()
    click(qtbot, find(window, "record_button"))
    assert find(window, "start_participant").property("text") == "P07"
    assert find(window, "start_trial").property("text") == "2"
    find(window, "start_dialog").close()


@pytest.mark.panels("video", "session")
def test_the_start_dialog_can_be_skipped(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    console.stop_session()
    console.calls.clear()
    click(qtbot, find(window, "record_button"))
    click(qtbot, find(window, "start_dialog_skip"))
    assert console.calls == [("start_session", TrialDetails())]


def test_the_red_button_over_a_dialog_is_as_in_the_bar_and_not_on_the_edge_of_the_dialog(
    qtbot: QtBot, window: MainWindow
) -> None:
    red = find(window, "emergency_stop")
    bar = QRect(red.mapToGlobal(QPoint()), red.size())
    for over_px in (-40, 4):
        dialog = QDialog(window)
        dialog.setModal(True)
        dialog.setGeometry(QRect(QPoint(bar.left() + over_px - 300, bar.top()), QSize(300, 200)))
        dialog.show()
        qtbot.waitUntil(lambda dialog=dialog: dialog.findChild(QWidget, "emergency_over_dialog") is not None)
        copy = dialog.findChild(QWidget, "emergency_over_dialog")
        assert copy is not None
        place = copy.geometry()
        assert (place.top(), place.right(), place.height()) == (bar.top(), bar.right(), bar.height())
        assert not place.intersects(dialog.geometry())
        assert place.width() >= bar.width() - 8, "its margin only"
        dialog.close()
        dialog.deleteLater()


@pytest.mark.panels("video", "session")
def test_a_running_recording_is_stopped_from_the_top_bar(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    click(qtbot, find(window, "record_button"))
    choose(window, "record_menu", "Stop recording")
    assert console.calls == [("stop_session", None)]


@pytest.mark.panels("video", "session")
def test_the_red_button_latches_and_only_the_banner_releases(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    button = find(window, "emergency_stop")
    click(qtbot, button)
    click(qtbot, button)
    assert [name for name, _ in console.calls] == ["emergency_stop", "emergency_stop"]
    assert console.state.drive.value.emergency_stop
    assert find(window, "emergency_band").isVisible()
    click(qtbot, find(window, "emergency_release"))
    assert console.calls[-1] == ("clear_emergency_stop", None)
    assert not window.findChild(QWidget, "emergency_band").isVisible()  # type: ignore[union-attr]


@pytest.mark.panels("video", "session")
def test_the_red_button_acts_on_the_press(window: MainWindow, console: FakeConsole) -> None:
    QTest.mousePress(find(window, "emergency_stop"), Qt.MouseButton.LeftButton)
    assert console.calls == [("emergency_stop", None)]


@pytest.mark.panels("video", "session")
def test_problems_are_cards_that_can_be_dismissed(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    focused = window.focusWidget()
    for number in range(SHOWN_AT_ONCE + 1):
        console.state.add(Problem(1, "error", f"Problem {number}", "It means this.", "Do that."))
    console.state.add(Problem(1, "error", f"Problem {SHOWN_AT_ONCE}", "It means this.", "Do that."))
    cards = window.problems.cards
    assert [card.problem.what for card in cards] == [f"Problem {number}" for number in range(1, SHOWN_AT_ONCE + 1)]
    assert window.focusWidget() is focused
    click(qtbot, find(cards[0], "problem_dismiss"))
    assert len(window.problems.cards) == SHOWN_AT_ONCE - 1


@pytest.mark.panels("video", "session")
def test_a_problem_that_is_over_goes_away_automatically(window: MainWindow, console: FakeConsole) -> None:
    state = console.state
    link, drive = state.link.value, state.drive.value

    def told(*whats: str) -> None:
        assert [card.problem.what for card in window.problems.cards] == list(whats)

    state.link.set(dataclasses.replace(link, state="lost"))
    state.add(Problem(1, "error", "Away", "", "", until="connected"))
    state.add(Problem(1, "error", "Not told", "", "", until="released"))
    state.add(Problem(1, "error", "Broken", "", ""))
    state.link.set(dataclasses.replace(link, state="connecting"))
    lost = "The connection to the robot is lost."
    told(lost, "Not told", "Broken")
    state.link.set(link)
    told(lost, "Not told", "Broken")
    console.ahead_ns = 3_000_000_000
    console.alarms.evaluate()
    told("Not told", "Broken")
    state.drive.set(dataclasses.replace(drive, emergency_stop=True))
    told("Not told", "Broken")
    state.drive.set(drive)
    told("Broken")


@pytest.mark.panels("video", "session")
@pytest.mark.parametrize(
    ("until", "value_of", "over"),
    [
        ("voice", "speech", {"ready": True, "detail": ""}),
        ("assistant", "assistant", {"state": "ready"}),
        ("people", "perception", {"state": "ready"}),
        ("microphone", "microphone", {"state": "on"}),
        ("recording", "recording", {"state": "starting"}),
    ],
)
def test_a_restored_service_removes_its_problem(
    window: MainWindow, console: FakeConsole, until: ProblemEnd, value_of: str, over: dict[str, Any]
) -> None:
    value = getattr(console.state, value_of)
    value.set(type(value.value)())
    console.state.add(Problem(1, "error", "It stopped", "", "", until=until))
    assert len(window.problems.cards) == 1
    value.set(dataclasses.replace(value.value, **over))
    assert window.problems.cards == ()


@pytest.mark.panels("video", "session")
def test_a_picture_that_is_back_takes_its_problem_away(window: MainWindow, console: FakeConsole) -> None:
    console.state.frame.clear()
    console.state.add(Problem(1, "error", "No camera", "", "", until="picture"))
    freshen(console)
    assert window.problems.cards == ()


@pytest.mark.panels("video", "session")
def test_anything_can_be_found_and_done(window: MainWindow, console: FakeConsole) -> None:
    view = find(window, "video_view")
    view.setFocus()
    QTest.keyClick(view, Qt.Key.Key_K, Qt.KeyboardModifier.ControlModifier)
    field = find(window, "palette_field")
    assert field.hasFocus()
    QTest.keyClicks(field, "kitchen")
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.calls == [("go_to_place", "Kitchen")]
    assert view.hasFocus()


@pytest.mark.panels("video", "session")
def test_escape_closes_the_palette_and_stops(window: MainWindow, console: FakeConsole) -> None:
    window.show_command_palette()
    QTest.keyClick(find(window, "palette_field"), Qt.Key.Key_Escape)
    assert console.calls == [("stop", None)]
    assert not window.findChild(QWidget, "command_palette").isVisible()  # type: ignore[union-attr]


def test_finding_wants_every_word_and_prefers_beginnings() -> None:
    entries = [
        PaletteItem(text, "Place", "", lambda: None, id=text) for text in ("Go to Lab bench", "Lab tour", "Kitchen")
    ]
    assert [entry.text for entry in Finder(entries).matching("lab")] == ["Lab tour", "Go to Lab bench"]
    assert [entry.text for entry in Finder(entries).matching("lab go")] == ["Go to Lab bench"]
    assert Finder(entries).matching("xyz") == []


def test_the_shortcut_sheet_opens_by_key(qtbot: QtBot, window: MainWindow) -> None:
    view = find(window, "video_view")
    view.setFocus()
    QTest.keyClick(view, Qt.Key.Key_Slash, Qt.KeyboardModifier.ControlModifier)
    sheet = find(window, "shortcut_sheet")

    def texts() -> set[str]:
        return {label.text() for label in sheet.findChildren(QLabel)}

    qtbot.waitUntil(lambda: texts() >= {"All shortcuts", "Stop the robot", "Drive forward", "Wizard error"})


def test_the_status_bar_uses_words(window: MainWindow, console: FakeConsole) -> None:
    bar = window.status_bar
    bar.refresh()
    assert bar.items["link"].text == "Simulated robot"
    assert bar.items["round_trip"].text == "link 12 ms"
    assert bar.items["battery"].text == "battery 78 %"
    assert bar.items["models"].text == "local models only"
    assert bar.items["recording"].text == "recording, 184 MB"
    assert bar.items["disk"].text == "41.3 GB free"
    console.state.perception.set(PerceptionStatus("ready", "a model", server="wss://lab:8768"))
    bar.refresh()
    assert bar.items["models"].text == "pictures leave this computer"
    assert "wss://lab:8768" in bar.items["models"].toolTip()
    console.state.assistant_setup.set(AssistantSetup("gemini:large", "generativelanguage.googleapis.com"))
    bar.refresh()
    assert bar.items["models"].text == "language model: gemini:large, pictures sent too"
    assert "Questions are sent to generativelanguage.googleapis.com." in bar.items["models"].toolTip()
    permissions = replace(console.scenario.permissions, transcription=True)
    console.scenario = replace(console.scenario, permissions=permissions)
    bar.refresh()
    assert bar.items["listening"].text == "no transcription"
    console.state.listening.set(ListeningStatus("ready", "tiny.en", "en"))
    assert bar.items["listening"].text == "no transcription", "no microphone is open"
    console.state.microphone.set(MicrophoneStatus("on"))
    assert bar.items["listening"].text == "listening"
    console.state.listening.set(ListeningStatus("failed", detail="No speech recogniser was found."))
    assert (bar.items["listening"].text, bar.items["listening"].role) == ("no transcription", "amber")
    console.state.link.set(LinkStatus("lost", "Simulated robot", "ws://127.0.0.1:9090", "no answer"))
    console.state.clear_robot_streams()
    bar.refresh()
    assert bar.items["link"].text == "Simulated robot unreachable"
    assert bar.items["lidar"].text == "no LIDAR yet"
    assert isinstance(find(window, "status_link"), StatusItem)


def test_a_new_item_of_the_status_bar_never_lies_on_another(window: MainWindow, console: FakeConsole) -> None:
    bar = window.status_bar
    window.resize(1366, 768)
    QApplication.processEvents()
    for words in ("", "video delayed 0.5 s"):
        bar.items["video"].say(words, "amber")
        bar.items["load"].say("busy: people detection much less often, video and panels slower" * 2, "amber")
        bar._fit()
        places = [item.geometry() for item in bar.items.values() if item.isVisible()]
        assert all(left.right() < right.left() for left, right in itertools.pairwise(places)), words
        assert places[-1].right() < bar.width(), words


def test_every_control_has_a_name_for_screen_readers(window: MainWindow) -> None:
    nameless = [
        button.objectName() or repr(button)
        for button in window.findChildren(ActionButton)
        if button.isVisible() and not button.accessibleName()
    ]
    assert nameless == []


@pytest.mark.panels("video", "session")
def test_closing_keeps_the_place_of_the_window(window: MainWindow, settings: MemorySettings, qtbot: QtBot) -> None:
    with qtbot.waitSignal(window.closed):
        window.close()
    assert settings.values["window/geometry"]


@pytest.mark.panels("video", "session")
def test_the_connection_can_be_looked_at(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    click(qtbot, find(window, "status_link"))
    card = find(window, "connection_card")
    assert isinstance(card, ConnectionCard)
    card.sample()
    console.state.link.set(LinkStatus("lost", "Simulated robot"))
    card.sample()
    card.refresh()
    assert find(window, "connection_plot").isVisible()
    newest = card.values_ms["round_trip"]
    assert newest[-2] == 12.0
    assert math.isnan(newest[-1])
    QTest.keyClick(card, Qt.Key.Key_Escape)
    assert not card.isVisible()


def choose_from_window_menu(qtbot: QtBot, window: MainWindow, text: str) -> None:
    click(qtbot, find(window, "window_menu_button"))
    choose(window, "window_menu", text)


def choose_panel(qtbot: QtBot, window: MainWindow, title: str) -> None:
    click(qtbot, find(window, "window_menu_button"))
    menus = window.findChildren(QMenu, "panels_menu")
    next(action for action in menus[-1].actions() if action.text() == title).trigger()
    find(window, "window_menu").close()


def test_a_panel_that_the_scenario_does_not_have_is_added_in_a_tab_and_closed_again(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    choose_panel(qtbot, window, "Diagnostics")
    qtbot.waitUntil(lambda: "diagnostics" in window.panels)
    tree = window.dock_host.tree
    assert tree is not None
    tabs = next(node for node in nodes_of(tree) if isinstance(node, TabNode) and "diagnostics" in node.tabs)
    assert tabs == TabNode(("assistant", "session", "diagnostics"), "diagnostics")
    window.layout_keeper.save()
    saved = console.named("SaveLayout")[-1]
    assert "diagnostics" in panels_in(layout_from_data(json.loads(saved.layout)))
    choose_panel(qtbot, window, "Diagnostics")
    qtbot.waitUntil(lambda: "diagnostics" not in window.panels)
    tree = window.dock_host.tree
    assert tree is not None
    assert "diagnostics" not in panels_in(tree)
    assert set(window.panels) == set(panels_in(samples.TOUR.layout))


def nodes_of(node: LayoutNode) -> list[LayoutNode]:
    return (
        [node, *(inner for child in node.children for inner in nodes_of(child))]
        if isinstance(node, SplitNode)
        else [node]
    )


def test_an_added_panel_has_its_keys(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    window.close_panel("drive")
    window.open_panel("drive")
    console.scenario = samples.MENTAL
    window.show_scenario(samples.MENTAL)
    window.open_panel("map")
    target = window.panels["map"].focus_target()
    target.setFocus()
    console.calls.clear()
    QTest.keyClick(target, Qt.Key.Key_W)
    assert [name for name, _ in console.calls] == ["drive", "release_drive"]
    window.close_panel("map")
    assert "map" not in window.panels


def test_disabled_panels_cannot_be_added(qtbot: QtBot, settings: MemorySettings, theme: Theme) -> None:
    permissions = Permissions(driving=False, assistant=False, robot_controls=False)
    window = open_window(
        qtbot, FakeConsole(dataclasses.replace(samples.TOUR, permissions=permissions)), settings, theme
    )
    assert not {"drive", "assistant", "robot"} & set(window.board.possible())
    window.open_panel("robot")
    assert "robot" not in window.panels
    assert not [entry.text for entry in window.palette_entries() if entry.text.startswith(("Robot", "Drive", "Go to"))]


@pytest.mark.panels("video", "session")
def test_the_robots_are_listed_and_another_is_requested_when_something_would_end(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    click(qtbot, find(window, "status_link"))
    click(qtbot, find(window, "connection_robots"))
    menu = window.findChild(QMenu, "robot_menu")
    assert menu is not None
    assert [(action.text(), action.isChecked()) for action in menu.actions()] == [
        ("Simulated robot", True),
        ("TIAGo", False),
    ]
    choose(window, "robot_menu", "TIAGo")
    assert console.named("use_robot") == []
    question = find(window, "question_band").accessibleName()
    assert "is on its way to Robot arm and will stop" in question
    assert "recording continues" in question
    click(qtbot, find(window, "question_no"))
    assert not window.findChild(QWidget, "question_band").isVisible()  # type: ignore[union-attr]
    choose(window, "robot_menu", "TIAGo")
    click(qtbot, find(window, "question_yes"))
    assert console.named("use_robot") == ["tiago"]


@pytest.mark.panels("video", "session")
def test_a_robot_whose_profile_is_broken_is_listed_with_the_reason(
    window: MainWindow, console: FakeConsole, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = ListedProfile("mine", "mine", "", error="line 3: 'speed' is not known")
    monkeypatch.setattr(console, "robots", lambda: [broken])
    window.menus.open_robot_menu()
    menu = window.findChild(QMenu, "robot_menu")
    assert menu is not None
    action = menu.actions()[0]
    assert (action.text(), action.isEnabled(), action.toolTip()) == ("mine · cannot be used", False, broken.error)
    menu.close()


@pytest.mark.panels("video", "session")
def test_at_rest_another_robot_is_connected_at_once(window: MainWindow, console: FakeConsole) -> None:
    console.state.goal.set(None)
    console.state.recording.set(RecordingStatus())
    console.state.drive.set(DriveStatus(allowed=True, reason=""))
    window.robots.choose(console.robots()[1])
    assert console.named("use_robot") == ["tiago"]


def test_the_guard_that_is_off_is_there_to_be_switched_on(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    console.set_guard(on=False)
    assert find(window, "guard_band").accessibleName().startswith("Obstacle guard is off.")
    click(qtbot, find(window, "guard_on"))
    assert console.calls[-1] == ("set_guard", True)
    assert not window.findChild(QWidget, "guard_band").isVisible()  # type: ignore[union-attr]


def test_no_banner_moves_the_panels(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    def places() -> list[QRect]:
        QApplication.processEvents()
        return [QRect(panel.mapTo(window, QPoint()), panel.size()) for panel in window.panels.values()]

    before = places()
    video = window.panels["video"]
    assert isinstance(video, VideoPanel)
    qtbot.waitUntil(lambda: "Going to Robot arm, 6.2 m left" in [text for text, _role in video.view.chips])
    console.set_guard(on=False)
    assert places() == before
    console.emergency_stop()
    window._question.ask("Connect to TIAGo now? " + "It will stop. " * 20, "Connect", lambda: None)
    assert places() == before
    assert (window.width(), window.height()) == (1366, 768)
    bands = [find(window, name) for name in ("emergency_band", "guard_band", "question_band")]
    assert all(later.y() > earlier.geometry().bottom() for earlier, later in itertools.pairwise(bands))
    for band in bands:
        for button in band.findChildren(ActionButton):
            assert button.width() >= button.sizeHint().width(), "its answer is legible"


@pytest.mark.panels("video", "session")
@pytest.mark.parametrize("command", ["go to the kitchen", "Drive to kitchen", "navigate to the kitchen", "kitchen"])
def test_a_place_is_driven_to_by_command(window: MainWindow, console: FakeConsole, command: str) -> None:
    window.show_command_palette()
    field = find(window, "palette_field")
    QTest.keyClicks(field, command)
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.calls == [("go_to_place", "Kitchen")]


def test_robots_controls_and_maps_are_found_too(window: MainWindow, console: FakeConsole) -> None:
    call = CallService("/do", "std_srvs/Trigger", {})
    console.state.controls.set(
        (RobotControl("wave", "Wave", "button", call), RobotControl("dock", "Dock", "button", call, confirm=True))
    )
    console.state.mapping.set(MapStatus(can_save=True, can_switch=True, mapping=False))
    entries = window.palette_entries()
    best = {
        query: Finder(entries).matching(query)[0] for query in ("robot wave", "tiago", "start mapping", "diagnostics")
    }
    assert {query: entry.text for query, entry in best.items()} == {
        "robot wave": "Robot: Wave", "tiago": "Connect to TIAGo", "start mapping": "Start mapping",
        "diagnostics": "Diagnostics",
    }  # fmt: skip
    best["robot wave"].do()
    best["start mapping"].do()
    assert console.calls == [("use_control", ("wave", True)), ("set_mapping", True)]
    Finder(entries).matching("robot dock")[0].do()
    assert len(console.named("use_control")) == 1
    assert find(window, "question_band").accessibleName() == "Dock?"


def test_a_scenario_that_the_program_opens_automatically_is_shown(
    qtbot: QtBot, settings: MemorySettings, theme: Theme
) -> None:
    console = FakeConsole(samples.TOUR, {samples.MENTAL.path: samples.MENTAL})  # type: ignore[dict-item]
    window = open_window(qtbot, console, settings, theme)
    assert samples.MENTAL.path is not None
    console.open_scenario(samples.MENTAL.path)
    assert set(window.panels) == set(panels_in(samples.MENTAL.layout))
    assert window.windowTitle().startswith("Mental health check")


def test_saving_a_place_keeps_what_is_typed_and_the_panels(window: MainWindow, console: FakeConsole) -> None:
    window.open_panel("diagnostics")
    find(window, "speak_field").setFocus()
    QTest.keyClicks(find(window, "speak_field"), "half a sent")
    console.scenario = dataclasses.replace(samples.TOUR, places=(), path=Path("/own/tour_guide.yaml"), sha256="other")
    console.state.scenario.set(console.scenario)
    assert find(window, "speak_field").property("text") == "half a sent"
    assert "diagnostics" in window.panels


def test_saving_the_layout_keeps_what_is_typed(qtbot: QtBot, settings: MemorySettings, theme: Theme) -> None:
    console = FakeConsole(samples.TOUR, {samples.MENTAL.path: samples.MENTAL})  # type: ignore[dict-item]
    window = open_window(qtbot, console, settings, theme)
    window.open_panel("diagnostics")
    tree = window.dock_host.tree
    assert tree is not None
    copy = dataclasses.replace(samples.TOUR, layout=tree, path=Path("/own/tour_guide.yaml"), sha256="other")
    console._others[Path("/own/tour_guide.yaml")] = copy
    find(window, "speak_field").setFocus()
    QTest.keyClicks(find(window, "speak_field"), "half a sent")
    console.open_scenario(Path("/own/tour_guide.yaml"))
    assert find(window, "speak_field").property("text") == "half a sent"
    assert "diagnostics" in window.panels
    window.close_panel("diagnostics")
    assert "diagnostics" in window.panels, "it belongs to the scenario now, and is closed like the others"
    assert not window.dock_host.is_open("diagnostics")


def test_the_status_bar_shows_what_is_old_and_what_was_refused(window: MainWindow, console: FakeConsole) -> None:
    bar = window.status_bar
    bar.refresh()
    assert (bar.items["refused"].text, bar.items["pose"].text) == ("", "")
    now_ns = clock.now_ns()
    console.state.traffic.set({"control": TrafficMeasured(now_ns, "control", "cbor", 3, ())})
    console.state.link.set(
        LinkStatus(
            "connected",
            "Lab robot",
            "ws://lab",
            "",
            12.0,
            text_formatting.session_clock_ms(console.state.present.anchor) - 3.14,
            0.4,
        )
    )
    console.state.add(RobotPose(now_ns - 1_200_000_000, None, Pose2D(0, 0, 0)))
    console.state.add(BatteryState(now_ns - 180_000_000_000, 0.6))
    bar.refresh()
    assert bar.items["refused"].text == "3 messages refused"
    assert bar.items["pose"].text == "pose delayed 1.2 s"
    assert bar.items["battery"].text == "battery 60 %, reported 3 min ago"
    assert "Robot clock 3.1 ± 0.4 ms behind." in bar.items["round_trip"].toolTip()


def test_a_place_of_a_screen_of_another_size_is_no_place(qtbot: QtBot) -> None:
    """Qt refuses the geometry after undocking the computer, and left a window of a few hundred pixels."""
    settings, kept = MemorySettings(), QWidget()
    qtbot.addWidget(kept)
    kept.resize(400, 300)
    geometry = bytearray(kept.saveGeometry().data())
    width_at = 4 + 2 + 2 + 16 + 16 + 4 + 1 + 1  # after magic, version, two rectangles, screen and two flags
    (screen_px,) = struct.unpack_from(">i", geometry, width_at)
    assert screen_px == kept.screen().geometry().width()
    struct.pack_into(">i", geometry, width_at, 2 * screen_px)
    settings.setValue("window/geometry", QByteArray(bytes(geometry)))
    window = QWidget()
    qtbot.addWidget(window)
    place = WindowPlace(window, settings)
    place.restore()
    first_time = QWidget()
    qtbot.addWidget(first_time)
    WindowPlace(first_time, MemorySettings()).restore()
    assert window.size() == first_time.size()
    settings.setValue("window/geometry", "somebody edited the file")
    place.restore()
    assert window.size() == first_time.size()


def test_every_line_of_the_menu_says_what_it_is_about(qtbot: QtBot, window: MainWindow) -> None:
    """The items Dark and Light alone did not explain what "like the system" refers to."""
    click(qtbot, find(window, "window_menu_button"))
    lines = [action.text() for action in window.findChild(QMenu, "window_menu").actions()]
    assert "Dark" not in lines
    assert next(line for line in lines if line.startswith("Appearance: "))
    find(window, "window_menu").close()
