"""The records of an MCAP file (https://mcap.dev/spec), as whoever writes and whoever reads it needs them."""

import struct

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX, ATTACHMENT, ATTACHMENT_INDEX = range(1, 11)
STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(11, 16)
KNOWN = range(HEADER, DATA_END + 1)
# Every record begins with what it is and how many bytes follow.
HEAD = struct.Struct("<BQ")
# What comes before the data of a message: channel, sequence, log time, publish time.
MESSAGE_BODY = struct.Struct("<HIQQ")
# Start, end, unfolded size, checksum; then the name of the compression, whose length is the last of these.
CHUNK_BODY = struct.Struct("<QQQII")
# Start, end, offset and length of a chunk, and how many bytes follow that tell where its message indexes are.
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
    """Where a text that begins at ``at`` ends."""
    return at + 4 + int.from_bytes(data[at : at + 4], "little")


def schema_record(number: int, name: str, encoding: str, data: bytes) -> bytes:
    return record(SCHEMA, struct.pack("<H", number) + text(name) + text(encoding) + struct.pack("<I", len(data)) + data)


def number_of(declaration: bytes) -> int:
    """Of a schema's or a channel's record."""
    return int.from_bytes(declaration[HEAD.size : HEAD.size + 2], "little")
