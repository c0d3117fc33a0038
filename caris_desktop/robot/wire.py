"""One websocket to a rosbridge server on an asyncio loop: sends without a task hop, knows a dead peer by its silence.

It stands on the sans-I/O layer of the ``websockets`` package rather than on its coroutines, because a velocity command
must reach the socket in the very call that decides on it, and every byte that arrives must count as a sign of life.
"""

import asyncio
import contextlib
import itertools
import logging
import socket
import ssl
import struct
from dataclasses import dataclass
from typing import Protocol, cast
from urllib.parse import urlsplit

from websockets.client import ClientProtocol
from websockets.exceptions import InvalidHandshake, InvalidURI, PayloadTooBig
from websockets.frames import Frame, Opcode
from websockets.http11 import Response
from websockets.uri import parse_uri

from caris_desktop.domain.address import without_credentials

logger = logging.getLogger(__name__)

_RESET_ON_CLOSE = struct.pack("ii", 1, 0)


@dataclass(frozen=True, slots=True)
class Timings:
    """When a silent peer is in trouble and when it is dead, and how fast to come back to it. Seconds."""

    ping_every_s: float = 0.2
    trouble_after_s: float = 0.5
    dead_after_s: float = 0.85
    handshake_s: float = 1.5
    first_retry_s: float = 0.2
    longest_retry_s: float = 1.0


CONTROL_TIMINGS = Timings()
# A large map keeps both ends busy for seconds; nothing drives over this one.
MEDIA_TIMINGS = Timings(ping_every_s=0.5, trouble_after_s=2.0, dead_after_s=4.0)


class WireOwner(Protocol):
    """Who is told what happens on the wire. All calls come on the loop."""

    def wire_received(self, payload: bytes) -> None:
        """A whole message, text or binary."""

    def wire_heard(self) -> None:
        """Something arrived after the trouble mark."""

    def wire_silent(self) -> None:
        """Nothing arrived for ``trouble_after_s``."""

    def wire_round_trip(self, round_trip_s: float) -> None:
        """A ping came back."""

    def wire_lost(self, reason: str) -> None:
        """The connection is over. Called once, and only for one that was open."""


class Wire(asyncio.Protocol):
    """One connection, from handshake to loss. Make it with :func:`open_wire`."""

    def __init__(self, url: str, owner: WireOwner, timings: Timings, largest_frame_bytes: int) -> None:
        self._loop = asyncio.get_running_loop()
        self._owner = owner
        self._timings = timings
        self._protocol = ClientProtocol(parse_uri(url), max_size=largest_frame_bytes, logger=_quiet_logger())
        self._transport: asyncio.Transport | None = None
        self.opened: asyncio.Future[None] = self._loop.create_future()
        self._open = False
        self._over = False
        self._heard_s = self._loop.time()
        self._began_s = self._heard_s
        self._silent = False
        self._pieces: list[bytes] = []
        self._pings: dict[bytes, float] = {}
        self._ping_numbers = itertools.count(1)
        self._next_ping_s = 0.0
        self._watch_s = min(timings.ping_every_s, timings.trouble_after_s / 4, 0.1)
        self._watched_s = 0.0
        self._watch: asyncio.TimerHandle | None = None
        self._why_lost = ""

    @property
    def is_open(self) -> bool:
        return self._open and not self._over

    @property
    def unsent_bytes(self) -> int:
        """What the operating system has not taken yet."""
        return 0 if self._transport is None else self._transport.get_write_buffer_size()

    def send_text(self, payload: bytes) -> bool:
        """Hand one message to the socket now. False, and the message is gone, when the connection is not open."""
        if not self.is_open:
            return False
        self._protocol.send_text(payload)
        self._flush()
        return True

    def close(self) -> None:
        """Say goodbye properly; what was sent before still arrives."""
        if self.is_open:
            self._why_lost = "closed by this program"
            self._protocol.send_close(1000)
            self._flush()
        elif self._transport is not None:
            self._transport.abort()

    def abort(self, reason: str) -> None:
        """Drop the connection and whatever lies unsent in it, so that nothing of it arrives later."""
        self._why_lost = reason
        if self._transport is not None:
            raw = self._transport.get_extra_info("socket")
            if raw is not None:
                with contextlib.suppress(OSError):
                    raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET_ON_CLOSE)
            self._transport.abort()
        # Everybody learns of it now; connection_lost would come one turn of the loop later.
        self._end()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._began_s = self._loop.time()
        raw = transport.get_extra_info("socket")
        if raw is not None:
            raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._protocol.send_request(self._protocol.connect())
        self._flush()

    def data_received(self, data: bytes) -> None:
        self._heard_s = self._loop.time()
        if self._silent:
            self._silent = False
            self._owner.wire_heard()
        self._protocol.receive_data(data)
        for event in self._protocol.events_received():
            if isinstance(event, Response):
                self._take_response()
            elif isinstance(event, Frame) and not self._over:
                self._take_frame(event)
        if self._over:
            return
        self._flush()
        if self._protocol.handshake_exc is not None and not self.opened.done():
            self.opened.set_exception(self._protocol.handshake_exc)
        # Closing with unread data would reset the connection, and our last zeros with it: wait for the peer's goodbye.
        parted = self._protocol.close_rcvd is not None or self._protocol.parser_exc is not None
        if self._protocol.close_expected() and parted and self._transport is not None:
            self._why_lost = self._why_lost or self._farewell()
            self._transport.close()

    def eof_received(self) -> None:
        self._protocol.receive_eof()
        self._flush()

    def connection_lost(self, exc: Exception | None) -> None:
        if not self._why_lost and exc is not None:
            self._why_lost = str(exc)
        self._end()

    def _take_response(self) -> None:
        if self._protocol.handshake_exc is not None:
            return
        self._open = True
        self._watched_s = self._next_ping_s = self._loop.time()
        # The first answer over a slow network takes as long as the handshake did.
        self._heard_s = 2.0 * self._watched_s - self._began_s
        self._watch = self._loop.call_later(self._watch_s, self._look_after)
        if not self.opened.done():
            self.opened.set_result(None)

    def _take_frame(self, frame: Frame) -> None:
        if frame.opcode in (Opcode.TEXT, Opcode.BINARY, Opcode.CONT):
            if frame.fin and not self._pieces:
                self._owner.wire_received(bytes(frame.data))
                return
            self._pieces.append(bytes(frame.data))
            if frame.fin:
                whole, self._pieces = b"".join(self._pieces), []
                self._owner.wire_received(whole)
        elif frame.opcode is Opcode.PONG:
            sent_s = self._pings.pop(bytes(frame.data), None)
            if sent_s is not None:
                # Earlier ones, had they been answered, would have been answered before.
                self._pings = {token: at_s for token, at_s in self._pings.items() if at_s > sent_s}
                self._owner.wire_round_trip(self._loop.time() - sent_s)

    def _look_after(self) -> None:
        now_s = self._loop.time()
        late_s = now_s - self._watched_s - self._watch_s
        self._watched_s = now_s
        self._watch = self._loop.call_later(self._watch_s, self._look_after)
        if late_s > self._watch_s:
            # It was this process that slept; what the peer sent meanwhile still lies unread in the socket.
            self._heard_s = min(now_s, self._heard_s + late_s)
        silent_s = now_s - self._heard_s
        if silent_s >= self._timings.dead_after_s:
            self.abort(f"nothing came from it for {silent_s:.1f} s")
            return
        if silent_s >= self._timings.trouble_after_s and not self._silent:
            self._silent = True
            self._owner.wire_silent()
        if now_s >= self._next_ping_s and self.is_open:
            self._next_ping_s = now_s + self._timings.ping_every_s
            token = b"%d" % next(self._ping_numbers)
            self._pings[token] = now_s
            self._protocol.send_ping(token)
            self._flush()

    def _farewell(self) -> str:
        if isinstance(self._protocol.parser_exc, PayloadTooBig):
            return "it sent a message that is far too large"
        close = self._protocol.close_rcvd
        if close is None:
            return str(self._protocol.parser_exc or "the connection was closed")
        return f"it closed the connection ({close.code}{' ' + close.reason if close.reason else ''})"

    def _flush(self) -> None:
        if self._transport is None or self._transport.is_closing():
            self._protocol.data_to_send()
            return
        for data in self._protocol.data_to_send():
            if data:
                self._transport.write(data)
            elif self._transport.can_write_eof():
                self._transport.write_eof()

    def _end(self) -> None:
        if self._over:
            return
        self._over = True
        if self._watch is not None:
            self._watch.cancel()
        reason = self._why_lost or "the connection broke off"
        if not self.opened.done():
            self.opened.set_exception(ConnectionError(reason))
        # Nobody may be waiting any more.
        self.opened.exception()
        if self._open:
            self._owner.wire_lost(reason)


async def open_wire(url: str, owner: WireOwner, timings: Timings, *, largest_frame_bytes: int) -> Wire:
    """Connect and shake hands.

    Raises
    ------
    OSError, TimeoutError, websockets.exceptions.InvalidHandshake, websockets.exceptions.InvalidURI
        When no rosbridge answers there within ``timings.handshake_s``.
    """
    parts = urlsplit(url)
    secure = parts.scheme == "wss"
    made: list[Wire] = []

    def make() -> Wire:
        made.append(Wire(url, owner, timings, largest_frame_bytes))
        return made[-1]

    try:
        async with asyncio.timeout(timings.handshake_s):
            await asyncio.get_running_loop().create_connection(
                make,
                parts.hostname or "",
                parts.port or (443 if secure else 80),
                ssl=ssl.create_default_context() if secure else None,
            )
            await made[-1].opened
    except BaseException:
        for wire in made:
            wire.abort("the handshake did not complete")
        raise
    return made[-1]


def explain_failure(error: BaseException, address: str) -> tuple[str, str]:
    """Why no connection came about, and what to do, for the wizard. No password of ``address`` is in it."""
    address = without_credentials(address)
    name = urlsplit(address).hostname or address
    if isinstance(error, TimeoutError):
        return (
            f"Nothing answers at {address}.",
            "Check that the robot is on and in the same network, and that no firewall is in the way.",
        )
    if isinstance(error, socket.gaierror):
        return (f"No computer named {name} is known.", "Check the address, or use the robot's IP address.")
    if isinstance(error, ConnectionRefusedError):
        return (
            f"{name} is there, but no rosbridge listens at {address}.",
            "Start rosbridge on the robot (rosbridge_websocket), or correct the port.",
        )
    if isinstance(error, InvalidURI):
        return (f"{address} is not an address that can be used: {error.msg}.", "Correct the robot's address.")
    if isinstance(error, (InvalidHandshake, ConnectionError)):
        return (
            f"What answers at {address} is not a rosbridge server ({error}).",
            "Check the port; rosbridge uses 9090 unless set otherwise.",
        )
    return (f"{address} cannot be reached ({error}).", "Check the network and the robot's address.")


def _quiet_logger() -> logging.Logger:
    # The protocol's own debug lines would print every velocity command.
    quiet = logging.getLogger("caris_desktop.robot.wire.frames")
    quiet.setLevel(logging.INFO)
    return quiet
