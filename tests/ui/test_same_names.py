"""Import conflict of scenario files: the question, the display and the result."""

from dataclasses import replace
from pathlib import Path

import pytest
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QComboBox, QLabel, QLineEdit, QPlainTextEdit, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain.intents import ImportScenario, SameName
from caris_desktop.scenario.bundle import BundledFile, ImportQuestion, NameConflict
from caris_desktop.scenario.scenario_file import scenario_text
from caris_desktop.ui.main_window import MainWindow
from tests.ui import samples
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole

THERE = scenario_text(samples.TOUR)
THEIRS = scenario_text(replace(samples.TOUR, title="Their tour"))
FILE = Path("/received/tour.caris")
QUESTION = ImportQuestion(
    FILE,
    (
        NameConflict(BundledFile("scenario", "tour", THEIRS), Path("/mine/tour.yaml"), THERE, True, "tour-2"),
        NameConflict(
            BundledFile("robot", "tiago", "title: Theirs"), Path("/came/tiago.yaml"), "title: x", False, "tiago-2"
        ),
    ),
)

pytestmark = pytest.mark.panels("map")


@pytest.fixture
def dialog(window: MainWindow, console: FakeConsole) -> QWidget:
    console.state.import_question.reset_value(QUESTION)
    return find(window, "same_names_dialog")


def imported(console: FakeConsole) -> list[object]:
    return console.named("ImportScenario")


def test_both_are_saved_under_a_name_that_is_shown_and_can_be_changed(
    qtbot: QtBot, dialog: QWidget, console: FakeConsole
) -> None:
    assert not dialog.isModal(), "the robot can be driven and stopped meanwhile"
    name = find(dialog, "new_name_scenario")
    assert isinstance(name, QLineEdit) and name.text() == "tour-2"
    name.setText("their-tour")
    click(qtbot, find(dialog, "same_names_import"))
    decided = (SameName("scenario", "tour", "their-tour"), SameName("robot", "tiago", "tiago-2"))
    assert imported(console) == [ImportScenario(FILE, decided)]


def test_own_files_can_be_replaced_and_shipped_ones_cannot(qtbot: QtBot, dialog: QWidget, console: FakeConsole) -> None:
    of_robot, of_scenario = (find(dialog, f"same_name_choice_{kind}") for kind in ("robot", "scenario"))
    assert isinstance(of_robot, QComboBox) and isinstance(of_scenario, QComboBox)
    assert (of_robot.count(), of_scenario.count()) == (1, 2)
    of_scenario.setCurrentIndex(1)
    assert not dialog.findChildren(QLineEdit, "new_name_scenario")[0].isVisible()
    click(qtbot, find(dialog, "same_names_import"))
    decided = (SameName("scenario", "tour"), SameName("robot", "tiago", "tiago-2"))
    assert imported(console) == [ImportScenario(FILE, decided)]


@pytest.mark.parametrize(
    ("name", "said"), [("tour", "already exists"), ("a b", "letters, digits"), ("", "letters, digits")]
)
def test_a_name_that_cannot_be_is_reported_at_once(dialog: QWidget, name: str, said: str) -> None:
    field, refusal = find(dialog, "new_name_scenario"), dialog.findChild(QLabel, "same_names_refusal")
    assert isinstance(field, QLineEdit) and refusal is not None
    assert find(dialog, "same_names_import").isEnabled()
    field.clear()
    QTest.keyClicks(field, name)
    assert said in refusal.text()
    assert not find(dialog, "same_names_import").isEnabled()


def test_cancel_changes_nothing(qtbot: QtBot, dialog: QWidget, console: FakeConsole) -> None:
    click(qtbot, find(dialog, "same_names_cancel"))
    assert imported(console) == []


def test_differences_are_shown_in_words_and_line_by_line(qtbot: QtBot, dialog: QWidget) -> None:
    click(qtbot, find(dialog, "what_differs_scenario"))
    shown = find(dialog, "differences_scenario")
    assert isinstance(shown, QPlainTextEdit)
    lines = shown.toPlainText().splitlines()
    assert lines[0].startswith("title: ") and "Their" in lines[0]
    assert "-title: Tour guide" in lines and "+title: Their tour" in lines
