"""Replay window in a separate process with commands on stdin.

``python -m tests.app.replay_child SESSION_DIR``. Commands: ``key NAME`` (a key stroke), ``click OBJECT_NAME``,
``quit``. Prints a JSON line whenever the text of its top bar changes.
"""

import argparse
import sys

from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication

from caris_desktop.app import replay_command
from caris_desktop.app.replay_command import ReplayRun
from caris_desktop.ui.widgets.buttons import ActionButton
from tests.support.stdin_commands import StateReporter, run_until_closed


class ReplayDriver(StateReporter):
    def __init__(self, run: ReplayRun) -> None:
        super().__init__()
        self._run = run

    def _on_line(self, line: str) -> None:
        word, _, rest = line.partition(" ")
        window = self._run.window
        if word == "key":
            QTest.keyClick(QApplication.focusWidget() or window, Qt.Key(getattr(Qt.Key, f"Key_{rest}")))
        elif word == "click":
            QTest.mouseClick(window.findChild(ActionButton, rest), Qt.MouseButton.LeftButton)
        elif word == "quit":
            QApplication.closeAllWindows()

    def _state(self) -> dict[str, object]:
        button = self._run.window.findChild(ActionButton, "emergency_stop")
        return {"red_button": button.text() if button.isVisible() else ""}


def main() -> int:
    parser = argparse.ArgumentParser()
    replay_command.add_arguments(parser)
    run = ReplayRun(parser.parse_args())
    run.show()
    return run_until_closed(run, ReplayDriver(run))


if __name__ == "__main__":
    sys.exit(main())
