"""Observer window: displays everything, and sends nothing to the console."""

import dataclasses

import pytest
from PySide6.QtCore import QCoreApplication, QEvent, QPoint, QRect, Qt
from PySide6.QtGui import QGuiApplication
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QAbstractButton, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain.events import Problem
from caris_desktop.ui.conversation.transcript_view import TranscriptView
from caris_desktop.ui.dock_area import PanelTitleBar
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.observer_window import ObserverWindow, Sees
from caris_desktop.ui.panels.session_panel import SessionPanel
from caris_desktop.ui.theme import Theme
from tests.support.window_check import painted_texts
from tests.ui import samples
from tests.ui.conftest import MemorySettings, find, freshen, open_window
from tests.ui.fake_console import FakeConsole


def _opened(window: MainWindow, console: FakeConsole, sees: Sees) -> ObserverWindow:
    samples.converse(console)
    samples.suggest(console)
    window.observers.open(sees)
    observer = window.observers.open_window
    assert observer is not None
    observer.complete()
    for _each in ("window", "columns", "cards"):
        QCoreApplication.sendPostedEvents(None, QEvent.Type.LayoutRequest)
    freshen(console)
    return observer


def _said_in(observer: QWidget) -> str:
    return " ".join(text.text for text in painted_texts(observer))


def _tags_in(observer: QWidget) -> set[str]:
    transcript = observer.findChild(TranscriptView)
    assert transcript is not None and transcript.rows
    return {tag for row in transcript.rows for tag in row.tags}


@pytest.mark.long
def test_everything_permitted_is_there(window: MainWindow, console: FakeConsole) -> None:
    observer = _opened(window, console, "everything")
    assert "Luis" in _said_in(observer)
    assert _tags_in(observer) == {"amused"}


def test_without_names_nobody_is_named_and_nothing_suggested(window: MainWindow, console: FakeConsole) -> None:
    observer = _opened(window, console, "no_names")
    texts = _said_in(observer)
    assert "Luis" not in texts and "Ana" not in texts and "Person" in texts
    assert _tags_in(observer) == set(), "what the wizard thinks of a turn is not for whom it is about"
    cards = [card.text for card in console.state.suggestions.value.cards]
    assert cards and not any(text[:20] in texts for text in cards)


@pytest.mark.parametrize("sees", ["everything", "no_names"])
@pytest.mark.long("everything")
def test_neither_mouse_nor_keys_do_anything_there(window: MainWindow, console: FakeConsole, sees: Sees) -> None:
    observer = _opened(window, console, sees)
    console.calls.clear()
    for x in range(20, observer.width(), 60):
        for y in range(20, observer.height(), 40):
            QTest.mouseClick(observer.windowHandle(), Qt.MouseButton.LeftButton, pos=QPoint(x, y))
    for key in (Qt.Key.Key_W, Qt.Key.Key_P, Qt.Key.Key_M, Qt.Key.Key_F1, Qt.Key.Key_Return):
        QTest.keyClick(observer, key)
    assert [call for call in console.calls if call[0] != "keep_layout"] == []


@pytest.mark.parametrize("sees", ["everything", "no_names"])
@pytest.mark.long("everything")
def test_titles_show_no_control_that_would_do_nothing(window: MainWindow, console: FakeConsole, sees: Sees) -> None:
    observer = _opened(window, console, sees)
    bars = observer.findChildren(PanelTitleBar)
    shown = [button for bar in bars for button in bar.findChildren(QAbstractButton) if button.isVisible()]
    assert len(bars) == (4 if sees == "everything" else 2)
    assert [button.objectName() for button in shown] == []


@pytest.mark.long
def test_another_scenario_takes_away_what_it_forbids(window: MainWindow, console: FakeConsole) -> None:
    _opened(window, console, "everything")
    console.scenario = dataclasses.replace(samples.MENTAL, panels_off=("map",))
    window.show_scenario(console.scenario)
    observer = window.observers.open_window
    assert observer is not None and observer.findChild(QWidget, "map_panel") is None
    observer.close()
    assert window.observers.open_window is None


@pytest.mark.long
def test_earlier_events_are_still_listed_with_another_scenario(window: MainWindow, console: FakeConsole) -> None:
    observer = _opened(window, console, "everything")
    console.state.event_happened.emit(Problem(1, "warning", "The robot waved.", "", ""))
    console.scenario = samples.MENTAL
    window.show_scenario(console.scenario)
    log = observer.findChild(SessionPanel)
    assert log is not None
    assert any("The robot waved." in entry.sentence for entry in log.save_state())


@pytest.mark.long
def test_at_a_switch_it_stays_where_it_is_and_its_panels_come_one_in_a_turn(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    observer = _opened(window, console, "everything")
    observer.setGeometry(40, 50, 900, 700)

    def panels() -> set[str]:
        qtbot.wait(0)  # replaced widgets are deleted in the next pass
        names = ("video_panel", "conversation_panel", "map_panel", "session_panel")
        return {name for name in names if observer.findChild(QWidget, name) is not None}

    before = panels()
    assert len(before) == 4
    console.scenario = dataclasses.replace(samples.MENTAL, panels_off=("map",))
    seen: list[int] = []
    made = observer._make_next
    observer._turn.timeout.disconnect()
    observer._turn.timeout.connect(lambda: seen.append(len(observer._missing)) or made())  # type: ignore[func-returns-value]
    observer.show_scenario()
    assert window.observers.open_window is observer and observer.geometry() == QRect(40, 50, 900, 700)
    qtbot.waitUntil(lambda: not observer._missing)
    assert seen == [3, 2, 1] and panels() == before - {"map_panel"}


class _OtherScreen:
    def availableGeometry(self) -> QRect:
        return QRect(1920, 0, 1600, 900)


@pytest.mark.long
def test_it_opens_on_the_other_screen_where_there_is_one(
    window: MainWindow, console: FakeConsole, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = window.screen()
    here = _opened(window, console, "everything")
    assert own.geometry().contains(here.geometry().center()), "with one screen it is on that"
    here.close()
    monkeypatch.setattr(QGuiApplication, "screens", lambda: [own, _OtherScreen()])
    assert _opened(window, console, "everything").geometry() == QRect(1920, 0, 1600, 900)


@pytest.mark.parametrize("sees", ["everything", "no_names"])
@pytest.mark.long("no_names")
def test_one_that_was_open_as_the_program_ended_is_there_again_for_the_same_eyes(
    qtbot: QtBot, console: FakeConsole, theme: Theme, sees: Sees
) -> None:
    settings = MemorySettings()
    window = open_window(qtbot, console, settings, theme)
    observer = _opened(window, console, sees)
    observer.setGeometry(40, 50, 700, 500)
    window.close()
    again = open_window(qtbot, FakeConsole(samples.TOUR), settings, theme)
    assert again.observers.open_window is None, "not before the window stands"
    again.observers.restore()
    shown = again.observers.open_window
    assert shown is not None and (shown.sees, shown.geometry()) == (sees, QRect(40, 50, 700, 500))
    shown.close()
    again.close()
    third = open_window(qtbot, FakeConsole(samples.TOUR), settings, theme)
    third.observers.restore()
    assert third.observers.open_window is None, "the wizard had closed it"
    third.close()


@pytest.mark.long
def test_after_a_kill_it_is_there_again_too(qtbot: QtBot, console: FakeConsole, theme: Theme) -> None:
    settings = MemorySettings()
    window = open_window(qtbot, console, settings, theme)
    _opened(window, console, "no_names")
    killed = MemorySettings()
    killed.values.update(settings.values)
    window.close()
    again = open_window(qtbot, FakeConsole(samples.TOUR), killed, theme)
    again.observers.restore()
    assert again.observers.open_window is not None and again.observers.open_window.sees == "no_names"
    again.close()


@pytest.mark.parametrize("kept", ["the participant", None, 7, ["everything"]])
@pytest.mark.long
def test_unknown_observer_settings_open_none(qtbot: QtBot, console: FakeConsole, theme: Theme, kept: object) -> None:
    settings = MemorySettings()
    settings.values.update({"observer/sees": kept, "observer/geometry": "nowhere"})
    window = open_window(qtbot, console, settings, theme)
    window.observers.restore()
    assert window.observers.open_window is None
    window.close()


def test_the_signs_begin_at_the_edge_of_the_panels(window: MainWindow, console: FakeConsole) -> None:
    observer = _opened(window, console, "no_names")
    bars = observer.findChildren(PanelTitleBar)
    assert find(observer, "glance").x() == min(bar.mapTo(observer, QPoint()).x() for bar in bars) == 8
