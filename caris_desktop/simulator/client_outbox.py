"""Outgoing queue of one client: bounded, newest value wins, so slow clients block no others."""

import asyncio
import base64
import itertools
import math
from collections import deque
from collections.abc import Callable
from dataclasses import field
from functools import cached_property
from typing import Any, Protocol

import cv2
import numpy as np

from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.ros import rosbridge

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


class Sender(Protocol):
    """Destination of messages; ``send`` waits for the peer.

    ``of`` is the message whose last piece this is; None for other pieces.
    """

    async def send(self, message: str | bytes, of: Published | None = None) -> None: ...


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
    def topics(self) -> set[str]:
        """Subscribed topics."""
        return set(self._streams)

    def takes(self, topic: str) -> bool:
        """True if the client is subscribed to ``topic``."""
        return topic in self._streams

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

    async def send_all(self, sender: Sender) -> None:
        """Send until cancelled, or until the sender fails, whose error is raised."""
        while True:
            self._filled.clear()
            pieces, published, wait_s = self._take()
            for number, piece in enumerate(pieces, 1):
                await sender.send(piece, published if number == len(pieces) else None)
            if pieces:
                continue
            try:
                await asyncio.wait_for(self._filled.wait(), wait_s)
            except TimeoutError:
                continue

    def _take(self) -> tuple[list[str | bytes], Published | None, float | None]:
        """Next pieces and their message, or the remaining throttle time."""
        if self._answers:
            return [self._answers.popleft()], None, None
        while True:
            pieces, published, wait_s = self._take_published()
            if pieces or published is None:
                return pieces, published, wait_s
            self._unwritable(published.topic)

    def _take_published(self) -> tuple[list[str | bytes], Published | None, float | None]:
        """As above; without pieces if the message cannot be encoded."""
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
        if first is None:
            return [], None, wait_s
        _, published = first.waiting.popleft()
        if first.queue_length:
            first.sent_s = now_s
        return self._encoded(first, published), published, None

    def _encoded(self, stream: _Stream, published: Published) -> list[str | bytes]:
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
