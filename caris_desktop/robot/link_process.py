"""Common part of the link processes: loop, connection to the console, and state reports."""

import asyncio
import gc
import logging
import os
import pickle
import signal
import struct
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from typing import Any, Literal, Protocol

from caris_desktop.domain import link_commands
from caris_desktop.domain.address import without_credentials
from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import LinkChanged, LinkState, Problem
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.robot.console_sender import ConsoleSender, ProblemReporter

logger = logging.getLogger(__name__)

GOODBYE_S = 0.3
_LAST_WORDS_S = 0.5
_READ_BYTES = 64 * 1024

UNREACHABLE_MEANING = QT_TR_NOOP(
    "Driving, video and all other robot functions are not available. The console keeps trying to connect."
)


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
