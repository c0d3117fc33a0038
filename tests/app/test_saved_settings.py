"""Settings apply at once, are written soon, and never block the window."""

import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from PySide6.QtCore import QByteArray, QSettings
from pytestqt.qtbot import QtBot

from caris_desktop.app.user_settings import SavedSettings
from caris_desktop.domain.failure import UserFacingError

INI = QSettings.Format.IniFormat


def _in_file(path: Path) -> QSettings:
    return QSettings(str(path), INI)


def test_settings_apply_at_once_and_are_in_the_file_when_the_program_ends(qapp: object, tmp_path: Path) -> None:
    path = tmp_path / "settings.ini"
    before = _in_file(path)
    before.setValue("appearance/theme", "dark")
    kept = SavedSettings(before)
    assert kept.value("appearance/theme") == "dark" and kept.value("sound/microphone", "none") == "none"
    kept.setValue("sound/microphone", "Desk")
    kept.setValue("window/geometry", QByteArray(b"\x00\x01"))
    assert kept.value("sound/microphone") == "Desk"
    kept.finish()
    after = _in_file(path)
    assert after.value("sound/microphone") == "Desk" and after.value("appearance/theme") == "dark"
    assert after.value("window/geometry") == QByteArray(b"\x00\x01")


def test_settings_of_another_window_stay(qapp: object, tmp_path: Path) -> None:
    path = tmp_path / "settings.ini"
    console, replay = SavedSettings(_in_file(path)), SavedSettings(_in_file(path))
    replay.setValue("replay/geometry", QByteArray(b"r"))
    replay.finish()
    console.setValue("window/geometry", QByteArray(b"w"))
    console.finish()
    assert sorted(_in_file(path).allKeys()) == ["replay/geometry", "window/geometry"]


def test_the_thread_of_the_window_writes_nothing(qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = SavedSettings(_in_file(tmp_path / "settings.ini"))
    writing, go_on, by = threading.Event(), threading.Event(), list[threading.Thread]()
    write: Callable[[SavedSettings], None] = SavedSettings._write

    def slow_disk(self: SavedSettings) -> None:
        by.append(threading.current_thread())
        writing.set()
        assert go_on.wait(20)
        write(self)

    monkeypatch.setattr(SavedSettings, "_write", slow_disk)
    kept.setValue("a", "1")
    assert writing.wait(20)
    for number in range(5):  # the disk still does not answer
        kept.setValue("a", str(number))
        assert kept.value("a") == str(number)
    go_on.set()
    kept.finish()
    assert _in_file(tmp_path / "settings.ini").value("a") == "4"
    assert threading.main_thread() not in by and len(by) <= 2, "what was set meanwhile is written together"


def test_a_folder_that_cannot_be_written_to_is_reported_once_and_costs_nothing_else(
    qtbot: QtBot, tmp_path: Path
) -> None:
    (tmp_path / "no folder").write_text("a file")
    kept = SavedSettings(_in_file(tmp_path / "no folder" / "settings.ini"))
    told: list[UserFacingError] = []
    kept.failed.connect(told.append)
    kept.setValue("a", "1")
    qtbot.waitUntil(lambda: bool(told), timeout=20_000)
    kept.setValue("a", "2")
    kept.finish()
    assert len(told) == 1 and "settings.ini" in told[0].advice and kept.value("a") == "2"
