"""Time from process start to a painted window that has accepted a key, compared with a bare PySide6 window.

Prints one JSON object.

Each start is a new process. The first of each kind compiles to bytecode, as an installation does, and warms the disk
cache; it is not counted.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from tests.benchmarks.screen_and_statistics import on_a_screen, percentiles


def console_takes_a_key() -> None:
    """Child process with the real console; prints the times of a typed letter in the Speak field and of the first
    paint.
    """

    from caris_desktop.app import command_table

    command_table.begin_quickly()
    from PySide6.QtCore import QSettings, QTimer
    from PySide6.QtTest import QTest
    from PySide6.QtWidgets import QPlainTextEdit

    from caris_desktop.app.console_command import ConsoleRun, default_arguments

    with tempfile.TemporaryDirectory() as folder:
        settings = QSettings(str(Path(folder) / "settings.ini"), QSettings.Format.IniFormat)
        run = ConsoleRun(default_arguments(scenario="tour-guide", study=Path(folder) / "study"), settings=settings)
        run.window.painted.connect(lambda: _notify("painted", then=run.application.quit))
        run.show()
        field = run.window.findChild(QPlainTextEdit, "speak_field")

        def press() -> None:
            QTest.keyClicks(field, "a")
            if field.isVisible() and field.toPlainText() == "a":
                _notify("key", then=run.application.quit)

        QTimer.singleShot(0, press)
        run.application.exec()
        run.close()


def bare_window_takes_a_key() -> None:
    """Child process with a single line edit."""
    from PySide6.QtCore import QTimer
    from PySide6.QtGui import QPaintEvent
    from PySide6.QtTest import QTest
    from PySide6.QtWidgets import QApplication, QPlainTextEdit

    class Field(QPlainTextEdit):
        def paintEvent(self, event: QPaintEvent) -> None:
            super().paintEvent(event)
            QTimer.singleShot(0, lambda: _notify("painted", then=application.quit))

    application = QApplication(sys.argv[:1])
    field = Field()
    field.show()

    def press() -> None:
        QTest.keyClicks(field, "a")
        _notify("key", then=application.quit)

    QTimer.singleShot(0, press)
    application.exec()


_told: dict[str, int] = {}


def _notify(what: str, *, then: Callable[[], None]) -> None:
    """Record the first time of each; call ``then`` once both are known."""
    _told.setdefault(what, time.monotonic_ns())
    if len(_told) == 2:
        print(json.dumps(_told), flush=True)
        _told["done"] = 0
        then()


def _start_s(kind: str) -> dict[str, float]:
    started_ns = time.monotonic_ns()
    child = subprocess.run(
        [sys.executable, "-m", "tests.benchmarks.startup_time", "--child", kind],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        timeout=60,
        env={name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"},
    )
    return {what: (at_ns - started_ns) / 1e9 for what, at_ns in json.loads(child.stdout.splitlines()[0]).items()}


def measure(starts: int) -> dict[str, object]:
    samples: dict[str, list[dict[str, float]]] = {"console": [], "bare": []}
    for number in range(starts + 1):
        for kind, times_s in samples.items():
            elapsed_s = _start_s(kind)
            if number:
                times_s.append(elapsed_s)

    def of(kind: str, what: str) -> dict[str, float]:
        return percentiles([each[what] for each in samples[kind]])

    return {
        "benchmark": "startup_time",
        "window_takes_key_s": of("console", "key"),
        "window_painted_s": of("console", "painted"),
        "bare_window_s": of("bare", "key"),
        "bare_window_painted_s": of("bare", "painted"),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--starts", type=int, default=10)
    parser.add_argument("--child", choices=("console", "bare"))
    arguments = parser.parse_args()
    if arguments.child == "console":
        console_takes_a_key()
    elif arguments.child == "bare":
        bare_window_takes_a_key()
    else:
        on_a_screen()
        print(json.dumps(measure(arguments.starts)))
