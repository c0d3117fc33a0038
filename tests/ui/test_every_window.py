"""No cut-off or overlapping text in a dialog, card or secondary window, on small and usual screens."""

import pytest
from PySide6.QtCore import QSize
from PySide6.QtWidgets import QLabel, QScrollArea, QWidget

from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.containers import Scrolled
from caris_desktop.ui.window_appearance import ENGLISH, TRIAL
from tests.support.window_check import cut_off
from tests.ui.every_window import SMALL, SMALLEST, USUAL, EveryWindow


def _found(theme: Theme, language: str, *screens: QSize) -> tuple[list[str], set[str]]:
    """The flaws, and the names of the checked parts."""
    opened, found, names = EveryWindow(theme, language), list[str](), set[str]()
    try:
        for seen in opened.seen():
            names.add(seen.name.partition(",")[0])
            for screen in screens:
                found += opened.flaws_in(seen, screen)
    finally:
        opened.close()
    return found, names


@pytest.mark.long
def test_every_window_can_be_read_where_there_is_least_room(theme: Theme) -> None:
    theme.set_choice("dark")
    found, names = _found(theme, TRIAL, SMALLEST)
    assert found == []
    assert names == {
        "palette", "keys", "connection", "preflight", "alarms", "first use", "start", "sessions", "sessions found",
        "export", "robot", "robot mapped", "robot offers", "gamepad", "face editor", "layout title", "scenario",
        "observer", "face", "replay", "tier", "agreement", "import", "help",
    }  # fmt: skip


@pytest.mark.parametrize("language", [pytest.param(ENGLISH, marks=pytest.mark.long), TRIAL])
@pytest.mark.long("trial")
def test_the_window_of_a_replay_can_be_read_on_every_screen(theme: Theme, language: str) -> None:
    opened, found = EveryWindow(theme, language), list[str]()
    try:
        for seen in opened.of_the_replay():
            for screen in (USUAL, SMALL, SMALLEST):
                found += opened.flaws_in(seen, screen)
                assert seen.part.size() == screen or not seen.name.startswith("replay")
    finally:
        opened.close()
    assert found == []


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("choice", ["dark", "light"])
@pytest.mark.parametrize("language", [ENGLISH, TRIAL])
def test_every_window_can_be_read_everywhere(theme: Theme, choice: str, language: str) -> None:
    theme.set_choice("light" if choice == "light" else "dark")
    assert _found(theme, language, USUAL, SMALL, SMALLEST)[0] == []


@pytest.mark.panels("video")
def test_the_check_sees_what_cannot_be_scrolled_to(window: MainWindow) -> None:
    """Negative control: a widget wider than an area that scrolls only vertically."""
    wide = QLabel("Further than anybody can scroll")
    wide.setMinimumWidth(400)
    area: QScrollArea = Scrolled(wide)
    area.setParent(window)
    area.setGeometry(100, 200, 200, 80)
    area.show()
    holder: QWidget = window
    found = cut_off(holder)
    area.hide()
    area.deleteLater()
    assert any("cannot be scrolled to" in flaw for flaw in found), found
