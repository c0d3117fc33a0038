"""Editor next to the main window: opened from there, with the robot controls always available."""

import pytest
from PySide6.QtCore import Qt
from PySide6.QtGui import QCloseEvent
from PySide6.QtTest import QTest
from pytestqt.qtbot import QtBot

from caris_desktop.ui.main_window import MainWindow
from tests.ui import samples
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole
from tests.ui.test_window import choose


def test_it_opens_once_the_disk_has_reported_and_not_where_the_window_closes_before(
    window: MainWindow, console: FakeConsole
) -> None:
    console.disk_is_slow = True
    window.editor.open()
    window.editor.open()
    assert window.editor.editor is None
    console.answer_of_disk()
    editor = window.editor.editor
    assert editor is not None and editor.isVisible()
    editor.close()
    window.editor.open()
    window.editor.close()
    console.answer_of_disk()
    assert window.editor.editor is None


def test_it_opens_from_the_menu_and_driving_and_the_emergency_stop_go_past_it(
    qtbot: QtBot, window: MainWindow, console: FakeConsole, monkeypatch: pytest.MonkeyPatch
) -> None:
    click(qtbot, find(window, "scenario_button"))
    choose(window, "scenario_menu", "Edit this scenario…")
    editor = window.editor.editor
    assert editor is not None
    qtbot.waitUntil(editor.isActiveWindow)
    # It does not cover the emergency stop button, and its lower edge is on the screen.
    red = find(window, "emergency_stop")
    assert editor.frameGeometry().top() > red.mapToGlobal(red.rect().bottomLeft()).y()
    assert editor.frameGeometry().bottom() <= editor.screen().availableGeometry().bottom()
    # While typing, Alt drives here too, and types nothing.
    title = editor.reveal(("title",))
    assert title is not None
    QTest.keyPress(title.control, Qt.Key.Key_Up, Qt.KeyboardModifier.AltModifier)
    assert console.named("drive")[-1][0] > 0
    QTest.keyRelease(title.control, Qt.Key.Key_Up, Qt.KeyboardModifier.AltModifier)
    assert not editor.document.changed
    QTest.keyClick(editor, Qt.Key.Key_Escape)
    QTest.keyClick(editor, Qt.Key.Key_Escape)
    assert console.named("emergency_stop")
    assert editor.isVisible()
    assert any(entry.text == "Edit this scenario…" for entry in window.palette_entries())
    window.editor.open()
    assert window.editor.editor is editor
    # The next opened scenario is edited next, and unsaved changes are not lost without a question.
    assert console.open_scenario(samples.MENTAL.path)
    editor.document.set(("title",), "Another")
    window.editor.open()
    assert window.editor.editor is editor
    assert "The editor shows a different scenario than “Mental health check”" in editor.notice.text.text()
    editor.notice.answers[1].click()
    qtbot.waitUntil(lambda: window.editor.editor not in (None, editor))
    editor = window.editor.editor
    assert editor is not None and editor.document.data["title"] == "Mental health check"
    assert console.open_scenario(samples.TOUR.path)
    window.editor.open()
    qtbot.waitUntil(lambda: window.editor.editor not in (None, editor))
    editor = window.editor.editor
    assert editor is not None and editor.document.data["title"] == "Tour guide"
    # The main window does not close with unsaved changes.
    editor.document.set(("title",), "Another")
    monkeypatch.setattr(QCloseEvent, "spontaneous", lambda _event: True)
    monkeypatch.setattr(window.closing, "asks_first", lambda _event: False)
    assert not window.close()
    editor.notice.answers[1].click()
    assert window.editor.editor is None
