"""Stalls of the GUI thread's event loop under full load: video, perception, recording, driving and typing.

A timer of 5 ms in the GUI thread measures its delays; in the same run, the same timer in a bare Qt process measures the
effect of the machine on any program. Prints one JSON object.
"""

import argparse
import json
import subprocess
import sys
import time

from PySide6.QtCore import QCoreApplication, QObject, Qt, QTimer
from PySide6.QtTest import QTest

from caris_desktop.domain import intents
from tests.benchmarks.console_under_load import ConsoleUnderLoad
from tests.benchmarks.screen_and_statistics import on_a_screen, percentiles

PERIOD_MS = 5
STALL_MS = 150.0


class LatenessMeter(QObject):
    """Delay of each tick of a 5 ms timer, in milliseconds."""

    def __init__(self) -> None:
        super().__init__()
        self.late_ms: list[float] = []
        self._last_s = time.monotonic()
        self._timer = QTimer(self)
        self._timer.setTimerType(Qt.TimerType.PreciseTimer)
        self._timer.timeout.connect(self._tick)
        self._timer.start(PERIOD_MS)

    def _tick(self) -> None:
        now_s = time.monotonic()
        self.late_ms.append(max(0.0, (now_s - self._last_s) * 1e3 - PERIOD_MS))
        self._last_s = now_s


def bare_process(seconds: float) -> None:
    """The same timer in a program that does nothing else."""
    application = QCoreApplication(sys.argv[:1])
    meter = LatenessMeter()
    QTimer.singleShot(int(seconds * 1000), application.quit)
    application.exec()
    over = sum(late > STALL_MS for late in meter.late_ms)
    print(json.dumps({**percentiles(meter.late_ms), "over_150_ms": over}))


def measure(seconds: float, cameras: list[str] | None) -> dict[str, object]:
    load = ConsoleUnderLoad(cameras=cameras)
    bare = subprocess.Popen(
        [sys.executable, "-m", "tests.benchmarks.ui_stalls", "--bare", "--seconds", str(seconds)],
        stdout=subprocess.PIPE,
        text=True,
    )
    load.let_qt_run(1.0)
    pad = load.focus_driving()
    meter = LatenessMeter()
    until_s = time.monotonic() + seconds
    number = 0
    while time.monotonic() < until_s:
        key = (Qt.Key.Key_A, Qt.Key.Key_D)[number % 2]
        number += 1
        QTest.keyPress(pad, key)
        load.let_qt_run(0.8)
        QTest.keyRelease(pad, key)
        if number % 4 == 0:
            load.console.do(intents.Say("This is what a wizard says while driving.", "typed"))
        load.let_qt_run(0.2)
    late_ms = list(meter.late_ms)
    report = load.load()
    load.close()
    bare_stalls = json.loads(bare.communicate(timeout=60)[0])
    return {
        "benchmark": "ui_stalls",
        "seconds": seconds,
        "stall_ms": percentiles(late_ms),
        "bare_process_ms": bare_stalls,
        "load": report,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--bare", action="store_true", help="only the timer in a bare process")
    parser.add_argument(
        "--camera", action="append", metavar="SOURCE", help="as that of the console; may be given several times"
    )
    arguments = parser.parse_args()
    if arguments.bare:
        bare_process(arguments.seconds)
    else:
        on_a_screen()
        print(json.dumps(measure(arguments.seconds, arguments.camera)))
