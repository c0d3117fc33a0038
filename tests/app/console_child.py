"""The real console in a process of its own, told by lines on stdin what keys to press; for tests that stop or kill it.

``python -m tests.app.console_child ADDRESS STUDY_DIR``. Lines: ``press KEY``, ``release KEY``, ``record``,
``end_recording``, ``open SCENARIO_FILE``, ``photo``, ``export``, ``quit``.
Prints a JSON line whenever something that a wizard would see has changed.
"""

import json
import os
import sys
import threading
import time
from pathlib import Path

from PySide6.QtCore import QObject, QSettings, Qt, QTimer, Signal
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication

from caris_desktop.app.console_command import ConsoleRun, default_arguments
from caris_desktop.domain.events import Problem
from caris_desktop.study.trial import TrialDetails


class Driver(QObject):
    """Carries out the lines and reports what is on show."""

    line_read = Signal(str)

    def __init__(self, run: ConsoleRun) -> None:
        super().__init__()
        self._run = run
        self._shown: dict[str, object] = {}
        self._problems: list[str] = []
        self._exports: list[str] = []
        run.console.state.event_happened.connect(self._on_event)
        run.console.session_exported.connect(lambda folder: self._exports.append(str(folder)))
        self.line_read.connect(self._on_line)
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._report)
        self._timer.start(20)
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in sys.stdin:
            self.line_read.emit(line.strip())
        self.line_read.emit("quit")

    def _on_line(self, line: str) -> None:
        word, _, rest = line.partition(" ")
        window = self._run.window
        if word == "press":
            QTest.keyClick(window, Qt.Key.Key_D, Qt.KeyboardModifier.ControlModifier)
            QTest.keyPress(QApplication.focusWidget() or window, Qt.Key(getattr(Qt.Key, f"Key_{rest}")))
        elif word == "release":
            QTest.keyRelease(QApplication.focusWidget() or window, Qt.Key(getattr(Qt.Key, f"Key_{rest}")))
        elif word == "record":
            self._run.console.start_session(TrialDetails(participant="P1"))
        elif word == "end_recording":
            self._run.console.stop_session()
        elif word == "open":
            self._run.console.open_scenario(Path(rest))
        elif word == "photo":
            self._run.console.take_photo()
        elif word == "export":
            self._run.console.export_session()
        elif word == "quit":
            QApplication.closeAllWindows()

    def _on_event(self, event: object) -> None:
        if isinstance(event, Problem):
            self._problems.append(f"{event.what} {event.meaning} {event.advice}")

    def _report(self) -> None:
        console, state = self._run.console, self._run.console.state
        shown: dict[str, object] = {
            "link": state.link.value.state,
            "drive_allowed": state.drive.value.allowed,
            "video": state.frame.freshness,
            "scan": state.scan.freshness,
            "map": state.map.freshness,
            "recording": state.recording.value.state,
            "perception": state.perception.value.state,
            "people_here": len(state.persons.value),
            "session": str(console.session_folder or ""),
            "children": console.child_pids,
            "scenario": console.scenario.title,
            "assistant": state.assistant.value.state,
            "problems": list(self._problems),
            "exports": list(self._exports),
        }
        if shown != self._shown:
            self._shown = shown
            print(json.dumps({"at_ns": time.monotonic_ns(), **shown}), flush=True)


def main(address: str, study: Path) -> int:
    settings = QSettings(str(study.parent / "settings.ini"), QSettings.Format.IniFormat)
    camera = os.environ.get("CARIS_TEST_CAMERA")
    run = ConsoleRun(
        default_arguments(scenario="tour-guide", robot=address, study=study, camera=camera), settings=settings
    )
    run.show()
    driver = Driver(run)
    try:
        return run.application.exec()
    finally:
        driver.deleteLater()
        run.close()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2])))
