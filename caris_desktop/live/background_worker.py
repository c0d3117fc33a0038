"""Background worker for file access and process exits, with results in the GUI thread; and timers."""

import asyncio
import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Coroutine
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import partial
from typing import Any, TypeVar

from PySide6.QtCore import QObject, Qt, QTimer, Signal

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.translation import tr

_log = logging.getLogger(__name__)
_FINISHED_WITHIN_S = 30.0
_STEP_S = 0.05
T = TypeVar("T")
During = Callable[[str, Callable[[], None]], None]
Outcome = Callable[[], None]


def do_in_parallel(work: Callable[[], T], meanwhile: Callable[[], object]) -> T:
    """Run ``work``, which must not use Qt, in a thread; returns or raises what it does.

    Meanwhile ``meanwhile`` is called repeatedly in the calling thread.
    """
    with ThreadPoolExecutor(1, "slow-work") as executor:
        future = executor.submit(work)
        while not future.done():
            meanwhile()
            wait([future], _STEP_S)
        return future.result()


class BackgroundWorker(QObject):
    """Runs jobs in the order of requests, and delivers results in that order. Call from the GUI thread; jobs run in a
    thread started on demand, and must not use Qt.

    An fsync may take a third of a second; teleoperation ends when the GUI thread stalls for half of that.
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
        self._done.connect(self._notify, Qt.ConnectionType.QueuedConnection)

    def do(self, work: Callable[[], T], done: Callable[[T], None], failed: Callable[[UserFacingError], None]) -> None:
        """Run ``work``, then call ``done`` with its result or ``failed`` with its exception. Returns at once."""
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
        """Complete all jobs, deliver their results, and accept no more. Blocks half a minute at most.

        ``during`` runs slow work with a message and returns when it is done.
        """
        until_s = time.monotonic() + _FINISHED_WITHIN_S
        while (self._undone or self._outcomes) and time.monotonic() < until_s:
            if self._undone:
                during(tr("The last changes are being written to disk."), partial(self._wait, until_s))
            self._notify()
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

    def _notify(self) -> None:
        while self._outcomes:
            self._outcomes.popleft()()

    def _work(self) -> None:  # worker thread
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
            with contextlib.suppress(RuntimeError):  # the console did not wait any longer
                self._done.emit()


def _outcome(work: Callable[[], T], done: Callable[[T], None], failed: Callable[[UserFacingError], None]) -> Outcome:
    try:
        return partial(done, work())
    except UserFacingError as failure:
        return partial(failed, failure)
    except Exception as error:
        _log.exception("%r failed", work)
        return partial(
            failed,
            UserFacingError(
                tr("A background task failed."),
                f"{type(error).__name__}: {error}.",
                tr("Try again; the log has the details."),
            ),
        )


def new_timer(
    parent: QObject,
    on_timeout: Callable[[], object],
    interval_ms: int = 0,
    *,
    single_shot: bool = False,
    precise: bool = False,
) -> QTimer:
    """Timer that is not started. ``precise``: to the millisecond, instead of within 5 %."""
    timer = QTimer(parent, singleShot=single_shot, interval=interval_ms)
    if precise:
        timer.setTimerType(Qt.TimerType.PreciseTimer)
    timer.timeout.connect(on_timeout)
    return timer


# Asyncio event loop of the console, in its own thread.


class AsyncioThread:
    """Runs coroutines for the GUI thread; stop it before the program ends."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="asyncio", daemon=True)
        self._thread.start()

    def submit(self, coroutine: Coroutine[Any, Any, T]) -> "Future[T]":
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop)

    def stop(self, *, timeout_s: float = 2.0) -> None:
        """Cancel running tasks and end the thread."""
        if self._loop.is_closed():
            return
        self._loop.call_soon_threadsafe(self._cancel_all)
        self._thread.join(timeout_s)

    def _cancel_all(self) -> None:
        tasks = asyncio.all_tasks(self._loop)
        for task in tasks:
            task.cancel()
        if not tasks:
            self._loop.stop()
            return
        gathered = asyncio.gather(*tasks, return_exceptions=True)
        gathered.add_done_callback(lambda _done: self._loop.stop())

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_forever()
        self._loop.run_until_complete(self._loop.shutdown_asyncgens())
        self._loop.close()
