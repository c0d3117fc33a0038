"""One console at a time has a study: two would write its people past one another, and drive one robot.

Whoever starts it a second time, as by another double click while the first is still on its way, gets the window that is
there.
"""

import logging
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PySide6.QtCore import QLockFile

from caris_desktop.app.composition import StartError
from caris_desktop.live.live_robots import show_window

_log = logging.getLogger(__name__)
_LOCK = ".console.lock"
# One listens only once its window stands, and may have much to write at its end.
_WAITS_S, _TRIES_AFTER_S = 20.0, 0.25


class AlreadyOpenError(Exception):
    """The study is open on this computer, and its window is in front now."""


@contextmanager
def held(study: Path, consoles: Path) -> Iterator[None]:
    """Hold the study meanwhile. ``consoles``: where running ones listen.

    Raises AlreadyOpenError, or StartError where the console that has it cannot be shown.
    """
    lock = QLockFile(str(study / _LOCK))
    lock.setStaleLockTime(0)  # it is held as long as its process runs, however long that is
    until_s = time.monotonic() + _WAITS_S
    while not lock.tryLock(0):
        if lock.error() != QLockFile.LockError.LockFailedError:
            # That a study is read only is told where something is to be written.
            _log.warning("the study %s is not locked: %s", study, lock.error())
            break
        _leave_it(lock, study, consoles, impatient=time.monotonic() > until_s)
        time.sleep(_TRIES_AFTER_S)
    try:
        yield
    finally:
        lock.unlock()


def _leave_it(lock: QLockFile, study: Path, consoles: Path, *, impatient: bool) -> None:
    """To whoever has it. Returns where that console is still on its way, or about to end."""
    pid, host, _program = lock.getLockInfo()
    if pid and host != platform.node():
        raise StartError(
            f"The study {study} is open on the computer {host}. Two consoles would write past one another there. "
            "Close it on that computer, or give another folder with --study."
        )
    if pid and show_window(consoles, pid):
        raise AlreadyOpenError(f"The study {study} is open already: its window was brought to the front.")
    if impatient:
        raise StartError(
            f"The study {study} is open in another console (process {pid}), which does not answer. "
            "Close that one, or give another folder with --study."
        )
