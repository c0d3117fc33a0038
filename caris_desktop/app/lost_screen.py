"""The screen goes away meanwhile: its server ends, a remote desktop is cut off, somebody logs out.

Xlib and Qt call ``exit`` then, which destroys what other threads still use. A program with Python in it hangs there for
good, with the microphone open and the recording unfinished, or crashes. It ends at once instead, as when it is killed,
for which everything is made: the link stops the robot, the recorder finishes its files, and the next start offers to go
on with the trial.
"""

import ctypes
import logging
import os
import time

from PySide6.QtCore import QMessageLogContext, QtMsgType, qInstallMessageHandler
from PySide6.QtWidgets import QApplication

_log = logging.getLogger(__name__)
_of_qt = logging.getLogger("qt")

# Whoever logs out or shuts the computer down ends programs and their screen in no certain order. Python runs handlers
# of signals while it sleeps, so one that was told to end writes down that it was.
_TOLD_WITHIN_S = 1.0
_SAYS_SO = ("The X11 connection broke", "The Wayland connection broke")
# A screen reader asks again and again for parts that are gone by then, and is late with its answers on a busy machine.
_OF_SCREEN_READERS = (
    "Could not find accessible on path", "Received text event for invalid interface", "Subscription string",
    "QSpiApplication::", "AtSpiAdaptor::",
)  # fmt: skip
_LEVELS = {
    QtMsgType.QtDebugMsg: logging.DEBUG, QtMsgType.QtInfoMsg: logging.INFO, QtMsgType.QtWarningMsg: logging.WARNING,
    QtMsgType.QtCriticalMsg: logging.ERROR, QtMsgType.QtFatalMsg: logging.CRITICAL,
}  # fmt: skip


def end_with_screen(application: QApplication) -> None:
    """From now on; what Qt says of itself goes into the log. Until :func:`forget_screen`."""
    qInstallMessageHandler(_on_message)
    if application.platformName() == "xcb":
        try:
            ctypes.CDLL("libX11.so.6").XSetIOErrorHandler(_on_x_error)
        except (OSError, AttributeError):
            _log.exception("when the screen goes away the program may hang")


def forget_screen() -> None:
    """Before the interpreter ends, which no longer takes calls."""
    qInstallMessageHandler(None)


def _on_message(level: QtMsgType, _context: QMessageLogContext, message: str) -> None:
    usual = message.startswith(_OF_SCREEN_READERS)
    _of_qt.log(logging.DEBUG if usual else _LEVELS.get(level, logging.WARNING), "%s", message)
    if message.startswith(_SAYS_SO):
        _end()


def _end() -> None:
    _log.error("The screen is gone: the program ends, and the recorder finishes what is recorded.")
    time.sleep(_TOLD_WITHIN_S)
    logging.shutdown()
    os._exit(1)


# Xlib keeps no reference to it.
_on_x_error = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(lambda _display: _end())
