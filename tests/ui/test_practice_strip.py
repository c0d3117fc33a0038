"""Practice strip: the next step, and the result saved for the wizard."""

from dataclasses import replace

from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLabel
from pytestqt.qtbot import QtBot

from caris_desktop.domain import intents
from caris_desktop.live.services.practice_service import STEPS
from caris_desktop.live.status import PracticeStatus, PracticeStepStatus
from caris_desktop.ui.first_use import practised
from caris_desktop.ui.main_window import MainWindow
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole


def status_at(now: int) -> PracticeStatus:
    steps = tuple(
        PracticeStepStatus(step.id, "done" if number < now else "now" if number == now else "open")
        for number, step in enumerate(STEPS)
    )
    return PracticeStatus("running", steps, done=now)


def _text(window: MainWindow, name: str) -> str:
    label = find(window, name)
    assert isinstance(label, QLabel)
    return label.text()


def test_it_leads_from_step_to_step_with_the_key_that_does_it(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    assert window.practice.isHidden()
    window.wizards.choose("Ana")
    window.practice.begin()
    assert console.named("BeginPractice") == [intents.BeginPractice("Ana")]
    console.state.practice.set(status_at(2))
    assert "3 of 10" in _text(window, "practice_title") and "F1" in _text(window, "practice_how")
    click(qtbot, find(window, "practice_skip"))
    click(qtbot, find(window, "practice_end"))
    assert console.calls[-2][0] == "SkipPracticeStep" and console.calls[-1][0] == "EndPractice"


def test_the_keys_of_the_first_step_drive_wherever_the_focus_is(window: MainWindow, console: FakeConsole) -> None:
    console.state.practice.set(status_at(0))
    for place in ("speak_field", "people_list"):
        find(window, place).setFocus()
        QApplication.processEvents()
        assert "Hold Alt W, or Alt and the up arrow key" in _text(window, "practice_how")
        QTest.keyPress(find(window, place), Qt.Key.Key_Up, Qt.KeyboardModifier.AltModifier)
        assert console.calls[-1][0] == "drive"
        QTest.keyRelease(find(window, place), Qt.Key.Key_Up, Qt.KeyboardModifier.AltModifier)


def test_the_return_is_on_the_button(window: MainWindow, console: FakeConsole, qtbot: QtBot) -> None:
    ended = replace(status_at(10), state="ended", done=10, score=99, minutes=2.1, back_to="Reception")
    console.state.practice.set(ended)
    assert find(window, "practice_end").accessibleName() == "Back to Reception"
    console.state.practice.set(replace(ended, back_to=""))
    assert find(window, "practice_end").accessibleName() == "Close"
    click(qtbot, find(window, "practice_end"))
    assert console.calls[-1][0] == "EndPractice"
    console.state.practice.set(PracticeStatus())


def test_the_result_is_saved_once_for_the_wizard(window: MainWindow, console: FakeConsole) -> None:
    window.wizards.choose("Ana")
    for score in (70, 82):
        console.state.practice.set(status_at(9))
        ended = replace(status_at(10), state="ended", done=10, score=score, minutes=6.5)
        console.state.practice.set(ended)
        window.practice._show(ended)  # as when a key is changed meanwhile
    assert [run["score"] for run in practised(window.wizards)] == [70, 82]
    assert "82 of 100" in _text(window, "practice_title") and "70" in _text(window, "practice_how")
    window.wizards.choose("Ben")
    assert practised(window.wizards) == []
    console.state.practice.set(PracticeStatus())
    assert window.practice.isHidden()
