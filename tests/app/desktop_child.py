"""``console_child`` for a virtual screen: real keys come from outside, and the gamepad is SDL's virtual one.

More lines: ``plug``, ``pad AXIS VALUE``, ``unplug``. Prints ``TEXT`` and the Speak field's text whenever it changes,
``KEYS`` and who has them, ``GAMEPAD`` and its name.
"""

import sys
from pathlib import Path

from PySide6.QtCore import QSettings
from PySide6.QtWidgets import QLineEdit

from caris_desktop.app.console_command import ConsoleRun, default_arguments
from tests.app.console_child import Driver
from tests.support.virtual_gamepad import VirtualGamepad


class DesktopDriver(Driver):
    def __init__(self, run: ConsoleRun) -> None:
        super().__init__(run)
        self._pad: VirtualGamepad | None = None
        field = run.window.findChild(QLineEdit, "speak_field")
        if field is None:
            raise RuntimeError("the scenario has no Speak panel")
        field.textChanged.connect(lambda text: print("TEXT", text, flush=True))
        run.console.state.gamepad.changed.connect(lambda status: print("GAMEPAD", status.name, flush=True))
        run.window.hold.key_owner_changed.connect(lambda owner: print("KEYS", owner, flush=True))

    def _on_line(self, line: str) -> None:
        word, _, rest = line.partition(" ")
        if word == "plug":
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
    driver = DesktopDriver(run)
    try:
        return run.application.exec()
    finally:
        driver.deleteLater()
        run.close()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2])))
