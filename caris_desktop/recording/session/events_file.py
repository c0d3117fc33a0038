"""Reader, writer and repair of ``events.mcap`` (https://mcap.dev/spec), by chunk.

The reader uses the index if present, else scans the file once. A block is a chunk with compressed messages, or a run of
messages outside of chunks; damaged or truncated ones are left out, never guessed.

The ``mcap`` package reads the result, in tests too. Its writer is not used: it accumulates an object per chunk and
channel (megabytes per hour with short chunks), writes a chunk in several pieces, which a kill may interrupt, and cannot
copy chunks of another file.
"""

import json
import logging
import struct
import zlib
from array import array
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import field
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.json_encoding import recorded_schema
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.recording.disk_file import DiskFile

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX, ATTACHMENT, ATTACHMENT_INDEX = range(1, 11)
STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(11, 16)
KNOWN = range(HEADER, DATA_END + 1)
# Head of every record: opcode and length.
HEAD = struct.Struct("<BQ")
# Before the data of a message: channel, sequence, log time, publish time.
MESSAGE_BODY = struct.Struct("<HIQQ")
# Start, end, uncompressed size, checksum, and length of the compression name that follows.
CHUNK_BODY = struct.Struct("<QQQII")
_CRC = slice(HEAD.size + 24, HEAD.size + 28)
# Start, end, offset and length of a chunk, and the length of the following message index offsets.
CHUNK_INDEX_BODY = struct.Struct("<QQQQI")
FOOTER_BODY = struct.Struct("<QQI")


def record(opcode: int, body: bytes) -> bytes:
    return HEAD.pack(opcode, len(body)) + body


def text(words: str) -> bytes:
    data = words.encode("utf-8", "replace")
    return struct.pack("<I", len(data)) + data


def text_map(entries: dict[str, str]) -> bytes:
    data = b"".join(text(key) + text(value) for key, value in entries.items())
    return struct.pack("<I", len(data)) + data


def text_end(data: bytes, at: int) -> int:
    """End offset of a string that begins at ``at``."""
    return at + 4 + int.from_bytes(data[at : at + 4], "little")


def schema_record(number: int, name: str, data: bytes) -> bytes:
    head = struct.pack("<H", number) + text(name) + text("jsonschema")
    return record(SCHEMA, head + struct.pack("<I", len(data)) + data)


def number_of(declaration: bytes) -> int:
    """Id of a schema or channel record."""
    return int.from_bytes(declaration[HEAD.size : HEAD.size + 2], "little")


_log = logging.getLogger(__name__)
_BESIDE = (HEADER, ATTACHMENT, METADATA)
_TAIL_BYTES = HEAD.size + FOOTER_BODY.size + len(MAGIC)
_INDEX_ENTRY = np.dtype([("channel", "<u2"), ("offset", "<u8")])
# A map of 10,000 x 10,000 cells has 100 million bytes; the recorder closes a chunk after some megabytes.
_MAX_BLOCK_BYTES = 1 << 28
_RUN_BYTES = 1 << 20
_LARGEST_NS = 2**63 - 1
_HEADER = record(HEADER, text("") + text("caris-desktop"))
_BEGINNING = MAGIC + _HEADER
# Offset of the compression name in a chunk, which locates the next chunk behind damage.
_ZSTD, _ZSTD_AT = b"\x04\x00\x00\x00zstd", HEAD.size + CHUNK_BODY.size - 4


class Message(NamedTuple):
    """One message of a chunk: ``content[start:end]`` is its data. Times are UTC nanoseconds."""

    channel: int
    sequence: int
    log_ns: int
    publish_ns: int
    start: int
    end: int

    @property
    def record_start(self) -> int:
        """Offset of the message's record in the chunk's content."""
        return self.start - MESSAGE_BODY.size - HEAD.size


class DamagedBlockError(ValueError):
    """Chunk that cannot be decompressed."""


class Channel(Value):
    """``record`` and ``schema`` are the complete raw records."""

    topic: str
    record: bytes
    schema: bytes

    @property
    def schema_number(self) -> int:
        """Schema id, 0 for a channel without a schema."""
        return int.from_bytes(self.record[HEAD.size + 2 : HEAD.size + 4], "little")

    @property
    def json_schema(self) -> dict[str, Any] | None:
        """JSON Schema of its messages from the file; None if it has none."""
        body = self.schema[HEAD.size + 2 :]
        for _ in ("name", "encoding"):
            body = body[4 + int.from_bytes(body[:4], "little") :]
        try:
            schema = json.loads(body[4 : 4 + int.from_bytes(body[:4], "little")])
        except (ValueError, RecursionError):
            return None
        return schema if isinstance(schema, dict) else None


class BlockIndex(Value, eq=False):
    """Positions of the chunks. Arrays have one entry per chunk, in file order.

    ``has_summary`` is True if the file's own index was used. Otherwise ``damaged_bytes`` counts skipped bytes, and
    ``beside`` has the file-level records: header, metadata, attachments.
    """

    offsets: NDArray[np.int64]
    lengths: NDArray[np.int64]
    ends_utc_ns: NDArray[np.int64]
    channels: dict[int, Channel]
    blocks_of: dict[int, NDArray[np.int64]]
    has_summary: bool
    damaged_bytes: int = 0
    beside: tuple[bytes, ...] = ()

    @property
    def count(self) -> int:
        return len(self.offsets)


@dataclass(slots=True)
class _Gathered:
    """Index under construction."""

    blocks: list[tuple[int, int, int]] = field(default_factory=list)
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, bytes] = field(default_factory=dict)
    blocks_of: dict[int, list[int]] = field(default_factory=dict)
    damaged_bytes: int = 0
    beside: list[bytes] = field(default_factory=list)

    def add_block(self, block: tuple[int, int, int], channels: Iterable[int]) -> None:
        for channel in channels:
            self.blocks_of.setdefault(channel, []).append(len(self.blocks))
        self.blocks.append(block)

    def add_declaration(self, opcode: int, record: bytes) -> None:
        body = record[HEAD.size :]
        number = number_of(record)
        if opcode == SCHEMA:
            self.schemas[number] = record
        elif opcode == CHANNEL:
            length = int.from_bytes(body[4:8], "little")
            topic = body[8 : 8 + length].decode("utf-8", "replace")
            schema = self.schemas.get(int.from_bytes(body[2:4], "little"), b"")
            self.channels[number] = Channel(topic, record, schema)

    def index(self, *, has_summary: bool) -> BlockIndex:
        table = np.array(self.blocks, np.int64).reshape(-1, 3)
        return BlockIndex(
            table[:, 0],
            table[:, 1],
            table[:, 2],
            self.channels,
            {channel: np.array(blocks, np.int64) for channel, blocks in self.blocks_of.items()},
            has_summary,
            self.damaged_bytes,
            tuple(self.beside),
        )


def read_index(path: Path) -> BlockIndex:
    """Index of the file, from a scan if it is missing or damaged. Raises OSError."""
    with path.open("rb") as file:
        return _by_summary(file) or scan(file, thorough=False)


def has_summary(path: Path) -> bool:
    """True if the file was finished, with an index at its end. Raises OSError."""
    with path.open("rb") as file:
        return _summary_span(file) is not None


def is_ours(path: Path) -> bool:
    """True if this program wrote the file, by its first bytes. Raises OSError."""
    with path.open("rb") as file:
        return file.read(len(_BEGINNING)) == _BEGINNING


def messages_of(content: bytes, channels: Collection[int] | None = None) -> Iterator[Message]:
    """Messages of a decompressed chunk that are in these channels (default: all)."""
    at, end = 0, len(content)
    while at + HEAD.size <= end:
        opcode, length = HEAD.unpack_from(content, at)
        body = at + HEAD.size
        at = body + length
        if at > end:
            return
        if opcode == MESSAGE and length >= MESSAGE_BODY.size:
            channel, sequence, log_ns, publish_ns = MESSAGE_BODY.unpack_from(content, body)
            if channels is None or channel in channels:
                yield Message(channel, sequence, log_ns, publish_ns, body + MESSAGE_BODY.size, at)


def channels_in(content: bytes) -> Iterator[int]:
    """Channel of each message of a decompressed chunk."""
    at, end = 0, len(content)
    while at + HEAD.size <= end:
        opcode, length = HEAD.unpack_from(content, at)
        at += HEAD.size
        if opcode == MESSAGE and length >= MESSAGE_BODY.size and at + length <= end:
            yield content[at] | content[at + 1] << 8
        at += length


def read_block(file: IO[bytes], index: BlockIndex, number: int) -> bytes:
    """Decompressed records of one chunk. Raises DamagedBlockError, OSError."""
    return decompress(read_record(file, index, number))


def intact_blocks(file: IO[bytes], index: BlockIndex, channels: Collection[int] | None = None) -> Iterator[bytes]:
    """Decompressed chunks that contain these channels (default: all), in order, but damaged ones. Raises OSError."""
    numbers: Iterable[int] = range(index.count)
    if channels is not None:
        numbers = sorted({int(number) for channel in channels for number in index.blocks_of.get(channel, ())})
    for number in numbers:
        try:
            yield read_block(file, index, number)
        except DamagedBlockError as error:
            name = getattr(file, "name", "a recording")
            _log.info("%s: the block at byte %d is left out: %s", name, index.offsets[number], error)


def read_messages(file: IO[bytes], index: BlockIndex, channels: Collection[int]) -> Iterator[tuple[Message, bytes]]:
    """Messages of these channels with their data, in recording order, as far as they are intact. Raises OSError."""
    for content in intact_blocks(file, index, channels):
        for message in messages_of(content, channels):
            yield message, content[message.start : message.end]


def compression_of(chunk: bytes) -> tuple[str, int]:
    """Compression of a chunk's record, and its compressed size in bytes."""
    at = HEAD.size + CHUNK_BODY.size
    (name_bytes,) = struct.unpack_from("<I", chunk, at - 4)
    (folded_bytes,) = struct.unpack_from("<Q", chunk, at + name_bytes)
    return chunk[at : at + name_bytes].decode("utf-8", "replace"), folded_bytes


def is_chunk(record: bytes) -> bool:
    """True if the record is a chunk rather than a run of messages."""
    return record[:1] == bytes([CHUNK])


def read_record(file: IO[bytes], index: BlockIndex, number: int) -> bytes:
    """Raw record of one chunk, compressed. Raises DamagedBlockError, OSError."""
    if index.lengths[number] > _MAX_BLOCK_BYTES:
        raise DamagedBlockError(f"it has {index.lengths[number]} bytes")
    file.seek(int(index.offsets[number]))
    record = file.read(int(index.lengths[number]))
    if len(record) != index.lengths[number]:
        raise DamagedBlockError("it is truncated at the end of the file")
    return record


def decompress(record: bytes) -> bytes:
    """Decompress a chunk's record; a run of messages is returned unchanged. Raises DamagedBlockError."""
    if not is_chunk(record):
        return record
    try:
        _, _, size_bytes, crc, name_bytes = CHUNK_BODY.unpack_from(record, HEAD.size)
        at = HEAD.size + CHUNK_BODY.size
        compression = record[at : at + name_bytes]
        (folded_bytes,) = struct.unpack_from("<Q", record, at + name_bytes)
    except struct.error as error:
        raise DamagedBlockError("its header is truncated") from error
    start = at + name_bytes + 8
    content = record[start : start + folded_bytes]
    if size_bytes > _MAX_BLOCK_BYTES:
        raise DamagedBlockError(f"it would decompress to {size_bytes} bytes")
    if compression == b"zstd":
        import zstandard

        try:
            # The frame's own size would be allocated unchecked.
            if zstandard.frame_content_size(content) not in (-1, size_bytes):
                raise DamagedBlockError("its sizes are inconsistent")
            content = zstandard.ZstdDecompressor().decompress(content, max_output_size=size_bytes)
        except zstandard.ZstdError as error:
            raise DamagedBlockError(str(error)) from error
    elif compression:
        raise DamagedBlockError(f"unknown compression: {compression!r}")
    if len(content) != size_bytes or (crc and zlib.crc32(content) != crc):
        raise DamagedBlockError("its checksum is invalid")
    return content


def _summary_span(file: IO[bytes]) -> tuple[int, int, int] | None:
    """Start, end and checksum of the summary section."""
    size_bytes = file.seek(0, 2)
    if size_bytes < len(MAGIC) + _TAIL_BYTES:
        return None
    file.seek(size_bytes - _TAIL_BYTES)
    tail = file.read(_TAIL_BYTES)
    opcode, length = HEAD.unpack_from(tail)
    if tail[-len(MAGIC) :] != MAGIC or (opcode, length) != (FOOTER, FOOTER_BODY.size):
        return None
    start, _, crc = FOOTER_BODY.unpack_from(tail, HEAD.size)
    end = size_bytes - _TAIL_BYTES
    return (start, end, crc) if len(MAGIC) <= start < end else None


def _by_summary(file: IO[bytes]) -> BlockIndex | None:
    span = _summary_span(file)
    if span is None:
        return None
    start, end, crc = span
    file.seek(start)
    summary = file.read(end - start + _TAIL_BYTES - len(MAGIC) - 4)
    if crc and zlib.crc32(summary) != crc:
        _log.warning("the index of %s is damaged", getattr(file, "name", "a recording"))
        return None
    gathered, at, messages = _Gathered(), 0, 0
    try:
        while at < end - start:
            opcode, length = HEAD.unpack_from(summary, at)
            body = at + HEAD.size
            if opcode in (SCHEMA, CHANNEL):
                gathered.add_declaration(opcode, summary[at : body + length])
            elif opcode == CHUNK_INDEX:
                _, last_ns, offset, size, map_bytes = CHUNK_INDEX_BODY.unpack_from(summary, body)
                if offset + size > start:
                    return None
                entries = np.frombuffer(
                    summary, _INDEX_ENTRY, map_bytes // _INDEX_ENTRY.itemsize, body + CHUNK_INDEX_BODY.size
                )
                gathered.add_block((offset, size, last_ns), entries["channel"].tolist())
            elif opcode == STATISTICS:
                (messages,) = struct.unpack_from("<Q", summary, body)
            at = body + length
        # Without chunk or message indexes the file must be scanned.
        return None if messages and not gathered.blocks_of else gathered.index(has_summary=True)
    except (struct.error, ValueError, OverflowError):
        return None


def scan(file: IO[bytes], *, thorough: bool = True) -> BlockIndex:
    """Scan the whole file for intact chunks, also behind damage. Raises OSError.

    Unless ``thorough``, the chunk headers and indexes are trusted; :func:`read_block` detects errors later.
    """
    end = file.seek(0, 2)
    file.seek(0)
    gathered = _Gathered()
    at = len(MAGIC) if file.read(len(MAGIC)) == MAGIC else 0
    run: list[bytes] = []
    run_at = at
    chunks: set[bytes] = set()  # a file system may give a part of a file twice

    def end_run() -> None:
        if run:
            records = b"".join(run)
            _add_records(gathered, records, (run_at, len(records)))
            run.clear()

    while at < end:
        file.seek(at)
        head = file.read(HEAD.size)
        opcode, length = HEAD.unpack(head) if len(head) == HEAD.size else (0, 0)
        if opcode not in KNOWN or length > end - at - HEAD.size:
            end_run()
            found = _next_chunk(file, at + 1, end)
            gathered.damaged_bytes += found - at
            at = found
            continue
        if opcode in (DATA_END, FOOTER):
            break
        record_bytes = HEAD.size + length
        if opcode == MESSAGE:
            if not run or at - run_at > _RUN_BYTES:
                end_run()
                run_at = at
            run.append(head + file.read(length))
        elif opcode == CHUNK:
            end_run()
            about = head + file.read(min(length, CHUNK_BODY.size))
            file.seek(at + HEAD.size)
            if about not in chunks:
                listed = not thorough and _add_listed_chunk(gathered, file, at, record_bytes)
                if not listed:
                    file.seek(at + HEAD.size)
                if not listed and not _add_chunk(gathered, head + file.read(length), at):
                    found = _next_chunk(file, at + 1, end)
                    gathered.damaged_bytes += found - at
                    at = found
                    continue
                if about[_CRC] != bytes(4):
                    chunks.add(about)
        elif opcode in (SCHEMA, CHANNEL):
            end_run()
            gathered.add_declaration(opcode, head + file.read(length))
        elif opcode in _BESIDE:
            gathered.beside.append(head + file.read(length))
        at += record_bytes
    end_run()
    return gathered.index(has_summary=False)


def _add_listed_chunk(gathered: _Gathered, file: IO[bytes], at: int, record_bytes: int) -> bool:
    """Add a chunk by its message indexes; False if these are incomplete."""
    head = file.read(CHUNK_BODY.size)
    if len(head) < CHUNK_BODY.size:
        return False
    _, last_ns, _, _, _ = CHUNK_BODY.unpack(head)
    place, numbers = at + record_bytes, []
    while True:
        file.seek(place)
        entry = file.read(HEAD.size + 2)
        if len(entry) < HEAD.size + 2:
            return False
        opcode, length = HEAD.unpack_from(entry)
        if opcode != MESSAGE_INDEX or length > _MAX_BLOCK_BYTES:
            break
        numbers.append(int.from_bytes(entry[HEAD.size :], "little"))
        place += HEAD.size + length
    # A chunk that declares a channel must be decompressed, and so must the last one, whose indexes may be incomplete.
    if not numbers or any(number not in gathered.channels for number in numbers) or last_ns > _LARGEST_NS:
        return False
    gathered.add_block((at, record_bytes, last_ns), dict.fromkeys(numbers))
    return True


def _add_chunk(gathered: _Gathered, record: bytes, at: int) -> bool:
    try:
        content = decompress(record)
    except DamagedBlockError as error:
        _log.info("the chunk at byte %d is damaged: %s", at, error)
        return False
    _add_records(gathered, content, (at, len(record)))
    return True


def _add_records(gathered: _Gathered, content: bytes, place: tuple[int, int]) -> None:
    numbers: set[int] = set()
    at, last_ns = 0, 0
    while at + HEAD.size <= len(content):
        opcode, length = HEAD.unpack_from(content, at)
        body = at + HEAD.size
        if opcode in (SCHEMA, CHANNEL):
            gathered.add_declaration(opcode, content[at : body + length])
        elif opcode == MESSAGE and length >= MESSAGE_BODY.size and body + length <= len(content):
            number, _, log_ns, _ = MESSAGE_BODY.unpack_from(content, body)
            last_ns = max(last_ns, log_ns)
            numbers.add(number)
        at = body + length
    if numbers:
        gathered.add_block((*place, min(last_ns, _LARGEST_NS)), numbers)


def _next_chunk(file: IO[bytes], at: int, end: int) -> int:
    """First offset from ``at`` at which a chunk may begin; ``end`` if there is none."""
    window = 1 << 22
    while at < end:
        file.seek(at)
        content = file.read(window + _ZSTD_AT + len(_ZSTD))
        found = content.find(_ZSTD)
        while found >= 0:
            start = found - _ZSTD_AT
            if start >= 0 and content[start] == CHUNK:
                (length,) = struct.unpack_from("<Q", content, start + 1)
                if at + start + HEAD.size + length <= end:
                    return at + start
            found = content.find(_ZSTD, found + 1)
        at += window
    return end


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

    def __init__(self, file: DiskFile, *, header: bytes = _HEADER) -> None:
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
        file.write(MAGIC + header)

    def add_metadata(self, name: str, entries: dict[str, str]) -> None:
        """Write a metadata record. Call before the first message."""
        self.copy_alongside(record(METADATA, text(name) + text_map(entries)))

    def copy_alongside(self, data: bytes) -> None:
        """Copy a metadata or attachment record. Call before the first message."""
        place = struct.pack("<QQ", self._file.tell(), len(data))
        body = data[HEAD.size :]
        if data[0] == METADATA:
            name = body[: text_end(body, 0)]
            self._metadata_indexes += record(METADATA_INDEX, place + name)
            self._metadata += 1
        elif data[0] == ATTACHMENT:
            # Two times, name, media type, then the length of the data.
            names_end = text_end(body, text_end(body, 16))
            data_bytes = body[names_end : names_end + 8]
            self._attachment_indexes += record(ATTACHMENT_INDEX, place + body[:16] + data_bytes + body[16:names_end])
            self._attachments += 1
        self._file.write(data)

    def add_schema(self, name: str, data: bytes) -> int:
        """Add a JSON Schema; return its id."""
        number = max(self._schemas, default=0) + 1
        self._schemas[number] = schema_record(number, name, data)
        self._chunk.records += self._schemas[number]
        return number

    def add_channel(self, topic: str, schema: int) -> int:
        """Add a channel of JSON messages; return its id."""
        number = max(self._channels, default=0) + 1
        body = struct.pack("<HH", number, schema) + text(topic) + text("json") + text_map({})
        self._channels[number] = record(CHANNEL, body)
        self._chunk.records += self._channels[number]
        return number

    def declare(self, declaration: bytes) -> None:
        """Declare a schema or channel record of copied chunks, for the summary."""
        table = self._schemas if declaration[0] == SCHEMA else self._channels
        table[number_of(declaration)] = declaration

    def add_lost_schema(self, number: int, name: str, data: bytes) -> None:
        """Add a JSON Schema for a copied channel whose own schema is missing in its file."""
        if number not in self._schemas:
            self._schemas[number] = schema_record(number, name, data)
            self._file.write(self._schemas[number])

    def add_message(self, channel: int, data: bytes, *, log_time: int, publish_time: int, sequence: int) -> None:
        """Add a message; it is in the file after :meth:`flush`. On an exception it is not added."""
        if len(self._chunk.records) > _LARGEST_CHUNK_BYTES:
            self.flush()
        chunk = self._chunk
        chunk.note(channel, log_time, len(chunk.records))
        chunk.records += _MESSAGE_HEAD.pack(
            MESSAGE, MESSAGE_BODY.size + len(data), channel, sequence, log_time, publish_time
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
        return record(CHUNK, head + text(_COMPRESSION) + struct.pack("<Q", len(packed)) + packed)

    def _write_chunk(self, chunk: _Chunk, folded: bytes) -> None:
        begin = self._file.tell()
        block = bytearray(folded)
        offsets = bytearray()
        for channel, index in chunk.index.items():
            offsets += struct.pack("<HQ", channel, begin + len(block))
            entries = _little_endian(index)
            block += record(MESSAGE_INDEX, struct.pack("<HI", channel, len(entries)) + entries)
        self._file.write(bytes(block))
        for channel, index in chunk.index.items():
            self._counts[channel] += len(index) // 2
        compression, folded_bytes = compression_of(folded)
        self._chunk_indexes += record(
            CHUNK_INDEX,
            CHUNK_INDEX_BODY.pack(chunk.begin_ns, chunk.end_ns, begin, len(folded), len(offsets))
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
        data_end = record(DATA_END, struct.pack("<I", 0))
        begin = self._file.tell() + len(data_end)
        summary, offsets = bytearray(), bytearray()
        for opcode, group in (
            (SCHEMA, b"".join(self._schemas.values())),
            (CHANNEL, b"".join(self._channels.values())),
            (STATISTICS, self._statistics()),
            (CHUNK_INDEX, bytes(self._chunk_indexes)),
            (ATTACHMENT_INDEX, bytes(self._attachment_indexes)),
            (METADATA_INDEX, bytes(self._metadata_indexes)),
        ):
            if group:
                place = struct.pack("<BQQ", opcode, begin + len(summary), len(group))
                offsets += record(SUMMARY_OFFSET, place)
                summary += group
        offsets_begin = begin + len(summary)
        summary += offsets
        # The checksum covers the footer up to itself.
        footer = HEAD.pack(FOOTER, FOOTER_BODY.size) + struct.pack("<QQ", begin, offsets_begin)
        checksum = zlib.crc32(footer, zlib.crc32(summary))
        self._file.write(data_end + bytes(summary) + footer + struct.pack("<I", checksum) + MAGIC)

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
        return record(STATISTICS, head + counts)


def _little_endian(numbers: "array[int]") -> bytes:
    if struct.pack("=H", 1) != struct.pack("<H", 1):
        numbers = numbers[:]
        numbers.byteswap()
    return numbers.tobytes()


class AddedMessage(Value):
    """Message to append. ``schema`` is a JSON Schema of that name; times are UTC nanoseconds."""

    topic: str
    schema_name: str
    schema: bytes
    data: bytes
    log_ns: int
    publish_ns: int


def rewrite(
    source: IO[bytes],
    index: BlockIndex,
    target: DiskFile,
    on_chunk: Callable[[bytes], bytes],
    *,
    added: AddedMessage | None = None,
    skip_damaged: bool = False,
) -> None:
    """Copy the result of :func:`scan` of ``source`` to the new file ``target``.

    ``on_chunk`` receives the decompressed content of each chunk, and returns what is written. Damaged chunks are left
    out, or raise OSError. Raises OSError.
    """
    writer = _begun(target, index)
    for number in range(index.count):
        try:
            record = read_record(source, index, number)
            content = decompress(record)
        except DamagedBlockError as error:
            if not skip_damaged:
                raise OSError(5, f"the disk returned different data than before: {error}") from error
            _log.warning("the block at byte %d is left out: %s", index.offsets[number], error)
            continue
        changed = on_chunk(content)
        _copy_block(writer, index, changed, record if changed == content else b"")
    if added is not None:
        channels = (number for number, channel in index.channels.items() if channel.topic == added.topic)
        number = next(channels, 0) or writer.add_channel(
            added.topic, writer.add_schema(added.schema_name, added.schema)
        )
        writer.add_message(number, added.data, log_time=added.log_ns, publish_time=added.publish_ns, sequence=1)
    writer.finish()


Change = Callable[[int, bytes], bytes]
"""Receives channel and data of a message; returns the data to write."""


def copy_changed(source: IO[bytes], index: BlockIndex, target: DiskFile, change: Change) -> None:
    """Copy a log to the new file ``target``, with the data of each message replaced by ``change``.

    ``index`` is from :func:`scan`. Damaged chunks are left out. Raises OSError.
    """

    def changed(content: bytes) -> bytes:
        parts: list[bytes] = []
        at = 0
        for message in messages_of(content):
            data = content[message.start : message.end]
            new = change(message.channel, data)
            if new != data:
                body = message.record_start + HEAD.size
                head = HEAD.pack(MESSAGE, message.start - body + len(new))
                parts += content[at : message.record_start], head, content[body : message.start], new
                at = message.end
        return b"".join((*parts, content[at:]))

    rewrite(source, index, target, changed, skip_damaged=True)


def _begun(target: DiskFile, index: BlockIndex) -> McapFile:
    """New file with the file-level records."""
    header = next((record for record in index.beside if record[0] == HEADER), _HEADER)
    writer = McapFile(target, header=header)
    for record in index.beside:
        if record[0] != HEADER:
            writer.copy_alongside(record)
    for channel in index.channels.values():
        if channel.schema:
            writer.declare(channel.schema)
        writer.declare(channel.record)
    for channel in index.channels.values():
        if channel.schema_number and not channel.schema:
            # Its schema was in a lost chunk, and readers require one.
            name, schema = recorded_schema(channel.topic) or ("lost", {})
            writer.add_lost_schema(channel.schema_number, name, json.dumps(schema).encode())
    return writer


def _copy_block(writer: McapFile, index: BlockIndex, content: bytes, record: bytes) -> None:
    """Copy one chunk; ``record`` is its raw record, empty if the content was changed."""
    messages = list(messages_of(content))
    known = [message for message in messages if message.channel in index.channels]
    if len(known) < len(messages) or (record and not is_chunk(record)):
        # A run of messages outside of chunks, or one whose channel was in a lost chunk.
        content = b"".join(content[message.record_start : message.end] for message in known)
        record = b""
    if known:
        writer.copy_chunk(content, record)
