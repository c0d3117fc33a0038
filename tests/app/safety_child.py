"""``console_child`` with the ways in which driving ends.

More lines: ``key NAME`` (a key stroke), ``click OBJECT_NAME``, ``focus OBJECT_NAME``, ``dialog`` and ``close_dialog``
(a modal one), ``other_program`` (it comes to the front), ``stall SECONDS`` (of the GUI), ``clear`` (the
emergency stop), ``guard on`` or ``guard off``, ``plug``, ``pad AXIS VALUE`` and ``unplug`` (a virtual gamepad).
"""

import sys
import time
from pathlib import Path

from PySide6.QtCore import QSettings, Qt, QTimer
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QDialog, QWidget

from caris_desktop.app.console_command import ConsoleRun, default_arguments
from tests.app.console_child import Driver
from tests.support.virtual_gamepad import VirtualGamepad


class SafetyDriver(Driver):
    def __init__(self, run: ConsoleRun) -> None:
        super().__init__(run)
        self._dialog: QDialog | None = None
        self._pad: VirtualGamepad | None = None

    def _on_line(self, line: str) -> None:
        word, _, rest = line.partition(" ")
        window = self._run.window
        target = QApplication.activeModalWidget() or QApplication.focusWidget() or window
        if word == "press" and self._dialog is None and not window.isActiveWindow():
            # The window takes its time to be in front again after a dialog.
            QTimer.singleShot(10, self, lambda: self._on_line(line))
        elif word == "key":
            QTest.keyClick(target, Qt.Key(getattr(Qt.Key, f"Key_{rest}")))
        elif word == "click":
            QTest.mouseClick(window.findChild(QWidget, rest), Qt.MouseButton.LeftButton)
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
            self._run.console.clear_emergency_stop()
        elif word == "guard":
            self._run.console.set_guard(on=rest == "on")
        elif word == "plug":
            self._pad = VirtualGamepad()
        elif word == "pad" and self._pad is not None:
            axis, value = rest.split()
            self._pad.push(int(axis), float(value))
        elif word == "unplug" and self._pad is not None:
            self._pad.unplug()
        else:
            super()._on_line(line)


def main(address: str, study: Path) -> int:
    settings = QSettings(str(study.parent / "settings.ini"), QSettings.Format.IniFormat)
    run = ConsoleRun(default_arguments(scenario="tour-guide", robot=address, study=study), settings=settings)
    run.show()
    driver = SafetyDriver(run)
    try:
        return run.application.exec()
    finally:
        driver.deleteLater()
        run.close()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2])))
