"""A replay's window in a process of its own, told by lines on stdin what to press.

``python -m tests.app.replay_child SESSION_DIR``. Lines: ``key NAME`` (a key stroke), ``click OBJECT_NAME``, ``quit``.
Prints a JSON line whenever what its top bar says has changed.
"""

import argparse
import json
import sys
import threading

from PySide6.QtCore import QObject, Qt, QTimer, Signal
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication

from caris_desktop.app import replay_command
from caris_desktop.app.replay_command import ReplayRun
from caris_desktop.ui.widgets.buttons import ActionButton


class ReplayDriver(QObject):
    line_read = Signal(str)

    def __init__(self, run: ReplayRun) -> None:
        super().__init__()
        self._run = run
        self._shown: dict[str, object] = {}
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
        if word == "key":
            QTest.keyClick(QApplication.focusWidget() or window, Qt.Key(getattr(Qt.Key, f"Key_{rest}")))
        elif word == "click":
            QTest.mouseClick(window.findChild(ActionButton, rest), Qt.MouseButton.LeftButton)
        elif word == "quit":
            QApplication.closeAllWindows()

    def _report(self) -> None:
        button = self._run.window.findChild(ActionButton, "emergency_stop")
        shown: dict[str, object] = {"red_button": button.text() if button.isVisible() else ""}
        if shown != self._shown:
            self._shown = shown
            print(json.dumps(shown), flush=True)


def main() -> int:
    parser = argparse.ArgumentParser()
    replay_command.add_arguments(parser)
    run = ReplayRun(parser.parse_args())
    run.show()
    driver = ReplayDriver(run)
    try:
        return run.application.exec()
    finally:
        driver.deleteLater()
        run.close()


if __name__ == "__main__":
    sys.exit(main())
