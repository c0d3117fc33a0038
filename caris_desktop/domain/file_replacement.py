"""Atomic replacement of files: used for everything that the program will read again."""

import contextlib
import errno
import logging
import os
import secrets
import stat
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)
_NOT_FOR_FOLDERS = (errno.EINVAL, errno.ENOTSUP)
# A name may have 255 bytes, a character up to four.
SHOWN_CHARACTERS = 50


def no_room(error: OSError) -> bool:
    """Whether ``error`` means that the disk, or the user's quota, is full."""
    return error.errno in _NO_ROOM


def replace_file(
    path: Path, data: bytes | Iterable[bytes], *, durable: bool, on_full: Callable[[], bool] = lambda: False
) -> None:
    """Replace ``path`` with ``data`` atomically: a reader finds either the old or the new file, never a part.

    The content goes to a temporary file next to ``path``, unique so that concurrent writers do not collide, with the
    permissions of the existing file. After any failure, also in ``data`` itself, the old file remains and no temporary
    file. A symbolic link is replaced, not followed.

    Parameters
    ----------
    durable
        Wait until content and name are on the disk, so that a power failure loses neither. May take long.
    on_full
        Called to free space on a full disk; if it has, the write continues where it stopped.

    Raises OSError if the file cannot be written, or whatever ``data`` raises.
    """
    descriptor, beside = _opened_alongside(path)
    try:
        try:
            _copy_permissions(descriptor, path)
            for part in (data,) if isinstance(data, bytes) else data:
                _write_all(descriptor, part, on_full)
            if durable:
                os.fsync(descriptor)
        finally:
            os.close(descriptor)
        beside.replace(path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise
    if durable:
        bring_to_disk(path.parent)


def bring_to_disk(path: Path) -> None:
    """Flush a file, or the names in a folder, to the disk. Raises OSError."""
    folder = path.is_dir()
    if folder and sys.platform == "win32":
        return
    descriptor = os.open(path, os.O_RDONLY if sys.platform != "win32" else os.O_RDWR)
    try:
        os.fsync(descriptor)
    except OSError as error:
        # Some network file systems do not support this, and there is no alternative.
        if not (folder and error.errno in _NOT_FOR_FOLDERS):
            raise
    finally:
        os.close(descriptor)


def _opened_alongside(path: Path) -> tuple[int, Path]:
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    while True:
        beside = path.with_name(f".{path.name[:SHOWN_CHARACTERS]}.{secrets.token_hex(4)}.part")
        with contextlib.suppress(FileExistsError):
            return os.open(beside, flags, 0o666), beside


def _copy_permissions(descriptor: int, path: Path) -> None:
    """Copy the permissions before the content is written: a private file is never readable by
    others, not even briefly.
    """
    try:
        there = path.lstat()
    except FileNotFoundError:
        return
    mode = stat.S_IMODE(there.st_mode)
    # Queried first: file systems without permissions refuse to change them.
    if stat.S_ISREG(there.st_mode) and stat.S_IMODE(os.fstat(descriptor).st_mode) != mode and hasattr(os, "fchmod"):
        os.fchmod(descriptor, mode)


def _write_all(descriptor: int, data: bytes, on_full: Callable[[], bool]) -> None:
    rest = memoryview(data)
    while rest:
        try:
            rest = rest[os.write(descriptor, rest) :]
        except OSError as error:
            if not (no_room(error) and on_full()):
                raise


# File permissions: written files are private to the user unless shared with the group.
#
# ``CARIS_SHARE_WITH_GROUP=1`` shares them, for a study with several accounts.

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
