"""Names that nothing has yet: of files, tiers, topics and cameras."""

import os
import re
from collections.abc import Callable
from pathlib import Path

RESERVED_ON_WINDOWS = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)", re.IGNORECASE)
"""Names of files that are devices there, whatever their suffix."""


def usable_stem(stem: str, otherwise: str) -> str:
    """``stem`` as a file name on every system; ``otherwise`` if it is empty."""
    return f"{stem}-1" if RESERVED_ON_WINDOWS.fullmatch(stem) else stem or otherwise


def free_name(stem: str, suffix: str, is_taken: Callable[[str], bool], *, number_as: str = "-{}") -> str:
    """``STEMSUFFIX``, or numbered from 2 if that is taken."""
    name, number = f"{stem}{suffix}", 2
    while is_taken(name):
        name, number = f"{stem}{number_as.format(number)}{suffix}", number + 1
    return name


def free_path(path: Path, suffix: str = "") -> Path:
    """``path``, or numbered before this end of its name if something is there."""
    stem = path.name.removesuffix(suffix)
    return path.with_name(free_name(stem, suffix, lambda name: os.path.lexists(path.with_name(name))))
