"""Replaces a file whole or not at all: how everything is written that the program will read again."""

import contextlib
import errno
import os
import secrets
import stat
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)
_NOT_FOR_FOLDERS = (errno.EINVAL, errno.ENOTSUP)
# A name may have 255 bytes, and a character up to four.
SHOWN_CHARACTERS = 50


def no_room(error: OSError) -> bool:
    """Whether ``error`` says that the disk, or the user's share of it, is full."""
    return error.errno in _NO_ROOM


def replace_file(
    path: Path, data: bytes | Iterable[bytes], *, durable: bool, on_full: Callable[[], bool] = lambda: False
) -> None:
    """Put ``data`` in the place of ``path``: whoever reads finds the old file or the new one, never a part of it.

    It is written beside ``path``, under a name of its own so that two who save at once do not mix, and keeps the
    permissions of the file that was there. Whatever goes wrong, also in ``data`` itself, the old file stays and nothing
    else is left behind. A link is replaced, not followed.

    Parameters
    ----------
    durable
        Wait until the disk has the content, and then the name: neither is lost when the power goes. May take long.
    on_full
        Asked for room when the disk is full; when it has made some, the write goes on where it stopped.

    Raises
    ------
    OSError
        Where it cannot be written, or whatever ``data`` raises.
    """
    descriptor, beside = _opened_beside(path)
    try:
        try:
            _keep_permissions(descriptor, path)
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
    """Bring a file, or the names in a folder, to the disk itself. Raises OSError."""
    folder = path.is_dir()
    if folder and sys.platform == "win32":
        return
    descriptor = os.open(path, os.O_RDONLY if sys.platform != "win32" else os.O_RDWR)
    try:
        os.fsync(descriptor)
    except OSError as error:
        # Some network file systems know no such thing, and there is nothing else that could be done.
        if not (folder and error.errno in _NOT_FOR_FOLDERS):
            raise
    finally:
        os.close(descriptor)


def _opened_beside(path: Path) -> tuple[int, Path]:
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    while True:
        beside = path.with_name(f".{path.name[:SHOWN_CHARACTERS]}.{secrets.token_hex(4)}.part")
        with contextlib.suppress(FileExistsError):
            return os.open(beside, flags, 0o666), beside


def _keep_permissions(descriptor: int, path: Path) -> None:
    """Before anything is in the file: what only its owner may read is never open to others, not for a moment."""
    try:
        there = path.lstat()
    except FileNotFoundError:
        return
    kept = stat.S_IMODE(there.st_mode)
    # Asked first: file systems without permissions refuse to change them.
    if stat.S_ISREG(there.st_mode) and stat.S_IMODE(os.fstat(descriptor).st_mode) != kept and hasattr(os, "fchmod"):
        os.fchmod(descriptor, kept)


def _write_all(descriptor: int, data: bytes, on_full: Callable[[], bool]) -> None:
    rest = memoryview(data)
    while rest:
        try:
            rest = rest[os.write(descriptor, rest) :]
        except OSError as error:
            if not (no_room(error) and on_full()):
                raise
