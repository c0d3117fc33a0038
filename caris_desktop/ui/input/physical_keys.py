"""Physical key state: distinguishes auto-repeat from real presses, where Qt alone cannot.

On X11 a held key arrives as release-press pairs. Qt recognises a repeat only if both are already in its queue, which
fails on a busy machine and always after a modifier release: the robot would stutter, and letters would be typed.
Detectable auto-repeat of the X server reports only real releases.
"""

import ctypes
import logging
import time
from collections import deque
from collections.abc import Callable, Mapping

from PySide6.QtCore import QAbstractNativeEventFilter, QByteArray, QObject, Qt, QTimer
from PySide6.QtGui import QGuiApplication, QKeyEvent, QNativeInterface, QWindow
from PySide6.QtWidgets import QApplication, QWidget

from caris_desktop.ui.focus_widget import window_of

logger = logging.getLogger(__name__)

_CORE_KEYBOARD = 0x0100
_KEY_PRESS, _KEY_RELEASE, _FOCUS_OUT = 2, 3, 10
_NOTIFY_GRAB = 1
_XK_ESCAPE, _XK_PAUSE, _XK_F1 = 0xFF1B, 0xFF13, 0xFFBE
_STOP_KEYS = {_XK_PAUSE: int(Qt.Key.Key_Pause), _XK_ESCAPE: int(Qt.Key.Key_Escape)}
_FUNCTION_KEYS = {_XK_F1 + number: int(Qt.Key.Key_F1) + number for number in range(12)}

X11_LEVELS = 0x80 | 0x20
"""Mod5 and Mod3, which select the third and fifth level of a keyboard layout (AltGr is Mod5)."""
LONGEST_REPEAT_GAP_S = 1.2
"""Maximum interval of auto-repeat; a later press is a new one whose release was not received."""
_LONGEST_REPEAT_GAP_MS = int(LONGEST_REPEAT_GAP_S * 1000)


class _XkbState(ctypes.Structure):
    """XkbStateRec of X11/extensions/XKBstr.h in full, since Xlib fills it; only ``group`` is read."""

    _fields_ = [
        ("group", ctypes.c_ubyte), ("locked_group", ctypes.c_ubyte), ("base_group", ctypes.c_ushort),
        ("latched_group", ctypes.c_ushort), ("mods", ctypes.c_ubyte * 9), ("ptr_buttons", ctypes.c_ushort),
    ]  # fmt: skip


class _XcbEvent(ctypes.Structure):
    """Start of xcb_key_press_event_t; ``mode`` is the byte there in xcb_focus_out_event_t."""

    _fields_ = [
        ("response_type", ctypes.c_uint8), ("detail", ctypes.c_uint8), ("sequence", ctypes.c_uint16),
        ("time", ctypes.c_uint32), ("mode", ctypes.c_uint8), ("root", ctypes.c_uint8 * 3), ("window", ctypes.c_uint32),
    ]  # fmt: skip


class NativeKeyEvents(QAbstractNativeEventFilter):
    """Key events of the X server that Qt discards.

    Reports keyboard grabs by other programs, such as a window manager's Alt+Tab or Alt+Escape (on X11 a grab arrives as
    a FocusOut event, together with the key), and keys sent to a window of ours that was closed meanwhile: between an
    Esc that closes a dialog and the keyboard grab that follows, the X server still sends keys to the dialog.

    Args:
        on_grab: Called when another program, or Qt, grabbed the keyboard.
        on_lost_key: Called with key code, X server time in ms and whether it is a press.
    """

    def __init__(self, on_grab: Callable[[], None], on_lost_key: Callable[[int, int, bool], None]) -> None:
        super().__init__()
        self._on_grab = on_grab
        self._on_lost_key = on_lost_key
        # X window ids are not used again for a long time; a key for a closed window arrives within a second.
        self._closed_windows: deque[int] = deque(maxlen=32)

    def add_closed_window(self, window_id: int) -> None:
        """Report the keys still sent to this native window."""
        self._closed_windows.append(window_id)

    def nativeEventFilter(self, _event_type: QByteArray | bytes | bytearray | memoryview, message: int) -> object:
        head = _XcbEvent.from_address(int(message))
        kind = head.response_type & 0x7F
        if kind == _FOCUS_OUT and head.mode == _NOTIFY_GRAB:
            self._on_grab()
        elif kind in (_KEY_PRESS, _KEY_RELEASE) and head.window in self._closed_windows:
            self._on_lost_key(head.detail, head.time, kind == _KEY_PRESS)
        return False, 0


class PhysicalKeys:
    """Detector of auto-repeat. Pass each key event in order, once or several times."""

    def __init__(self) -> None:
        self._x11: ctypes.CDLL | None = None
        self._xkbcommon: ctypes.CDLL | None = None
        self._display = 0
        self._down: dict[int, tuple[int, bool]] = {}
        """By key code: when it was pressed last, in ms of the X server, and whether that was a repeat."""
        self._ask_x_server()

    @property
    def exact(self) -> bool:
        """Whether each release is a physical one."""
        return self._x11 is not None

    def _ask_x_server(self) -> None:
        app = QGuiApplication.instance()
        if QGuiApplication.platformName() != "xcb" or not isinstance(app, QGuiApplication):
            return
        try:
            native = app.nativeInterface()
            if not isinstance(native, QNativeInterface.QX11Application):
                return
            x11 = ctypes.CDLL("libX11.so.6")
            x11.XkbSetDetectableAutoRepeat.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.POINTER(ctypes.c_int)]
            x11.XQueryKeymap.argtypes = [ctypes.c_void_p, ctypes.c_char_p]
            display, supported = int(native.display()), ctypes.c_int()
            if x11.XkbSetDetectableAutoRepeat(display, 1, ctypes.byref(supported)) and supported.value:
                self._x11, self._display = x11, display
            x11.XKeysymToKeycode.argtypes = [ctypes.c_void_p, ctypes.c_ulong]
            x11.XKeysymToKeycode.restype = ctypes.c_ubyte
            x11.XkbGetState.argtypes = [ctypes.c_void_p, ctypes.c_uint, ctypes.POINTER(_XkbState)]
            x11.XkbKeycodeToKeysym.argtypes = [ctypes.c_void_p, ctypes.c_ubyte, ctypes.c_uint, ctypes.c_uint]
            x11.XkbKeycodeToKeysym.restype = ctypes.c_ulong
            x11.XGetInputFocus.argtypes = [
                ctypes.c_void_p, ctypes.POINTER(ctypes.c_ulong), ctypes.POINTER(ctypes.c_int),
            ]  # fmt: skip
            # Qt's xcb plugin requires this library, so it is installed.
            self._xkbcommon = ctypes.CDLL("libxkbcommon.so.0")
        except (OSError, AttributeError, TypeError) as error:
            logger.warning("held keys may stutter: the X server was not asked for exact releases (%s)", error)

    def repeated(self, event: QKeyEvent) -> bool:
        """Whether a press or shortcut override is auto-repeat."""
        scan_code = int(event.nativeScanCode())
        if self._x11 is None or not scan_code:
            return event.isAutoRepeat()
        return self.repeats(scan_code, int(event.timestamp()))

    def repeats(self, scan_code: int, stamp_ms: int) -> bool:
        """Register a press at this X server time in ms; whether it is auto-repeat."""
        known = self._down.get(scan_code)
        if known is not None and known[0] == stamp_ms:
            # The same press, on its way from shortcut to window to widget.
            return known[1]
        # Qt's own flag is wrong for a release and press with the same time stamp, as a delayed server sends them. Our
        # clock is no help either: this process may have been delayed while the key was held.
        again = known is not None and 0 <= stamp_ms - known[0] < _LONGEST_REPEAT_GAP_MS
        self._down[scan_code] = (stamp_ms, again)
        return again

    def released(self, event: QKeyEvent) -> bool:
        """Register a release; False if it is part of auto-repeat."""
        self.release(int(event.nativeScanCode()))
        return self.exact or not event.isAutoRepeat()

    def release(self, scan_code: int) -> None:
        """Register a physical release."""
        self._down.pop(scan_code, None)

    def still_down(self, scan_codes: set[int]) -> set[int]:
        """Keys of ``scan_codes`` that are down now; empty if unknown."""
        if self._x11 is None:
            self._down.clear()
            return set()
        keymap = ctypes.create_string_buffer(32)
        self._x11.XQueryKeymap(self._display, keymap)
        down = {code for code in scan_codes | set(self._down) if code < 256 and keymap.raw[code // 8] >> code % 8 & 1}
        self._down = {code: known for code, known in self._down.items() if code in down}
        return down & scan_codes

    def stop_key_down(self) -> int | None:
        """Qt key of Escape or Pause if it is down now, whichever program receives it."""
        down = self._first_down(_STOP_KEYS)
        return None if down is None else down[0]

    def stop_key(self, scan_code: int) -> int | None:
        """Qt key of Escape or Pause if it has this key code."""
        return next((key for keysym, key in _STOP_KEYS.items() if self._code_of(keysym) == scan_code), None)

    def function_key_down(self) -> tuple[int, int] | None:
        """Qt key and key code of one of F1 to F12 that is down now, whichever program receives it."""
        return self._first_down(_FUNCTION_KEYS)

    def _first_down(self, keys: Mapping[int, int]) -> tuple[int, int] | None:
        """First key that is down; ``keys`` maps keysyms to Qt keys."""
        if self._x11 is None:
            return None
        keymap = ctypes.create_string_buffer(32)
        self._x11.XQueryKeymap(self._display, keymap)
        for keysym, key in keys.items():
            code = self._code_of(keysym)
            if code and keymap.raw[code // 8] >> code % 8 & 1:
                return key, code
        return None

    def _code_of(self, keysym: int) -> int:
        """Key code of a keysym; 0 if no key has it."""
        return 0 if self._x11 is None else int(self._x11.XKeysymToKeycode(self._display, keysym))

    def focused_window(self) -> int:
        """Focused window id of the X server, even during a grab; 0 if unknown."""
        if self._x11 is None:
            return 0
        window, revert_to = ctypes.c_ulong(), ctypes.c_int()
        self._x11.XGetInputFocus(self._display, ctypes.byref(window), ctypes.byref(revert_to))
        return int(window.value)

    def letters(self, codes: Mapping[str, int]) -> dict[str, str]:
        """Letters that the current layout types on these key codes; empty if unknown."""
        if self._x11 is None or self._xkbcommon is None:
            return {}
        state = _XkbState()
        self._x11.XkbGetState(self._display, _CORE_KEYBOARD, ctypes.byref(state))
        found = {}
        for position, code in codes.items():
            keysym = self._x11.XkbKeycodeToKeysym(self._display, code, state.group, 0)
            letter = chr(self._xkbcommon.xkb_keysym_to_utf32(ctypes.c_uint32(keysym)) or 0).upper()
            if letter.isprintable() and not letter.isspace():
                found[position] = letter
        return found


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
