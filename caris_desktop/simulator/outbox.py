"""What waits to be sent to one client: bounded, and the newest value wins, so that a slow client blocks nobody."""

import asyncio
import itertools
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from caris_desktop.ros import rosbridge

UNBOUNDED_LENGTH = 200
"""What a queue_length of 0 ("unbounded") means here."""
MAX_ANSWERS = 2000


class Published:
    """One message of a topic, encoded at most once in each format, however many clients take it.

    ``sequence`` counts the messages of its topic from 1.
    """

    __slots__ = ("_cbor", "_json", "message", "sequence", "topic")

    def __init__(self, topic: str, message: dict[str, Any], *, sequence: int = 0) -> None:
        self.topic = topic
        self.message = message
        self.sequence = sequence
        self._json: str | None = None
        self._cbor: bytes | None = None

    @property
    def json(self) -> str:
        if self._json is None:
            self._json = rosbridge.encode_json({"op": "publish", "topic": self.topic, "msg": self.message})
        return self._json

    @property
    def cbor(self) -> bytes:
        if self._cbor is None:
            self._cbor = rosbridge.encode_cbor({"op": "publish", "topic": self.topic, "msg": self.message})
        return self._cbor

    def size_bytes(self, piece: str | bytes) -> int:
        """The size of the whole message in the format of ``piece``, without what fragments add."""
        return len(self.cbor) if isinstance(piece, bytes) else len(self.json)


class Sender(Protocol):
    """Where messages go; ``send`` waits while the other side does not take them.

    ``of`` is the message whose last piece this is; None for any other piece.
    """

    async def send(self, message: str | bytes, of: Published | None = None) -> None: ...


@dataclass(frozen=True, slots=True)
class Subscription:
    """How one subscription of a client wants its messages."""

    throttle_s: float = 0.0
    queue_length: int = 0
    cbor: bool = False
    fragment_size: int | None = None


@dataclass(slots=True)
class _Stream:
    """All subscriptions of one client to one topic; like rosbridge they share one stream, the strictest wish wins."""

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
    def cbor(self) -> bool:
        return any(wish.cbor for wish in self.subscriptions.values())

    @property
    def fragment_size(self) -> int | None:
        sizes = [wish.fragment_size for wish in self.subscriptions.values() if wish.fragment_size is not None]
        return min(sizes) if sizes else None


class Outbox:
    """Everything on its way to one client. ``clock`` is the event loop's time."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._answers: deque[str | bytes] = deque()
        self._streams: dict[str, _Stream] = {}
        self._order = itertools.count()
        self._fragment_ids = itertools.count()
        self._filled = asyncio.Event()
        self.dropped = 0

    @property
    def topics(self) -> set[str]:
        """Topics that the client is subscribed to."""
        return set(self._streams)

    def takes(self, topic: str) -> bool:
        """Whether the client is subscribed to ``topic``."""
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
        """Queue a message if its topic is subscribed; the oldest gives way when the queue is full."""
        stream = self._streams.get(published.topic)
        if stream is None:
            return
        if stream.queue_length == 0 and self._clock() < stream.sent_s + stream.throttle_s:
            return  # rosbridge too drops what a throttle without a queue does not let through
        stream.waiting.append((next(self._order), published))
        while len(stream.waiting) > (stream.queue_length or UNBOUNDED_LENGTH):
            stream.waiting.popleft()
            self.dropped += 1
        if stream.queue_length == 0 and stream.throttle_s > 0.0:
            stream.sent_s = self._clock()
        self._filled.set()

    def answer(self, operation: dict[str, Any]) -> bool:
        """Queue an operation that must not be lost. False when the client has not taken thousands of them."""
        if len(self._answers) >= MAX_ANSWERS:
            return False
        self._answers.append(rosbridge.encode_json(operation))
        self._filled.set()
        return True

    def raw(self, content: str | bytes) -> None:
        """Queue anything, well-formed or not."""
        self._answers.append(content)
        self._filled.set()

    async def send_all(self, sender: Sender) -> None:
        """Send what comes, until cancelled or the sender fails (whose error is passed on)."""
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
        """What to send next and what of, or how long until a throttle lets something through."""
        if self._answers:
            return [self._answers.popleft()], None, None
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
        if stream.cbor:
            return [published.cbor]
        size = stream.fragment_size
        if size is None or len(published.json) <= size:
            return [published.json]
        message_id = f"{published.topic}:{next(self._fragment_ids)}"
        return [
            rosbridge.encode_json(piece)
            for piece in rosbridge.fragments_of(published.json, message_id=message_id, size=size)
        ]
