"""Child processes of the console: start, supervision, termination.

A *process body* is a plain function ``body(connection, *arguments)`` of a feature package. It runs in a spawned child,
exchanges pickled frozen dataclasses over a duplex connection, and returns when the connection ends.
"""

import contextlib
import faulthandler
import logging
import multiprocessing
import os
import pickle
import select
import signal
import sys
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection, wait
from typing import Any, Literal

from caris_desktop.domain.process_settings import title_process
from caris_desktop.domain.value_class import Value
from caris_desktop.live.frame_ring import FrameRing, FrameRings
from caris_desktop.live.logs import configure_child_logging

_log = logging.getLogger(__name__)
_SWITCH_WITHIN_S = 0.0005
_CONTEXT = multiprocessing.get_context("spawn")

Health = Literal["running", "restarting", "failed"]
"""State of a required child. "failed": it failed too often to be restarted."""


class RingToWrite(Value):
    """Placeholder argument for the frame ring of this name; the child attaches it."""

    name: str


class RingsToRead(Value):
    """Placeholder argument for a reader of these rings, and of others once frames name them."""

    names: tuple[str, ...]


class ProcessSpec(Value):
    """Entry point of a child: module-level function and picklable arguments."""

    name: str
    target: Callable[..., None]
    arguments: tuple[Any, ...] = ()


class ChildProcess:
    """Child process with a reader thread in the console.

    ``on_message(value, raw)`` and ``on_exit(exit_code)`` run in that thread; ``raw`` is the pickled form, for
    forwarding without pickling again.
    """

    def __init__(
        self,
        body: ProcessSpec,
        *,
        on_message: Callable[[Any, bytes], None],
        on_exit: Callable[[int | None], None] | None = None,
    ) -> None:
        self.body = body
        self._on_message = on_message
        self._on_exit = on_exit
        self._closing = False
        self._send_lock = threading.Lock()
        # Prevents closing the connection during use: its descriptor would be reused by the next file.
        self._close_lock = threading.Lock()
        self._connection: Connection | None = None
        self._process: multiprocessing.process.BaseProcess | None = None
        self._reader: threading.Thread | None = None

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    def start(self) -> None:
        # The GUI thread must not wait 5 ms for the GIL while a reader thread unpickles.
        sys.setswitchinterval(min(sys.getswitchinterval(), _SWITCH_WITHIN_S))
        ours, theirs = _CONTEXT.Pipe(duplex=True)
        process = _CONTEXT.Process(
            target=_run_body, args=(self.body, theirs), name=f"caris-{self.body.name}", daemon=True
        )
        process.start()
        theirs.close()
        self._connection, self._process = ours, process
        self._reader = threading.Thread(
            target=self._read, args=(ours, process), name=f"read-{self.body.name}", daemon=True
        )
        self._reader.start()

    def send(self, message: Any) -> bool:
        """Send ``message`` without waiting; False if the child ended or does not read."""
        return self.send_raw(pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL))

    def send_raw(self, raw: bytes) -> bool:
        connection = self._connection
        if connection is None:
            return False
        with self._send_lock:
            try:
                if not _writable(connection):
                    return False
                connection.send_bytes(raw)
            except (OSError, ValueError):
                return False
        return True

    def send_raw_waiting(self, raw: bytes) -> bool:
        """Like :meth:`send_raw`, but waits for buffer space. Never in the GUI thread."""
        connection = self._connection
        if connection is None:
            return False
        with self._send_lock:
            try:
                connection.send_bytes(raw)
            except (OSError, ValueError):
                return False
        return True

    def ask_to_end(self) -> None:
        """Close the connection, so that several children end in parallel. :meth:`stop` must follow."""
        self._closing = True
        connection = self._connection
        if connection is None:
            return
        # A half-close ends the child's reads while its last messages still arrive.
        self._shut(connection, whole=sys.platform == "win32")

    def _shut(self, connection: Connection, *, whole: bool) -> None:
        """Abort a send in progress; with ``whole`` close the connection once no send is active."""
        if sys.platform != "win32":
            with self._close_lock, contextlib.suppress(OSError), _socket_of(connection) as half:
                half.shutdown(_SHUT_WR)
        if whole:
            with self._send_lock, self._close_lock:
                connection.close()

    def stop(self, *, grace_s: float) -> None:
        """End the child: close the connection, wait, then kill. Blocks slightly longer than ``grace_s``."""
        self.ask_to_end()
        process = self._process
        if process is None or self._connection is None:
            return
        # Only the reader thread reaps: two threads waiting for one process would steal each other's status.
        if not wait([process.sentinel], grace_s):
            _log.warning("%s did not end within %.1f s: killed", self.body.name, grace_s)
            process.kill()
            wait([process.sentinel], 1.0)
        if self._reader is not None and self._reader is not threading.current_thread():
            self._reader.join(2.0)
        self._connection = None

    def kill(self) -> None:
        """Kill a hung child. Its exit is reported as usual."""
        if self._process is not None:
            self._process.kill()

    def _read(self, connection: Connection, process: multiprocessing.process.BaseProcess) -> None:
        while True:
            try:
                raw = connection.recv_bytes()
            except (EOFError, OSError):
                break
            try:
                self._on_message(pickle.loads(raw), raw)  # noqa: S301 - from our own child, over a private pipe
            except Exception:
                _log.exception("a message of %s could not be handled", self.body.name)
        process.join(5.0)
        self._shut(connection, whole=True)
        if not self._closing:
            level = logging.INFO if process.exitcode == 0 else logging.ERROR
            _log.log(level, "%s ended by itself with exit code %s", self.body.name, process.exitcode)
            if self._on_exit is not None:
                self._on_exit(process.exitcode)


if sys.platform != "win32":
    import socket

    _SHUT_WR = socket.SHUT_WR

    def _socket_of(connection: Connection) -> socket.socket:
        return socket.socket(fileno=os.dup(connection.fileno()))


def _writable(connection: Connection) -> bool:
    if sys.platform == "win32":
        return True
    # Not select, which fails for descriptors from 1024 on.
    waits = select.poll()
    waits.register(connection.fileno(), select.POLLOUT)
    return any(events & select.POLLOUT for _descriptor, events in waits.poll(0))


def _run_body(body: ProcessSpec, connection: Connection) -> None:
    """Child side. Ignores signals to the process group: the console ends its children in order."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    title_process(body.name)
    if hasattr(os, "setsid"):
        # Linux shares CPU time among sessions first: a separate session prevents this child's load from taking the
        # window's share.
        with contextlib.suppress(OSError):
            os.setsid()
    faulthandler.enable()
    configure_child_logging(body.name)
    rings: list[FrameRing | FrameRings] = []
    arguments: list[Any] = []
    for argument in body.arguments:
        if isinstance(argument, RingToWrite):
            ring = FrameRing.attach(argument.name)
            rings.append(ring)
            arguments.append(ring)
        elif isinstance(argument, RingsToRead):
            readers = FrameRings((FrameRing.attach(name) for name in argument.names), attach=True)
            rings.append(readers)
            arguments.append(readers)
        else:
            arguments.append(argument)
    try:
        body.target(connection, *arguments)
    except Exception:
        _log.exception("%s failed", body.name)
        raise
    finally:
        for attached in rings:
            attached.close()
