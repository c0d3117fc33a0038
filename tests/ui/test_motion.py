"""Strips of commanded and measured motion."""

import pytest
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.events import CommandSent
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import Odometry
from caris_desktop.live.status import DriveStatus
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panel import PanelContext
from caris_desktop.ui.panels.motion_panel import POINTS, SPAN_S, MotionPanel, RollingBuffer
from tests.support.yardstick import in_yardsticks
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("drive")


@pytest.fixture
def panel(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> MotionPanel:
    panel = MotionPanel(PanelContext(console, window.theme, window.actions_table, window.hold))
    qtbot.addWidget(panel)
    panel.resize(480, 300)
    for button in panel.title_widgets():
        button.setParent(panel)
    panel.show()
    panel._redraw.stop()
    console.state.drive.set(DriveStatus(True, ""))
    return panel


def feed(console: FakeConsole, *, seconds: float) -> None:
    now_ns = clock.now_ns()
    for tick in range(int(seconds * 20)):
        stamp_ns = now_ns - int((seconds - tick / 20) * 1e9)
        console.state.add(CommandSent(stamp_ns, tick, Twist2D(0.4, 0.0, 0.5), "keyboard"))
        console.state.add(Odometry(stamp_ns, None, Pose2D(1.0, 2.0, 0.3), Twist2D(0.3, 0.0, 0.4)))


def test_both_lines_are_drawn_over_the_last_half_minute(panel: MotionPanel, console: FakeConsole) -> None:
    feed(console, seconds=5.0)
    panel._draw()
    seconds, commanded = panel.shown(0, "commanded")
    assert seconds[0] == pytest.approx(-5.0, abs=0.3)
    assert set(commanded.tolist()) == {0.4}
    axis = panel._plots[0].getAxis("left")
    assert axis.tickStrings([0.4], axis.autoSIPrefixScale * axis.scale, 0.1) == ["0.4"], "not in thousandths"
    _, turning = panel.shown(1, "measured")
    assert turning[-1] == pytest.approx(22.9, abs=0.1)


def test_a_pause_of_commands_is_a_gap() -> None:
    strip = RollingBuffer(1)
    for stamp_s in (1.0, 1.1, 5.0, 5.1):
        strip.add(int(stamp_s * 1e9), 0.3)
    rows = strip.window(6.0, gap_s=0.5)
    assert len(rows) == 5
    assert rows[2, 1] != rows[2, 1], "not a number, so that no line is drawn"


@pytest.mark.long
def test_memory_is_bounded(panel: MotionPanel, console: FakeConsole) -> None:
    feed(console, seconds=POINTS / 20 + 60)
    assert panel.sample_count <= 3 * POINTS
    panel._draw()
    seconds, _ = panel.shown(0, "measured")
    assert seconds[0] >= -SPAN_S - 1.0


def test_paused_it_stands_still(qtbot: QtBot, panel: MotionPanel, console: FakeConsole) -> None:
    feed(console, seconds=2.0)
    click(qtbot, find(panel, "motion_pause"))
    before = panel.shown(0, "measured")[0].tolist()
    feed(console, seconds=1.0)
    panel._draw()
    assert panel.shown(0, "measured")[0].tolist() == before
    assert panel.fact[0].startswith("paused")
    click(qtbot, find(panel, "motion_pause"))
    assert panel.shown(0, "measured")[0].tolist() != before


def test_the_limit_of_the_motion_is_named_and_marked(panel: MotionPanel, console: FakeConsole) -> None:
    feed(console, seconds=1.0)
    panel._draw()
    assert panel.fact[0].startswith("0.30 m/s")
    console.state.drive.set(DriveStatus(True, "", guard="blocked", guard_distance_m=0.1))
    for _ in range(3):
        panel._draw()
    assert panel.fact == ("guard: blocked", "amber")
    _, marked = panel._lines[0][2].getData()
    assert marked.max() > 0 > marked.min()


@pytest.mark.long
def test_drawing_is_cheap(panel: MotionPanel, console: FakeConsole) -> None:
    feed(console, seconds=SPAN_S)

    def draw() -> None:
        panel._draw()
        panel.grab()

    cost = in_yardsticks(draw, tries=10)
    print(f"\nmotion strips: {cost:.1f} yardsticks")
    assert cost < 40.0
