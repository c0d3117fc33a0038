"""Writes MCAP (https://mcap.dev/spec), chunk by chunk, for sessions of any length.

The ``mcap`` package reads it, in tests too. Its own writer keeps an object for every chunk and channel, which grows
by megabytes an hour where chunks are short, and writes each chunk in pieces, any of which a kill may find missing.
"""

import struct
import zlib
from array import array
from collections import Counter
from dataclasses import dataclass
from typing import Any

from caris_desktop.recording.disk_file import DiskFile

MAGIC = b"\x89MCAP0\r\n"
_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX = range(1, 9)
_STATISTICS, _METADATA, _METADATA_INDEX, _SUMMARY_OFFSET, _DATA_END = range(0x0B, 0x10)
_RECORD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
_LARGEST_CHUNK_BYTES = 1024 * 1024
_COMPRESSION = "zstd"
_COMPRESSION_LEVEL = 3


@dataclass(slots=True)
class _Chunk:
    """The one in progress: its records, and for each channel where its messages are."""

    records: bytearray
    index: "dict[int, array[int]]"
    begin_ns: int = 2**64 - 1
    end_ns: int = 0


class McapFile:
    """One file that is written from front to end. Times are nanoseconds of UTC. Methods raise OSError."""

    def __init__(self, file: DiskFile, *, library: str) -> None:
        import zstandard

        self._file = file
        self._compressor: Any = zstandard.ZstdCompressor(level=_COMPRESSION_LEVEL)
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._counts: Counter[int] = Counter()
        self._begin_ns: int | None = None
        self._end_ns = 0
        self._chunks = 0
        self._chunk_indexes = bytearray()
        self._metadata_indexes = bytearray()
        self._metadata = 0
        self._chunk = _Chunk(bytearray(), {})
        file.write(MAGIC + _record(_HEADER, _text("") + _text(library)))

    def add_metadata(self, name: str, entries: dict[str, str]) -> None:
        """Outside of any chunk. To be called before the first message."""
        record = _record(_METADATA, _text(name) + _text_map(entries))
        self._metadata_indexes += _record(
            _METADATA_INDEX, struct.pack("<QQ", self._file.tell(), len(record)) + _text(name)
        )
        self._metadata += 1
        self._file.write(record)

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """The number of the schema."""
        number = len(self._schemas) + 1
        content = struct.pack("<H", number) + _text(name) + _text(encoding) + struct.pack("<I", len(data)) + data
        self._schemas.append(_record(_SCHEMA, content))
        self._chunk.records += self._schemas[-1]
        return number

    def add_channel(self, topic: str, message_encoding: str, schema: int) -> int:
        """The number of the channel."""
        number = len(self._channels) + 1
        content = struct.pack("<HH", number, schema) + _text(topic) + _text(message_encoding) + _text_map({})
        self._channels.append(_record(_CHANNEL, content))
        self._chunk.records += self._channels[-1]
        return number

    def add_message(self, channel: int, data: bytes, *, log_time: int, publish_time: int, sequence: int) -> None:
        """It is in the file once :meth:`flush` has returned."""
        chunk = self._chunk
        index = chunk.index.get(channel)
        if index is None:
            index = chunk.index[channel] = array("Q")
        chunk.begin_ns = min(chunk.begin_ns, log_time)
        chunk.end_ns = max(chunk.end_ns, log_time)
        index.append(log_time)
        index.append(len(chunk.records))
        chunk.records += _MESSAGE_HEAD.pack(_MESSAGE, 22 + len(data), channel, sequence, log_time, publish_time)
        chunk.records += data
        self._counts[channel] += 1
        if len(chunk.records) > _LARGEST_CHUNK_BYTES:
            self.flush()

    def flush(self) -> None:
        """Write the chunk in progress, in one piece with its index."""
        chunk = self._chunk
        if not chunk.index:
            return
        packed = self._compressor.compress(bytes(chunk.records))
        head = _CHUNK_HEAD.pack(chunk.begin_ns, chunk.end_ns, len(chunk.records), zlib.crc32(chunk.records))
        content = head + _text(_COMPRESSION) + struct.pack("<Q", len(packed)) + packed
        begin = self._file.tell()
        block = bytearray(_record(_CHUNK, content))
        chunk_bytes = len(block)
        offsets = bytearray()
        for channel, index in chunk.index.items():
            offsets += struct.pack("<HQ", channel, begin + len(block))
            entries = _little_endian(index)
            block += _record(_MESSAGE_INDEX, struct.pack("<HI", channel, len(entries)) + entries)
        self._chunk_indexes += _record(
            _CHUNK_INDEX,
            struct.pack("<QQQQI", chunk.begin_ns, chunk.end_ns, begin, chunk_bytes, len(offsets))
            + offsets
            + struct.pack("<Q", len(block) - chunk_bytes)
            + _text(_COMPRESSION)
            + struct.pack("<QQ", len(packed), len(chunk.records)),
        )
        self._chunks += 1
        self._begin_ns = chunk.begin_ns if self._begin_ns is None else min(self._begin_ns, chunk.begin_ns)
        self._end_ns = max(self._end_ns, chunk.end_ns)
        self._chunk = _Chunk(bytearray(), {})
        self._file.write(bytes(block))

    def finish(self) -> None:
        """The summary at the end, by which readers jump."""
        self.flush()
        self._file.write(_record(_DATA_END, struct.pack("<I", 0)))
        begin = self._file.tell()
        summary, offsets = bytearray(), bytearray()
        for opcode, group in (
            (_SCHEMA, b"".join(self._schemas)),
            (_CHANNEL, b"".join(self._channels)),
            (_STATISTICS, self._statistics()),
            (_CHUNK_INDEX, bytes(self._chunk_indexes)),
            (_METADATA_INDEX, bytes(self._metadata_indexes)),
        ):
            if group:
                offsets += _record(_SUMMARY_OFFSET, struct.pack("<BQQ", opcode, begin + len(summary), len(group)))
                summary += group
        offsets_begin = begin + len(summary)
        summary += offsets
        # The checksum covers the footer up to itself.
        footer = _RECORD.pack(_FOOTER, 20) + struct.pack("<QQ", begin, offsets_begin)
        checksum = zlib.crc32(footer, zlib.crc32(summary))
        self._file.write(bytes(summary) + footer + struct.pack("<I", checksum) + MAGIC)

    def _statistics(self) -> bytes:
        counts = b"".join(struct.pack("<HQ", channel, count) for channel, count in sorted(self._counts.items()))
        head = struct.pack(
            "<QHIIIIQQI",
            self._counts.total(),
            len(self._schemas),
            len(self._channels),
            0,
            self._metadata,
            self._chunks,
            self._begin_ns or 0,
            self._end_ns,
            len(counts),
        )
        return _record(_STATISTICS, head + counts)


def _record(opcode: int, content: bytes) -> bytes:
    return _RECORD.pack(opcode, len(content)) + content


def _text(text: str) -> bytes:
    data = text.encode("utf-8", "replace")
    return struct.pack("<I", len(data)) + data


def _text_map(entries: dict[str, str]) -> bytes:
    data = b"".join(_text(key) + _text(value) for key, value in entries.items())
    return struct.pack("<I", len(data)) + data


def _little_endian(numbers: "array[int]") -> bytes:
    if struct.pack("=H", 1) != struct.pack("<H", 1):
        numbers = numbers[:]
        numbers.byteswap()
    return numbers.tobytes()
