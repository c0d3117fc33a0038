"""Takes a picture of the editor of scenarios: ``python packaging/editor_picture.py SCENARIO PICTURE.png [THEME]``."""

import sys
import tempfile
from pathlib import Path

from PySide6.QtCore import QSettings, QTimer
from PySide6.QtWidgets import QWidget

from caris_desktop.app.console_command import ConsoleRun, default_arguments

_SIZE_PX = (1366, 768)
_LOOK_MS, _SETTLED_MS = 50, 3000


def main(scenario: str, picture: Path, theme: str) -> int:
    """As it is after two changes, with the phrases on show. Nothing is saved."""
    with tempfile.TemporaryDirectory() as folder:
        settings = QSettings(str(Path(folder) / "settings.ini"), QSettings.Format.IniFormat)
        arguments = default_arguments(scenario=scenario, theme=theme, study=Path(folder) / "study")
        run = ConsoleRun(arguments, settings=settings)
        run.window.editor.open()

        def change() -> None:
            editor = run.window.editor.editor
            if editor is None:  # its file is still being read
                QTimer.singleShot(_LOOK_MS, change)
                return
            editor.resize(*_SIZE_PX)
            editor.document.set(("permissions", "photos"), False)
            editor.document.set(("phrases", 1, "key"), "Ctrl+G")
            editor.reveal(("phrases", 1, "key"))
            QTimer.singleShot(_SETTLED_MS, lambda: take(editor))

        def take(editor: QWidget) -> None:
            editor.grab().save(str(picture))
            run.application.quit()

        change()
        run.application.exec()
        run.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2]), sys.argv[3] if len(sys.argv) > 3 else "dark"))
