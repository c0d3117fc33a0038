"""List of present alarms: opened from the lower edge and from the palette, and cleared automatically."""

import dataclasses

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLabel, QScrollArea, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain.events import ANSWER, Problem
from caris_desktop.live.status import Alarm
from caris_desktop.ui import tokens
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.notifications import AlarmList
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole


@pytest.fixture
def alarms(window: MainWindow) -> AlarmList:
    found = window.findChild(AlarmList)
    assert found is not None
    return found


def wrong(console: FakeConsole, what: str, **more: object) -> None:
    console.state.add(Problem(1, "warning", what, "It means this.", "Do that.", **more))  # type: ignore[arg-type]


def test_the_words_at_the_lower_edge_open_it_and_it_empties_automatically(
    qtbot: QtBot, window: MainWindow, console: FakeConsole, alarms: AlarmList
) -> None:
    button = window.findChild(QWidget, "alarms_button")
    assert button is not None and not button.isVisible()
    link = console.state.link.value
    console.state.link.set(dataclasses.replace(link, state="lost"))
    wrong(console, "Nothing was said.", until="connected", cause=ANSWER)
    wrong(console, "Classes unknown to the detector: cake.")
    assert (button.text(), button.role) == ("2 alarms", "red")  # type: ignore[attr-defined]
    typing = find(window, "speak_field")
    typing.setFocus()
    click(qtbot, find(window, "alarms_button"))
    lost, cake = alarms.rows
    assert "The connection to the robot is lost." in lost.accessibleName()
    assert "Caused by this: Nothing was said." in lost.accessibleDescription(), "what followed from it stands with it"
    wrong(console, "No rosbridge listens there.", until="connected")
    told = lost.accessibleDescription()
    assert "No rosbridge listens there." in told, "why it is so stands with it"
    assert told.index("No rosbridge") < told.index("Caused by this"), "and not among what came of it"
    assert "No rosbridge listens there." in window.problems.cards[0].accessibleName()
    click(qtbot, find(cake, "alarm_seen_to"))
    assert [row.accessibleName() for row in alarms.rows] == [lost.accessibleName()]
    console.state.link.set(link)
    console.ahead_ns = 3_000_000_000
    console.alarms.evaluate()
    assert alarms.rows == ()
    assert find(window, "no_alarm").isVisible()
    assert not button.isVisible()
    QTest.keyClick(alarms, Qt.Key.Key_Escape)
    assert not alarms.isVisible()
    assert window.focusWidget() is typing


def test_opening_it_while_driving_does_not_resume_the_drive(
    qtbot: QtBot, window: MainWindow, console: FakeConsole, alarms: AlarmList
) -> None:
    wrong(console, "Classes unknown to the detector: cake.")
    view = find(window, "video_view")
    view.setFocus()
    console.calls.clear()
    QTest.keyClick(view, Qt.Key.Key_W)
    assert console.calls, "a bare key drove"
    click(qtbot, find(window, "alarms_button"))
    assert alarms.isVisible()
    QTest.keyClick(alarms, Qt.Key.Key_Escape)
    assert not alarms.isVisible()
    console.calls.clear()
    focused = window.focusWidget()
    assert focused is not None
    QTest.keyClick(focused, Qt.Key.Key_W)
    assert console.calls == [], "a click at the lower edge ends driving by bare keys"


def test_the_palette_opens_it_and_the_log_of_what_was_is_one_click_away(
    qtbot: QtBot, window: MainWindow, alarms: AlarmList
) -> None:
    entry = next(entry for entry in window.palette_entries() if entry.text == "Active alarms")
    entry.do()
    assert alarms.isVisible()
    click(qtbot, find(alarms, "alarms_log"))
    assert not alarms.isVisible()
    assert window.board.is_open("session")


def test_a_dismissed_alarm_comes_back_with_the_intent_it_blocks(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    console.state.link.set(dataclasses.replace(console.state.link.value, state="lost"))
    (card,) = window.problems.cards
    click(qtbot, find(card, "problem_dismiss"))
    assert window.problems.cards == ()
    wrong(console, "Going to the kitchen is not possible.", until="connected", cause=ANSWER)
    (card,) = window.problems.cards
    assert card.problem.what == "The connection to the robot is lost."
    assert "Going to the kitchen is not possible." in card.accessibleName()
    what = next(label for label in card.findChildren(QLabel) if label.text() == card.problem.what)
    assert what.font().weight() == tokens.WEIGHT_SEMIBOLD, "what is wrong stands out from the first moment"
    wrong(console, "This scenario does not allow photos.", cause=ANSWER)
    assert [card.problem.what for card in window.problems.cards][1:] == ["This scenario does not allow photos."]
    assert len(console.state.alarms.value) == 1


def test_notes_are_lines_of_the_log_alone(window: MainWindow, console: FakeConsole) -> None:
    console.state.add(Problem(1, "info", "The camera sends its pictures uncompressed.", "", ""))
    assert window.problems.cards == ()
    assert console.state.alarms.value == ()
    assert any("uncompressed" in line for line in window.panels["session"].log_lines())  # type: ignore[attr-defined]


@pytest.mark.panels("speak")
def test_the_list_shows_the_last_line_of_a_new_alarm(
    qtbot: QtBot, window: MainWindow, console: FakeConsole, alarms: AlarmList
) -> None:
    console.state.link.set(dataclasses.replace(console.state.link.value, state="lost"))
    wrong(console, "No response from the robot. Check that it is on. Nothing blocks it. " * 2, until="connected")
    click(qtbot, find(window, "alarms_button"))
    (area,) = alarms.findChildren(QScrollArea)
    for _ in range(2):
        QApplication.processEvents()
        assert area.viewport().height() >= area.widget().heightForWidth(area.viewport().width())
        wrong(console, "Classes unknown to the detector: cake, and many others that nobody has ever heard of. " * 2)


def test_a_popup_grows_with_what_its_alarm_has_caused(window: MainWindow, console: FakeConsole) -> None:
    full = Alarm("disk", "disk", "error", "The disk is full.", "Only events are recorded.", "Free some disk space.", 1)
    caused = ("The disk is filling up: 302 MB left.", "The disk is nearly full: 23 MB left, and then it is full.")
    for count in (1, 2):
        console.state.alarms.set((dataclasses.replace(full, folded=caused[:count]),))
        QApplication.processEvents()
    (card,) = window.problems.cards
    texts = [label for label in card.findChildren(QLabel) if label.isVisible() and label.wordWrap()]
    assert len(texts) == 4
    assert [label.text() for label in texts if label.height() < label.heightForWidth(label.width())] == []
