"""Traffic statistics per topic of one link: rate, volume, age. Counting only, no sockets."""

from collections.abc import Callable, Mapping
from typing import Any, Literal

from caris_desktop.domain.events import TopicTraffic, TrafficMeasured
from caris_desktop.domain.value_class import dataclass
from caris_desktop.robot.clock_offset import OffsetEstimate
from caris_desktop.ros.dialect import decode_time

MOST_TOPICS = 200


@dataclass(slots=True)
class _Count:
    type: str = ""
    messages: int = 0
    size_bytes: int = 0
    refused: int = 0
    encoding: Literal["", "cbor", "json"] = ""
    received_ns: int | None = None
    stamp_ns: int | None = None


class TrafficMeter:
    """Counts arrivals. :meth:`measure`, once per second, returns the counts and resets them."""

    def __init__(self, link: str) -> None:
        self._link = link
        self._counts: dict[str, _Count] = {}
        self._began_ns: int | None = None
        self._refused = 0

    def listens(self, topic: str, message_type: str) -> None:
        """Note a subscribed topic, which is listed even without messages."""
        self._count(topic).type = message_type

    def stops_listening(self, topic: str) -> None:
        """Drop a topic without subscriptions."""
        self._counts.pop(topic, None)

    def arrived(self, topic: str, *, size_bytes: int, arrival_ns: int) -> None:
        """Count one message, decoded or not."""
        count = self._count(topic)
        count.messages += 1
        count.size_bytes += size_bytes
        count.received_ns = arrival_ns

    def decoded(self, topic: str, message: Any, *, binary: bool) -> None:
        """Note the encoding and stamp of a decoded message."""
        if topic in self._counts:
            self._counts[topic].encoding = "cbor" if binary else "json"
            self._counts[topic].stamp_ns = stamp_of(message)

    def encoding_of(self, topic: str) -> Literal["", "cbor", "json"]:
        """Encoding of the topic's newest message."""
        return self._counts[topic].encoding if topic in self._counts else ""

    def refused(self, topic: str | None) -> None:
        """Count an unusable message; ``topic`` None if unknown."""
        self._refused += 1
        if topic is not None and topic in self._counts:
            self._counts[topic].refused += 1

    def measure(
        self, now_ns: int, offset_at: Callable[[int], OffsetEstimate | None] = lambda _: None
    ) -> TrafficMeasured:
        """Statistics since the last call."""
        period_s = 1.0 if self._began_ns is None else max(1e-3, (now_ns - self._began_ns) / 1e9)
        self._began_ns = now_ns
        topics = []
        for topic, count in sorted(self._counts.items()):
            age_ms = None
            if count.messages and count.stamp_ns and count.received_ns is not None:
                offset = offset_at(count.received_ns)
                if offset is not None:
                    age_ms = (count.received_ns + offset.offset_ns - count.stamp_ns) / 1e6
            topics.append(
                TopicTraffic(
                    topic=topic,
                    type=count.type,
                    rate_hz=count.messages / period_s,
                    bytes_per_s=count.size_bytes / period_s,
                    last_heard_s=None if count.received_ns is None else max(0.0, (now_ns - count.received_ns) / 1e9),
                    age_ms=age_ms,
                    refused=count.refused,
                    encoding=count.encoding,
                )
            )
            count.messages = count.size_bytes = 0
        used = {topic.encoding for topic in topics} - {""}
        encoding: Literal["cbor", "json", "both"] = "both" if len(used) > 1 else "cbor" if "cbor" in used else "json"
        return TrafficMeasured(now_ns, self._link, encoding, self._refused, tuple(topics))

    def _count(self, topic: str) -> _Count:
        count = self._counts.get(topic)
        if count is None:
            if len(self._counts) >= MOST_TOPICS:
                # More topics than anyone subscribes to: a faulty server must not fill the memory.
                return _Count()
            count = self._counts[topic] = _Count()
        return count


def stamp_of(message: Any) -> int | None:
    """Robot stamp of a message in ns; None if missing or zero."""
    if not isinstance(message, Mapping):
        return None
    header = message.get("header")
    if header is None:
        transforms = message.get("transforms")
        if isinstance(transforms, (list, tuple)) and transforms and isinstance(transforms[0], Mapping):
            header = transforms[0].get("header")
    try:
        return decode_time(header["stamp"]) if isinstance(header, Mapping) else None
    except (KeyError, ValueError):
        return None
