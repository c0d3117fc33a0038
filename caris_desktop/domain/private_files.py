"""What this program writes is its user's alone, unless the user shares it with their group.

``CARIS_SHARE_WITH_GROUP=1`` is that setting: a study on which several accounts work is then open to their group.
"""

import logging
import os
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path

_log = logging.getLogger(__name__)
SHARE_VARIABLE = "CARIS_SHARE_WITH_GROUP"


def keep_new_files_private() -> None:
    """Of this process and all that it starts. Also of what libraries write, a database and its log above all."""
    os.umask(_others())


def narrow(paths: Iterable[Path]) -> int:
    """Take from others what an earlier version left open to them: these files, and folders with all that is in them.

    Gives how many were open. Whose they are not stay as they are, links are not followed, and a folder that is closed
    already is not looked into.
    """
    return sum(_narrowed(path) for top in paths for path in _open_ones(top))


def _others() -> int:
    return 0o007 if os.environ.get(SHARE_VARIABLE) == "1" else 0o077


def _open_ones(top: Path) -> Iterator[Path]:
    if not _is_open(top):
        return
    for folder, _, files in os.walk(top, onerror=None):
        yield from (path for name in files if _is_open(path := Path(folder, name)))
        if Path(folder) != top and _is_open(Path(folder)):
            yield Path(folder)
    # The last, so that what is broken off is gone on with the next time.
    yield top


def _is_open(path: Path) -> bool:
    try:
        there = path.lstat()
    except OSError:
        return False
    plain = stat.S_ISREG(there.st_mode) or stat.S_ISDIR(there.st_mode)
    return plain and bool(there.st_mode & _others()) and hasattr(os, "geteuid") and there.st_uid == os.geteuid()


def _narrowed(path: Path) -> bool:
    try:
        path.chmod(stat.S_IMODE(path.lstat().st_mode) & ~_others())
    except OSError as error:
        _log.info("%s stays open to others: %s", path, error)
        return False
    return True
