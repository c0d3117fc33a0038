"""The one QApplication of a program with a window."""

import os
import sys

from PySide6.QtWidgets import QApplication

from caris_desktop import __version__
from caris_desktop.ui.theme import SCALES

_CORES_TO_PAINT_WITH = 4


def the_application(scale: str = "") -> QApplication:
    """The one that exists, or a new one, which shows everything ``scale`` times as large (one of SCALES)."""
    if scale and scale in SCALES:
        os.environ.setdefault("QT_SCALE_FACTOR", scale)
    # Qt cuts larger fills and pictures into pieces for a pool of threads, and waits for all of them. Where other
    # programs keep a few cores busy, the window waits for the processor as many times, and once is enough.
    if (os.cpu_count() or 1) < _CORES_TO_PAINT_WITH:
        os.environ.setdefault("QT_NO_GUI_THREADPOOL", "1")
    existing = QApplication.instance()
    application = existing if isinstance(existing, QApplication) else QApplication(sys.argv[:1])
    application.setApplicationName("CARIS Desktop")
    application.setApplicationVersion(__version__)
    return application
