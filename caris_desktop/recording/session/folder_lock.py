"""Lock on a session folder being written, so that a growing session is not repaired."""

import errno
import logging
import os
import sys
import time
from pathlib import Path
from typing import Self

_log = logging.getLogger(__name__)
LOCK_NAME = ".recording"
# A check by :func:`is_held` locks it briefly.
_TRIES, _BETWEEN_TRIES_S = 20, 0.025


class FolderHeldError(OSError):
    """Another process, or another part of this one, writes into the folder."""


class FolderLock:
    """Lock until :meth:`release` or the end of the process, after which the file remains unlocked."""

    def __init__(self, path: Path, descriptor: int) -> None:
        self._path = path
        self._descriptor: int | None = descriptor

    def release(self) -> None:
        """Release the lock and remove its file."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is None:
            return
        if sys.platform == "win32":
            # An open file cannot be removed there.
            os.close(descriptor)
            self._remove()
        else:
            self._remove()
            os.close(descriptor)

    def _remove(self) -> None:
        try:
            self._path.unlink(missing_ok=True)
        except OSError:
            _log.exception("%s stays behind; it holds nothing", self._path)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


def hold(folder: Path) -> FolderLock:
    """Lock ``folder`` for recording or repair.

    Raises FolderHeldError if somebody else has it. Raises OSError if the lock's file cannot be made, for example on a
    disk that cannot be written.
    """
    path = folder / LOCK_NAME
    for _ in range(_TRIES):
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        # The previous holder may have removed the file between our open and our lock.
        if _locked(descriptor) and _is_file_at(path, descriptor):
            return FolderLock(path, descriptor)
        os.close(descriptor)
        time.sleep(_BETWEEN_TRIES_S)
    raise FolderHeldError(errno.EBUSY, "a recording is in progress in this folder", str(folder))


def is_held(folder: Path) -> bool:
    """True while ``folder`` is being recorded into or repaired."""
    try:
        descriptor = os.open(folder / LOCK_NAME, os.O_RDONLY)
    except FileNotFoundError:
        return False
    except OSError:
        # Windows refuses to open it while another process holds it.
        return sys.platform == "win32"
    try:
        return not _locked(descriptor, shared=True)
    finally:
        os.close(descriptor)


def _is_file_at(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except OSError:
        return False


if sys.platform == "win32":
    import msvcrt

    def _locked(descriptor: int, *, shared: bool = False) -> bool:
        """Lock the file; closing the descriptor releases it."""
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
else:
    import fcntl

    def _locked(descriptor: int, *, shared: bool = False) -> bool:
        """Lock the file; closing the descriptor releases it."""
        try:
            fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
