"""Writes a broken-off ``events.mcap`` anew: every whole block as it is, with the index and summary that it lacks."""

import json
import logging
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import IO, Any

from caris_desktop.domain.schema import json_schema
from caris_desktop.domain.streams import spec_of_topic
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.session import mcap_blocks
from caris_desktop.recording.session.mcap_blocks import MAGIC, BlockIndex, Channel, Message

_log = logging.getLogger(__name__)
_RECORD_HEAD_BYTES = 9
_COMPRESSION_LEVEL = 3


@dataclass(frozen=True, slots=True)
class AddedMessage:
    """A message to put behind all others. ``schema`` is a JSON Schema of that name; times are UTC nanoseconds."""

    topic: str
    schema_name: str
    schema: bytes
    data: bytes
    log_ns: int
    publish_ns: int


@dataclass(slots=True)
class _Summary:
    """What the end of the file will tell of it."""

    schemas: dict[int, bytes] = field(default_factory=dict)
    channels: dict[int, bytes] = field(default_factory=dict)
    chunks: list[Any] = field(default_factory=list)
    attachments: list[Any] = field(default_factory=list)
    metadata: list[Any] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    first_ns: int = 0
    last_ns: int = 0


def rewrite(
    source: IO[bytes],
    index: BlockIndex,
    target: DiskFile,
    *,
    added: AddedMessage | None,
    look_at: Callable[[bytes], None],
) -> None:
    """Copy what :func:`mcap_blocks.scan` found in ``source`` to the new file ``target``.

    ``look_at`` is given the unfolded content of each block. Raises OSError.
    """
    summary = _Summary()
    target.write(MAGIC)
    _write_beside(target, index, summary)
    for number in range(index.count):
        try:
            record = mcap_blocks.read_record(source, index, number)
            content = mcap_blocks.unfolded(record)
        except mcap_blocks.DamagedBlockError as error:
            raise OSError(5, f"the disk gave other bytes than a moment ago: {error}") from error
        look_at(content)
        _write_block(target, index, content, record, summary)
    if added is not None:
        _add(target, index, added, summary)
    _write_end(target, summary)


def copy_changed(source: IO[bytes], index: BlockIndex, target: DiskFile, change: Callable[[bytes], bytes]) -> None:
    """Copy a record to the new file ``target``, the data of each message as ``change`` gives it.

    ``index`` is that of :func:`mcap_blocks.scan`. Blocks that are damaged are left out. Raises OSError.
    """
    summary = _Summary()
    target.write(MAGIC)
    _write_beside(target, index, summary)
    for number in range(index.count):
        try:
            record = mcap_blocks.read_record(source, index, number)
            content = mcap_blocks.unfolded(record)
        except mcap_blocks.DamagedBlockError as error:
            _log.warning("the block at byte %d is left out: %s", index.offsets[number], error)
            continue
        changed = _changed(content, change)
        if changed != content:
            content, record = changed, _folded(changed)
        _write_block(target, index, content, record, summary)
    _write_end(target, summary)


def _changed(content: bytes, change: Callable[[bytes], bytes]) -> bytes:
    parts: list[bytes] = []
    at = 0
    for message in mcap_blocks.messages_of(content):
        data = content[message.start : message.end]
        new = change(data)
        if new != data:
            start = message.record_start
            parts.append(content[at : start + 1])
            parts.append(struct.pack("<Q", message.start - start - _RECORD_HEAD_BYTES + len(new)))
            parts.append(content[start + _RECORD_HEAD_BYTES : message.start])
            parts.append(new)
            at = message.end
    return b"".join([*parts, content[at:]])


def _folded(content: bytes) -> bytes:
    """A chunk of these records."""
    import zstandard
    from mcap.records import Chunk

    times_ns = [message.log_ns for message in mcap_blocks.messages_of(content)]
    chunk = Chunk(
        compression="zstd",
        data=zstandard.ZstdCompressor(level=_COMPRESSION_LEVEL).compress(content),
        message_start_time=min(times_ns),
        message_end_time=max(times_ns),
        uncompressed_crc=zlib.crc32(content),
        uncompressed_size=len(content),
    )
    return _bytes_of(chunk)


def _write_beside(target: DiskFile, index: BlockIndex, summary: _Summary) -> None:
    import io

    from mcap.data_stream import ReadDataStream
    from mcap.opcode import Opcode
    from mcap.records import Attachment, AttachmentIndex, Header, Metadata, MetadataIndex

    # The header comes first, and there must be one.
    records = sorted(index.beside, key=lambda record: record[0] != Opcode.HEADER)
    if not records or records[0][0] != Opcode.HEADER:
        target.write(_bytes_of(Header(profile="", library="caris-desktop")))
    for record in records:
        offset = target.tell()
        target.write(record)
        body = ReadDataStream(io.BytesIO(record[9:]))
        if record[0] == Opcode.METADATA:
            summary.metadata.append(MetadataIndex(offset, len(record), Metadata.read(body).name))
        elif record[0] == Opcode.ATTACHMENT:
            attachment = Attachment.read(body)
            summary.attachments.append(
                AttachmentIndex(
                    offset=offset,
                    length=len(record),
                    log_time=attachment.log_time,
                    create_time=attachment.create_time,
                    data_size=len(attachment.data),
                    name=attachment.name,
                    media_type=attachment.media_type,
                )
            )


def _write_block(target: DiskFile, index: BlockIndex, content: bytes, record: bytes, summary: _Summary) -> None:
    messages = list(mcap_blocks.messages_of(content))
    known = [message for message in messages if message.channel in index.channels]
    for message in known:
        channel = index.channels[message.channel]
        summary.channels[message.channel] = channel.record
        if channel.schema:
            summary.schemas[int.from_bytes(channel.schema[9:11], "little")] = channel.schema
        elif channel.schema_number and channel.schema_number not in summary.schemas:
            # It was in a lost block, and no reader does without one.
            schema = _lost_schema(channel)
            summary.schemas[channel.schema_number] = schema
            target.write(schema)
    if not known:
        return
    if len(known) == len(messages) and mcap_blocks.is_chunk(record):
        _write_chunk(target, record, content, known, summary)
        return
    # A run of messages outside of chunks, or one whose channel was in a lost block: it is put into a new chunk.
    from mcap.records import Chunk

    content = b"".join(content[message.record_start : message.end] for message in known)
    times_ns = [message.log_ns for message in known]
    chunk = Chunk(
        compression="",
        data=content,
        message_start_time=min(times_ns),
        message_end_time=max(times_ns),
        uncompressed_crc=zlib.crc32(content),
        uncompressed_size=len(content),
    )
    _write_chunk(target, _bytes_of(chunk), content, list(mcap_blocks.messages_of(content)), summary)


def _lost_schema(channel: Channel) -> bytes:
    from mcap.records import Schema

    spec = spec_of_topic(channel.topic)
    data = b"{}" if spec is None else json.dumps(json_schema(spec.value_type)).encode()
    name = "lost" if spec is None else f"caris.{spec.value_type.__name__}"
    return _bytes_of(Schema(id=channel.schema_number, data=data, encoding="jsonschema", name=name))


def _write_chunk(target: DiskFile, record: bytes, content: bytes, messages: list[Message], summary: _Summary) -> None:
    from mcap.records import ChunkIndex, MessageIndex

    start = target.tell()
    target.write(record)
    places: dict[int, list[tuple[int, int]]] = {}
    for message in messages:
        places.setdefault(message.channel, []).append((message.log_ns, message.record_start))
    index_start = target.tell()
    offsets: dict[int, int] = {}
    parts: list[bytes] = []
    at = index_start
    for channel, entries in places.items():
        offsets[channel] = at
        parts.append(_bytes_of(MessageIndex(channel, entries)))
        at += len(parts[-1])
        summary.counts[channel] = summary.counts.get(channel, 0) + len(entries)
    target.write(b"".join(parts))
    first_ns = min(message.log_ns for message in messages)
    last_ns = max(message.log_ns for message in messages)
    summary.first_ns = min(summary.first_ns, first_ns) if summary.chunks else first_ns
    summary.last_ns = max(summary.last_ns, last_ns)
    compression, folded_bytes = mcap_blocks.compression_of(record)
    summary.chunks.append(
        ChunkIndex(
            message_start_time=first_ns,
            message_end_time=last_ns,
            chunk_start_offset=start,
            chunk_length=len(record),
            message_index_offsets=offsets,
            message_index_length=at - index_start,
            compression=compression,
            compressed_size=folded_bytes,
            uncompressed_size=len(content),
        )
    )


def _add(target: DiskFile, index: BlockIndex, added: AddedMessage, summary: _Summary) -> None:
    from mcap import records

    schema_number = max(summary.schemas, default=0) + 1
    number = max(index.channels, default=0) + 1
    schema = _bytes_of(
        records.Schema(id=schema_number, data=added.schema, encoding="jsonschema", name=added.schema_name)
    )
    channel = _bytes_of(
        records.Channel(id=number, topic=added.topic, message_encoding="json", metadata={}, schema_id=schema_number)
    )
    for known, its in index.channels.items():
        if its.topic == added.topic:
            number, schema, channel = known, its.schema, its.record
    if schema:
        summary.schemas[int.from_bytes(schema[9:11], "little")] = schema
    summary.channels[number] = channel
    message = records.Message(
        channel_id=number, log_time=added.log_ns, data=added.data, publish_time=added.publish_ns, sequence=1
    )
    content = schema + channel + _bytes_of(message)
    chunk = records.Chunk(
        compression="",
        data=content,
        message_start_time=added.log_ns,
        message_end_time=added.log_ns,
        uncompressed_crc=zlib.crc32(content),
        uncompressed_size=len(content),
    )
    _write_chunk(target, _bytes_of(chunk), content, list(mcap_blocks.messages_of(content)), summary)


def _write_end(target: DiskFile, summary: _Summary) -> None:
    from mcap.opcode import Opcode
    from mcap.records import DataEnd, Footer, Statistics, SummaryOffset

    target.write(_bytes_of(DataEnd(0)))
    statistics = Statistics(
        attachment_count=len(summary.attachments),
        channel_count=len(summary.channels),
        channel_message_counts=summary.counts,
        chunk_count=len(summary.chunks),
        message_count=sum(summary.counts.values()),
        message_end_time=summary.last_ns,
        message_start_time=summary.first_ns,
        metadata_count=len(summary.metadata),
        schema_count=len(summary.schemas),
    )
    start = target.tell()
    groups = (
        (Opcode.SCHEMA, list(summary.schemas.values())),
        (Opcode.CHANNEL, list(summary.channels.values())),
        (Opcode.STATISTICS, [_bytes_of(statistics)]),
        (Opcode.CHUNK_INDEX, [_bytes_of(chunk) for chunk in summary.chunks]),
        (Opcode.ATTACHMENT_INDEX, [_bytes_of(attachment) for attachment in summary.attachments]),
        (Opcode.METADATA_INDEX, [_bytes_of(metadata) for metadata in summary.metadata]),
    )
    content, offsets = b"", []
    for opcode, records in groups:
        group = b"".join(records)
        if group:
            offsets.append(
                SummaryOffset(group_opcode=opcode, group_start=start + len(content), group_length=len(group))
            )
        content += group
    offsets_start = start + len(content)
    content += b"".join(_bytes_of(offset) for offset in offsets)
    head = struct.pack("<BQQQ", Opcode.FOOTER, 8 + 8 + 4, start, offsets_start)
    footer = Footer(
        summary_start=start, summary_offset_start=offsets_start, summary_crc=zlib.crc32(head, zlib.crc32(content))
    )
    target.write(content + _bytes_of(footer) + MAGIC)


def _bytes_of(record: Any) -> bytes:
    from mcap.data_stream import RecordBuilder

    builder = RecordBuilder()
    record.write(builder)
    content: bytes = builder.end()
    return content
