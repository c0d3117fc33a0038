"""Keyboard operation: Tab visits each panel completely in reading order and reaches everything."""

import pytest
from PySide6.QtCore import QSize, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QWidget

from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.window_appearance import ENGLISH
from tests.support.tab_order_check import tab_order, tab_order_flaws
from tests.ui.every_window import USUAL, EveryWindow
from tests.ui.test_screen_reader import settle, shown  # noqa: F401 - a fixture


@pytest.mark.parametrize(
    "size",
    [pytest.param(QSize(1920, 1080), id="1920x1080", marks=pytest.mark.long), pytest.param(USUAL, id="1366x768")],
)
@pytest.mark.long("*1920x1080", "mental-health-check-*", "tour-guide-*")
def test_tab_goes_through_every_scenario_as_it_is_read(shown: MainWindow, size: QSize) -> None:  # noqa: F811
    shown.resize(size)
    settle()
    found = tab_order_flaws(shown)
    for name in shown.board.possible() if size == USUAL else ():
        if name not in shown.dock_host.docks or not shown.dock_host.docks[name].isVisible():
            shown.open_panel(name)
            settle()
            found += [f"{name} opened: {flaw}" for flaw in tab_order_flaws(shown)]
    assert found == []


@pytest.mark.long
def test_tab_goes_through_every_window_and_a_replay_as_it_is_read(theme: Theme) -> None:
    opened, found = EveryWindow(theme, ENGLISH), list[str]()
    try:
        for seen in opened.seen():
            if seen.part.isWindow() and seen.part.objectName() == "main_window":
                seen.part.resize(USUAL)
            if seen.part.windowFlags() & Qt.WindowType.WindowDoesNotAcceptFocus:
                continue  # checked by other tests
            opened.settle()
            found += [f"{seen.name}: {flaw}" for flaw in tab_order_flaws(seen.part)]
    finally:
        opened.close()
    assert found == []


@pytest.mark.panels("video", "map")
def test_tab_stays_in_a_card_and_the_bar_above_it(window: MainWindow) -> None:
    window.show_preflight()
    reached = tab_order(window)
    assert {"preflight_close", "emergency_stop"} <= {part.objectName() for part in reached}
    assert not [part for part in reached if window.dock_host.isAncestorOf(part)], "which the card covers"
    window.hold.escape_pressed.emit()
    assert [part for part in tab_order(window) if window.dock_host.isAncestorOf(part)]


@pytest.mark.panels("video", "map")
def test_shift_tab_reverses_the_order(window: MainWindow) -> None:
    there = tab_order(window)
    back = []
    there[0].setFocus()
    for _ in there:
        QTest.keyClick(QApplication.focusWidget() or window, Qt.Key.Key_Backtab)
        back.append(QApplication.focusWidget())
    assert back == [*reversed(there[1:]), there[0]]


@pytest.mark.panels("drive")
def test_the_check_sees_a_wrong_order(window: MainWindow) -> None:
    """Negative control: a skipped widget and one that is reached too late."""

    class AsMade(QWidget):
        """Window with Qt's default tab order."""

    made = AsMade()
    made.setObjectName("as_made")
    texts = ("First", "Second", "Third", "Mouse only")
    first, second, third, mouse = parts = [ActionButton(window.theme, text) for text in texts]
    for number, part in enumerate(parts):
        part.setParent(made)
        part.setObjectName(part.text())
        part.setGeometry(100 * number, 0, 90, 30)
    mouse.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    QWidget.setTabOrder(first, third)
    QWidget.setTabOrder(third, second)
    made.show()
    made.activateWindow()
    found = tab_order_flaws(made)
    made.close()
    made.deleteLater()
    assert any("'Second' comes after ActionButton 'Third'" in flaw for flaw in found), found
    assert any("'Mouse only', is not reachable by keyboard" in flaw for flaw in found), found
