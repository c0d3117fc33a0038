"""``console_child`` with the events that end driving.

Further commands: ``key NAME`` (a key stroke), ``click OBJECT_NAME``, ``click_if_there OBJECT_NAME``, ``focus
OBJECT_NAME``, ``dialog`` and ``close_dialog`` (a modal one), ``other_program`` (it comes to the front), ``stall
SECONDS`` (of the GUI), ``clear`` (the emergency stop), ``guard on`` or ``guard off``.
"""

import sys
import time
from pathlib import Path

from PySide6.QtCore import Qt, QTimer
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QDialog, QWidget

from caris_desktop.app.console_command import ConsoleRun
from caris_desktop.domain import intents
from tests.app.console_child import Driver, main


class SafetyDriver(Driver):
    def __init__(self, run: ConsoleRun) -> None:
        super().__init__(run)
        self._dialog: QDialog | None = None

    def _on_line(self, line: str) -> None:
        word, _, rest = line.partition(" ")
        window = self._run.window
        target = QApplication.activeModalWidget() or QApplication.focusWidget() or window
        if word == "press" and self._dialog is None and not window.isActiveWindow():
            # The window needs time to become active again after a dialog.
            QTimer.singleShot(10, self, lambda: self._on_line(line))
        elif word == "key":
            QTest.keyClick(target, Qt.Key(getattr(Qt.Key, f"Key_{rest}")))
        elif word == "click":
            QTest.mouseClick(window.findChild(QWidget, rest), Qt.MouseButton.LeftButton)
        elif word == "click_if_there":
            if (there := window.findChild(QWidget, rest)) is not None:
                QTest.mouseClick(there, Qt.MouseButton.LeftButton)
        elif word == "focus":
            window.findChild(QWidget, rest).setFocus()
        elif word == "dialog":
            self._dialog = QDialog(window)
            self._dialog.setModal(True)
            self._dialog.show()
        elif word == "close_dialog" and self._dialog is not None:
            self._dialog.close()
            self._dialog.deleteLater()
            self._dialog = None
            window.activateWindow()
        elif word == "other_program":
            for state in (Qt.ApplicationState.ApplicationInactive, Qt.ApplicationState.ApplicationActive):
                self._run.application.applicationStateChanged.emit(state)
        elif word == "stall":
            time.sleep(float(rest))
        elif word == "clear":
            self._run.console.do(intents.ReleaseEmergencyStop())
        elif word == "guard":
            self._run.console.do(intents.SetGuard(on=rest == "on"))
        else:
            super()._on_line(line)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2]), SafetyDriver))
