"""Random access to a recorded session by arrival time, without reading all of it."""

import logging
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from operator import itemgetter
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.streams import BY_TYPE, Delivery, StreamSpec, spec_of_topic
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session import events_file
from caris_desktop.recording.session.events_file import BlockIndex, DamagedBlockError, Message
from caris_desktop.recording.session.session_header import reading
from caris_desktop.recording.session.session_reader import Session, value_reader

_log = logging.getLogger(__name__)
_KEPT_BLOCKS = 64
_KEPT_BLOCK_BYTES = 64 * 1024 * 1024
_END_TOLD_NS = 1_000_000_000


class _Block(Value, eq=False):
    """Decompressed chunk. ``arrivals_ns`` is int64, one for each message, non-decreasing."""

    content: bytes
    messages: tuple[Message, ...]
    arrivals_ns: NDArray[np.int64]
    channels: NDArray[np.int64]


class SessionTimeline:
    """Reads values by session time. One thread at a time; ``close`` when done.

    A value's arrival is when it reached the console and was displayed. Arrivals never decrease; where they do (clocks
    of old recordings), a value counts as arrived together with its predecessors.
    """

    def __init__(self, session: Session) -> None:
        """Raises SessionError if the recording cannot be read."""
        self.session = session
        self._path = session.folder / "events.mcap"
        with reading(self._path):
            self._index: BlockIndex = events_file.read_index(self._path)
            self._file: IO[bytes] = self._path.open("rb")
        self._session_from_utc_ns = session.clock.at_utc(0)
        # Arrival of the last message of each chunk, including all before it.
        self._ends_ns = np.maximum.accumulate(self._index.ends_utc_ns + self._session_from_utc_ns)
        self._topics = {number: channel.topic for number, channel in self._index.channels.items()}
        specs = {number: spec_of_topic(topic) for number, topic in self._topics.items()}
        self._specs: dict[int, StreamSpec] = {number: spec for number, spec in specs.items() if spec is not None}
        self._read = value_reader(self._path)
        self._blocks: OrderedDict[int, _Block] = OrderedDict()
        self._cached_bytes = 0
        self._values: dict[int, tuple[tuple[int, int], Any]] = {}

    @property
    def start_ns(self) -> int:
        return self.session.started_ns

    @property
    def end_ns(self) -> int:
        """End of the session, including the recording of its end event."""
        recorded_ns = int(self._ends_ns[-1]) if self._index.count else 0
        return max(
            self.session.started_ns, self.session.ended_ns, min(recorded_ns, self.session.ended_ns + _END_TOLD_NS)
        )

    def state_at(self, at_ns: int) -> list[Any]:
        """State at a time: the newest value of each state stream and key.

        Sorted by arrival. The reader judges their age.
        """
        return [value for _arrived_ns, value in self.arrivals_until(at_ns)]

    def arrivals_until(self, at_ns: int) -> list[tuple[int, Any]]:
        """The same, each with its arrival."""
        channels = self._channels(lambda spec: spec.delivery is Delivery.LATEST)
        newest = sorted(filter(None, (self._newest(channel, at_ns) for channel in channels)), key=itemgetter(0, 1))
        return [(arrived_ns, value) for _, _, arrived_ns, value in newest if value is not None]

    def between(
        self, after_ns: int, until_ns: int, *, types: Iterable[type[Any]] | None = None
    ) -> Iterator[tuple[int, Any]]:
        """Arrival and value of everything (or of these types) with ``after_ns`` < arrival <= ``until_ns``."""
        channels = self._channels_of(types)
        first = int(np.searchsorted(self._ends_ns, after_ns, side="right"))
        last = int(np.searchsorted(self._ends_ns, until_ns, side="right"))
        for number in self._blocks_with(channels, first, min(last, self._index.count - 1)):
            block = self._block(number)
            begin = int(np.searchsorted(block.arrivals_ns, after_ns, side="right"))
            end = int(np.searchsorted(block.arrivals_ns, until_ns, side="right"))
            for place in range(begin, end):
                if block.messages[place].channel in channels:
                    value = self._made(block, place)
                    if value is not None:
                        yield int(block.arrivals_ns[place]), value

    def events_before(self, at_ns: int, limit: int, types: Iterable[type[Any]] | None = None) -> list[tuple[int, Any]]:
        """Newest ``limit`` events (of these types) up to that time, with arrivals, oldest first."""
        channels = self._channels_of(types, events_only=types is None)
        last = min(int(np.searchsorted(self._ends_ns, at_ns, side="right")), self._index.count - 1)
        found: list[tuple[int, Any]] = []
        for number in reversed(self._blocks_with(channels, 0, last)):
            block = self._block(number)
            end = int(np.searchsorted(block.arrivals_ns, at_ns, side="right"))
            for place in range(end - 1, -1, -1):
                if len(found) >= limit:
                    return found[::-1]
                if block.messages[place].channel in channels:
                    value = self._made(block, place)
                    if value is not None:
                        found.append((int(block.arrivals_ns[place]), value))
        return found[::-1]

    def events(self, *types: type[Any]) -> list[tuple[int, Any]]:
        """All values of these types with arrivals, in order of arrival."""
        if not self._index.count:
            return []
        return list(self.between(-(2**62), int(self._ends_ns[-1]), types=types))

    def close(self) -> None:
        self._file.close()
        self._blocks.clear()
        self._values.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _channels(self, is_selected: Callable[[StreamSpec], bool]) -> set[int]:
        return {number for number, spec in self._specs.items() if is_selected(spec)}

    def _channels_of(self, types: Iterable[type[Any]] | None, *, events_only: bool = False) -> set[int]:
        if types is not None:
            names = {BY_TYPE[value_type].name for value_type in types}
            return self._channels(lambda spec: spec.name in names)
        return self._channels(lambda spec: not events_only or spec.delivery is Delivery.LOSSLESS)

    def _blocks_with(self, channels: set[int], first: int, last: int) -> list[int]:
        """Sorted numbers of the chunks from ``first`` to ``last`` that contain these channels."""
        parts = []
        for channel in channels:
            blocks = self._index.blocks_of.get(channel)
            if blocks is not None:
                parts.append(blocks[np.searchsorted(blocks, first) : np.searchsorted(blocks, last, side="right")])
        return np.unique(np.concatenate(parts)).tolist() if parts else []

    def _newest(self, channel: int, at_ns: int) -> tuple[int, int, int, Any] | None:
        """Chunk, position, arrival and value of the channel's newest message by that time.

        The last value of each channel is cached: a map is valid for a whole session.
        """
        blocks = self._index.blocks_of.get(channel)
        if blocks is None:
            return None
        last = int(np.searchsorted(self._ends_ns, at_ns, side="right"))
        for number in blocks[: np.searchsorted(blocks, last, side="right")][::-1].tolist():
            block = self._block(number)
            end = int(np.searchsorted(block.arrivals_ns, at_ns, side="right"))
            places = np.flatnonzero(block.channels[:end] == channel)
            if len(places):
                place = int(places[-1])
                cached = self._values.get(channel)
                if cached is None or cached[0] != (number, place):
                    cached = self._values[channel] = (number, place), self._made(block, place)
                return number, place, int(block.arrivals_ns[place]), cached[1]
        return None

    def _made(self, block: _Block, place: int) -> Any | None:
        message = block.messages[place]
        found = self._read(self._topics[message.channel], block.content[message.start : message.end])
        return None if found is None else found[1]

    def _block(self, number: int) -> _Block:
        """Chunk by number, empty if damaged."""
        if number in self._blocks:
            self._blocks.move_to_end(number)
            return self._blocks[number]
        block = self._blocks[number] = self._unfolded(number)
        self._cached_bytes += len(block.content)
        while len(self._blocks) > 1 and (len(self._blocks) > _KEPT_BLOCKS or self._cached_bytes > _KEPT_BLOCK_BYTES):
            self._cached_bytes -= len(self._blocks.popitem(last=False)[1].content)
        return block

    def _unfolded(self, number: int) -> _Block:
        try:
            with reading(self._path):
                content = events_file.read_block(self._file, self._index, number)
        except DamagedBlockError as error:
            _log.warning("%s: the block at byte %d is left out: %s", self._path, self._index.offsets[number], error)
            content = b""
        messages = tuple(events_file.messages_of(content))
        logged_ns = np.array([message.log_ns for message in messages], np.int64) + self._session_from_utc_ns
        if number:
            logged_ns = np.maximum(logged_ns, self._ends_ns[number - 1])
        channels = np.array([message.channel for message in messages], np.int64)
        return _Block(content, messages, np.maximum.accumulate(logged_ns), channels)
