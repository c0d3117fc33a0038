"""Where keys lie on the keyboard, whatever letter is printed on them, from the codes that each system gives them.

A position is named after the US keyboard: ``W`` is the key right of the first letter, which types Z on a French one.
The macOS table has been checked against Apple's header, not yet tried on a Mac.
"""

from collections.abc import Mapping

_POSITIONS = "QWERTYUIOPASDFGHJKLZXCVBNM1234567890"
# Linux: X keycodes, which are evdev's plus 8; Wayland compositors give the same.
_EVDEV = dict(
    zip(_POSITIONS, (*range(24, 34), *range(38, 47), *range(52, 59), *range(10, 20)), strict=True)
)  # fmt: skip
# Windows: set 1 scan codes.
_WINDOWS = dict(
    zip(_POSITIONS, (*range(0x10, 0x1A), *range(0x1E, 0x27), *range(0x2C, 0x33), *range(2, 12)), strict=True)
)  # fmt: skip
# macOS: kVK_ANSI_* of Carbon's HIToolbox/Events.h; Qt gives no scan code there but this as the virtual key.
_MAC = dict(
    zip(
        _POSITIONS,
        (
            12, 13, 14, 15, 17, 16, 32, 34, 31, 35, 0, 1, 2, 3, 5, 4, 38, 40, 37, 6, 7, 8, 9, 11, 45, 46,
            18, 19, 20, 21, 23, 22, 26, 28, 25, 29,
        ),
        strict=True,
    )
)  # fmt: skip


def position_codes(platform: str) -> Mapping[str, int]:
    """The key code of each position; empty for a system whose codes are not known. ``platform`` as ``sys.platform``."""
    if platform == "darwin":
        return _MAC
    if platform == "win32":
        return _WINDOWS
    return _EVDEV if platform.startswith(("linux", "freebsd")) else {}


def key_code(platform: str, *, scan_code: int, virtual_key: int) -> int | None:
    """What identifies the physical key of an event; None where the event does not tell."""
    if platform == "darwin":
        return virtual_key
    return scan_code or None


def position_of(platform: str, code: int | None) -> str | None:
    """The position of the key with this code; None for one that is not in the table."""
    return next((name for name, known in position_codes(platform).items() if known == code), None)


def modifier_name(platform: str, modifier: str) -> str:
    """What is printed on the keyboard for Qt's ``Alt``, ``Ctrl``, ``Meta`` and ``Shift``."""
    if platform != "darwin":
        return modifier
    # Qt calls the command key Control and the control key Meta there.
    return {"Alt": "⌥", "Ctrl": "⌘", "Meta": "⌃", "Shift": "⇧"}.get(modifier, modifier)
