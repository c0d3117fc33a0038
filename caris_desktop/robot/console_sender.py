"""Non-blocking sender from a link process to the console."""

import heapq
import logging
import threading
from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Connection
from operator import itemgetter
from typing import Any

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import Gap, Problem, Severity
from caris_desktop.domain.sensing import AudioChunk, FrameRef
from caris_desktop.domain.streams import BY_TYPE, Delivery
from caris_desktop.domain.translation import QT_TR_NOOP, localized

logger = logging.getLogger(__name__)

# Half an hour of velocity commands at 20 Hz and related events.
MOST_EVENTS = 50_000
# A burst passes completely; a suspended console gets the newest of each stream on resuming.
MOST_VALUES_PER_STREAM = 8
# Audio is not a stream of newest values: each dropped chunk is a loss.
MOST_SOUNDS = 200


class ConsoleSender:
    """Accepts domain values on the loop and writes them to the console from its own thread.

    A suspended console fills the pipe and blocks its writer. That is this thread, so that the loop with the motion
    lease continues. Events are retained (up to a bound that lasts for a day of suspension); of state values the oldest
    are dropped and reported as a :class:`Gap`. Everything is sent in order: a value that overtook the loss of the link
    would count as live.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._changed = threading.Condition()
        # With sequence numbers across all queues.
        self._events: deque[tuple[int, Any]] = deque()
        self._values: dict[str, deque[tuple[int, Any]]] = {}
        self._number = 0
        self._gaps: dict[str, int] = {}
        self._closing = False
        self._thread = threading.Thread(target=self._write, name="link-outbox", daemon=True)
        self._thread.start()

    def put(self, value: Any) -> None:
        """Queue a value without blocking. Raises KeyError for a type that is not in the stream table."""
        spec = BY_TYPE[type(value)]
        with self._changed:
            self._number += 1
            if spec.delivery is Delivery.LOSSLESS:
                if len(self._events) >= MOST_EVENTS:
                    self._events.popleft()
                    self._gaps["events"] = self._gaps.get("events", 0) + 1
                self._events.append((self._number, value))
            else:
                # Each camera is a separate stream.
                key = f"{spec.name}:{value.camera}" if isinstance(value, FrameRef) else spec.name
                waiting = self._values.setdefault(key, deque())
                if len(waiting) >= (MOST_SOUNDS if isinstance(value, AudioChunk) else MOST_VALUES_PER_STREAM):
                    waiting.popleft()
                    self._gaps[spec.name] = self._gaps.get(spec.name, 0) + 1
                waiting.append((self._number, value))
            self._changed.notify()

    def close(self, timeout_s: float) -> None:
        """Write the rest, for at most ``timeout_s``."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(timeout_s)

    def _write(self) -> None:
        while True:
            with self._changed:
                while not (self._events or any(self._values.values()) or self._closing):
                    self._changed.wait()
                numbered = heapq.merge(self._events, *self._values.values(), key=itemgetter(0))
                batch = [value for _number, value in numbered]
                batch += [
                    Gap(now_ns(), stream, count, QT_TR_NOOP("the console could not keep up"))
                    for stream, count in self._gaps.items()
                ]
                self._events.clear()
                self._values.clear()
                self._gaps.clear()
                if not batch and self._closing:
                    return
            try:
                for value in batch:
                    self._connection.send(value)
            except (OSError, ValueError) as error:
                # The loop detects the closed connection separately.
                logger.info("The console is gone: %s", error)
                return


class ProblemReporter:
    """Aggregates equal problems into one Problem at intervals, with their count."""

    def __init__(
        self, put: Callable[[Problem], None], *, at_most_every_s: float = 10.0, clock: Callable[[], int] = now_ns
    ) -> None:
        self._put = put
        self._now_ns = clock
        self._every_ns = int(at_most_every_s * 1e9)
        self._last_ns: dict[str, int] = {}
        self._count: dict[str, int] = {}

    def count(self, key: str, *, severity: Severity, what: str, meaning: str, advice: str, cause: str = "") -> None:
        """Report the first of a kind at once and later ones summarised. ``{count}`` in ``what`` is their number.

        ``cause`` defaults to ``key``.
        """
        now = self._now_ns()
        self._count[key] = self._count.get(key, 0) + 1
        if key in self._last_ns and now - self._last_ns[key] < self._every_ns:
            return
        self._last_ns[key] = now
        number = self._count.pop(key)
        self._put(Problem(now, severity, localized(what, count=number), meaning, advice, "quiet", cause or key))
