"""Commands on stdin for a window in a separate process, for tests that press its keys or kill it."""

import json
import sys
import threading
import time
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, QTimer, Signal

if TYPE_CHECKING:
    from caris_desktop.app.console_command import ConsoleRun
    from caris_desktop.app.replay_command import ReplayRun


class StdinCommands(QObject):
    """Reader of stdin: passes each line, and ``quit`` at the end of stdin, to ``_on_line`` in the GUI thread."""

    line_read = Signal(str)

    def __init__(self) -> None:
        super().__init__()
        self.line_read.connect(self._on_line)
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in sys.stdin:
            self.line_read.emit(line.strip())
        self.line_read.emit("quit")

    def _on_line(self, line: str) -> None:
        raise NotImplementedError


class StateReporter(StdinCommands):
    """Prints the displayed state as a JSON line whenever it changes."""

    def __init__(self) -> None:
        super().__init__()
        self._shown: dict[str, object] = {}
        self._timer = QTimer(self, interval=20)
        self._timer.timeout.connect(self._report)
        self._timer.start()

    def _report(self) -> None:
        shown = self._state()
        if shown != self._shown:
            self._shown = shown
            print(json.dumps({"at_ns": time.monotonic_ns(), **shown}), flush=True)

    def _state(self) -> dict[str, object]:
        raise NotImplementedError


def run_until_closed(run: "ConsoleRun | ReplayRun", reporter: StateReporter) -> int:
    """Run the event loop until the window is closed."""
    try:
        return run.application.exec()
    finally:
        reporter.deleteLater()
        run.close()
