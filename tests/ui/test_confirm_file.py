"""Confirmation of a file's references: the listed items, and the effect of each answer."""

from pathlib import Path

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QLabel, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain.intents import ConfirmFile, OpenScenario
from caris_desktop.live.confirmed_files import FileQuestion, FileReference
from caris_desktop.ui.main_window import MainWindow
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole

FILE = Path("/received/<img src=x>.yaml")
OLD = FileReference("address", "https://evil.example/" + "a" * 300, "listening.server")
NEW = FileReference("path", "<b>/etc/passwd</b>\u202e", "cameras.source")
QUESTION = FileQuestion("<h1>Tour</h1>", FILE, "a" * 64, (OLD, NEW), frozenset({OLD}), OpenScenario(FILE))

pytestmark = pytest.mark.panels("map")


@pytest.fixture
def dialog(window: MainWindow, console: FakeConsole) -> QWidget:
    console.state.file_question.reset_value(QUESTION)
    return find(window, "confirm_file_dialog")


def test_everything_is_listed_as_plain_text_and_what_is_new_is_marked(dialog: QWidget) -> None:
    assert not dialog.isModal(), "the robot can be driven and stopped meanwhile"
    labels = dialog.findChildren(QLabel)
    assert all(label.textFormat() is Qt.TextFormat.PlainText for label in labels)
    texts = [label.text().replace("\u200b", "") for label in labels]
    assert "“<h1>Tour</h1>” has changed. May it use this?" in texts
    assert OLD.text in texts
    assert "<b>/etc/passwd</b>\\u202e" in texts
    order = [
        texts.index(text) for text in ("New in this file", "<b>/etc/passwd</b>\\u202e", "Confirmed before", OLD.text)
    ]
    assert order == sorted(order)
    assert dialog.width() <= 860, "no name makes it wider than a screen"


def test_a_yes_is_saved_and_then_the_file_is_requested_again(
    qtbot: QtBot, dialog: QWidget, console: FakeConsole
) -> None:
    click(qtbot, find(dialog, "confirm_file_allow"))
    assert console.named("ConfirmFile") == [ConfirmFile("a" * 64, accepted=True)]
    assert console.named("open_scenario") == [FILE]


@pytest.mark.parametrize("how", ["button", "escape", "close"])
def test_everything_else_is_a_no(qtbot: QtBot, dialog: QWidget, console: FakeConsole, how: str) -> None:
    if how == "button":
        click(qtbot, find(dialog, "confirm_file_cancel"))
    elif how == "escape":
        QTest.keyClick(dialog, Qt.Key.Key_Escape)
    else:
        dialog.close()
    assert console.named("ConfirmFile") == [ConfirmFile("a" * 64, accepted=False)]
    assert console.named("open_scenario") == []


def test_another_question_takes_the_place_of_the_one_before(
    dialog: QWidget, window: MainWindow, console: FakeConsole
) -> None:
    console.state.file_question.reset_value(FileQuestion("B", FILE, "b" * 64, (NEW,), frozenset(), OpenScenario(FILE)))
    open_now = [one for one in window.findChildren(QWidget, "confirm_file_dialog") if one.isVisible()]
    assert len(open_now) == 1
    assert open_now[0] is not dialog
