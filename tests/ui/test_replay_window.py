"""Replay window: its title, and its emergency stop button for the connected robot."""

import re
from collections.abc import Iterator

import pytest
from PySide6.QtCore import QPoint, QRect, QSize, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QDialog, QLabel, QPlainTextEdit, QScrollArea, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain.events import Problem
from caris_desktop.live.state import LiveState, PresentClock
from caris_desktop.live.status import LiveRobotsStatus
from caris_desktop.scenario.scenario_model import LayoutNode, PanelLeaf, SplitNode, TabNode
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.video_panel import VideoPanel
from caris_desktop.ui.replay.timeline_view import lower_edge
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from tests.ui import samples
from tests.ui.conftest import MemorySettings, click, find, open_window
from tests.ui.fake_console import FakeConsole
from tests.ui.fake_replay import FakeReplay, sample_overview

pytestmark = pytest.mark.panels("video", "session")

LONG = "The robot of the second floor that everybody calls by its full name " * 4


@pytest.fixture
def replay() -> FakeReplay:
    return FakeReplay(overview=sample_overview())


@pytest.fixture
def window(
    qtbot: QtBot, console: FakeConsole, settings: MemorySettings, theme: Theme, replay: FakeReplay
) -> Iterator[MainWindow]:
    theme.set_choice("dark")
    window = open_window(qtbot, console, settings, theme)
    console.is_replay = True
    window.use_replay(replay)
    window.resize(1366, 768)  # a replay saves its own geometry
    QApplication.processEvents()
    yield window


@pytest.fixture
def past(qtbot: QtBot, settings: MemorySettings, theme: Theme, replay: FakeReplay) -> MainWindow:
    """Replay at a time before the first value, with every panel open."""
    console = FakeConsole(samples.TOUR)
    console.state = LiveState(present=PresentClock(live=False))
    window = MainWindow(console, settings=settings, theme=theme)
    qtbot.addWidget(window)
    window.use_replay(replay)
    window.resize(1366, 768)
    window.show()
    for name in window.board.possible():
        window.open_panel(name)
    return window


def red_button(window: MainWindow) -> ActionButton:
    button = window.findChild(ActionButton, "emergency_stop")
    assert button is not None
    return button


def test_without_a_live_robot_there_is_no_red_button(window: MainWindow) -> None:
    assert find(window, "replay_badge").accessibleName() == "REPLAY"
    assert not red_button(window).isVisible()


@pytest.mark.long("robots0*", "robots2*")
@pytest.mark.parametrize(
    ("robots", "text"),
    [
        (("Simulated robot",), "Stop Simulated robot (live)"),
        (("TIAGo", "Pepper"), "Stop 2 robots (live)"),
        ((LONG,), "Stop The robot of the second… (live)"),
    ],
)
def test_the_red_button_says_whose_stop_it_is(
    window: MainWindow, replay: FakeReplay, robots: tuple[str, ...], text: str
) -> None:
    replay.live_robots.set(LiveRobotsStatus(robots))
    QApplication.processEvents()
    button = red_button(window)
    assert button.isVisible()
    assert button.text() == text
    assert all(robot in button.toolTip() for robot in robots)
    assert window.width() == 1366
    assert window.rect().contains(QRect(button.mapTo(window, QPoint()), button.size()))
    assert button.width() >= button.sizeHint().width()


def test_keys_and_the_red_button_reach_the_live_robot(
    window: MainWindow, replay: FakeReplay, console: FakeConsole
) -> None:
    replay.live_robots.set(LiveRobotsStatus(("Simulated robot",)))
    console.calls.clear()
    focused = QApplication.focusWidget()
    assert focused is not None
    QTest.keyClick(focused, Qt.Key.Key_Escape)
    QTest.keyClick(focused, Qt.Key.Key_Pause)
    QTest.mousePress(red_button(window), Qt.MouseButton.LeftButton)
    assert [name for name, _ in console.calls] == ["stop", "emergency_stop", "emergency_stop"]
    stops = [spec.id for spec in window.actions_table.specs if spec.group == "Safety"]
    assert stops == ["stop", "emergency_stop"], "the sheet of shortcuts tells of them"


def test_a_past_emergency_stop_is_not_latched_now(window: MainWindow, replay: FakeReplay, console: FakeConsole) -> None:
    replay.live_robots.set(LiveRobotsStatus(("Simulated robot",)))
    console.emergency_stop()  # as in the recording
    assert red_button(window).text() == "Stop Simulated robot (live)"
    shown = [widget for widget in window.findChildren(QWidget, "emergency_release") if widget.isVisible()]
    assert shown == [], "nothing is released by a replay"
    replay.live_robots.set(LiveRobotsStatus(("Simulated robot",), emergency_stop=True))
    assert red_button(window).text() == "Emergency stop active (live)"


def test_over_a_dialog_the_button_says_the_same(qtbot: QtBot, window: MainWindow, replay: FakeReplay) -> None:
    replay.live_robots.set(LiveRobotsStatus(("Simulated robot",)))
    dialog = QDialog(window)
    dialog.setModal(True)
    dialog.show()
    qtbot.waitUntil(lambda: dialog.findChild(ActionButton, "emergency_stop_copy") is not None)
    copy = dialog.findChild(ActionButton, "emergency_stop_copy")
    assert copy is not None
    assert copy.text() == "Stop Simulated robot (live)"
    dialog.close()
    dialog.deleteLater()


def test_a_replay_closes_without_a_question(window: MainWindow, console: FakeConsole) -> None:
    assert console.state.recording.value.state == "recording", "then"
    assert window.closing.what_ends() == []
    assert samples.TOUR.title in window.windowTitle()


@pytest.mark.panels()
@pytest.mark.long
def test_the_picture_is_complete_without_scrolling(window: MainWindow) -> None:
    panels, video = find(window, "replay_panels"), window.panels["video"]
    assert isinstance(panels, QScrollArea)
    assert isinstance(video, VideoPanel)
    window.show_scenario(window._console.scenario)  # as at a time with another scenario
    video = window.panels["video"]
    assert isinstance(video, VideoPanel)
    QApplication.processEvents()
    place = QRect(video.view.mapTo(panels.viewport(), QPoint()), video.view.size())
    assert panels.viewport().rect().contains(place)
    assert place.height() > 150
    assert video.findChild(QWidget, "photo_button") is None, "nothing is taken in a replay"


@pytest.mark.parametrize(
    ("tree", "edge"),
    [
        (PanelLeaf("video"), 1.0),
        (TabNode(("map", "video")), 1.0),
        (PanelLeaf("map"), None),
        (SplitNode("vertical", (PanelLeaf("video"), PanelLeaf("map")), (3.0, 1.0)), 0.75),
        (SplitNode("vertical", (PanelLeaf("map"), PanelLeaf("video")), (3.0, 1.0)), 1.0),
        (samples.TOUR.layout, 0.68),
    ],
)
def test_the_end_of_the_picture_is_known_from_the_layout(tree: LayoutNode, edge: float | None) -> None:
    assert lower_edge(tree, "video") == edge


@pytest.mark.long
def test_nothing_is_live_and_nothing_is_waited_for(past: MainWindow) -> None:
    video, map_panel = past.panels["video"], past.panels["map"]
    assert isinstance(video, VideoPanel)
    past.status_bar.refresh()
    said = [label.text() for label in past.findChildren(QLabel)]
    said += [field.placeholderText() for field in past.findChildren(QPlainTextEdit)]
    said += [panel.fact[0] for panel in past.panels.values()]
    said += [item.text for item in past.status_bar.items.values()]
    said += [*video.view.words_without_picture(), map_panel.view.map_state.waiting]  # type: ignore[attr-defined]
    coding = find(past, "coding_words")
    assert isinstance(coding, QLabel)
    said.remove(coding.text())  # annotation is the purpose of this window
    found = [
        text for text in said if re.search(r"\b(live|connecting|wait\w*|yet|as soon as|getting ready)\b", text, re.I)
    ]
    assert found == []
    link = past.status_bar.items["link"]
    assert link.text.endswith(" · recorded"), "another robot may be driven now"
    assert link.role != "green"
    video.view.show_freshness("fresh")
    video.state.frame.freshness = "fresh"
    video._refresh()
    assert video.fact[0].startswith("recorded")


def test_problems_of_the_session_are_history(window: MainWindow, replay: FakeReplay, console: FakeConsole) -> None:
    console.state.add(Problem(1, "error", "The recording stopped", "Nothing is kept.", "Free disk space."))
    assert window.problems.cards == ()
    replay.noticed.emit(Problem(1, "error", "Your annotations are not saved.", "", "Make room."))
    assert [card.problem.what for card in window.problems.cards] == ["Your annotations are not saved."]


@pytest.mark.panels()
@pytest.mark.long
def test_on_a_small_screen_the_timeline_is_a_drawer(qtbot: QtBot, window: MainWindow, replay: FakeReplay) -> None:
    panels, canvas, drawer = find(window, "replay_panels"), find(window, "timeline_view"), "timeline_drawer"
    canvas = canvas.focusProxy()
    assert canvas is not None and canvas.isVisible() and not window.findChild(QWidget, drawer).isVisible()  # type: ignore[union-attr]
    window.resize(683, 384)
    QApplication.processEvents()
    assert window.size() == QSize(683, 384)
    assert panels.isVisible() and not canvas.isVisible()
    video = window.panels["video"]
    assert isinstance(video, VideoPanel)
    shown = QRect(video.view.mapTo(window, QPoint()), video.view.size())
    assert shown.height() >= 90 and shown.bottom() <= find(window, "timeline_view").mapTo(window, QPoint()).y()
    focused = window.focusWidget()
    assert focused is not None
    QTest.keyClick(focused, Qt.Key.Key_Space)
    assert replay.playback.value.playing, "Space plays, wherever the keys are"
    click(qtbot, find(window, drawer))
    assert canvas.isVisible() and not panels.isVisible()
    assert canvas.hasFocus(), "so that a label's key codes"
    click(qtbot, find(window, drawer))
    assert panels.isVisible() and not canvas.isVisible()
    focused = window.focusWidget()
    assert focused is not None
    QTest.keyClick(focused, Qt.Key.Key_T, Qt.KeyboardModifier.ControlModifier)
    assert canvas.isVisible() and canvas.hasFocus()
    click(qtbot, find(window, drawer))
    window.resize(1366, 768)
    QApplication.processEvents()
    assert panels.isVisible() and canvas.isVisible()
    assert not window.findChild(QWidget, drawer).isVisible()  # type: ignore[union-attr]


@pytest.mark.panels()
def test_messages_and_the_field_that_gets_the_keys_are_in_view(qtbot: QtBot, window: MainWindow) -> None:
    panels = find(window, "replay_panels")
    assert isinstance(panels, QScrollArea)
    bar, cards = panels.verticalScrollBar(), window.problems
    assert bar.maximum() > 100
    cards.notify("This is a replay.", "Nothing is said.", "Use the console.")
    for scrolled in (0, bar.maximum()):
        bar.setValue(scrolled)
        QApplication.processEvents()
        place = QRect(cards.mapTo(panels.viewport(), QPoint()), cards.size())
        in_line = cards.line.isVisible() and not cards.isVisible()
        assert in_line or panels.viewport().rect().contains(place), scrolled
    window.actions_table.run("find_said")
    field = QApplication.focusWidget()
    assert field is not None
    assert panels.viewport().rect().contains(QRect(field.mapTo(panels.viewport(), QPoint()), field.size()))
