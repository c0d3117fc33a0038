"""Which keys are really down, where Qt alone cannot tell.

On X11 a held key arrives as release and press pairs, and Qt tells them from real ones only when both are already in
its queue, which fails on a busy machine and always after a modifier went up: then the robot would stutter, and letters
would be typed. Asking the X server for releases of the finger alone ends that at its source.
"""

import ctypes
import logging
import time

from PySide6.QtGui import QGuiApplication, QKeyEvent, QNativeInterface

logger = logging.getLogger(__name__)

LONGEST_REPEAT_GAP_S = 1.2
"""A held key repeats sooner than this; a later press is a new one whose release went elsewhere."""


class PhysicalKeys:
    """Knows repeats from presses. Feed it each key event once or several times, in order."""

    def __init__(self) -> None:
        self._x11: ctypes.CDLL | None = None
        self._display = 0
        self._down: dict[int, tuple[float, int, bool]] = {}
        self._ask_x_server()

    @property
    def exact(self) -> bool:
        """Whether a release always means that the key went up."""
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
        except (OSError, AttributeError, TypeError) as error:
            logger.warning("held keys may stutter: the X server was not asked for exact releases (%s)", error)

    def repeated(self, event: QKeyEvent) -> bool:
        """Whether a press (or the offer of one as a shortcut) comes from a finger that has not moved."""
        scan_code = int(event.nativeScanCode())
        if self._x11 is None or not scan_code:
            return event.isAutoRepeat()
        now_s, stamp = time.monotonic(), int(event.timestamp())
        known = self._down.get(scan_code)
        if known is not None and known[1] == stamp:
            # The same press on its way from shortcut to window to widget.
            return known[2]
        again = event.isAutoRepeat() or (known is not None and now_s - known[0] < LONGEST_REPEAT_GAP_S)
        self._down[scan_code] = (now_s, stamp, again)
        return again

    def released(self, event: QKeyEvent) -> bool:
        """Take note of a release; False where it is only a part of a repeat."""
        self._down.pop(int(event.nativeScanCode()), None)
        return not event.isAutoRepeat()

    def still_down(self, scan_codes: set[int]) -> set[int]:
        """Those of ``scan_codes`` whose keys are down at this moment; none where that cannot be known."""
        if self._x11 is None:
            self._down.clear()
            return set()
        keymap = ctypes.create_string_buffer(32)
        self._x11.XQueryKeymap(self._display, keymap)
        down = {code for code in scan_codes | set(self._down) if code < 256 and keymap.raw[code // 8] >> code % 8 & 1}
        self._down = {code: known for code, known in self._down.items() if code in down}
        return down & scan_codes
