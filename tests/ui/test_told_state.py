"""Accessible descriptions of stick, map and timeline, with a limited rate."""

import itertools
import math

import numpy as np
import pytest
from PySide6.QtCore import QEvent, QPoint, Qt
from PySide6.QtGui import QAccessible, QFocusEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import LaserScan
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.drive_panel import Joystick
from caris_desktop.ui.robot_motion import nearest_of, nearest_words
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.accessible_descriptions import RecentlyVisible, ThrottledAccessibleDescription
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole
from tests.ui.fake_replay import FakeReplay, open_scene, sample_coding, sample_overview

LEFT = Qt.MouseButton.LeftButton


def told(widget: QWidget) -> str:
    interface = QAccessible.queryAccessibleInterface(widget)
    assert interface is not None
    return interface.text(QAccessible.Text.Description)


def scan_of(ranges_m: list[float], mount: Pose2D | None) -> LaserScan:
    step = 2 * math.pi / len(ranges_m)
    return LaserScan(clock.now_ns(), None, "laser", -math.pi, step, 0.1, 10.0, np.array(ranges_m, np.float32), mount)


class Written:
    """Records the descriptions and the number of requests."""

    def __init__(self) -> None:
        self.asked = 0

    def words(self) -> str:
        self.asked += 1
        return f"state {self.asked}"


def test_nothing_is_requested_without_a_screen_reader(qtbot: QtBot) -> None:
    assert not QAccessible.isActive()
    widget, written = QWidget(), Written()
    qtbot.addWidget(widget)
    state = ThrottledAccessibleDescription(widget, written.words)
    widget.show()
    for _ in range(20):
        state.changed()
    assert (written.asked, told(widget)) == (0, "")


@pytest.mark.usefixtures("screen_reader")
def test_many_changes_are_reported_at_once_and_then_once_more_for_the_last(qtbot: QtBot) -> None:
    widget, written = QWidget(), Written()
    qtbot.addWidget(widget)
    state = ThrottledAccessibleDescription(widget, written.words)
    for _ in range(50):
        state.changed()
    assert (written.asked, told(widget)) == (1, "state 1")
    qtbot.waitUntil(lambda: told(widget) == "state 2")
    assert written.asked == 2


@pytest.mark.usefixtures("screen_reader")
def test_entering_a_region_announces_its_current_state(qtbot: QtBot) -> None:
    widget, written = QWidget(), Written()
    qtbot.addWidget(widget)
    state = ThrottledAccessibleDescription(widget, written.words, every_ms=60_000)
    state.changed()
    state.changed()
    assert told(widget) == "state 1"
    QApplication.sendEvent(widget, QFocusEvent(QEvent.Type.FocusIn))
    assert told(widget) == "state 2"


class Picture:
    """Minimal view with the source of its boxes."""

    def __init__(self) -> None:
        self.boxes: list[tuple[str, bool]] = []

    def visible_detections(self) -> list[tuple[str, bool]]:
        return self.boxes


def test_a_box_that_comes_and_goes_is_a_person_who_is_there() -> None:
    seen, picture, told_of = RecentlyVisible(), Picture(), list[tuple[str, ...]]()
    for quarter in range(40):
        picture.boxes = [("Ada", True)] if quarter < 10 and quarter % 2 else []
        seen.add(picture, quarter / 4)  # type: ignore[arg-type]
        told_of.append(seen.names)
    changes = [names for before, names in itertools.pairwise([("",), *told_of]) if before != names]
    assert changes == [(), ("Ada",), ()]


@pytest.mark.usefixtures("screen_reader")
@pytest.mark.panels("drive")
def test_the_stick_describes_its_command(qtbot: QtBot, theme: Theme) -> None:
    stick = Joystick(theme, use="base")
    qtbot.addWidget(stick)
    stick.resize(200, 200)
    stick.show()
    qtbot.waitUntil(lambda: told(stick) == "At rest")
    QTest.mousePress(stick, LEFT, pos=QPoint(100, 100))
    QTest.mouseMove(stick, QPoint(100, 0))
    qtbot.waitUntil(lambda: told(stick) == "100 % forward")
    QTest.mouseRelease(stick, LEFT, pos=QPoint(100, 0))
    qtbot.waitUntil(lambda: told(stick) == "At rest")
    stick.setEnabled(False)
    qtbot.waitUntil(lambda: told(stick) == "Off")


def test_the_head_stick_turns_the_head(qtbot: QtBot, theme: Theme) -> None:
    stick = Joystick(theme, use="head")
    qtbot.addWidget(stick)
    stick.resize(200, 200)
    stick.show()
    QTest.mousePress(stick, LEFT, pos=QPoint(100, 100))
    QTest.mouseMove(stick, QPoint(0, 100))
    assert stick.command_text() == "head to the left at 100 %"


@pytest.mark.parametrize(
    ("mount", "words"),
    [
        (Pose2D(0, 0, 0), "Nearest obstacle 1.0 m to the left"),
        (Pose2D(0, 0, math.pi / 2), "Nearest obstacle 1.0 m behind"),
        (Pose2D(0, 0, -math.pi / 2), "Nearest obstacle 1.0 m ahead"),
        (Pose2D(1.0, 0, 0), "Nearest obstacle 1.4 m ahead on the left"),
        (None, "The direction of the LIDAR is unknown"),
    ],
)
def test_the_nearest_obstacle_has_a_direction(mount: Pose2D | None, words: str) -> None:
    # Scan from behind over the right to the front left: one return, at 90 degrees to the left.
    assert nearest_words(scan_of([math.inf, math.inf, math.inf, 1.0], mount)) == words


def test_no_return_is_no_obstacle() -> None:
    nothing = scan_of([math.inf, math.nan, 0.0, 11.0], Pose2D(0, 0, 0))
    assert nearest_of(nothing) is None
    assert nearest_words(nothing) == "No obstacle within LIDAR range"


@pytest.mark.usefixtures("screen_reader")
@pytest.mark.panels("map")
def test_the_map_describes_the_nearest_return(window: MainWindow, console: FakeConsole, qtbot: QtBot) -> None:
    plan = find(window, "map_view")
    console.state.add(scan_of([math.inf, 2.5, math.inf, math.inf], Pose2D(0, 0, 0)))

    def hears() -> str:
        QApplication.sendEvent(plan, QFocusEvent(QEvent.Type.FocusIn))
        return told(plan)

    qtbot.waitUntil(lambda: "Nearest obstacle 2.5 m to the right." in hears())


@pytest.mark.usefixtures("screen_reader")
def test_the_timeline_describes_its_position(qtbot: QtBot, theme: Theme) -> None:
    replay = FakeReplay(overview=sample_overview(), coding=sample_coding(120_000))
    scene = open_scene(qtbot, theme, replay)
    canvas = scene.timeline.canvas
    replay.at_ms(34_500)
    qtbot.waitUntil(lambda: "At 00:34.500 of 02:00.000." in told(canvas))
    assert "Shown from 00:00.000 to 02:00.000." in told(canvas)
    overview = replay.overview.value
    assert overview is not None
    marks = sum(moment.kind == "mark" for moment in overview.moments)
    assert f"{marks} marks." in told(canvas) and "annotations by 2 coders" in told(canvas)
    canvas.zoom(4.0)
    qtbot.waitUntil(lambda: "to 02:00.000" not in told(canvas))
