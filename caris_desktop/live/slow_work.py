"""Work that waits on files, or for processes to end: done in a thread of its own, told in the GUI thread."""

import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import TypeVar

from PySide6.QtCore import QObject, Qt, Signal

from caris_desktop.domain.failure import ToldFailure
from caris_desktop.domain.translation import tr

_log = logging.getLogger(__name__)
_FINISHED_WITHIN_S = 30.0
_STEP_S = 0.05
T = TypeVar("T")
During = Callable[[str, Callable[[], None]], None]
Outcome = Callable[[], None]


def do_beside(work: Callable[[], None], meanwhile: Callable[[], None]) -> None:
    """Do ``work``, which knows nothing of Qt, in a thread of its own. Returns when it is done, or raises what it did.

    Until then ``meanwhile`` is called over and over in the calling thread.
    """
    failures: list[Exception] = []

    def do() -> None:
        try:
            work()
        except Exception as failure:  # it is raised again by whoever waits
            failures.append(failure)

    thread = threading.Thread(target=do, name="slow work")
    thread.start()
    while thread.is_alive():
        meanwhile()
        thread.join(_STEP_S)
    if failures:
        raise failures[0]


class SlowWork(QObject):
    """Does one piece after the other in the order in which they are asked for, and tells what came of them in that
    order. GUI thread; the thread that works begins with the first piece, and a piece knows nothing of Qt.

    A disk may take a third of a second for what is to be safe on it. Direct driving ends when the GUI thread stands
    still for half of that.
    """

    _done = Signal()

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._changed = threading.Condition()
        self._pieces: deque[Callable[[], Outcome]] = deque()
        self._undone = 0
        self._outcomes: deque[Outcome] = deque()
        self._closed = False
        self._thread: threading.Thread | None = None
        self._done.connect(self._tell, Qt.ConnectionType.QueuedConnection)

    def do(self, work: Callable[[], T], done: Callable[[T], None], failed: Callable[[ToldFailure], None]) -> None:
        """Do ``work``, then ``done`` with what it gave or ``failed`` with what it raised. Returns at once."""
        if self._closed:
            _log.info("%r is not done: the program ends", work)
            return
        with self._changed:
            self._pieces.append(partial(_outcome, work, done, failed))
            self._undone += 1
            self._changed.notify_all()
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="slow-work", daemon=True)
            self._thread.start()

    def finish(self, during: During) -> None:
        """Do all that was asked, tell what came of it, and begin nothing any more. Blocks, half a minute at most.

        ``during`` is given what takes long, with words for it, and does it before it returns.
        """
        until_s = time.monotonic() + _FINISHED_WITHIN_S
        while (self._undone or self._outcomes) and time.monotonic() < until_s:
            if self._undone:
                during(tr("What was asked last is being written to disk."), partial(self._wait, until_s))
            self._tell()
        with self._changed:
            self._closed = True
            self._pieces.clear()
            self._changed.notify_all()
        if self._undone:
            _log.error("the disk does not answer: %d pieces of work are left undone", self._undone)
        elif self._thread is not None:
            self._thread.join()

    def _wait(self, until_s: float) -> None:  # any thread
        with self._changed:
            self._changed.wait_for(lambda: not self._undone, timeout=max(0.0, until_s - time.monotonic()))

    def _tell(self) -> None:
        while self._outcomes:
            self._outcomes.popleft()()

    def _work(self) -> None:  # its own thread
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._pieces or self._closed)
                if not self._pieces:
                    return
                piece = self._pieces.popleft()
            outcome = piece()
            with self._changed:
                self._outcomes.append(outcome)
                self._undone -= 1
                self._changed.notify_all()
            with contextlib.suppress(RuntimeError):  # the console has gone without waiting any longer
                self._done.emit()


def _outcome(work: Callable[[], T], done: Callable[[T], None], failed: Callable[[ToldFailure], None]) -> Outcome:
    try:
        return partial(done, work())
    except ToldFailure as failure:
        return partial(failed, failure)
    except Exception as error:
        _log.exception("%r failed", work)
        return partial(
            failed,
            ToldFailure(
                tr("Something that was asked for could not be done."),
                f"{type(error).__name__}: {error}.",
                tr("Try it again; the log has the details."),
            ),
        )
