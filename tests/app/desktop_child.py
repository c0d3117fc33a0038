"""``console_child`` for a virtual screen: with real key events and SDL's virtual gamepad.

Prints ``TEXT`` and the Speak field's text whenever it changes, ``KEYS`` and the owner of the focus, ``GAMEPAD`` and its
name.
"""

import sys
from pathlib import Path

from PySide6.QtWidgets import QPlainTextEdit

from caris_desktop.app.console_command import ConsoleRun
from tests.app.console_child import Driver, main


class DesktopDriver(Driver):
    def __init__(self, run: ConsoleRun) -> None:
        super().__init__(run)
        field = run.window.findChild(QPlainTextEdit, "speak_field")
        if field is None:
            raise RuntimeError("the scenario has no Speak panel")
        field.textChanged.connect(lambda: print("TEXT", field.toPlainText(), flush=True))
        run.console.state.gamepad.changed.connect(lambda status: print("GAMEPAD", status.name, flush=True))
        run.window.hold.key_owner_changed.connect(lambda owner: print("KEYS", owner, flush=True))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2]), DesktopDriver))
