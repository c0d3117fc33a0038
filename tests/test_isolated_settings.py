"""Tests of the isolated settings of each test (tests/conftest.py)."""

from pathlib import Path

import pytest
from PySide6.QtWidgets import QFileDialog
from pytestqt.qtbot import QtBot


@pytest.mark.parametrize("turn", ["first", "second"])
def test_a_file_dialog_remembers_within_the_home_of_its_test(qtbot: QtBot, isolated_settings: Path, turn: str) -> None:
    dialog = QFileDialog(None, turn, str(isolated_settings))
    dialog.setOption(QFileDialog.Option.DontUseNativeDialog)
    del dialog  # its destructor writes
    assert (isolated_settings / "xdg_config_home" / "QtProject.conf").is_file()
