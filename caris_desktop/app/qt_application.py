"""The single QApplication of a program with a window."""

import ctypes
import gc
import logging
import os
import sys
import time

from PySide6.QtCore import QMessageLogContext, QObject, QtMsgType, qInstallMessageHandler
from PySide6.QtGui import qt_set_sequence_auto_mnemonic
from PySide6.QtWidgets import QApplication

from caris_desktop import __version__
from caris_desktop.live.background_worker import new_timer
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
    # A "&" in a name of a file's control or phrase must not give its button the key Alt+letter, which may drive.
    qt_set_sequence_auto_mnemonic(False)
    return application


# Loss of the screen at run time: the display server ends, a remote desktop disconnects, the user logs out.
#
# Xlib and Qt then call ``exit``, which destroys what other threads still use. A program with Python hangs there
# forever, with open microphone and unfinished recording, or crashes. Instead it ends at once, as if killed, which
# every part handles: the link stops the robot, the recorder finishes its files, and the next start offers to continue
# the trial.

_log = logging.getLogger(__name__)
_of_qt = logging.getLogger("qt")

# On logout or shutdown, programs and their screen end in no particular order. Python runs signal handlers while it
# sleeps, so that a termination signal is logged.
_MESSAGE_WITHIN_S = 1.0
_MESSAGES = ("The X11 connection broke", "The Wayland connection broke")
# A screen reader keeps querying parts that are already deleted, and answers late on a busy machine.
_OF_SCREEN_READERS = (
    "Could not find accessible on path", "Received text event for invalid interface", "Subscription string",
    "QSpiApplication::", "AtSpiAdaptor::",
)  # fmt: skip
_LEVELS = {
    QtMsgType.QtDebugMsg: logging.DEBUG, QtMsgType.QtInfoMsg: logging.INFO, QtMsgType.QtWarningMsg: logging.WARNING,
    QtMsgType.QtCriticalMsg: logging.ERROR, QtMsgType.QtFatalMsg: logging.CRITICAL,
}  # fmt: skip


def end_with_screen(application: QApplication) -> None:
    """Install the handlers until :func:`forget_screen`; Qt's own messages go to the log."""
    qInstallMessageHandler(_on_message)
    if application.platformName() == "xcb":
        try:
            ctypes.CDLL("libX11.so.6").XSetIOErrorHandler(_on_x_error)
        except (OSError, AttributeError):
            _log.exception("when the screen goes away the program may hang")


def forget_screen() -> None:
    """Remove the handlers before the interpreter ends and accepts no more calls."""
    qInstallMessageHandler(None)


def _on_message(level: QtMsgType, _context: QMessageLogContext, message: str) -> None:
    usual = message.startswith(_OF_SCREEN_READERS)
    _of_qt.log(logging.DEBUG if usual else _LEVELS.get(level, logging.WARNING), "%s", message)
    if message.startswith(_MESSAGES):
        _end()


def _end() -> None:
    _log.error("The screen is gone: the program ends, and the recorder finishes what is recorded.")
    time.sleep(_MESSAGE_WITHIN_S)
    logging.shutdown()
    os._exit(1)


# Xlib keeps no reference to it.
_on_x_error = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(lambda _display: _end())


_EVERY_MS = 250


class GarbageCollector(QObject):
    """Runs Python's cyclic garbage collector in the GUI thread, as often as Python would.

    By default Python collects in whichever thread allocates next. Qt objects in a cycle would be destroyed there, and
    Qt crashes at their next event.
    """

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self._was_enabled = gc.isenabled()
        gc.disable()
        self._timer = new_timer(self, self._collect)
        self._timer.start(_EVERY_MS)

    def stop(self) -> None:
        """Restore automatic collection."""
        self._timer.stop()
        if self._was_enabled:
            gc.enable()

    def _collect(self) -> None:
        # Collecting a generation includes the younger ones.
        for generation in (2, 1, 0):
            if gc.get_count()[generation] > gc.get_threshold()[generation]:
                gc.collect(generation)
                break
