"""Background imports of windows opened later, paused while driving."""

import importlib.util
import sys
from pathlib import Path

import pytest
from PySide6.QtCore import QObject
from pytestqt.qtbot import QtBot

from caris_desktop.ui.panel_manager import MODULES, LateImports
from caris_desktop.ui.panel_table import PANELS
from tests.ui.test_panel_table import LATE


def test_everything_that_can_be_opened_is_among_them() -> None:
    dialogs = {f"caris_desktop.{late}" for late in LATE if "replay" not in late and not late.endswith(".")}
    panels = {f"caris_desktop.ui.panels.{spec.name}_panel" for spec in PANELS.values()}
    assert dialogs | panels <= set(MODULES)
    assert all(importlib.util.find_spec(module) for module in MODULES)


def test_they_wait_while_a_person_drives_and_come_one_at_a_time(
    qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("late_piece_one", "late_piece_two")
    for name in names:
        (tmp_path / f"{name}.py").write_text("")
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(tmp_path)

    def there() -> list[str]:
        return [name for name in names if name in sys.modules]

    driving, window = [True], QObject()
    late = LateImports(lambda: driving[0], window, names)
    late.begin()
    late.import_next()
    assert there() == []
    driving[0] = False
    late.import_next()
    assert there() == ["late_piece_one"]
    late.import_next()
    assert there() == list(names)
    late.end()
    for name in names:
        del sys.modules[name]


def test_they_come_automatically_once_the_window_stands(qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("caris_desktop.ui.panel_manager.BEGIN_AFTER_MS", 0)
    monkeypatch.setattr("caris_desktop.ui.panel_manager.EVERY_MS", 0)
    read: list[str] = []
    asked, window = [], QObject()
    first = (lambda: read.append("scenarios"),)
    late = LateImports(lambda: bool(asked.append(True)), window, ("json", "math"), first=first)
    late.begin()
    qtbot.waitUntil(lambda: len(asked) == 3)
    qtbot.wait(20)
    assert len(asked) == 3, "it ends with the last one"
    assert read == ["scenarios"], "what the palette shows of a scenario is known before it opens"
