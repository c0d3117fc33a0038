"""What can be focused or pressed tells a screen reader its name, what it is and where, and no two are called alike."""

from collections.abc import Iterator

import pytest
from PySide6.QtCore import QSize, Qt
from PySide6.QtWidgets import QApplication, QLabel, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.events import CommandSent, Problem
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import Odometry
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.scenario.file import load_scenario
from caris_desktop.ui.language import ENGLISH
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.motion import MotionPanel
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from tests.support.access_check import told_flaws
from tests.ui import samples
from tests.ui.conftest import find, freshen
from tests.ui.every_window import USUAL, EveryWindow
from tests.ui.fake_console import FakeConsole

SCENARIOS = tuple(sorted(path.stem for path in layouts_dir().glob("*.yaml")))


@pytest.fixture(params=SCENARIOS)
def shown(request: pytest.FixtureRequest, theme: Theme) -> Iterator[MainWindow]:
    console = FakeConsole(load_scenario(layouts_dir() / f"{request.param}.yaml"))
    samples.fill_console(console)
    window = MainWindow(console, theme=theme)
    window.show()
    console.state.close()
    freshen(console)
    settle()
    yield window
    window.close()
    window.deleteLater()


def settle() -> None:
    for _ in range(20):
        QApplication.processEvents()


@pytest.mark.usefixtures("screen_reader")
@pytest.mark.parametrize("size", [QSize(1920, 1080), USUAL], ids=["1920x1080", "1366x768"])
def test_every_control_of_every_scenario_can_be_told(
    shown: MainWindow, size: QSize, request: pytest.FixtureRequest
) -> None:
    """Each panel is opened on the usual screen; with ``--long`` on the large one too, where names are the same."""
    shown.resize(size)
    settle()
    found = told_flaws(shown)
    for name in shown.board.possible() if size == USUAL or request.config.getoption("--long") else ():
        shown.open_panel(name)
        settle()
        found += [f"{name} opened: {flaw}" for flaw in told_flaws(shown.dock_host.docks[name])]
    assert found == []


@pytest.mark.usefixtures("screen_reader")
def test_every_control_of_every_window_and_of_a_replay_can_be_told(theme: Theme) -> None:
    opened, found = EveryWindow(theme, ENGLISH), list[str]()
    for what in ("The microphone is silent.", "No photo was taken."):
        opened.console.state.take(Problem(clock.now_ns(), "warning", what, "Nothing of it is kept.", "Look after it."))
    try:
        for seen in opened.seen():
            if seen.part.isWindow() and seen.part.objectName() == "main_window":
                seen.part.resize(USUAL)
            opened.settle()
            found += [f"{seen.name}: {flaw}" for flaw in told_flaws(seen.part)]
    finally:
        opened.close()
    assert found == []


@pytest.mark.usefixtures("screen_reader")
@pytest.mark.panels("drive")
def test_the_strips_of_motion_are_told_and_take_no_focus(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    window.open_panel("motion")
    panel = find(window, "motion_panel")
    assert isinstance(panel, MotionPanel)
    plot = panel._widget

    def told() -> str:
        now_ns = clock.now_ns()
        console.state.take(CommandSent(now_ns, 1, Twist2D(0.4, 0.0, 0.0), "keyboard"))
        console.state.take(Odometry(now_ns, None, Pose2D(1.0, 2.0, 0.3), Twist2D(0.0, 0.0, 0.0)))
        return plot.accessibleDescription()

    qtbot.waitUntil(lambda: told().startswith("Commanded: 0.40 m/s forward. Measured: standing still."))
    assert plot.accessibleName() and not [
        part for part in (plot, *plot.findChildren(QWidget)) if part.focusPolicy() != Qt.FocusPolicy.NoFocus
    ]


@pytest.mark.panels("video")
def test_the_check_sees_what_cannot_be_told(window: MainWindow) -> None:
    """It would find it: a control without a name, two of one name, one beside the window, and one that says nothing."""
    nameless, twice, again = (ActionButton(window.theme, text) for text in ("", "Twice", "Twice"))
    beside, silent = ActionButton(window.theme, "Beside the window"), QLabel()
    silent.setFocusPolicy(window.focusPolicy().StrongFocus)
    holder = QWidget(window)
    holder.setGeometry(100, 200, 300, 80)
    for number, part in enumerate((nameless, twice, again, beside, silent)):
        part.setParent(holder)
        part.setGeometry(60 * number, 0, 50, 30)
    beside.move(3000, 0)
    holder.show()
    found = told_flaws(window)
    holder.hide()
    holder.deleteLater()
    for words in ("has no name", "2 controls are called 'Twice'", "'Beside the window', lies at", "QLabel ''"):
        assert any(words in flaw for flaw in found), (words, found)
