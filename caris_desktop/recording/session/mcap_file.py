"""MCAP writer (https://mcap.dev/spec), chunk by chunk, for sessions of any length.

The ``mcap`` package reads the result, in tests too. Its writer is not used: it accumulates an object per chunk and
channel (megabytes per hour with short chunks), writes a chunk in several pieces, which a kill may interrupt, and cannot
copy chunks of another file.
"""

import struct
import zlib
from array import array
from collections import Counter
from dataclasses import field
from typing import Any

from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.session import mcap_records as records
from caris_desktop.recording.session.mcap_chunks import compression_of, messages_of
from caris_desktop.recording.session.mcap_records import record, text

_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
_LARGEST_CHUNK_BYTES = 1024 * 1024
_COMPRESSION = "zstd"
_COMPRESSION_LEVEL = 3


@dataclass(slots=True)
class _Chunk:
    """Current chunk: its records, and alternating times and offsets of the messages per channel."""

    records: bytearray = field(default_factory=bytearray)
    index: "dict[int, array[int]]" = field(default_factory=dict)
    begin_ns: int = 2**64 - 1
    end_ns: int = 0

    def note(self, channel: int, log_ns: int, at: int) -> None:
        index = self.index.get(channel)
        if index is None:
            index = self.index[channel] = array("Q")
        self.begin_ns = min(self.begin_ns, log_ns)
        self.end_ns = max(self.end_ns, log_ns)
        index.append(log_ns)
        index.append(at)


class McapFile:
    """Sequential writer of one file. Times are UTC nanoseconds. Methods raise OSError."""

    def __init__(self, file: DiskFile, *, library: str, header: bytes = b"") -> None:
        """``header`` is the record of a copied file, instead of our own."""
        import zstandard

        self._file = file
        self._compressor: Any = zstandard.ZstdCompressor(level=_COMPRESSION_LEVEL)
        self._schemas: dict[int, bytes] = {}
        self._channels: dict[int, bytes] = {}
        self._counts: Counter[int] = Counter()
        self._begin_ns: int | None = None
        self._end_ns = 0
        self._chunks = self._attachments = self._metadata = 0
        self._chunk_indexes = bytearray()
        self._attachment_indexes = bytearray()
        self._metadata_indexes = bytearray()
        self._chunk = _Chunk()
        file.write(records.MAGIC + (header or record(records.HEADER, text("") + text(library))))

    def add_metadata(self, name: str, entries: dict[str, str]) -> None:
        """Write a metadata record. Call before the first message."""
        self.copy_alongside(record(records.METADATA, text(name) + records.text_map(entries)))

    def copy_alongside(self, data: bytes) -> None:
        """Copy a metadata or attachment record. Call before the first message."""
        place = struct.pack("<QQ", self._file.tell(), len(data))
        body = data[records.HEAD.size :]
        if data[0] == records.METADATA:
            name = body[: records.text_end(body, 0)]
            self._metadata_indexes += record(records.METADATA_INDEX, place + name)
            self._metadata += 1
        elif data[0] == records.ATTACHMENT:
            # Two times, name, media type, then the length of the data.
            names_end = records.text_end(body, records.text_end(body, 16))
            data_bytes = body[names_end : names_end + 8]
            self._attachment_indexes += record(
                records.ATTACHMENT_INDEX, place + body[:16] + data_bytes + body[16:names_end]
            )
            self._attachments += 1
        self._file.write(data)

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a schema; return its id."""
        number = max(self._schemas, default=0) + 1
        self._schemas[number] = records.schema_record(number, name, encoding, data)
        self._chunk.records += self._schemas[number]
        return number

    def add_channel(self, topic: str, message_encoding: str, schema: int) -> int:
        """Add a channel; return its id."""
        number = max(self._channels, default=0) + 1
        body = struct.pack("<HH", number, schema) + text(topic) + text(message_encoding) + records.text_map({})
        self._channels[number] = record(records.CHANNEL, body)
        self._chunk.records += self._channels[number]
        return number

    def declare(self, declaration: bytes) -> None:
        """Declare a schema or channel record of copied chunks, for the summary."""
        table = self._schemas if declaration[0] == records.SCHEMA else self._channels
        table[records.number_of(declaration)] = declaration

    def add_lost_schema(self, number: int, name: str, data: bytes) -> None:
        """Add a JSON Schema for a copied channel whose own schema is missing in its file."""
        if number not in self._schemas:
            self._schemas[number] = records.schema_record(number, name, "jsonschema", data)
            self._file.write(self._schemas[number])

    def add_message(self, channel: int, data: bytes, *, log_time: int, publish_time: int, sequence: int) -> None:
        """Add a message; it is in the file after :meth:`flush`. On an exception it is not added."""
        if len(self._chunk.records) > _LARGEST_CHUNK_BYTES:
            self.flush()
        chunk = self._chunk
        chunk.note(channel, log_time, len(chunk.records))
        chunk.records += _MESSAGE_HEAD.pack(
            records.MESSAGE, records.MESSAGE_BODY.size + len(data), channel, sequence, log_time, publish_time
        )
        chunk.records += data

    def flush(self) -> None:
        """Write the current chunk and its index in one piece; it is retained if the write fails."""
        if self._chunk.index:
            self._write_chunk(self._chunk, self._folded(self._chunk))
            self._chunk = _Chunk()

    def copy_chunk(self, content: bytes, folded: bytes = b"") -> None:
        """Copy a chunk with these records of messages; ``folded`` is its compressed form, if available."""
        self.flush()
        chunk = _Chunk(bytearray(content))
        for message in messages_of(content):
            chunk.note(message.channel, message.log_ns, message.record_start)
        self._write_chunk(chunk, folded or self._folded(chunk))

    def _folded(self, chunk: _Chunk) -> bytes:
        packed = self._compressor.compress(bytes(chunk.records))
        head = _CHUNK_HEAD.pack(chunk.begin_ns, chunk.end_ns, len(chunk.records), zlib.crc32(chunk.records))
        return record(records.CHUNK, head + text(_COMPRESSION) + struct.pack("<Q", len(packed)) + packed)

    def _write_chunk(self, chunk: _Chunk, folded: bytes) -> None:
        begin = self._file.tell()
        block = bytearray(folded)
        offsets = bytearray()
        for channel, index in chunk.index.items():
            offsets += struct.pack("<HQ", channel, begin + len(block))
            entries = _little_endian(index)
            block += record(records.MESSAGE_INDEX, struct.pack("<HI", channel, len(entries)) + entries)
        self._file.write(bytes(block))
        for channel, index in chunk.index.items():
            self._counts[channel] += len(index) // 2
        compression, folded_bytes = compression_of(folded)
        self._chunk_indexes += record(
            records.CHUNK_INDEX,
            records.CHUNK_INDEX_BODY.pack(chunk.begin_ns, chunk.end_ns, begin, len(folded), len(offsets))
            + offsets
            + struct.pack("<Q", len(block) - len(folded))
            + text(compression)
            + struct.pack("<QQ", folded_bytes, len(chunk.records)),
        )
        self._chunks += 1
        self._begin_ns = chunk.begin_ns if self._begin_ns is None else min(self._begin_ns, chunk.begin_ns)
        self._end_ns = max(self._end_ns, chunk.end_ns)

    def finish(self) -> None:
        """Write the summary section for random access."""
        self.flush()
        data_end = record(records.DATA_END, struct.pack("<I", 0))
        begin = self._file.tell() + len(data_end)
        summary, offsets = bytearray(), bytearray()
        for opcode, group in (
            (records.SCHEMA, b"".join(self._schemas.values())),
            (records.CHANNEL, b"".join(self._channels.values())),
            (records.STATISTICS, self._statistics()),
            (records.CHUNK_INDEX, bytes(self._chunk_indexes)),
            (records.ATTACHMENT_INDEX, bytes(self._attachment_indexes)),
            (records.METADATA_INDEX, bytes(self._metadata_indexes)),
        ):
            if group:
                place = struct.pack("<BQQ", opcode, begin + len(summary), len(group))
                offsets += record(records.SUMMARY_OFFSET, place)
                summary += group
        offsets_begin = begin + len(summary)
        summary += offsets
        # The checksum covers the footer up to itself.
        footer = records.HEAD.pack(records.FOOTER, records.FOOTER_BODY.size) + struct.pack("<QQ", begin, offsets_begin)
        checksum = zlib.crc32(footer, zlib.crc32(summary))
        self._file.write(data_end + bytes(summary) + footer + struct.pack("<I", checksum) + records.MAGIC)

    def _statistics(self) -> bytes:
        counts = b"".join(struct.pack("<HQ", channel, count) for channel, count in sorted(self._counts.items()))
        head = struct.pack(
            "<QHIIIIQQI",
            self._counts.total(),
            len(self._schemas),
            len(self._channels),
            self._attachments,
            self._metadata,
            self._chunks,
            self._begin_ns or 0,
            self._end_ns,
            len(counts),
        )
        return record(records.STATISTICS, head + counts)


def _little_endian(numbers: "array[int]") -> bytes:
    if struct.pack("=H", 1) != struct.pack("<H", 1):
        numbers = numbers[:]
        numbers.byteswap()
    return numbers.tobytes()
