"""Settings of another version and broken ones: migrated, or backed up with a message; the program always starts."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from PySide6.QtCore import QByteArray, QSettings
from pytestqt.qtbot import QtBot

from caris_desktop.app import user_settings
from caris_desktop.app.console_command import ConsoleRun, default_arguments
from caris_desktop.domain.events import Problem

OF_THE_FIRST_RELEASE = r"""[General]
gamepads="[\"a pad\"]"
layouts_before_saving="{\"a.yaml\": {\"saved\": 1}}"
microphone=(none)
scenario=mental-health-check
theme=light
wizard_microphone=Headset

[window]
geometry=@ByteArray(\x1\xd9\xd0\xcb\0\x3)
"""


def opened(path: Path) -> QSettings:
    return QSettings(str(path), QSettings.Format.IniFormat)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "settings.ini"


def copies(file: Path) -> list[Path]:
    return list(file.parent.glob("settings *.ini"))


def test_settings_of_the_first_release_are_brought_into_their_groups(file: Path) -> None:
    file.write_text(OF_THE_FIRST_RELEASE, "utf-8")
    settings = opened(file)
    assert user_settings.bring_up_to_date(settings) is None
    settings.sync()
    again = opened(file)
    assert {key: again.value(key) for key in again.allKeys()} | {"version": int(str(again.value("version")))} == {
        "appearance/theme": "light",
        "gamepad/mappings": '["a pad"]',
        "layout/before_saving": '{"a.yaml": {"saved": 1}}',
        "scenario/last": "mental-health-check",
        "sound/microphone": "(none)",
        "sound/wizard_microphone": "Headset",
        "version": user_settings.VERSION,
        "window/geometry": QByteArray(b"\x01\xd9\xd0\xcb\x00\x03"),
    }
    assert user_settings.bring_up_to_date(again) is None
    assert copies(file) == [], "nothing was lost, so nothing is put aside"


@pytest.mark.logs(r"app\.user_settings: ")
@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"[General]\nversion=99\ntheme=light\nlayers=3\n", "newer version"),
        (b"[General]\nversion=soon\n", "could not be read"),
        (b"[General]\nversion=-4\n", "could not be read"),
        (b'{"theme": "light"}\n', "could not be read"),
        (b"[window]\ngeometry=@ByteArray(\\x1\\xd9\n[rep", "could not be read"),
        (bytes(range(128, 256)) * 40, "could not be read"),
    ],
    ids=["newer", "version no number", "negative version", "json", "cut off", "no text at all"],
)
def test_unreadable_settings_are_saved_as_a_copy_and_reported(file: Path, content: bytes, told: str) -> None:
    file.write_bytes(content)
    settings = opened(file)
    failure = user_settings.bring_up_to_date(settings)
    assert failure is not None
    assert told in failure.what
    (copy,) = copies(file)
    assert copy.read_bytes() == content
    assert str(copy) in failure.advice
    settings.setValue("appearance/theme", "dark")
    settings.sync()
    again = opened(file)
    assert again.allKeys() == ["appearance/theme", "version"]
    assert user_settings.bring_up_to_date(again) is None, "told once"


@pytest.mark.logs(r"app\.user_settings: ")
def test_two_broken_settings_within_a_second_are_both_saved(file: Path) -> None:
    for content in (b"one\n", b"two\n"):
        file.write_bytes(content)
        assert user_settings.bring_up_to_date(opened(file)) is not None
    assert sorted(copy.read_bytes() for copy in copies(file)) == [b"one\n", b"two\n"]


@pytest.mark.logs(r"app\.user_settings: ")
def test_settings_that_are_no_file_are_reported_and_left(tmp_path: Path) -> None:
    (tmp_path / "settings.ini").mkdir()
    failure = user_settings.bring_up_to_date(opened(tmp_path / "settings.ini"))
    assert failure is not None
    assert str(tmp_path / "settings.ini") in failure.advice


@pytest.fixture
def run(qtbot: QtBot, tmp_path: Path, file: Path) -> Iterator[ConsoleRun]:
    file.write_bytes(b"[General]\nversion=99\ntheme=7\n[window]\ngeometry=nonsense\n")
    run = ConsoleRun(default_arguments(study=tmp_path / "study"), settings=opened(file))
    qtbot.addWidget(run.window)
    yield run
    run.close()


@pytest.mark.logs(r"app\.user_settings: |live\.bus: Your settings")
def test_the_console_starts_and_reports_it(run: ConsoleRun, qtbot: QtBot) -> None:
    told: list[Problem] = []
    run.console.state.event_happened.connect(lambda event: told.append(event) if isinstance(event, Problem) else None)
    run.report_settings()
    qtbot.waitUntil(lambda: bool(told))
    assert "newer version" in told[0].what
    assert told[0].severity == "warning"


@pytest.mark.logs(r"app\.user_settings: ")
def test_a_value_of_another_kind_is_forgotten_before_the_window_takes_it(file: Path) -> None:
    file.write_text(f"[General]\nversion={user_settings.VERSION}\n[window]\ngeometry=nonsense\n", "utf-8")
    settings = opened(file)
    assert user_settings.bring_up_to_date(settings) is None
    assert not settings.contains("window/geometry")
