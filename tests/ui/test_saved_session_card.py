"""Card after a recording: what was saved, and the next steps."""

from dataclasses import replace
from pathlib import Path

import pytest
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import QLabel, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.live.status import RecordingStatus
from caris_desktop.ui.main_window import MainWindow
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("session")

FOLDER = Path("/study/sessions/2026-11-22_10-00-00_P07")


def stop_recording(console: FakeConsole) -> None:
    recording = RecordingStatus("recording", FOLDER, console.state.present.now_ns() - 764 * 10**9, 184_000_000)
    console.state.recording.set(recording)
    console.state.recording.set(replace(recording, state="stopping"))
    console.state.recording.set(replace(recording, state="idle"))


def test_a_stopped_recording_is_named_with_what_can_be_done(
    window: MainWindow, console: FakeConsole, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    monkeypatch.setattr(QDesktopServices, "openUrl", lambda url: opened.append(url.toLocalFile()))
    card = window.findChild(QWidget, "saved_session_card")
    assert card is not None and card.isHidden()
    focus = window.focusWidget()
    stop_recording(console)
    text = find(card, "saved_session_text")
    assert isinstance(text, QLabel) and text.text() == f"{FOLDER.name} · 12:44 · 184 MB"
    assert card.isVisible() and window.focusWidget() is focus, "the keys stay where they are"
    click(qtbot, find(card, "saved_session_folder"))
    assert opened == [str(FOLDER)] and card.isHidden()

    stop_recording(console)
    window.hold.escape_pressed.emit()
    assert card.isHidden()
    stop_recording(console)
    console.state.recording.set(RecordingStatus("starting"))
    assert card.isHidden(), "the next recording has begun"


def test_a_failed_recording_is_not_called_saved(window: MainWindow, console: FakeConsole) -> None:
    console.state.recording.set(RecordingStatus("recording", FOLDER))
    console.state.recording.set(RecordingStatus("failed", FOLDER, detail="The disk is full."))
    card = window.findChild(QWidget, "saved_session_card")
    assert card is not None and card.isHidden()
