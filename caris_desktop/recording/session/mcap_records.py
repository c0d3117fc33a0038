"""MCAP record types and layouts (https://mcap.dev/spec), for reader and writer."""

import struct

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


def schema_record(number: int, name: str, encoding: str, data: bytes) -> bytes:
    return record(SCHEMA, struct.pack("<H", number) + text(name) + text(encoding) + struct.pack("<I", len(data)) + data)


def number_of(declaration: bytes) -> int:
    """Id of a schema or channel record."""
    return int.from_bytes(declaration[HEAD.size : HEAD.size + 2], "little")
