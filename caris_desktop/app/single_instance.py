"""Single console per study: two would overwrite each other's people, and drive one robot.

A second start, such as another double click during the first, brings the existing window to the front.
"""

import logging
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PySide6.QtCore import QLockFile

from caris_desktop.app.composition import StartError
from caris_desktop.live.robot_connections import show_window

_log = logging.getLogger(__name__)
_LOCK = ".console.lock"
# A console listens only once its window is shown, and may write for long at its end.
_WAITS_S, _TRIES_AFTER_S = 20.0, 0.25


class AlreadyOpenError(Exception):
    """The study is open on this computer, and its window is now in front."""


@contextmanager
def held(study: Path, consoles: Path) -> Iterator[None]:
    """Hold the study's lock. ``consoles``: where running consoles listen.

    Raises AlreadyOpenError, or StartError if the console that holds it cannot be shown.
    """
    lock = QLockFile(str(study / _LOCK))
    lock.setStaleLockTime(0)  # held as long as its process runs, however long that is
    until_s = time.monotonic() + _WAITS_S
    while not lock.tryLock(0):
        if lock.error() != QLockFile.LockError.LockFailedError:
            # A read-only study is reported when something is to be written.
            _log.warning("the study %s is not locked: %s", study, lock.error())
            break
        _leave_it(lock, study, consoles, impatient=time.monotonic() > until_s)
        time.sleep(_TRIES_AFTER_S)
    try:
        yield
    finally:
        lock.unlock()


def _leave_it(lock: QLockFile, study: Path, consoles: Path, *, impatient: bool) -> None:
    """Leave the study to the console that holds it. Returns if that is still starting, or about to end."""
    pid, host, _program = lock.getLockInfo()
    if pid and host != platform.node():
        raise StartError(
            f"The study {study} is open on the computer {host}. Two consoles cannot use the same study. "
            "Close it on that computer, or choose another folder with --study."
        )
    if pid and show_window(consoles, pid):
        raise AlreadyOpenError(f"The study {study} is already open: its window was brought to the front.")
    if impatient:
        raise StartError(
            f"The study {study} is open in another console (process {pid}), which does not respond. "
            "Close that console, or choose another folder with --study."
        )
