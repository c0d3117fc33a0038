"""Keys that are pressed while the window manager hands them from a window that closes to the one behind it."""

import time
from collections.abc import Callable

from PySide6.QtCore import QObject, Qt, QTimer
from PySide6.QtGui import QGuiApplication, QWindow
from PySide6.QtWidgets import QApplication, QWidget

KEPT_S = 0.6
"""A window manager that is busy may need this long."""
_LOOK_EVERY_MS, _TOLD_MS = 20, 50
_GETS_NO_KEYS = (Qt.WindowType.Popup, Qt.WindowType.ToolTip, Qt.WindowType.SplashScreen)


def had_the_keys(hidden: QWidget) -> bool:
    """Whether it was the window in front; Qt knows of no active one by now, though our program is in front."""
    return (
        QApplication.activeWindow() is None
        and QGuiApplication.applicationState() == Qt.ApplicationState.ApplicationActive
        and hidden.windowType() not in _GETS_NO_KEYS
        and not hidden.windowFlags() & Qt.WindowType.WindowDoesNotAcceptFocus
    )


class KeptKeys(QObject):
    """Takes the keyboard while a window closes, so that no key goes to nobody until another one has the keys.

    On X11 a window that closes leaves the keys to nobody until the window manager has chosen another one: an Esc that
    is pressed then, the second one of an emergency stop, reaches no program at all. Elsewhere the system hands the
    keys on by itself, at once. ``focused_window`` gives the number of the window that has the keys by the X server.
    """

    def __init__(self, focused_window: Callable[[], int], parent: QObject) -> None:
        super().__init__(parent)
        self._focused_window = focused_window
        self._holder: QWindow | None = None
        self._until_s = 0.0
        self._look = QTimer(self, interval=_LOOK_EVERY_MS)
        self._look.timeout.connect(self._on_look)
        self._told = QTimer(self, singleShot=True, interval=_TOLD_MS)

    @property
    def just_taken(self) -> bool:
        """Whether it is ourselves of whom the X server tells that somebody has taken the keyboard."""
        return self._holder is not None or self._told.isActive()

    def keep_for_heir_of(self, closing: QWidget, main: QWidget) -> None:
        """Let the window behind ``closing``, that it belongs to or else ``main``, have all keys for a moment."""
        heir: QWidget | None = closing.parentWidget()
        while heir is not None and not heir.window().isVisible():
            heir = heir.window().parentWidget()
        handle = (main if heir is None else heir).window().windowHandle()
        if QGuiApplication.platformName() != "xcb" or handle is None or not handle.isVisible():
            return
        self._until_s = time.monotonic() + KEPT_S
        if handle is self._holder:
            return
        self.give_back()
        if handle.setKeyboardGrabEnabled(True):
            self._holder = handle
            self._look.start()

    def _on_look(self) -> None:
        """A window manager's own keys, as Alt+Tab, wait no longer than they must."""
        focused = self._focused_window()
        handed_on = focused and any(
            window.isVisible() and int(window.winId()) == focused for window in QGuiApplication.topLevelWindows()
        )
        if handed_on or time.monotonic() > self._until_s:
            self.give_back()

    def give_back(self) -> None:
        """They go to whichever window has the focus, as always."""
        self._look.stop()
        if self._holder is not None:
            holder, self._holder = self._holder, None
            self._told.start()
            holder.setKeyboardGrabEnabled(False)
