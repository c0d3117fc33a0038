"""Keyboard grab while focus passes from a closing window to the one behind it."""

import time
from collections.abc import Callable

from PySide6.QtCore import QObject, Qt, QTimer
from PySide6.QtGui import QGuiApplication, QWindow
from PySide6.QtWidgets import QApplication, QWidget

from caris_desktop.ui.focus_widget import window_of

KEPT_S = 0.6
"""Longest grab in seconds; a busy window manager may need this long."""
_LOOK_EVERY_MS, _TOLD_MS = 20, 50
_GETS_NO_KEYS = (Qt.WindowType.Popup, Qt.WindowType.ToolTip, Qt.WindowType.SplashScreen)


def had_the_keys(hidden: QWidget) -> bool:
    """Whether the hidden window was the active one: Qt has no active window now, yet the application is active."""
    return (
        QApplication.activeWindow() is None
        and QGuiApplication.applicationState() == Qt.ApplicationState.ApplicationActive
        and hidden.windowType() not in _GETS_NO_KEYS
        and not hidden.windowFlags() & Qt.WindowType.WindowDoesNotAcceptFocus
    )


class KeyboardGrab(QObject):
    """Grabs the keyboard while a window closes, so that no key is lost until another window is focused.

    On X11 a closing window leaves no focus until the window manager assigns it: an Esc pressed then, perhaps the second
    of an emergency stop, reaches no program. Other systems move the focus at once. ``focused_window`` returns the X
    server's focused window id.
    """

    def __init__(self, focused_window: Callable[[], int], parent: QObject) -> None:
        super().__init__(parent)
        self._focused_window = focused_window
        self._holder: QWindow | None = None
        self._until_s = 0.0
        self._focus_timer = QTimer(self, interval=_LOOK_EVERY_MS)
        self._focus_timer.timeout.connect(self._release_if_focus_moved)
        self._report_timer = QTimer(self, singleShot=True, interval=_TOLD_MS)

    @property
    def just_taken(self) -> bool:
        """Whether a keyboard grab reported by the X server is our own."""
        return self._holder is not None or self._report_timer.isActive()

    def hold_during_close(self, closing: QWidget, main: QWidget) -> None:
        """Grab the keyboard for the window behind ``closing``: its parent, else ``main``."""
        heir: QWidget | None = closing.parentWidget()
        while heir is not None and not window_of(heir).isVisible():
            heir = window_of(heir).parentWidget()
        handle = window_of(main if heir is None else heir).windowHandle()
        if QGuiApplication.platformName() != "xcb" or handle is None or not handle.isVisible():
            return
        self._until_s = time.monotonic() + KEPT_S
        if handle is self._holder:
            return
        self.give_back()
        if handle.setKeyboardGrabEnabled(True):
            self._holder = handle
            self._focus_timer.start()

    def _release_if_focus_moved(self) -> None:
        """Release the grab as soon as the focus has moved, so that the window manager's own keys (Alt+Tab) work."""
        focused = self._focused_window()
        handed_on = focused and any(
            window.isVisible() and int(window.winId()) == focused for window in QGuiApplication.topLevelWindows()
        )
        if handed_on or time.monotonic() > self._until_s:
            self.give_back()

    def give_back(self) -> None:
        """Release the grab; keys go to the focused window again."""
        self._focus_timer.stop()
        if self._holder is not None:
            holder, self._holder = self._holder, None
            self._report_timer.start()
            holder.setKeyboardGrabEnabled(False)
