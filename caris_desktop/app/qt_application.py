"""The single QApplication of a program with a window."""

import os
import sys

from PySide6.QtWidgets import QApplication

from caris_desktop import __version__
from caris_desktop.ui.theme import SCALES

_CORES_TO_PAINT_WITH = 4


def the_application(scale: str = "") -> QApplication:
    """Existing application, or a new one, scaled by ``scale`` (one of SCALES)."""
    if scale and scale in SCALES:
        os.environ.setdefault("QT_SCALE_FACTOR", scale)
    # Qt splits larger fills and pictures over a thread pool and waits for all threads. When other programs keep few
    # cores busy, the window waits for the processor once per thread; once is enough.
    if (os.cpu_count() or 1) < _CORES_TO_PAINT_WITH:
        os.environ.setdefault("QT_NO_GUI_THREADPOOL", "1")
    existing = QApplication.instance()
    application = existing if isinstance(existing, QApplication) else QApplication(sys.argv[:1])
    application.setApplicationName("CARIS Desktop")
    application.setApplicationVersion(__version__)
    application.setDesktopFileName("caris-desktop")  # by which Wayland finds the icon
    return application
