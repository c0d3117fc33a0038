"""A rosbridge v2 server over websockets: topics, services and actions, for any number of clients."""

import asyncio
import base64
import contextlib
import fnmatch
import hashlib
import hmac
import itertools
import json
import logging
import math
import os
import socket
import ssl
import time
from collections import deque
from collections.abc import Callable, Iterable, KeysView, Sequence
from dataclasses import field
from functools import cached_property, partial
from http import HTTPStatus
from pathlib import Path
from typing import Any, TextIO

import cv2
import numpy as np
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.protocol import State

from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.ros import rosbridge
from caris_desktop.ros.dialect import Dialect, same_type
from caris_desktop.ros.message_fields import MessageError, count, message_of, number, stamp_or_none, text
from caris_desktop.ros.message_fields import field as field_of
from caris_desktop.ros.rosbridge import FragmentAssembler, ProtocolError, decode_json
from caris_desktop.simulator import typedefs

UNBOUNDED_LENGTH = 200
"""What a queue_length of 0 ("unbounded") means here."""
MAX_ANSWERS = 2000


class Published:
    """Message of a topic, encoded at most once per format for all clients.

    ``sequence`` counts the topic's messages from 1. Without ``in_cbor`` rosbridge cannot encode it as CBOR.
    """

    def __init__(self, topic: str, message: dict[str, Any], *, sequence: int = 0, in_cbor: bool = True) -> None:
        self.topic = topic
        self.message = message
        self.sequence = sequence
        self.in_cbor = in_cbor

    @cached_property
    def json(self) -> str:
        return rosbridge.encode_json({"op": "publish", "topic": self.topic, "msg": self.message})

    @cached_property
    def cbor(self) -> bytes:
        return rosbridge.encode_cbor({"op": "publish", "topic": self.topic, "msg": self.message})

    @cached_property
    def png(self) -> str:
        return rosbridge.encode_json({"op": "png", "data": png_of(self.json)})

    def size_bytes(self, piece: str | bytes) -> int:
        """Size of the whole message in the format of ``piece``, without fragment overhead."""
        return len(self.cbor) if isinstance(piece, bytes) else len(self.json)


class Subscription(Value):
    """Options of one subscription of a client."""

    throttle_s: float = 0.0
    queue_length: int = 0
    compression: str = "none"


@dataclass(slots=True)
class _Stream:
    """All subscriptions of one client to one topic; as in rosbridge they share a stream with the strictest options."""

    subscriptions: dict[str, Subscription] = field(default_factory=dict)
    waiting: deque[tuple[int, Published]] = field(default_factory=deque)
    sent_s: float = float("-inf")

    @property
    def throttle_s(self) -> float:
        return min(wish.throttle_s for wish in self.subscriptions.values())

    @property
    def queue_length(self) -> int:
        return min(wish.queue_length for wish in self.subscriptions.values())

    @property
    def compression(self) -> str:
        wishes = {wish.compression for wish in self.subscriptions.values()}
        return next((strongest for strongest in ("cbor-raw", "cbor", "png") if strongest in wishes), "none")


class ClientOutbox:
    """Everything queued for one client. ``clock`` is the event loop's time.

    ``fragment_size`` splits longer messages, as rosbridge does once any operation has set it. ``unwritable`` is called
    with the topic of each message that cannot be encoded for its subscriber.
    """

    def __init__(self, clock: Callable[[], float], *, unwritable: Callable[[str], None] = lambda _: None) -> None:
        self.fragment_size: int | None = None
        self._clock = clock
        self._unwritable = unwritable
        self._answers: deque[str | bytes] = deque()
        self._streams: dict[str, _Stream] = {}
        self._order = itertools.count()
        self._filled = asyncio.Event()
        self.dropped = 0

    @property
    def topics(self) -> KeysView[str]:
        """Subscribed topics."""
        return self._streams.keys()

    def subscribe(self, topic: str, key: str, subscription: Subscription) -> None:
        """Add a subscription, or change the one with the same ``key``."""
        self._streams.setdefault(topic, _Stream()).subscriptions[key] = subscription

    def unsubscribe(self, topic: str, key: str | None) -> None:
        """Remove one subscription of a topic, or all of them without a ``key``."""
        stream = self._streams.get(topic)
        if stream is None:
            return
        if key is not None:
            stream.subscriptions.pop(key, None)
        if key is None or not stream.subscriptions:
            del self._streams[topic]

    def put(self, published: Published) -> None:
        """Queue a message if its topic is subscribed; drops the oldest if the queue is full."""
        stream = self._streams.get(published.topic)
        if stream is None:
            return
        if stream.queue_length == 0 and self._clock() < stream.sent_s + stream.throttle_s:
            return  # rosbridge drops throttled messages without a queue, too
        stream.waiting.append((next(self._order), published))
        while len(stream.waiting) > (stream.queue_length or UNBOUNDED_LENGTH):
            stream.waiting.popleft()
            self.dropped += 1
        if stream.queue_length == 0 and stream.throttle_s > 0.0:
            stream.sent_s = self._clock()
        self._filled.set()

    def answer(self, operation: dict[str, Any]) -> bool:
        """Queue a reliable operation. False if thousands are queued."""
        if len(self._answers) >= MAX_ANSWERS:
            return False
        text = rosbridge.encode_json(operation)
        self._answers.extend(self._cut(text, str(operation["id"]) if "id" in operation else 0))
        self._filled.set()
        return True

    def raw(self, content: str | bytes) -> None:
        """Queue raw content, possibly malformed."""
        self._answers.append(content)
        self._filled.set()

    async def send_all(self, sender: "ClientWire") -> None:
        """Send until cancelled, or until the sender fails, whose error is raised."""
        while True:
            self._filled.clear()
            if self._answers:
                await sender.send(self._answers.popleft())
                continue
            stream, wait_s = self._next_stream()
            if stream is None:
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._filled.wait(), wait_s)
                continue
            _, published = stream.waiting.popleft()
            if stream.queue_length:
                stream.sent_s = self._clock()
            pieces = self._encoded(stream, published)
            if not pieces:
                self._unwritable(published.topic)
            for place, piece in enumerate(pieces, 1):
                await sender.send(piece, published if place == len(pieces) else None)

    def _next_stream(self) -> tuple[_Stream | None, float | None]:
        """Stream of the oldest message that may be sent; without one, the time until the next may."""
        now_s, wait_s = self._clock(), None
        first: _Stream | None = None
        for stream in self._streams.values():
            if not stream.waiting:
                continue
            ready_in_s = stream.sent_s + stream.throttle_s - now_s if stream.queue_length else 0.0
            if ready_in_s > 0.0:
                wait_s = ready_in_s if wait_s is None else min(wait_s, ready_in_s)
            elif first is None or stream.waiting[0][0] < first.waiting[0][0]:
                first = stream
        return first, wait_s

    def _encoded(self, stream: _Stream, published: Published) -> list[str | bytes]:
        """Pieces to send; none if the message cannot be encoded as requested."""
        match stream.compression:
            case "cbor":
                # rosbridge fails on splitting binary data, too
                is_short = published.in_cbor and not self._is_long(published.cbor)
                return [published.cbor] if is_short else []
            case "cbor-raw":
                return []
            case "png":
                return self._cut(published.png, 0)
        return self._cut(published.json, 0)

    def _is_long(self, content: str | bytes) -> bool:
        return self.fragment_size is not None and len(content) > self.fragment_size

    def _cut(self, text: str, message_id: str | int) -> list[str | bytes]:
        """Split a message; topic messages have fragment id 0, as in rosbridge."""
        if self.fragment_size is None or not self._is_long(text):
            return [text]
        pieces = rosbridge.fragments_of(text, message_id=message_id, size=self.fragment_size)
        return [rosbridge.encode_json(piece) for piece in pieces]


def png_of(text: str) -> str:
    """``text`` packed as in rosbridge's ``compression: png``: the bytes of an image, padded with line ends."""
    content = text.encode()
    width_px = max(1, math.isqrt(len(content) // 3))
    height_px = math.ceil(len(content) / 3 / width_px)
    padded = np.frombuffer(content.ljust(width_px * height_px * 3, b"\n"), np.uint8)
    worked, encoded = cv2.imencode(".png", padded.reshape(height_px, width_px, 3)[..., ::-1])
    if not worked:
        raise ValueError("a text could not be packed as a picture")
    return base64.b64encode(encoded.tobytes()).decode()


class LineLog:
    """Log of JSON lines, to count losses and late commands. Raises OSError when the file cannot be written."""

    def __init__(self, path: Path) -> None:
        self._file: TextIO = path.open("a", encoding="utf-8", buffering=1)

    def close(self) -> None:
        self._file.close()

    def write(self, **line: Any) -> None:
        # CBOR includes bytes and undefined values, too.
        self._file.write(json.dumps(line, separators=(",", ":"), default=str) + "\n")


# Access control: rosauth's signed authentication.

SECRET_CHARS = 16
"""The length that rosauth demands of its secret."""
_CLOCKS_DIFFER_AT_MOST_S = 5.0


def authentication_code(secret: str, *, client: str, dest: str, rand: str, time_s: int, level: str, end_s: int) -> str:
    """rosauth's MAC: SHA-512 of the concatenated fields, in hexadecimal."""
    return hashlib.sha512(f"{secret}{client}{dest}{rand}{time_s}{level}{end_s}".encode()).hexdigest()


def introduces_itself(operation: dict[str, Any], secret: str, *, now_s: float) -> bool:
    """True if an ``auth`` operation is signed with ``secret``, current, and not expired.

    Raises MessageError when a field is missing or is no text or number.
    """
    what = "auth"
    time_s, end_s = number(operation, "t", what), number(operation, "end", what)
    code = authentication_code(
        secret,
        client=text(operation, "client", what),
        dest=text(operation, "dest", what),
        rand=text(operation, "rand", what),
        time_s=int(time_s),
        level=text(operation, "level", what),
        end_s=int(end_s),
    )
    given = text(operation, "mac", what)
    if not given.isascii():
        raise MessageError("auth.mac must be hexadecimal digits")
    of_this_moment = abs(now_s - time_s) <= _CLOCKS_DIFFER_AT_MOST_S and time_s < end_s
    return hmac.compare_digest(code, given.lower()) and of_this_moment


logger = logging.getLogger(__name__)

Message = dict[str, Any]
ROBOT_NODE = "/simulated_robot"
_GLOBBED = ("advertise", "unadvertise", "publish", "subscribe", "unsubscribe")
BRIDGE_NODE = "/rosbridge_websocket"
MAX_INCOMING_BYTES = 4 * 1024 * 1024
_SEND_BUFFER_BYTES = 256 * 1024
_MAX_NAME_CHARS = 500
_MAX_SUBSCRIPTIONS = 500
_MAX_CLIENTS = 64
_DROP_AFTER_S = 0.05
_CLIENT_SERVICE_LIMIT_S = 10.0
_UNREGISTER_AFTER_S = 10.0
_REFUSALS_KEPT = 100


class CallFailed(MessageError):  # noqa: N818 - it is an answer to the caller, not a fault of the program
    """A service refused or failed; the text is its answer."""


@dataclass(slots=True)
class Topic:
    """Topic with a publisher or subscriber. ``latched``: late subscribers get the last message.

    ``other_types`` are accepted in addition. The robot's own topics are permanent, with the robot as publisher or
    subscriber; others exist while any client uses them.
    """

    type: str
    latched: bool = False
    last: Published | None = None
    sequence: int = 0
    publishers: set[str] = field(default_factory=set)
    on_message: Callable[[Message], None] | None = None
    other_types: tuple[str, ...] = ()
    robots_own: bool = True


class SimulatedService(Value):
    """Service of the robot."""

    type: str
    call: Callable[[Message], Message]


class Action(Value):
    """ROS 2 action: ``start`` takes (goal id, goal, reply); ``cancel`` takes the goal id."""

    type: str
    start: Callable[[str, Message, Callable[[Message], None]], None]
    cancel: Callable[[str], None]


class Client:
    """One connected client."""

    def __init__(self, number_: int, connection: ServerConnection, outbox: ClientOutbox) -> None:
        self.name = f"/rosbridge_client_{number_}"
        self.connection = connection
        self.outbox = outbox
        self.fragments = FragmentAssembler(max_bytes=MAX_INCOMING_BYTES)
        self.services: dict[str, str] = {}
        self.advertised: set[str] = set()
        self.admitted = False
        # Received and unhandled messages, and whether a goal or a call blocks them.
        self.queue: deque[Message] = deque()
        self.held = False

    def abort(self) -> None:
        """Abort the connection without closing it, as a failing network does."""
        self.connection.transport.abort()


class _Connection(ServerConnection):
    """Reads its socket to the end even after the peer left.

    A suspended server may write before it reads on resuming; the failed write would otherwise discard received data
    that its system has acknowledged.
    """

    def connection_lost(self, exc: Exception | None) -> None:
        raw = self.transport.get_extra_info("socket")
        if raw is not None and self.transport.get_extra_info("ssl_object") is None:
            with contextlib.suppress(OSError), socket.socket(fileno=os.dup(raw.fileno())) as unread:
                while data := unread.recv(MAX_INCOMING_BYTES):
                    self.data_received(data)
        super().connection_lost(exc)


class BridgeServer:
    """The server, in the event loop of :meth:`start`.

    What rosbridge refuses silently is refused silently here: ``refusals`` has the newest reasons, like a real one's
    log.

    Parameters
    ----------
    dialect
        Which ROS it serves: some operations and limits are of one of them only.
    secret
        Clients that do not introduce themselves with it, as rosauth demands, are sent away.
    now_s
        The robot's clock, by which an introduction is of this moment.
    log
        One line per message and client: ``at_ns`` (this computer's clock), ``client``, ``topic``, ``sequence`` (of the
        topic, from 1), ``stamp_ns`` (of the header, null without one) and ``bytes``.
    obeyed_log
        One line per executed message of a client: ``at_ns`` (monotonic clock, shared by all processes), ``client``,
        ``topic`` and ``message``; per executed service call: ``at_ns``, ``client``, ``service`` and ``request``; and
        per client: ``at_ns``, ``connected``.
    goals_in_new_threads, services_in_new_threads
        rosbridge's ``send_action_goals_in_new_thread`` and ``call_services_in_new_thread``, false by default as
        they are in rosbridge 2.0 and 2.1: a goal or a call holds everything behind it that came over the same
        websocket, and a goal that no action server takes holds it for good. In ROS 1 neither does.
    """

    def __init__(
        self,
        dialect: Dialect = Dialect.ROS1,
        *,
        secret: str | None = None,
        now_s: Callable[[], float] = time.time,
        log: LineLog | None = None,
        obeyed_log: LineLog | None = None,
        topics_glob: Sequence[str] = (),
        goals_in_new_threads: bool = False,
        services_in_new_threads: bool = False,
    ) -> None:
        """``topics_glob``: rosbridge's parameter; other topics are ignored; empty for all."""
        self.dialect = dialect
        self._topics_glob = topics_glob
        self._goals_hold = dialect is Dialect.ROS2 and not goals_in_new_threads
        self._services_hold = dialect is Dialect.ROS2 and not services_in_new_threads
        self.service_s = 0.0
        self.refusals: deque[str] = deque(maxlen=_REFUSALS_KEPT)
        self.topics: dict[str, Topic] = {}
        self.services: dict[str, SimulatedService] = {}
        self.actions: dict[str, Action] = {}
        self.params: dict[str, Callable[[], Any]] = {}
        self.clients: set[Client] = set()
        self.latency_s = 0.0
        self.rate_bytes_s: float | None = None
        self._secret = secret
        self._now_s = now_s
        self._log = log
        self._obeyed_log = obeyed_log
        self._refused_until_s = 0.0
        self._numbers = itertools.count(1)
        self._forwarded: dict[str, tuple[Client, str | None, str]] = {}
        self._closing: set[asyncio.Task[None]] = set()
        self._unwritable: set[str] = set()
        self._server: Server | None = None

    async def start(self, host: str, port: int, *, tls: ssl.SSLContext | None = None) -> int:
        """Listen, and return the port; 0 selects a free one. Raises OSError when the address cannot be used."""
        self._server = await serve(
            self._serve_client,
            host,
            port,
            process_request=self._admit,
            create_connection=_Connection,
            ssl=tls,
            compression=None,
            max_size=MAX_INCOMING_BYTES,
            ping_interval=10.0,
            ping_timeout=20.0,
            close_timeout=1.0,
        )
        return int(self._server.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        """Disconnect every client and stop listening."""
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()

    def drop_link(self, seconds: float) -> None:
        """Disconnect every client after a moment, so that requests get an answer, and refuse new ones for a while."""

        def drop() -> None:
            self._refused_until_s = asyncio.get_running_loop().time() + seconds
            for client in list(self.clients):
                client.abort()

        asyncio.get_running_loop().call_later(_DROP_AFTER_S, drop)

    def has_subscribers(self, name: str) -> bool:
        """True if any client is subscribed to this topic."""
        return any(name in client.outbox.topics for client in self.clients)

    def publish(self, name: str, message: Message) -> None:
        """Publish a message of the robot, or relay a client's."""
        topic = self.topics[name]
        topic.sequence += 1
        published = self._published(name, message)
        if topic.latched:
            topic.last = published

        def deliver() -> None:
            for client in self.clients:
                client.outbox.put(published)

        self._later(deliver)

    def set_latched(self, name: str, message: Message) -> None:
        """Set the message for late subscribers of a latched topic, without publishing it."""
        self.topics[name].last = self._published(name, message)

    def _published(self, name: str, message: Message) -> Published:
        topic = self.topics[name]
        in_cbor = typedefs.cbor_refusal(self.dialect, topic.type, message) is None
        return Published(name, message, sequence=topic.sequence, in_cbor=in_cbor)

    def send_raw(self, contents: Iterable[str | bytes]) -> None:
        """Send malformed messages to every client."""
        for content in contents:
            for client in self.clients:
                if client.admitted:
                    client.outbox.raw(content)

    def _answer(self, client: Client, operation: Message, request_id: str | None = None) -> None:
        if request_id is not None:
            operation["id"] = request_id

        def put() -> None:
            if not client.outbox.answer(operation):
                logger.warning("%s does not take its answers; it is disconnected", client.name)
                client.abort()

        self._later(put)

    def _later(self, action: Callable[[], None]) -> None:
        if self.latency_s > 0.0:
            asyncio.get_running_loop().call_later(self.latency_s, action)
        else:
            action()

    def _admit(self, connection: ServerConnection, _: Request) -> Response | None:
        if asyncio.get_running_loop().time() < self._refused_until_s:
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "The link is down (an injected fault).\n")
        if len(self.clients) >= _MAX_CLIENTS:
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "Too many clients.\n")
        return None

    async def _serve_client(self, connection: ServerConnection) -> None:
        raw = connection.transport.get_extra_info("socket")
        if raw is not None:
            # the system's own buffer would hold seconds of old images for a slow client
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        outbox = ClientOutbox(asyncio.get_running_loop().time, unwritable=self._note_unwritable)
        client = Client(next(self._numbers), connection, outbox)
        if self._obeyed_log is not None:
            self._obeyed_log.write(at_ns=time.monotonic_ns(), connected=client.name)
        client.admitted = self._secret is None
        self.clients.add(client)
        logger.info("%s connected", client.name)
        sender = asyncio.create_task(self._send(client))
        try:
            async for content in connection:
                self._later(partial(self._receive, client, content))
                # The real one reads in one thread and executes in another, which drops the rest when the client leaves.
                await asyncio.sleep(0)
                if connection.state is State.CLOSED:
                    break
        except ConnectionClosed as closed:
            logger.info("%s: %s", client.name, closed)
        finally:
            self.clients.discard(client)
            client.queue.clear()
            for name in client.outbox.topics:
                self._forget_unused(name)
            for name, topic in self.topics.items():
                if client.name in topic.publishers:
                    self._retire(client, name)
            sender.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await sender
            logger.info("%s is gone", client.name)

    async def _send(self, client: Client) -> None:
        def delivered(published: Published, size_bytes: int) -> None:
            if self._log is not None:
                self._log.write(
                    at_ns=time.time_ns(),
                    client=client.name,
                    topic=published.topic,
                    sequence=published.sequence,
                    stamp_ns=stamp_or_none(published.message),
                    bytes=size_bytes,
                )

        wire = ClientWire(client.connection, rate_bytes_s=lambda: self.rate_bytes_s, delivered=delivered)
        try:
            with contextlib.suppress(ConnectionClosed):
                await client.outbox.send_all(wire)
        finally:
            wire.close()

    def _receive(self, client: Client, content: str | bytes) -> None:
        operation: Message = {}
        try:
            # some clients send JSON in binary frames; CBOR is only sent, never received
            operation = decode_json(content if isinstance(content, str) else content.decode("utf-8"))
            if client.admitted:
                client.queue.append(operation)
                self._handle_queue(client)
            elif operation["op"] == "auth" and introduces_itself(operation, self._secret or "", now_s=self._now_s()):
                client.admitted = True
                logger.info("%s has authenticated", client.name)
            else:
                self._send_away(client)
        except (ProtocolError, MessageError, UnicodeDecodeError) as error:
            self._note_refusal(f"{client.name}: {error}")
            if not client.admitted:
                self._send_away(client)

    def _handle_queue(self, client: Client) -> None:
        while client.queue and not client.held:
            try:
                self._handle(client, client.queue.popleft())
            except (ProtocolError, MessageError) as error:
                self._note_refusal(f"{client.name}: {error}")

    def _let_go(self, client: Client) -> None:
        client.held = False
        self._handle_queue(client)

    def _note_refusal(self, refusal: str) -> None:
        logger.warning("%s", refusal)
        self.refusals.append(refusal)

    def _note_unwritable(self, name: str) -> None:
        if name not in self._unwritable:
            self._unwritable.add(name)
            self._note_refusal(f"Exception calling subscribe callback: {name} cannot be written as it is asked for")

    def _send_away(self, client: Client) -> None:
        logger.warning("%s did not authenticate; its connection is closed", client.name)
        closing = asyncio.create_task(client.connection.close())
        self._closing.add(closing)
        closing.add_done_callback(self._closing.discard)

    def _handle(self, client: Client, operation: Message) -> None:
        handlers: dict[str, Callable[[Client, Message], object]] = {
            "advertise": self._advertise,
            "unadvertise": self._unadvertise,
            "publish": self._publish,
            "subscribe": self._subscribe,
            "unsubscribe": self._unsubscribe,
            "call_service": self._call_service,
            "advertise_service": self._advertise_service,
            "unadvertise_service": lambda client, operation: client.services.pop(_name(operation, "service"), None),
            "service_response": self._service_response,
            "fragment": self._fragment,
        }
        if self.dialect is Dialect.ROS2:
            handlers["send_action_goal"] = self._send_action_goal
            handlers["cancel_action_goal"] = self._cancel_action_goal
        name = operation["op"]
        if name not in handlers:
            raise ProtocolError(f"Unknown operation: {name[:100]}. Allowed operations: {list(handlers)}")
        if "fragment_size" in operation:
            # with any operation, it applies to everything sent to this client
            size = operation["fragment_size"]
            client.outbox.fragment_size = max(1, size) if isinstance(size, int) else None
        topic = str(operation.get("topic"))
        if (
            name in _GLOBBED
            and self._topics_glob
            and not any(fnmatch.fnmatch(topic, glob) for glob in self._topics_glob)
        ):
            self._note_refusal(f"No match found for topic, cancelling {name}: {topic}")
            return
        handlers[name](client, operation)

    def _topic(self, name: str, type_: str | None) -> Topic:
        """Topic by name, created on first use; as in rosbridge, another type is refused."""
        topic = self.topics.get(name)
        if type_ is None and topic is None:
            raise ProtocolError(f"Cannot infer topic type for topic {name} as it is not yet advertised")
        if type_ is not None and not typedefs.is_known(self.dialect, type_):
            known = topic is not None and (same_type(topic.type, type_) or type_ in topic.other_types)
            if not known:
                raise ProtocolError(f"Unable to load the manifest for package {type_.partition('/')[0]}")
        if topic is None:
            topic = self.topics[name] = Topic(type_ or "", robots_own=False)
        if type_ is not None and not same_type(topic.type, type_) and type_ not in topic.other_types:
            raise ProtocolError(
                f"Tried to register topic {name} with type {type_} but it is already established with type {topic.type}"
            )
        return topic

    def _retire(self, client: Client, name: str) -> None:
        """Remove a client's publisher; rosbridge retains it for a while."""

        def forget() -> None:
            topic = self.topics.get(name)
            if topic is not None and client.name in topic.publishers and name not in client.advertised:
                topic.publishers.discard(client.name)
                self._forget_unused(name)

        client.advertised.discard(name)
        asyncio.get_running_loop().call_later(_UNREGISTER_AFTER_S, forget)

    def _forget_unused(self, name: str) -> None:
        topic = self.topics.get(name)
        if topic is None or topic.robots_own or topic.publishers or self.has_subscribers(name):
            return
        del self.topics[name]

    def _advertise(self, client: Client, operation: Message) -> None:
        name = _name(operation, "topic")
        topic = self._topic(name, text(operation, "type", "advertise"))
        # the first advertisement sets latching; later ones only cause warnings
        topic.latched = topic.latched or (operation.get("latch") is True and not topic.publishers)
        topic.publishers.add(client.name)
        client.advertised.add(name)

    def _unadvertise(self, client: Client, operation: Message) -> None:
        name = _name(operation, "topic")
        if name in client.advertised:
            self._retire(client, name)

    def _publish(self, client: Client, operation: Message) -> None:
        name = _name(operation, "topic")
        topic = self._topic(name, None)
        topic.publishers.add(client.name)
        client.advertised.add(name)
        message = message_of(operation.get("msg", {}), "msg")
        if not topic.other_types and typedefs.is_known(self.dialect, topic.type):
            problem = typedefs.misfit(self.dialect, topic.type, message)
            if problem is not None:
                raise MessageError(f"{name}: {problem}")
            message = typedefs.with_defaults(self.dialect, topic.type, message)
        if topic.on_message is not None:
            topic.on_message(message)
            if self._obeyed_log is not None:
                self._obeyed_log.write(at_ns=time.monotonic_ns(), client=client.name, topic=name, message=message)
        self.publish(name, message)

    def _subscribe(self, client: Client, operation: Message) -> None:
        name = _name(operation, "topic")
        what = "subscribe"
        if name not in client.outbox.topics and len(client.outbox.topics) >= _MAX_SUBSCRIPTIONS:
            raise ProtocolError(f"a client may subscribe to at most {_MAX_SUBSCRIPTIONS} topics")
        for key in ("throttle_rate", "fragment_size", "queue_length"):
            # an integer or nothing: neither 200.0 nor null
            if key in operation and not isinstance(operation[key], int):
                raise ProtocolError(
                    f"Expected field {key} to be one of (<class 'int'>,). Invalid value: {operation[key]}"
                )
        compression = text(operation, "compression", what) if "compression" in operation else "none"
        subscription = Subscription(
            throttle_s=max(0.0, operation.get("throttle_rate", 0) / 1000.0),
            queue_length=count(operation, "queue_length", what, most=1_000_000) if "queue_length" in operation else 0,
            compression=compression,
        )
        type_ = text(operation, "type", what) if "type" in operation else None
        topic = self._topic(
            name, topic.type if compression == "cbor-raw" and (topic := self.topics.get(name)) else type_
        )
        client.outbox.subscribe(name, str(operation.get("id")), subscription)
        if topic.latched and topic.last is not None:
            last = topic.last
            self._later(lambda: client.outbox.put(last))

    def _unsubscribe(self, client: Client, operation: Message) -> None:
        name, key = _name(operation, "topic"), operation.get("id")
        client.outbox.unsubscribe(name, None if key is None else str(key))
        self._forget_unused(name)

    def _call_service(self, client: Client, operation: Message) -> None:
        name = _name(operation, "service")
        request_id = _id(operation)
        arguments = operation.get("args", {})
        provider = next((other for other in self.clients if name in other.services), None)
        if name not in self.services and provider is not None:
            self._forward(client, provider, name, arguments, request_id)
            return
        if self.service_s > 0.0 and name in self.services and not name.startswith(("/rosapi/", "/simulator/")):
            client.held = self._services_hold

            def answer_late() -> None:
                self._answer_call(client, name, arguments, request_id)
                if self._services_hold:
                    self._let_go(client)

            asyncio.get_running_loop().call_later(self.service_s, answer_late)
        else:
            self._answer_call(client, name, arguments, request_id)

    def _answer_call(self, client: Client, name: str, arguments: Any, request_id: str | None) -> None:
        values: Any
        try:
            values, succeeded = self._call(name, arguments), True
            if self._obeyed_log is not None:
                self._obeyed_log.write(at_ns=time.monotonic_ns(), client=client.name, service=name, request=arguments)
        except MessageError as error:
            values, succeeded = str(error), False
            if isinstance(error, CallFailed) and self.dialect is Dialect.ROS1:
                values = f"service [{name}] responded with an error: b'error processing request: {error}'"
        answer = {"op": "service_response", "service": name, "values": values, "result": succeeded}
        self._answer(client, answer, request_id)

    def _call(self, name: str, arguments: Any) -> Message:
        """Call a service. Raises MessageError for rosbridge's refusals, and CallFailed for the service's."""
        service = self.services.get(name)
        if service is None:
            raise MessageError(f"Service {name} does not exist")
        if isinstance(arguments, list):
            # in the order of the fields
            arguments = dict(zip(typedefs.field_names(self.dialect, service.type), arguments, strict=False))
        arguments = arguments if isinstance(arguments, dict) else {}
        problem = typedefs.misfit(self.dialect, service.type, arguments)
        if problem is not None:
            raise MessageError(problem)
        return service.call(arguments)

    def _forward(self, caller: Client, provider: Client, name: str, arguments: Any, request_id: str | None) -> None:
        forwarded_id = f"forwarded:{name}:{next(self._numbers)}"
        caller.held = self._services_hold
        self._forwarded[forwarded_id] = (caller, request_id, name)
        self._answer(provider, {"op": "call_service", "service": name, "args": arguments}, forwarded_id)

        def give_up() -> None:
            if forwarded_id in self._forwarded:
                self._service_response(caller, {"id": forwarded_id, "values": "the call timed out", "result": False})

        asyncio.get_running_loop().call_later(_CLIENT_SERVICE_LIMIT_S, give_up)

    def _advertise_service(self, client: Client, operation: Message) -> None:
        name, type_ = _name(operation, "service"), text(operation, "type", "advertise_service")
        if not typedefs.is_known(self.dialect, type_):
            raise ProtocolError(f"Unable to load the manifest for package {type_.partition('/')[0]}")
        client.services[name] = type_

    def _service_response(self, _: Client, operation: Message) -> None:
        waiting = self._forwarded.pop(str(operation.get("id")), None)
        if waiting is None:
            raise ProtocolError("no call is waiting for this service_response")
        caller, request_id, name = waiting
        answer = {
            "op": "service_response",
            "service": name,
            "values": operation.get("values", {}),
            "result": operation.get("result", True) is not False,
        }
        self._answer(caller, answer, request_id)
        if self._services_hold:
            self._let_go(caller)

    def _send_action_goal(self, client: Client, operation: Message) -> None:
        name = _name(operation, "action")
        request_id = _id(operation) or f"{name}:{next(self._numbers)}"
        wants_feedback = operation.get("feedback") is True

        def reply(answer: Message) -> None:
            if answer["op"] != "action_feedback" or wants_feedback:
                self._answer(client, {"action": name, **answer}, request_id)
            if answer["op"] == "action_result" and self._goals_hold:
                self._let_go(client)

        client.held = self._goals_hold
        action = self.actions.get(name)
        if action is None:
            # The real one waits for an action server without reporting that there is none.
            self._note_refusal(f"{client.name}: no action server takes {name}")
            return
        try:
            action.start(request_id, message_of(operation.get("args", {}), "args"), reply)
        except MessageError as error:
            reply({"op": "action_result", "status": 0, "result": False, "values": str(error)})

    def _cancel_action_goal(self, _: Client, operation: Message) -> None:
        action = self.actions.get(_name(operation, "action"))
        if action is None:
            raise ProtocolError(f"Action {operation['action']} does not exist")
        action.cancel(_id(operation) or "")

    def _fragment(self, client: Client, operation: Message) -> None:
        if not isinstance(operation.get("total"), int):
            # it counts towards the total, which is then never reached
            raise ProtocolError("error while trying to append a fragment: its total is not a whole number")
        message = client.fragments.add(operation)
        if message is not None:
            if message["op"] == "fragment":
                raise ProtocolError("a fragment must not contain fragments")
            self._handle(client, message)


def _name(operation: Message, kind: str) -> str:
    name = text(operation, kind, operation["op"], most=_MAX_NAME_CHARS)
    if not name.strip("/"):
        raise MessageError(f"{operation['op']}.{kind} must not be empty")
    return name if name.startswith("/") else f"/{name}"


def _id(operation: Message) -> str | None:
    return None if operation.get("id") is None else str(field_of(operation, "id", operation["op"]))


BUFFER_BYTES = 256 * 1024
"""What a slow link holds before its sender has to wait, as the buffers of a system and of a router do."""

_STEP_S = 0.1


class ClientWire:
    """Sends to ``socket`` in order.

    ``rate_bytes_s`` is queried before each message; None is unlimited. With a rate, messages are delayed by their size,
    one after the other, and none is dropped. JSON is almost all ASCII, so its characters count as bytes. ``delivered``
    receives each message of a topic and its size in bytes, once its last piece has been sent.
    """

    def __init__(
        self,
        socket: ServerConnection,
        *,
        rate_bytes_s: Callable[[], float | None],
        delivered: Callable[[Published, int], None] | None = None,
    ) -> None:
        self._socket = socket
        self._rate_bytes_s = rate_bytes_s
        self._delivered = delivered
        self._waiting: deque[tuple[str | bytes, Published | None]] = deque()
        self._held_bytes = 0
        self._changed = asyncio.Condition()
        self._error: Exception | None = None
        self._pump: asyncio.Task[None] | None = None

    async def send(self, message: str | bytes, of: Published | None = None) -> None:
        """Send, or queue on the slow link when there is space; ``of`` is the message that this piece completes.

        Raises what the socket raises, also when that happened to an earlier message.
        """
        if self._rate_bytes_s() is None and not self._held_bytes:
            await self._socket.send(message)
            self._note(message, of)
            return
        if self._pump is None:
            self._pump = asyncio.create_task(self._pump_all())
        async with self._changed:
            await self._changed.wait_for(lambda: self._error is not None or self._held_bytes < BUFFER_BYTES)
            if self._error is not None:
                raise self._error
            self._waiting.append((message, of))
            self._held_bytes += len(message)
            self._changed.notify_all()

    def close(self) -> None:
        """Drop unsent messages."""
        if self._pump is not None:
            self._pump.cancel()

    async def _pump_all(self) -> None:
        while True:
            async with self._changed:
                await self._changed.wait_for(lambda: bool(self._waiting))
            message, of = self._waiting[0]
            # in small steps, so that a rate change applies to the present message, too
            left_bytes: float = len(message)
            while left_bytes > 0.0 and (rate_bytes_s := self._rate_bytes_s()) is not None:
                step_s = min(left_bytes / rate_bytes_s, _STEP_S)
                await asyncio.sleep(step_s)
                left_bytes -= step_s * rate_bytes_s
            try:
                await self._socket.send(message)
            except Exception as error:  # raised to the next sender
                self._error = error
            else:
                self._note(message, of)
            async with self._changed:
                self._waiting.popleft()
                self._held_bytes -= len(message)
                self._changed.notify_all()
            if self._error is not None:
                return

    def _note(self, message: str | bytes, of: Published | None) -> None:
        if of is not None and self._delivered is not None:
            self._delivered(of, of.size_bytes(message))
