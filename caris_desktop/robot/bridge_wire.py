"""Websocket to a rosbridge server on an asyncio loop: sends without a task switch, detects dead peers by silence.

It uses the sans-I/O layer of the ``websockets`` package instead of its coroutines, because a velocity command must
reach the socket within the call that decides on it, and every received byte must count as a sign of life.
"""

import array
import asyncio
import contextlib
import itertools
import logging
import math
import socket
import ssl
import struct
import sys
from collections.abc import Callable
from typing import Protocol, cast
from urllib.parse import urlsplit

from websockets.client import ClientProtocol
from websockets.exceptions import InvalidHandshake, InvalidStatus, InvalidURI, PayloadTooBig
from websockets.frames import Frame, Opcode
from websockets.http11 import Response
from websockets.protocol import State
from websockets.uri import parse_uri

from caris_desktop.domain.address import without_credentials
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.robot.bridge_security import (
    LinkError,
    SecurityError,
    certificate_refusal,
    explain_tls_failure,
    no_tls,
    tls_context,
)
from caris_desktop.robot.profile_model import SecuritySettings

if sys.platform != "win32":
    import fcntl
    import termios

logger = logging.getLogger(__name__)

_TLS_READ_BYTES = 256 * 1024
_RESET_ON_CLOSE = struct.pack("ii", 1, 0)
# Time for a resumed peer to execute what it had not read.
_OBEYS_WITHIN_S = 1.0
_NOT_READY = 500
"""From this HTTP status on it is the server that cannot, and not the question that is wrong."""


class Timings(Value):
    """Timeouts of a silent peer, and reconnection delays. Seconds.

    Silence means no bytes of any kind over any connection to the same server: one busy with the others is not dead. An
    unanswered ping counts as well, after the longer ``unanswered_trouble_after_s`` and ``unanswered_dead_after_s``: it
    shows that our data does not arrive, although the robot's does.

    An abandoned peer whose system has accepted all of our bytes keeps its connection for up to ``leave_open_s``: see
    :meth:`Wire.give_up`. A lost peer is tried every ``first_retry_s`` for ``quick_retries_s``, then less often: the
    robot may move until a restarted bridge passes on a zero.
    """

    ping_every_s: float = 0.2
    trouble_after_s: float = 0.5
    dead_after_s: float = 0.85
    unanswered_trouble_after_s: float = 0.8
    unanswered_dead_after_s: float = 1.6
    leave_open_s: float = 600.0
    handshake_s: float = 1.5
    first_retry_s: float = 0.1
    quick_retries_s: float = 10.0
    longest_retry_s: float = 1.0


CONTROL_TIMINGS = Timings()
# A large map occupies both ends for seconds, and delays pings; nothing drives over this link.
MEDIA_TIMINGS = Timings(
    ping_every_s=0.5,
    trouble_after_s=2.0,
    dead_after_s=4.0,
    unanswered_trouble_after_s=math.inf,
    unanswered_dead_after_s=math.inf,
    leave_open_s=0.0,
    first_retry_s=0.2,
    quick_retries_s=0.0,
)


class WireOwner(Protocol):
    """Receiver of wire events. All calls come on the loop."""

    def wire_received(self, payload: bytes) -> None:
        """Whole message, text or binary."""

    def server_received_s(self) -> float:
        """When anything last came from the same server over another connection, on the loop's clock."""

    def wire_recovered(self) -> None:
        """The trouble is over: data arrived, and pings are answered."""

    def wire_silent(self) -> None:
        """Nothing arrived, or no ping was answered, for as long as ``Timings`` permits."""

    def wire_round_trip(self, round_trip_s: float) -> None:
        """A ping came back."""

    def wire_lost(self, reason: str) -> None:
        """The connection is over. Called once, and only for one that was open."""


class _Ping(Value):
    """Unanswered ping."""

    sent_s: float
    answered: Callable[[float], None] | None


class Wire(asyncio.Protocol):
    """One connection, from handshake to loss. Create it with :func:`open_wire`."""

    def __init__(
        self, url: str, owner: WireOwner, timings: Timings, largest_frame_bytes: int, tls: "TlsLayer | None" = None
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._address = without_credentials(url)
        self._owner = owner
        self._timings = timings
        self._protocol = ClientProtocol(parse_uri(url), max_size=largest_frame_bytes, logger=_quiet_logger())
        self._transport: asyncio.Transport | None = None
        self._tls = tls
        self.opened: asyncio.Future[None] = self._loop.create_future()
        self._open = False
        self._over = False
        self._received_s = self._loop.time()
        self._began_s = self._received_s
        self._silent = False
        self._pieces: list[bytes] = []
        self._pings: dict[bytes, _Ping] = {}
        self._ping_numbers = itertools.count(1)
        self._next_ping_s = 0.0
        self._watch_s = min(timings.ping_every_s, timings.trouble_after_s / 4, 0.1)
        self._watched_s = 0.0
        self._watch: asyncio.TimerHandle | None = None
        self._loss_reason = ""
        self._ended_here = False
        self._left_open: asyncio.TimerHandle | None = None

    @property
    def is_open(self) -> bool:
        return self._open and not self._over

    @property
    def received_s(self) -> float:
        """When anything last came."""
        return self._received_s

    @property
    def unsent_bytes(self) -> int:
        """Bytes that the operating system has not accepted yet."""
        return 0 if self._transport is None else self._transport.get_write_buffer_size()

    @property
    def own_host(self) -> str:
        """Local address."""
        return self._host("sockname")

    @property
    def peer_host(self) -> str:
        """Remote address."""
        return self._host("peername")

    @property
    def parted_by_peer(self) -> bool:
        """True if the peer closed the connection properly."""
        return self._over and self._protocol.close_rcvd is not None and not self._ended_here

    @property
    def broken_by_size(self) -> bool:
        """True if the connection ended because of an oversized frame."""
        return self._over and isinstance(self._protocol.parser_exc, PayloadTooBig)

    def send_text(self, payload: bytes) -> bool:
        """Hand one message to the socket now. False, and the message is dropped, if the connection is not open."""
        if not self.is_open or self._protocol.state is not State.OPEN:
            return False
        self._protocol.send_text(payload)
        self._flush()
        return True

    def send_ping(self, answered: Callable[[float], None] | None = None) -> None:
        """Send a ping, which the peer answers after reading everything before it.

        ``answered`` is called with the round trip in seconds; without it the owner is.
        """
        if self.is_open and self._protocol.state is State.OPEN:
            token = b"%d" % next(self._ping_numbers)
            self._pings[token] = _Ping(self._loop.time(), answered)
            self._protocol.send_ping(token)
            self._flush()

    def give_up(self, reason: str) -> None:
        """Abandon an unresponsive peer: lost from now on, but it may still read everything sent.

        A rosbridge discards unexecuted messages when its client disconnects. A suspended one would resume, execute some
        old commands, notice our end and drop the zero behind them. So the connection stays open, unused, until the peer
        has had time to execute. Bytes that its system has not accepted are discarded at once.
        """
        if self._timings.leave_open_s <= 0.0 or self.unsent_bytes or not self._read_by_peer():
            self.abort(reason)
            return
        self._loss_reason = reason
        self._left_open = self._loop.call_later(self._timings.leave_open_s, self.drop)
        self._end()

    @property
    def left_open(self) -> bool:
        """Abandoned, but not closed yet."""
        return self._left_open is not None

    def drop(self) -> None:
        """Close what :meth:`give_up` left open."""
        if self._left_open is not None:
            self._left_open.cancel()
            self._left_open = None
        if self._transport is not None:
            self._transport.abort()

    def _read_by_peer(self) -> bool:
        """True if the peer's system has acknowledged every byte; False if unknown."""
        raw = None if self._transport is None else self._transport.get_extra_info("socket")
        if raw is None or sys.platform != "linux":
            return False
        unacknowledged = array.array("i", [1])
        with contextlib.suppress(OSError):
            fcntl.ioctl(raw.fileno(), termios.TIOCOUTQ, unacknowledged)
        return unacknowledged[0] == 0

    def close(self) -> None:
        """Close properly; data sent before still arrives."""
        if self.is_open:
            self._ended_here = True
            self._loss_reason = QT_TR_NOOP("closed by this program")
            self._protocol.send_close(1000)
            self._flush()
        elif self._transport is not None:
            self._transport.abort()

    def abort(self, reason: str) -> None:
        """Drop the connection with all unsent data, so that nothing of it arrives later."""
        self._loss_reason = reason
        if self._transport is not None:
            raw = self._transport.get_extra_info("socket")
            if raw is not None:
                with contextlib.suppress(OSError):
                    raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET_ON_CLOSE)
            self._transport.abort()
        # Report it now; connection_lost would come one loop turn later.
        self._end()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._began_s = self._loop.time()
        raw = transport.get_extra_info("socket")
        if raw is not None:
            raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._tls is None:
            self._ask_for_websocket()
        else:
            self._shake_hands(b"")

    def data_received(self, data: bytes) -> None:
        if self._over:
            if self._left_open is not None and self._left_open.when() > self._loop.time() + _OBEYS_WITHIN_S:
                # It has resumed, and executes what it had not read.
                self._left_open.cancel()
                self._left_open = self._loop.call_later(_OBEYS_WITHIN_S, self.drop)
            return
        # Bytes of an incomplete TLS record count as a sign of life, too.
        self._received_s = self._loop.time()
        if self._silent and not self._unanswered(self._received_s):
            self._silent = False
            self._owner.wire_recovered()
        if self._tls is None:
            self._on_bytes(data)
        elif not self._tls.established:
            self._shake_hands(data)
        else:
            self._on_secured(data)

    def _ask_for_websocket(self) -> None:
        self._protocol.send_request(self._protocol.connect())
        self._flush()

    def _shake_hands(self, data: bytes) -> None:
        if self._tls is None or self._transport is None:
            return
        try:
            established = self._tls.shake_hands(data)
        except ssl.SSLError as error:
            # Send the TLS alert with the reason before closing.
            self._transport.write(self._tls.to_send())
            self._fail_opening(error)
            self._transport.close()
            return
        self._transport.write(self._tls.to_send())
        if established:
            self._ask_for_websocket()
            self._on_secured(b"")

    def _on_secured(self, data: bytes) -> None:
        if self._tls is None or self._transport is None:
            return
        try:
            plain, ended = self._tls.decrypt(data)
        except ssl.SSLError as error:
            self._fail_opening(error)
            self.abort(localized(QT_TR_NOOP("the secure connection was lost ({error})"), error=error.reason or error))
            return
        if plain:
            self._on_bytes(plain)
        if ended and not self._over:
            self._protocol.receive_eof()
            self._flush()
            self._transport.close()

    def _on_bytes(self, data: bytes) -> None:
        self._protocol.receive_data(data)
        for event in self._protocol.events_received():
            if isinstance(event, Response):
                self._on_response()
            elif isinstance(event, Frame) and not self._over:
                self._on_frame(event)
        if self._over:
            return
        self._flush()
        if self._protocol.handshake_exc is not None:
            self._fail_opening(self._protocol.handshake_exc)
        # Closing with unread data would reset the connection, and discard our last zeros: wait for the peer's close.
        parted = self._protocol.close_rcvd is not None or self._protocol.parser_exc is not None
        if self._protocol.close_expected() and parted and self._transport is not None:
            self._loss_reason = self._loss_reason or self._farewell()
            self._transport.close()

    def eof_received(self) -> None:
        if self._over:
            return
        self._protocol.receive_eof()
        self._flush()

    def connection_lost(self, exc: Exception | None) -> None:
        if self._left_open is not None:
            self._left_open.cancel()
            self._left_open = None
        if self._tls is not None and not self._tls.established:
            # Servers without TLS close on an unintelligible message.
            self._fail_opening(SecurityError(*no_tls(self._address)))
        if not self._loss_reason and exc is not None:
            self._loss_reason = str(exc)
        self._end()

    def _on_response(self) -> None:
        if self._protocol.handshake_exc is not None:
            return
        self._open = True
        self._watched_s = self._next_ping_s = self._loop.time()
        # The first answer over a slow network takes as long as the handshake did.
        self._received_s = 2.0 * self._watched_s - self._began_s
        self._watch = self._loop.call_later(self._watch_s, self._supervise)
        if not self.opened.done():
            self.opened.set_result(None)

    def _on_frame(self, frame: Frame) -> None:
        if frame.opcode in (Opcode.TEXT, Opcode.BINARY, Opcode.CONT):
            if frame.fin and not self._pieces:
                self._owner.wire_received(bytes(frame.data))
                return
            self._pieces.append(bytes(frame.data))
            if frame.fin:
                payload, self._pieces = b"".join(self._pieces), []
                self._owner.wire_received(payload)
        elif frame.opcode is Opcode.PONG:
            ping = self._pings.pop(bytes(frame.data), None)
            if ping is not None:
                # Answers to earlier pings would have arrived before.
                self._pings = {token: other for token, other in self._pings.items() if other.sent_s > ping.sent_s}
                (ping.answered or self._owner.wire_round_trip)(self._loop.time() - ping.sent_s)

    def _supervise(self) -> None:
        now_s = self._loop.time()
        late_s = now_s - self._watched_s - self._watch_s
        self._watched_s = now_s
        self._watch = self._loop.call_later(self._watch_s, self._supervise)
        if late_s > self._watch_s:
            # This process was suspended; the peer's data is still unread in the socket.
            self._received_s = min(now_s, self._received_s + late_s)
            self._pings = {
                token: _Ping(min(now_s, ping.sent_s + late_s), ping.answered) for token, ping in self._pings.items()
            }
        silent_s = now_s - max(self._received_s, self._owner.server_received_s())
        if silent_s >= self._timings.dead_after_s:
            self.give_up(localized(QT_TR_NOOP("no data received for {silent_s} s"), silent_s=f"{silent_s:.1f}"))
            return
        unanswered_s = self._unanswered_s(now_s)
        if unanswered_s >= self._timings.unanswered_dead_after_s:
            self.give_up(localized(QT_TR_NOOP("no response for {unanswered_s} s"), unanswered_s=f"{unanswered_s:.1f}"))
            return
        if not self._silent and (silent_s >= self._timings.trouble_after_s or self._unanswered(now_s)):
            self._silent = True
            self._owner.wire_silent()
        if now_s >= self._next_ping_s and self.is_open:
            self._next_ping_s = now_s + self._timings.ping_every_s
            self.send_ping()

    def _unanswered(self, now_s: float) -> bool:
        return self._unanswered_s(now_s) >= self._timings.unanswered_trouble_after_s

    def _unanswered_s(self, now_s: float) -> float:
        oldest = next(iter(self._pings.values()), None)
        return 0.0 if oldest is None else now_s - oldest.sent_s

    def _farewell(self) -> str:
        if isinstance(self._protocol.parser_exc, PayloadTooBig):
            return QT_TR_NOOP("it sent a message that is far too large")
        close = self._protocol.close_rcvd
        if close is None:
            return str(self._protocol.parser_exc or QT_TR_NOOP("the connection was closed"))
        return f"it closed the connection ({close.code}{' ' + close.reason if close.reason else ''})"

    def _flush(self) -> None:
        if self._transport is None or self._transport.is_closing():
            self._protocol.data_to_send()
            return
        for data in self._protocol.data_to_send():
            if data:
                self._transport.write(data if self._tls is None else self._tls.encrypt(data))
            elif self._tls is None and self._transport.can_write_eof():
                self._transport.write_eof()

    def _host(self, which: str) -> str:
        address = None if self._transport is None else self._transport.get_extra_info(which)
        return str(address[0]) if address else ""

    def _fail_opening(self, error: Exception) -> None:
        if not self.opened.done():
            self.opened.set_exception(error)

    def _end(self) -> None:
        if self._over:
            return
        self._over = True
        if self._watch is not None:
            self._watch.cancel()
        reason = self._loss_reason or QT_TR_NOOP("the connection was lost")
        self._fail_opening(ConnectionError(reason))
        if not self.opened.cancelled():
            # There may be no waiter any more.
            self.opened.exception()
        if self._open:
            self._owner.wire_lost(reason)


class TlsLayer:
    """TLS between websocket and socket, without its own I/O.

    asyncio's TLS transport hides how much the operating system has not accepted yet, and incomplete incoming messages.
    """

    def __init__(self, context: ssl.SSLContext, server_name: str) -> None:
        self._received = ssl.MemoryBIO()
        self._outgoing = ssl.MemoryBIO()
        self._object = context.wrap_bio(self._received, self._outgoing, server_hostname=server_name)
        self.established = False

    def shake_hands(self, data: bytes) -> bool:
        """Continue the handshake with received data; True once it is complete.

        Raises
        ------
        ssl.SSLError
            Above all ``ssl.SSLCertVerificationError``: the server is not who it should be.
        """
        self._received.write(data)
        try:
            self._object.do_handshake()
        except ssl.SSLWantReadError:
            return False
        self.established = True
        return True

    def to_send(self) -> bytes:
        """Handshake data to send."""
        return self._outgoing.read()

    def encrypt(self, data: bytes) -> bytes:
        self._object.write(data)
        return self._outgoing.read()

    def decrypt(self, data: bytes) -> tuple[bytes, bool]:
        """Decrypted data, and whether the peer has ended the stream.

        Raises
        ------
        ssl.SSLError
            When the stream was tampered with.
        """
        self._received.write(data)
        pieces: list[bytes] = []
        ended = False
        while True:
            try:
                piece = self._object.read(_TLS_READ_BYTES)
            except ssl.SSLWantReadError:
                break
            except ssl.SSLZeroReturnError:
                piece = b""
            if not piece:
                ended = True
                break
            pieces.append(piece)
        return b"".join(pieces), ended


async def open_wire(
    url: str, owner: WireOwner, timings: Timings, *, largest_frame_bytes: int, security: SecuritySettings | None = None
) -> Wire:
    """Connect and shake hands; with ``wss://`` the server authenticates first.

    Raises
    ------
    OSError, TimeoutError, websockets.exceptions.InvalidHandshake, websockets.exceptions.InvalidURI
        When no rosbridge answers there within ``timings.handshake_s``; ``ssl.SSLError`` is an OSError.
    caris_desktop.robot.bridge_security.SecurityError
        When the server's certificate is not accepted, or the trusted ones of ``security`` cannot be used.
    """
    parts = urlsplit(url)
    secure = parts.scheme == "wss"
    host, port = parts.hostname or "", parts.port or (443 if secure else 80)
    context = await tls_context(security or SecuritySettings(), host, port) if secure else None
    made: list[Wire] = []

    def make() -> Wire:
        tls = TlsLayer(context, host) if context is not None else None
        made.append(Wire(url, owner, timings, largest_frame_bytes, tls))
        return made[-1]

    try:
        async with asyncio.timeout(timings.handshake_s):
            await asyncio.get_running_loop().create_connection(make, host, port)
            await made[-1].opened
    except BaseException as error:
        for wire in made:
            wire.abort(QT_TR_NOOP("the handshake did not complete"))
        if isinstance(error, ssl.SSLCertVerificationError):
            raise await certificate_refusal(error, host, port) from error
        raise
    return made[-1]


def explain_failure(error: BaseException, address: str) -> tuple[str, str]:
    """Reason for a failed connection, and advice, for the wizard. Without any password of ``address``."""
    address = without_credentials(address)
    name = urlsplit(address).hostname or address
    if isinstance(error, LinkError):
        return error.what, error.advice
    if isinstance(error, ssl.SSLError):
        return explain_tls_failure(error, name, address)
    if isinstance(error, TimeoutError):
        return (
            localized(QT_TR_NOOP("No response from {address}."), address=address),
            QT_TR_NOOP(
                "Check that the robot is turned on and on the same network, and that no firewall blocks the connection."
            ),
        )
    if isinstance(error, socket.gaierror):
        return (
            localized(QT_TR_NOOP("The computer {name} cannot be found."), name=name),
            QT_TR_NOOP("Check the address, or use the robot's IP address."),
        )
    if isinstance(error, ConnectionRefusedError):
        return (
            localized(
                QT_TR_NOOP("{name} is reachable, but no rosbridge is running at {address}."), name=name, address=address
            ),
            QT_TR_NOOP("Start rosbridge on the robot (rosbridge_websocket), or correct the port."),
        )
    if isinstance(error, InvalidURI):
        return (
            localized(QT_TR_NOOP("{address} is not a valid address: {msg}."), address=address, msg=error.msg),
            QT_TR_NOOP("Correct the robot's address."),
        )
    if isinstance(error, InvalidStatus) and error.response.status_code >= _NOT_READY:
        away = QT_TR_NOOP("The server at {address} does not accept connections at the moment (HTTP {status}).")
        advice = QT_TR_NOOP("Wait a moment; if this continues, check that rosbridge is running on the robot.")
        return localized(away, address=address, status=error.response.status_code), advice
    if isinstance(error, (InvalidHandshake, ConnectionError)):
        return (
            localized(
                QT_TR_NOOP("The server at {address} is not a rosbridge server ({error})."), address=address, error=error
            ),
            (
                "Check the port; the default port of rosbridge is 9090. The address of a secured rosbridge "
                "starts with wss://."
            ),
        )
    return (
        localized(QT_TR_NOOP("{address} cannot be reached ({error})."), address=address, error=error),
        QT_TR_NOOP("Check the network and the robot's address."),
    )


def _quiet_logger() -> logging.Logger:
    # The protocol's debug log would contain every velocity command.
    quiet = logging.getLogger("caris_desktop.robot.bridge_wire.frames")
    quiet.setLevel(logging.INFO)
    return quiet
