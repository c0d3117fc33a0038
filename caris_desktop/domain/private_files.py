"""File permissions: written files are private to the user unless shared with the group.

``CARIS_SHARE_WITH_GROUP=1`` shares them, for a study with several accounts.
"""

import logging
import os
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path

_log = logging.getLogger(__name__)
SHARE_VARIABLE = "CARIS_SHARE_WITH_GROUP"


def make_new_files_private() -> None:
    """Set the umask of this process and its children, which covers files of libraries, such as a
    database and its log.
    """
    os.umask(_others())


def narrow(paths: Iterable[Path]) -> int:
    """Remove the permissions of others from these files, and from folders with their content, as earlier versions left
    them.

    Returns the count of files that were open to others. Files of other owners are left as they are, links are not
    followed, and closed folders are not searched.
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
    # The folder last, so that an interrupted run is resumed the next time.
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
