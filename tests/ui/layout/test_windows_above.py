"""Floating panels above the main window: keys, cards and closing the program."""

import pytest
from PySide6.QtCore import QRect, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.live.status import RecordingStatus
from caris_desktop.scenario.scenario_model import PanelName
from caris_desktop.ui.dock_host import FloatingWindow
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.window_place import clear_place
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole
from tests.ui.test_quit_guard import AskedByTheWindowManager

pytestmark = pytest.mark.panels("video", "speak", "map")


@pytest.fixture
def wide(window: MainWindow) -> MainWindow:
    window.resize(1600, 900)
    QApplication.processEvents()
    return window


def float_at(window: MainWindow, qtbot: QtBot, name: PanelName, place: QRect) -> FloatingWindow:
    at = window.mapToGlobal(window.rect().topLeft())
    window.dock_host.float_panel(name, place.translated(at))
    floating = window.dock_host.docks[name].window()
    assert isinstance(floating, FloatingWindow)
    floating.activateWindow()
    qtbot.waitUntil(lambda: QApplication.activeWindow() is floating)
    return floating


def lies(widget: QWidget) -> QRect:
    return QRect(widget.mapToGlobal(widget.rect().topLeft()), widget.size())


def test_the_program_can_end_and_finds_the_panels_there_again(wide: MainWindow, qtbot: QtBot) -> None:
    floating = float_at(wide, qtbot, "map", QRect(900, 300, 500, 400))
    before = wide.dock_host.arrangement
    assert floating.close(), "else the program goes on without its main window"
    assert wide.dock_host.arrangement == before
    event = AskedByTheWindowManager()
    floating.closeEvent(event)
    assert not event.isAccepted()
    assert wide.dock_host.docks["map"].window() is wide, "its own cross puts it back"


def test_a_window_opened_by_a_key_gets_the_keys(wide: MainWindow, qtbot: QtBot) -> None:
    floating = float_at(wide, qtbot, "map", QRect(1000, 300, 400, 300))
    for ask in (wide.focus_speak, wide.focus_driving, wide.marking.card.write_note, wide.show_command_palette):
        floating.activateWindow()
        qtbot.waitUntil(lambda: QApplication.activeWindow() is floating)
        ask()
        qtbot.waitUntil(wide.isActiveWindow)
    assert QApplication.focusWidget() is find(wide, "palette_field")
    QTest.keyClicks(find(wide, "palette_field"), "quit")
    assert find(wide, "palette_field").property("text") == "quit"
    wide.hold.escape_pressed.emit()
    speaking = float_at(wide, qtbot, "speak", QRect(100, 300, 400, 300))
    wide.activateWindow()
    qtbot.waitUntil(wide.isActiveWindow)
    wide.focus_speak()
    qtbot.waitUntil(lambda: QApplication.activeWindow() is speaking)


def test_an_opened_window_covers_nothing_and_the_keys_go_back(wide: MainWindow, qtbot: QtBot) -> None:
    floating = float_at(wide, qtbot, "map", QRect(980, 300, 600, 400))
    wide.show_command_palette()
    card = wide._palette_overlay.card
    assert not lies(card).intersects(floating.frameGeometry())
    assert floating.isVisible()
    wide.hold.escape_pressed.emit()
    qtbot.waitUntil(lambda: QApplication.activeWindow() is floating)


def test_a_covering_window_moves_away_and_returns(wide: MainWindow, qtbot: QtBot) -> None:
    wide.resize(780, 760)
    floating = float_at(wide, qtbot, "map", QRect(60, 60, 680, 600))
    place, before = floating.geometry(), wide.dock_host.arrangement
    wide.show_command_palette()
    assert not floating.isVisible()
    wide.dock_host.show_everything()
    assert not floating.isVisible(), "whatever is laid out meanwhile"
    wide.hold.escape_pressed.emit()
    assert floating.isVisible()
    assert floating.geometry() == place
    assert wide.dock_host.arrangement == before


@pytest.mark.parametrize(
    ("taken", "left"),
    [
        ((), 490),
        ((QRect(980, 0, 600, 800),), 980 - 620 - 12),
        ((QRect(0, 0, 600, 800),), 612),
        ((QRect(400, 0, 800, 800),), None),
        ((QRect(980, 600, 600, 200),), 490),
    ],
)
def test_a_card_moves_no_further_than_it_must(taken: tuple[QRect, ...], left: int | None) -> None:
    found = clear_place(QRect(490, 24, 620, 438), QRect(16, 24, 1568, 438), taken)
    assert (None if found is None else found.left()) == left


def test_problems_and_notes_are_not_reported_below_a_window(wide: MainWindow, qtbot: QtBot) -> None:
    floating = float_at(wide, qtbot, "map", QRect(0, 60, 700, 800))
    wide.problems.notify("Something happened.", "It matters.", "Do this.", "warning")
    wide.marking.card.write_note()
    for card in (wide.problems, wide.marking.card):
        assert card.isHidden() or not lies(card).intersects(floating.frameGeometry())
    assert wide.marking.card.isVisible()


def test_typing_quit_finds_how_it_is_closed(wide: MainWindow, qtbot: QtBot) -> None:
    for word in ("quit", "exit", "close the"):
        wide.show_command_palette()
        palette = wide._palette_overlay
        palette.field.setText(word)
        assert palette.list.entries[0].text == "Close the console", word
        wide.hold.escape_pressed.emit()
    wide.show_command_palette()
    palette.field.setText("quit")
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    assert wide.isVisible(), "not by one Enter too many"


def test_closing_by_the_palette_asks_first_as_the_cross_does(wide: MainWindow, console: FakeConsole) -> None:
    console.state.recording.set(RecordingStatus(state="recording"))
    console.state.goal.set(None)
    wide.closing.close_window()
    assert wide.isVisible()
    wide.closing._on_agreed(wide.closing.what_ends())
    assert not wide.isVisible()
