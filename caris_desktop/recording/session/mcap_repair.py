"""Repair of ``events.mcap``: copies intact chunks and adds the missing index and summary."""

import json
import logging
from collections.abc import Callable
from typing import IO

from caris_desktop.domain.json_encoding import recorded_schema
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.session import mcap_chunks
from caris_desktop.recording.session import mcap_records as records
from caris_desktop.recording.session.mcap_chunks import BlockIndex
from caris_desktop.recording.session.mcap_file import McapFile

_log = logging.getLogger(__name__)


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
    *,
    added: AddedMessage | None,
    on_chunk: Callable[[bytes], None],
) -> None:
    """Copy the result of :func:`mcap_blocks.scan` of ``source`` to the new file ``target``.

    ``on_chunk`` receives the decompressed content of each chunk. Raises OSError.
    """
    writer = _begun(target, index)
    for number in range(index.count):
        try:
            record = mcap_chunks.read_record(source, index, number)
            content = mcap_chunks.decompress(record)
        except mcap_chunks.DamagedBlockError as error:
            raise OSError(5, f"the disk returned different data than before: {error}") from error
        on_chunk(content)
        _copy_block(writer, index, content, record)
    if added is not None:
        _add(writer, index, added)
    writer.finish()


Change = Callable[[int, bytes], bytes]
"""Receives channel and data of a message; returns the data to write."""


def copy_changed(source: IO[bytes], index: BlockIndex, target: DiskFile, change: Change) -> None:
    """Copy a log to the new file ``target``, with the data of each message replaced by ``change``.

    ``index`` is from :func:`mcap_blocks.scan`. Damaged chunks are left out. Raises OSError.
    """
    writer = _begun(target, index)
    for number in range(index.count):
        try:
            record = mcap_chunks.read_record(source, index, number)
            content = mcap_chunks.decompress(record)
        except mcap_chunks.DamagedBlockError as error:
            _log.warning("the block at byte %d is left out: %s", index.offsets[number], error)
            continue
        changed = _changed(content, change)
        _copy_block(writer, index, changed, record if changed == content else b"")
    writer.finish()


def _changed(content: bytes, change: Change) -> bytes:
    parts: list[bytes] = []
    at = 0
    for message in mcap_chunks.messages_of(content):
        data = content[message.start : message.end]
        new = change(message.channel, data)
        if new != data:
            start = message.record_start
            body = start + records.HEAD.size
            parts.append(content[at:start])
            parts.append(records.HEAD.pack(records.MESSAGE, message.start - body + len(new)))
            parts.append(content[body : message.start])
            parts.append(new)
            at = message.end
    return b"".join([*parts, content[at:]])


def _begun(target: DiskFile, index: BlockIndex) -> McapFile:
    """New file with the file-level records."""
    header = next((record for record in index.beside if record[0] == records.HEADER), b"")
    writer = McapFile(target, library="caris-desktop", header=header)
    for record in index.beside:
        if record[0] != records.HEADER:
            writer.copy_alongside(record)
    for channel in index.channels.values():
        if channel.schema:
            writer.declare(channel.schema)
        writer.declare(channel.record)
    for channel in index.channels.values():
        if channel.schema_number and not channel.schema:
            # Its schema was in a lost chunk, and readers require one.
            writer.add_lost_schema(channel.schema_number, *_schema_of(channel.topic))
    return writer


def _copy_block(writer: McapFile, index: BlockIndex, content: bytes, record: bytes) -> None:
    """Copy one chunk; ``record`` is its raw record, empty if the content was changed."""
    messages = list(mcap_chunks.messages_of(content))
    known = [message for message in messages if message.channel in index.channels]
    if len(known) < len(messages) or (record and not mcap_chunks.is_chunk(record)):
        # A run of messages outside of chunks, or one whose channel was in a lost chunk.
        content = b"".join(content[message.record_start : message.end] for message in known)
        record = b""
    if known:
        writer.copy_chunk(content, record)


def _schema_of(topic: str) -> tuple[str, bytes]:
    """Name and content of this program's JSON Schema for a topic."""
    name, schema = recorded_schema(topic) or ("lost", {})
    return name, json.dumps(schema).encode()


def _add(writer: McapFile, index: BlockIndex, added: AddedMessage) -> None:
    number = next((number for number, channel in index.channels.items() if channel.topic == added.topic), None)
    if number is None:
        schema = writer.add_schema(added.schema_name, "jsonschema", added.schema)
        number = writer.add_channel(added.topic, "json", schema)
    writer.add_message(number, added.data, log_time=added.log_ns, publish_time=added.publish_ns, sequence=1)
