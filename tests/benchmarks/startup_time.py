"""Time from process start to a window that has taken a key, beside a bare PySide6 window. Prints one JSON object.

Each start is a fresh process; the first of each kind compiles to bytecode, as an installation does, and warms the disk
cache; it is not counted.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.benchmarks.screen_and_statistics import on_a_screen, percentiles


def console_takes_a_key() -> None:
    """Child: the real console; prints the monotonic time at which a typed letter stood in the Speak field."""
    from caris_desktop.app import quick_start

    quick_start.begin()
    from PySide6.QtCore import QSettings, QTimer
    from PySide6.QtTest import QTest
    from PySide6.QtWidgets import QPlainTextEdit

    from caris_desktop.app.console_command import ConsoleRun, default_arguments

    with tempfile.TemporaryDirectory() as folder:
        settings = QSettings(str(Path(folder) / "settings.ini"), QSettings.Format.IniFormat)
        run = ConsoleRun(default_arguments(scenario="tour-guide", study=Path(folder) / "study"), settings=settings)
        run.show()
        field = run.window.findChild(QPlainTextEdit, "speak_field")

        def press() -> None:
            QTest.keyClicks(field, "a")
            if field.isVisible() and field.toPlainText() == "a":
                print(time.monotonic_ns(), flush=True)
            run.application.exit(0)

        QTimer.singleShot(0, press)
        run.application.exec()
        run.close()


def bare_window_takes_a_key() -> None:
    """Child: one line edit and nothing else."""
    from PySide6.QtCore import QTimer
    from PySide6.QtTest import QTest
    from PySide6.QtWidgets import QApplication, QPlainTextEdit

    application = QApplication(sys.argv[:1])
    field = QPlainTextEdit()
    field.show()

    def press() -> None:
        QTest.keyClicks(field, "a")
        print(time.monotonic_ns(), flush=True)
        application.exit(0)

    QTimer.singleShot(0, press)
    application.exec()


def _start_s(kind: str) -> float:
    started_ns = time.monotonic_ns()
    child = subprocess.run(
        [sys.executable, "-m", "tests.benchmarks.startup_time", "--child", kind],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        timeout=60,
        env={name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"},
    )
    return (int(child.stdout.split()[0]) - started_ns) / 1e9


def measure(starts: int) -> dict[str, object]:
    samples: dict[str, list[float]] = {"console": [], "bare": []}
    for number in range(starts + 1):
        for kind, times_s in samples.items():
            elapsed_s = _start_s(kind)
            if number:
                times_s.append(elapsed_s)
    return {
        "benchmark": "startup_time",
        "window_takes_key_s": percentiles(samples["console"]),
        "bare_window_s": percentiles(samples["bare"]),
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
