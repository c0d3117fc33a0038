"""Scenarios as one file: menu items, file dialogs, and requests to the console."""

from dataclasses import replace
from pathlib import Path

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QDialogButtonBox, QFileDialog, QLineEdit, QMenu
from pytestqt.qtbot import QtBot

from caris_desktop.domain import intents
from caris_desktop.scenario.bundle import SUFFIX
from caris_desktop.ui.main_window import MainWindow
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("people")


def choose(qtbot: QtBot, window: MainWindow, line: str) -> QFileDialog:
    """The dialog opened by this line of the scenario menu."""
    click(qtbot, find(window, "scenario_button"))
    menu = window.findChild(QMenu, "scenario_menu")
    assert menu is not None and menu.isVisible()
    action = next(one for one in menu.actions() if one.text() == line)
    QTest.mouseClick(menu, Qt.MouseButton.LeftButton, pos=menu.actionGeometry(action).center())
    dialog = window.findChild(QFileDialog, "scenario_file_dialog")
    assert dialog is not None and dialog.isVisible()
    assert not dialog.isModal(), "the robot can be driven and stopped meanwhile"
    assert dialog.testOption(QFileDialog.Option.DontUseNativeDialog), "the keys that stop it are ours"
    return dialog


def decide(dialog: QFileDialog, button: QDialogButtonBox.StandardButton, *, name: str = "") -> None:
    line, box = dialog.findChild(QLineEdit, "fileNameEdit"), dialog.findChild(QDialogButtonBox, "buttonBox")
    assert line is not None and box is not None
    if name:
        line.selectAll()
        QTest.keyClicks(line, name)
    names = QApplication.activePopupWidget()
    if names is not None:
        names.hide()  # completions would take the click
    QTest.mouseClick(box.button(button), Qt.MouseButton.LeftButton)


def test_a_file_that_is_chosen_is_imported(
    qtbot: QtBot, window: MainWindow, console: FakeConsole, tmp_path: Path
) -> None:
    bundle = tmp_path / f"theirs{SUFFIX}"
    bundle.write_bytes(b"")
    (tmp_path / "other.txt").write_text("")
    dialog = choose(qtbot, window, "Import a scenario…")
    assert dialog.fileMode() is QFileDialog.FileMode.ExistingFile
    dialog.setDirectory(str(tmp_path))
    decide(dialog, QDialogButtonBox.StandardButton.Open, name=bundle.name)
    assert console.named("ImportScenario") == [intents.ImportScenario(bundle)]
    qtbot.waitUntil(lambda: window.findChild(QFileDialog) is None)
    decide(choose(qtbot, window, "Import a scenario…"), QDialogButtonBox.StandardButton.Cancel)
    assert len(console.named("ImportScenario")) == 1, "given up"


def test_the_scenario_in_force_is_written_where_that_is_chosen(
    qtbot: QtBot, window: MainWindow, console: FakeConsole, tmp_path: Path
) -> None:
    console.scenario = replace(console.scenario, path=tmp_path / "my-tour.yaml")
    dialog = choose(qtbot, window, "Export this scenario as one file…")
    line = dialog.findChild(QLineEdit, "fileNameEdit")
    assert line is not None and line.text() == f"my-tour{SUFFIX}", "a name is offered"
    dialog.setDirectory(str(tmp_path))
    decide(dialog, QDialogButtonBox.StandardButton.Save, name="shared")
    assert console.named("ShareScenario") == [intents.ShareScenario(tmp_path / f"shared{SUFFIX}")]
    qtbot.waitUntil(lambda: window.findChild(QFileDialog) is None)
