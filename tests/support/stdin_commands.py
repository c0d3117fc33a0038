"""A window in a separate process that does what the lines on stdin say; for tests that press its keys or kill it."""

import json
import sys
import threading
import time
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, QTimer, Signal

if TYPE_CHECKING:
    from caris_desktop.app.console_command import ConsoleRun
    from caris_desktop.app.replay_command import ReplayRun


class ToldByLines(QObject):
    """Each line goes to ``_on_line``, in the GUI thread; at the end of stdin that is ``quit``."""

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


class Reporter(ToldByLines):
    """Prints what is on show as a line of JSON, whenever that has changed."""

    def __init__(self) -> None:
        super().__init__()
        self._shown: dict[str, object] = {}
        self._timer = QTimer(self, interval=20)
        self._timer.timeout.connect(self._report)
        self._timer.start()

    def _report(self) -> None:
        shown = self._on_show()
        if shown != self._shown:
            self._shown = shown
            print(json.dumps({"at_ns": time.monotonic_ns(), **shown}), flush=True)

    def _on_show(self) -> dict[str, object]:
        raise NotImplementedError


def attend(run: "ConsoleRun | ReplayRun", reporter: Reporter) -> int:
    """Until the window is closed."""
    try:
        return run.application.exec()
    finally:
        reporter.deleteLater()
        run.close()
