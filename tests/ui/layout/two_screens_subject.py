"""Window in a separate process, for the screens of another process; prints the position of the map.

``python -m tests.ui.layout.two_screens_subject SETTINGS [X Y]``: X and Y are the initial position of the floating map.
"""

import sys

from PySide6.QtCore import QRect, QSettings
from PySide6.QtWidgets import QApplication

from caris_desktop.ui.main_window import MainWindow
from tests.ui import samples
from tests.ui.fake_console import FakeConsole


def main() -> None:
    app = QApplication([])
    settings = QSettings(sys.argv[1], QSettings.Format.IniFormat)
    window = MainWindow(FakeConsole(samples.TOUR), settings=settings)
    window.resize(1600, 900)
    window.show()
    app.processEvents()
    if len(sys.argv) > 2:
        window.dock_host.float_panel("map", QRect(int(sys.argv[2]), int(sys.argv[3]), 600, 500))
    app.processEvents()
    place = window.dock_host.docks["map"].window().geometry()
    arrangement = window.dock_host.arrangement
    kept = None if arrangement is None else arrangement.floating[0].place
    print("SCREENS", len(app.screens()))
    print("MAP", place.x(), place.y(), place.width(), place.height())
    print("KEPT", kept)
    settings.sync()
    window.close()


if __name__ == "__main__":
    main()
