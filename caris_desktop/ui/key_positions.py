"""Physical key positions, independent of the layout, from the scan codes of each operating system.

A position is named after the US keyboard: ``W`` types Z on a French one. The macOS table was checked against Apple's
header, not on a Mac.
"""

from collections.abc import Mapping

_POSITIONS = "QWERTYUIOPASDFGHJKLZXCVBNM1234567890"
# Linux: X keycodes, which are evdev codes plus 8; Wayland compositors use the same.
_EVDEV = dict(
    zip(_POSITIONS, (*range(24, 34), *range(38, 47), *range(52, 59), *range(10, 20)), strict=True)
)  # fmt: skip
# Windows: set 1 scan codes.
_WINDOWS = dict(
    zip(_POSITIONS, (*range(0x10, 0x1A), *range(0x1E, 0x27), *range(0x2C, 0x33), *range(2, 12)), strict=True)
)  # fmt: skip
# macOS: kVK_ANSI_* of Carbon's HIToolbox/Events.h; Qt reports these as the virtual key, without a scan code.
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
    """Key code of each position; empty for an unsupported system. ``platform`` as ``sys.platform``."""
    if platform == "darwin":
        return _MAC
    if platform == "win32":
        return _WINDOWS
    return _EVDEV if platform.startswith(("linux", "freebsd")) else {}


def key_code(platform: str, *, scan_code: int, virtual_key: int) -> int | None:
    """Code of an event's physical key; None if the event has none."""
    if platform == "darwin":
        return virtual_key
    return scan_code or None


def position_of(platform: str, code: int | None) -> str | None:
    """Position of the key with this code; None if it is not in the table."""
    return next((name for name, known in position_codes(platform).items() if known == code), None)


def modifier_name(platform: str, modifier: str) -> str:
    """Key cap label of Qt's ``Alt``, ``Ctrl``, ``Meta`` and ``Shift``."""
    if platform != "darwin":
        return modifier
    # On macOS, Qt calls the command key Control and the control key Meta.
    return {"Alt": "⌥", "Ctrl": "⌘", "Meta": "⌃", "Shift": "⇧"}.get(modifier, modifier)
