"""Drives ended by the console itself while other programs use every core.

The real console records, detects people, and shows a log of 2,000 rows and all of its panels, first side by side and
then in tabs, while a direction key is held nearly all the time. In the same run a bare Qt process counts how often its
own timer is more than 150 ms late: the effect of the machine on any program, and the limit for the number of drives
ended by the console. Prints one JSON object.
"""

import argparse
import json
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace

from PySide6.QtCore import QObject, Qt, QTimer
from PySide6.QtTest import QTest

from caris_desktop.domain import clock, intents
from caris_desktop.domain.events import DriveEnded, Marked
from caris_desktop.scenario.scenario_model import LayoutNode, PanelLeaf, PanelName, SplitNode, TabNode
from caris_desktop.ui.panels.session_panel import LOG_ROWS
from tests.benchmarks.burners import Burners
from tests.benchmarks.console_under_load import ConsoleUnderLoad
from tests.benchmarks.screen_and_statistics import on_a_screen, percentiles
from tests.benchmarks.ui_stalls import STALL_MS, LatenessMeter

BURNERS = 4
HELD_S = 4.6
LET_GO_S = 0.4
MARK_EVERY_MS = 500
SETTLED_S = 4.0
ENDED_BY_THE_CONSOLE = "The console stopped responding for a moment"
# Side by side, in three rows.
_ROWS: tuple[tuple[PanelName, ...], ...] = (
    ("video", "map", "people"),
    ("speak", "assistant", "drive", "session"),
    ("motion", "diagnostics", "robot"),
)


class Driver(QObject):
    """Holds a direction key, releases it briefly, and counts ended drives by reason."""

    def __init__(self, load: ConsoleUnderLoad) -> None:
        super().__init__()
        self.drives = 0
        self.ended: Counter[str] = Counter()
        self._load = load
        self._moving = False
        load.state.event_happened.connect(self._on_event)

    def _on_event(self, event: object) -> None:
        if isinstance(event, DriveEnded):
            self.ended[event.reason] += 1

    def drive_for(self, seconds: float) -> None:
        widget = self._load.focus_driving()
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            # Turning on the spot: no obstacle is in the way, whatever the robot did before.
            key = (Qt.Key.Key_A, Qt.Key.Key_D)[self.drives % 2]
            QTest.keyPress(widget, key)
            self.drives += bool(self._load.window.hold.held)
            self._load.let_qt_run(min(HELD_S, max(0.1, until_s - time.monotonic())))
            QTest.keyRelease(widget, key)
            self._load.let_qt_run(LET_GO_S)


def side_by_side() -> LayoutNode:
    rows = tuple(
        SplitNode("horizontal", tuple(PanelLeaf(name) for name in row), tuple(1.0 for _ in row)) for row in _ROWS
    )
    return SplitNode("vertical", rows, (1.0, 1.0, 1.0))


def behind_one_another() -> LayoutNode:
    """Video and Speak in front, all else in tabs behind."""
    return SplitNode(
        "horizontal",
        (
            TabNode(("video", "map", "people", "motion", "diagnostics", "robot"), "video"),
            TabNode(("speak", "assistant", "drive", "session"), "speak"),
        ),
        (2.0, 1.0),
    )


def measure(seconds: float, *, burners: int) -> dict[str, object]:
    load = ConsoleUnderLoad()
    driver = Driver(load)
    for number in range(LOG_ROWS):
        load.state.add(Marked(clock.now_ns(), f"Before {number}"))
    foreign = Burners(burners)
    bare = subprocess.Popen(
        [sys.executable, "-m", "tests.benchmarks.ui_stalls", "--bare", "--seconds", str(seconds)],
        stdout=subprocess.PIPE,
        text=True,
    )
    marks = QTimer(interval=MARK_EVERY_MS)
    marks.timeout.connect(lambda: load.console.do(intents.Mark("again")))
    marks.start()
    meter = LatenessMeter()
    by_layout: dict[str, object] = {}
    layouts = {"panels_open": side_by_side(), "panels_hidden": behind_one_another()}
    for name, layout in layouts.items():
        load.window.show_scenario(replace(load.console.scenario, layout=layout))
        load.let_qt_run(SETTLED_S)  # all panels are rebuilt, pyqtgraph is imported: no driving meanwhile
        before, first = Counter(driver.ended), len(meter.late_ms)
        began = time.monotonic(), time.thread_time()
        driver.drive_for(seconds / len(layouts))
        busy = (time.thread_time() - began[1]) / (time.monotonic() - began[0])
        late_ms = meter.late_ms[first:]
        by_layout[name] = {
            "ended": dict(driver.ended - before),
            "gui_stalls_over_150_ms": sum(late > STALL_MS for late in late_ms),
            "gui_late_ms": percentiles(late_ms),
            "gui_thread_percent": round(100 * busy, 1),
        }
    marks.stop()
    report = load.load()
    bare_report = json.loads(bare.communicate(timeout=60)[0])
    foreign.end()
    load.close()
    return {
        "benchmark": "driving_under_load",
        "seconds": seconds,
        "burners": burners,
        "drives": driver.drives,
        "ended_by_the_console": driver.ended[ENDED_BY_THE_CONSOLE],
        "ended": dict(driver.ended),
        "bare_process_stalls_over_150_ms": bare_report["over_150_ms"],
        "bare_process_ms": bare_report,
        **by_layout,
        "load": report,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--burners", type=int, default=BURNERS)
    arguments = parser.parse_args()
    on_a_screen()
    print(json.dumps(measure(arguments.seconds, burners=arguments.burners)))
