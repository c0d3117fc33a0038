"""Wizard profiles: separate settings; a new wizard starts with the settings from before the first profile."""

from pathlib import Path

import pytest
from PySide6.QtCore import QSettings, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QLineEdit, QMenu
from pytestqt.qtbot import QtBot

from caris_desktop.domain.events import TrialDetails
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.palette.command_palette import CommandPalette
from caris_desktop.ui.preferences import WizardProfiles
from tests.ui.conftest import MemorySettings, click, find
from tests.ui.fake_console import FakeConsole


@pytest.fixture
def kept(tmp_path: Path) -> QSettings:
    return QSettings(str(tmp_path / "settings.ini"), QSettings.Format.IniFormat)


def test_each_wizard_has_her_own_values_also_in_the_next_run(kept: QSettings) -> None:
    profiles = WizardProfiles(kept)
    changes: list[str] = []
    profiles.changed.connect(lambda: changes.append(profiles.current))
    assert (profiles.current, profiles.names) == ("", ())
    profiles.set_value("shortcuts", "of all")
    profiles.choose("Ana")
    assert profiles.value("shortcuts") == "of all", "what was set before she gave her name is not lost"
    assert profiles.own_value("shortcuts") is None
    profiles.set_value("shortcuts", "of Ana")
    profiles.choose(" Tom  Ray/2 ")
    assert profiles.value("shortcuts") == "of all"
    profiles.set_value("shortcuts", "of Tom")
    profiles.choose("ana")
    assert changes == ["Ana", "Tom Ray/2", "Ana"]
    kept.sync()
    again = WizardProfiles(QSettings(kept.fileName(), QSettings.Format.IniFormat))
    assert (again.current, again.names) == ("Ana", ("Ana", "Tom Ray/2"))
    assert [again.value("shortcuts"), again.choose("TOM RAY/2"), again.value("shortcuts")] == ["of Ana", None, "of Tom"]
    again.choose("")
    assert again.value("shortcuts") == "of all"


@pytest.mark.parametrize("broken", ["", "no json", "7", '{"Ana": 1}', '["Ana", 3, "", "ana"]', None])
def test_a_broken_list_of_names_is_no_obstacle(broken: str | None) -> None:
    settings = MemorySettings()
    settings.setValue("wizards/names", broken)
    settings.setValue("wizards/current", "Tom")
    profiles = WizardProfiles(settings)
    assert profiles.current == "Tom"
    profiles.choose("Ana")
    assert profiles.names[0] == "Ana"


def test_no_name_reaches_what_belongs_to_another() -> None:
    settings = MemorySettings()
    profiles = WizardProfiles(settings)
    for name in ("*", "../Ana", "Ana/shortcuts", "names", "current", "%2A", "Ana"):
        profiles.choose(name)
        profiles.set_value("shortcuts", name)
    profiles.choose("")
    assert profiles.value("shortcuts") is None
    for name in ("*", "../Ana", "Ana/shortcuts", "names", "current", "%2A", "Ana"):
        profiles.choose(name)
        assert profiles.value("shortcuts") == name


def test_without_settings_it_is_saved_for_this_run() -> None:
    profiles = WizardProfiles(None)
    profiles.choose("Ana")
    profiles.set_value("x", 3)
    assert (profiles.current, profiles.value("x")) == ("Ana", 3)


def test_the_dialog_before_a_recording_chooses_the_wizard(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    console.suggested = TrialDetails(wizard="Kim")
    for written, chosen in (("Ana", "Ana"), ("", "Ana")):
        window.sessions.open_start_dialog()
        field = find(window, "start_wizard")
        assert isinstance(field, QLineEdit)
        assert field.text() == (window.wizards.current or "Kim")
        field.setText(written)
        click(qtbot, find(window, "start_dialog_begin"))
        assert window.wizards.current == chosen
    assert [details.wizard for details in console.named("start_session")] == ["Ana", ""]


def test_the_window_menu_and_find_anything_choose_the_wizard(window: MainWindow, qtbot: QtBot) -> None:
    for name in ("Ana", "T & M"):
        window.wizards.choose(name)
    window.menus.open_window_menu()
    names = names_of(window)
    offered = [(action.text(), action.isChecked()) for action in names.actions() if not action.isSeparator()]
    assert offered == [("Ana", False), ("T && M", True), ("Not specified", False), ("Another wizard…", False)]
    names.actions()[0].trigger()
    assert window.wizards.current == "Ana"
    close_menus(window)
    wanted = {entry.text: entry for entry in window.palette_entries() if entry.kind == "Wizard"}
    assert list(wanted) == ["Wizard: T & M", "Wizard: not specified"]
    wanted["Wizard: not specified"].do()
    assert window.wizards.current == ""
    palette = window.findChild(CommandPalette)
    assert palette is not None
    for typed, chosen in (("ana", "Ana"), ("Lee", "Lee")):
        window.menus.open_window_menu()
        next(action for action in names_of(window).actions() if action.text() == "Another wizard…").trigger()
        close_menus(window)
        QTest.keyClicks(palette.field, typed)
        QTest.keyClick(palette.field, Qt.Key.Key_Return)
        assert window.wizards.current == chosen


def names_of(window: MainWindow) -> QMenu:
    return next(menu for menu in window.findChildren(QMenu) if menu.title().startswith(("Wizard", "Who is")))


def close_menus(window: MainWindow) -> None:
    for menu in window.findChildren(QMenu):
        menu.close()
