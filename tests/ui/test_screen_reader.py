"""Each control has a name, a role and a position for a screen reader, and names are unique."""

import gc
import random
import weakref
from collections.abc import Iterator
from dataclasses import replace

import pytest
from PySide6.QtCore import QEvent, QSize, Qt
from PySide6.QtGui import QAccessible, QAccessibleInterface
from PySide6.QtWidgets import QApplication, QLabel, QWidget
from pytestqt.qtbot import QtBot
from shiboken6 import Shiboken

from caris_desktop.domain import clock
from caris_desktop.domain.events import CommandSent, Problem
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import Odometry
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.ui.accessibility import install_accessible_roles
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.motion_panel import MotionPanel
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.window_appearance import ENGLISH
from tests.support.accessibility_check import accessibility_flaws
from tests.ui import samples
from tests.ui.conftest import find, freshen
from tests.ui.every_window import USUAL, EveryWindow
from tests.ui.fake_console import FakeConsole

SCENARIOS = tuple(sorted(path.stem for path in layouts_dir().glob("*.yaml")))


_IN_EVERY_RUN = {"tour-guide", "mental-health-check"}
"""With nearly every permission, and with few."""


@pytest.fixture(
    params=[pytest.param(name, marks=[] if name in _IN_EVERY_RUN else [pytest.mark.long]) for name in SCENARIOS]
)
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
@pytest.mark.long("*1920x1080")
def test_every_control_of_every_scenario_can_be_reported(
    shown: MainWindow, size: QSize, request: pytest.FixtureRequest
) -> None:
    """Each panel is opened on the usual screen; with ``--long`` on the large one too, where names are the same."""
    shown.resize(size)
    settle()
    found = accessibility_flaws(shown)
    for name in shown.board.possible() if size == USUAL or request.config.getoption("--long") else ():
        shown.open_panel(name)
        settle()
        found += [f"{name} opened: {flaw}" for flaw in accessibility_flaws(shown.dock_host.docks[name])]
    assert found == []


@pytest.mark.usefixtures("screen_reader")
@pytest.mark.long
def test_every_control_of_every_window_and_of_a_replay_can_be_reported(theme: Theme) -> None:
    opened, found = EveryWindow(theme, ENGLISH), list[str]()
    for what in ("The microphone is silent.", "No photo was taken."):
        opened.console.state.add(Problem(clock.now_ns(), "warning", what, "Nothing of it is kept.", "Look after it."))
    try:
        for seen in opened.seen():
            if seen.part.isWindow() and seen.part.objectName() == "main_window":
                seen.part.resize(USUAL)
            opened.settle()
            found += [f"{seen.name}: {flaw}" for flaw in accessibility_flaws(seen.part)]
    finally:
        opened.close()
    assert found == []


@pytest.mark.usefixtures("screen_reader")
@pytest.mark.panels("drive")
def test_the_strips_of_motion_are_reported_and_take_no_focus(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    window.open_panel("motion")
    panel = find(window, "motion_panel")
    assert isinstance(panel, MotionPanel)
    plot = panel._widget

    def told() -> str:
        now_ns = clock.now_ns()
        console.state.add(CommandSent(now_ns, 1, Twist2D(0.4, 0.0, 0.0), "keyboard"))
        console.state.add(Odometry(now_ns, None, Pose2D(1.0, 2.0, 0.3), Twist2D(0.0, 0.0, 0.0)))
        return plot.accessibleDescription()

    qtbot.waitUntil(lambda: told().startswith("Commanded: 0.40 m/s forward. Measured: standing still."))
    assert plot.accessibleName() and not [
        part for part in (plot, *plot.findChildren(QWidget)) if part.focusPolicy() != Qt.FocusPolicy.NoFocus
    ]


@pytest.mark.usefixtures("screen_reader")
@pytest.mark.panels("video", "map")
def test_the_picture_the_map_and_the_transcript_have_descriptions(window: MainWindow) -> None:
    told: dict[str, tuple[str, str]] = {}
    for panel, name in (("video", "video_view"), ("map", "map_view"), ("conversation", "transcript")):
        window.open_panel(panel)
        settle()
        interface = QAccessible.queryAccessibleInterface(find(window, name))
        assert interface is not None
        told[name] = interface.role().name, interface.text(QAccessible.Text.Description)
    assert told["video_view"][0] == told["map_view"][0] == "Graphic"
    assert told["video_view"][1].endswith(("Still.", "Moving.")), "as the label on the picture says"
    assert told["video_view"][1].startswith("In the picture: ") and told["map_view"][1].startswith("The robot is at")
    assert told["transcript"][0] == "List"


@pytest.mark.usefixtures("screen_reader")
@pytest.mark.panels("video")
def test_a_lost_link_is_told_at_once(window: MainWindow) -> None:
    console = window._console
    assert isinstance(console, FakeConsole)
    window.open_panel("video")
    settle()
    console.state.link.set(replace(console.state.link.value, state="lost"))
    settle()
    assert find(window, "video_view").accessibleDescription().endswith("No link.")


class _Painted(QWidget):
    accessible_role = QAccessible.Role.Graphic

    def accessible_words(self) -> str:
        return f"with {len(self.children())} in it"


@pytest.mark.usefixtures("screen_reader")
@pytest.mark.long
def test_widgets_come_and_go_while_a_screen_reader_walks_through_them(qapp: QApplication) -> None:
    """Qt deletes an accessible interface with its widget, and widgets are deleted in any order."""
    install_accessible_roles()
    chance, holder = random.Random(7), QWidget()  # noqa: S311 - a test, not cryptography
    ways = (QWidget.deleteLater, Shiboken.delete, lambda widget: widget.setParent(None))
    gone: list[weakref.ref[QWidget]] = []
    for number in range(400):
        one = _Painted(holder)
        one.setAccessibleName(f"number {number}")
        one.setAccessibleDescription("as it was when that was said")
        _Painted(one)
        gone += [weakref.ref(one), weakref.ref(one.children()[0])]
        root = QAccessible.queryAccessibleInterface(holder)
        assert root is not None
        told = [told for told in _walked(root) if told.role() == QAccessible.Role.Graphic]
        assert told[-2].text(QAccessible.Text.Description) == "with 1 in it"
        del one, told, root
        if number % 3:
            chance.choice(ways)(chance.choice(holder.children()))
        if not number % 5:
            QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete.value)
    holder.deleteLater()
    QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete.value)
    del holder
    gc.collect()
    assert not [ref for ref in gone if ref() is not None and Shiboken.isValid(ref())]


def _walked(node: QAccessibleInterface) -> Iterator[QAccessibleInterface]:
    yield node
    for number in range(node.childCount()):
        child = node.child(number)
        if child is not None:
            yield from _walked(child)


@pytest.mark.panels("video")
def test_the_check_sees_what_cannot_be_reported(window: MainWindow) -> None:
    """Negative control: a control without a name, two of one name, one outside the window, and one without a role."""
    nameless, twice, again = (ActionButton(window.theme, text) for text in ("", "Twice", "Twice"))
    beside, silent = ActionButton(window.theme, "Beside the window"), QLabel()
    silent.setFocusPolicy(window.focusPolicy().StrongFocus)
    holder = QWidget(window)
    holder.setGeometry(100, 200, 300, 80)
    unknown = QWidget()
    unknown.setAccessibleName("Drawn by hand")
    beside.setToolTip("<p>Somewhere</p>")
    for number, part in enumerate((nameless, twice, again, beside, silent, unknown)):
        part.setParent(holder)
        part.setGeometry(60 * number, 0, 50, 30)
    beside.move(3000, 0)
    holder.show()
    found = accessibility_flaws(window)
    holder.hide()
    holder.deleteLater()
    for words in (
        "has no name",
        "2 controls share the accessible name 'Twice'",
        "'Beside the window', is at",
        "QLabel ''",
        "'Drawn by hand', has no",
        "has HTML tags in its accessible description: '<p>Somewhere</p>'",
    ):
        assert any(words in flaw for flaw in found), (words, found)
