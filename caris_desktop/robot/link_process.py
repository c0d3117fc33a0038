"""Common part of the link processes: loop, connection to the console, and state reports."""

import asyncio
import gc
import heapq
import logging
import os
import pickle
import signal
import struct
import sys
import threading
from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from operator import itemgetter
from typing import Any, Literal, Protocol

from caris_desktop.domain import link_commands
from caris_desktop.domain.address import without_credentials
from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import Gap, LinkChanged, LinkState, Problem, Severity
from caris_desktop.domain.sensing import AudioChunk, FrameRef
from caris_desktop.domain.streams import BY_TYPE, Delivery
from caris_desktop.domain.translation import QT_TR_NOOP, localized

logger = logging.getLogger(__name__)

GOODBYE_S = 0.3
_LAST_WORDS_S = 0.5
_READ_BYTES = 64 * 1024

UNREACHABLE_MEANING = QT_TR_NOOP(
    "Driving, video and all other robot functions are not available. The console keeps trying to connect."
)


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


class Link(Protocol):
    """Content of a link process. All calls are on its loop."""

    def start(self) -> None:
        """Connect, and reconnect."""

    def process_commands(self, received: list[link_commands.RobotCommand]) -> None:
        """Execute the console's commands in order. Never raises."""

    async def finish(self) -> None:
        """Leave the robot safe, then disconnect."""


def run_link(connection: Connection, make: Callable[[ConsoleSender], Link]) -> None:
    """Run a link until CloseLink, the end of ``connection`` or SIGTERM."""
    # Ctrl-C in a terminal reaches the whole process group; the console decides when to exit.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # The loop must not wait 5 ms for the interpreter lock while the outbox pickles a scan.
    sys.setswitchinterval(0.0005)
    asyncio.run(_serve(connection, make))


async def _serve(connection: Connection, make: Callable[[ConsoleSender], Link]) -> None:
    loop = asyncio.get_running_loop()
    outbox = ConsoleSender(connection)
    link = make(outbox)
    ended = asyncio.Event()
    reader = CommandReader(connection)
    loop.add_signal_handler(signal.SIGTERM, ended.set)

    def process_commands() -> None:
        try:
            received = reader.read()
        except (EOFError, OSError, pickle.UnpicklingError):
            # The console died or closed its end. Pending commands are dropped.
            received = [link_commands.CloseLink(now_ns())]
        if any(isinstance(command, link_commands.CloseLink) for command in received):
            loop.remove_reader(connection.fileno())
            ended.set()
        else:
            link.process_commands(received)

    loop.add_reader(connection.fileno(), process_commands)
    link.start()
    # Exclude the imports' objects from garbage collection, which would cause pauses while driving.
    gc.freeze()
    await ended.wait()
    await link.finish()
    outbox.close(_LAST_WORDS_S)


class CommandReader:
    """Non-blocking reader of a ``multiprocessing`` connection.

    ``Connection.recv`` blocks on incomplete messages: a console suspended while writing would stop the loop, and the
    motion lease with it. A message is its length in four bytes, then its pickle.
    """

    _LENGTH = struct.Struct("!i")

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._received = bytearray()

    def read(self) -> list[Any]:
        """Messages that are complete by now, oldest first.

        Raises
        ------
        EOFError, OSError, pickle.UnpicklingError
            If the other end has ended, or sends something else.
        """
        while self._connection.poll(0):
            piece = os.read(self._connection.fileno(), _READ_BYTES)
            if not piece:
                raise EOFError
            self._received += piece
        messages: list[Any] = []
        while (end := self._end_of_first()) <= len(self._received):
            messages.append(ForkingPickler.loads(self._received[self._LENGTH.size : end]))
            del self._received[:end]
        return messages

    def _end_of_first(self) -> int:
        """End of the first message, present or expected."""
        if len(self._received) < self._LENGTH.size:
            return self._LENGTH.size
        (length,) = self._LENGTH.unpack_from(self._received)
        if length < 0:
            raise pickle.UnpicklingError("a message of more than 2 GB")
        return self._LENGTH.size + int(length)


class LinkReporter:
    """Reports a link to the console: LinkChanged for each change, one Problem per outage."""

    def __init__(self, link: Literal["control", "media"], address: str, outbox: ConsoleSender) -> None:
        self._link = link
        self._address = without_credentials(address)
        self._put = outbox.put
        self.problems = ProblemReporter(outbox.put)
        self._reported_unreachable = False
        self._was_connected = False

    def changed(self, state: LinkState, detail: str = "") -> None:
        if state == "connected":
            self._reported_unreachable = False
            self._was_connected = True
        self._put(LinkChanged(now_ns(), self._link, state, self._address, detail))

    def unreachable(self, what: str, advice: str) -> None:
        logger.debug("%s: %s", self._link, what)
        if self._reported_unreachable:
            return
        self._reported_unreachable = True
        # A robot that was connected before stays "lost" until it is back; the detail is the reason.
        self.changed("lost" if self._was_connected else "connecting", what)
        # One Problem suffices for an absent robot; the control link reports for both.
        if self._link == "control":
            self._put(Problem(now_ns(), "error", what, UNREACHABLE_MEANING, advice, until="connected"))

    def refused(self, detail: str) -> None:
        self.problems.count(
            "refused",
            severity="warning",
            what=localized(
                QT_TR_NOOP("The robot sent {count} message(s) that cannot be used: {detail}."), detail=detail[:200]
            ),
            meaning=QT_TR_NOOP("They were ignored; everything else works."),
            advice=QT_TR_NOOP("If something stays empty, check the topic names and types in the robot profile."),
        )
