"""Readers of ROS message containers: ROS 1 bags, rosbag2 and MCAP, complete or truncated.

Files are read sequentially and never written; decompressed sizes are limited in advance. Formats:
https://wiki.ros.org/Bags/Format/2.0, https://mcap.dev/spec, https://github.com/ros2/rosbag2.

Long because it reads three containers, each within its limits.
"""

import bz2
import heapq
import io
import logging
import re
import shutil
import sqlite3
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import field, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import IO, Any, NamedTuple
from urllib.parse import quote

from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.domain.yaml_files import parse_yaml
from caris_desktop.recording.session.manifest import digest_of
from caris_desktop.recording.session.session_header import is_session

_log = logging.getLogger(__name__)
MAX_MESSAGE_BYTES = 128 * 1024 * 1024
_MAX_CHUNK_BYTES = 256 * 1024 * 1024
_MAX_HEADER_BYTES = 1024 * 1024
_MAX_METADATA_BYTES = 16 * 1024 * 1024
_MAX_UNFOLDED_FILE_BYTES = 1 << 38
_ROS1_MAGIC, _MCAP_MAGIC, _SQLITE_MAGIC, _ZSTD_MAGIC = (
    b"#ROSBAG V2.0\n",
    b"\x89MCAP0\r\n",
    b"SQLite format 3\x00",
    b"\x28\xb5\x2f\xfd",
)
# Writers store messages nearly in order; sorting looks this far back.
REORDER_NS, _REORDER_BYTES = 1_000_000_000, 64 * 1024 * 1024


class BagError(Exception):
    """Unusable bag, with the reason as user text."""


class BagChannel(Value):
    """One topic with one message type. ``type`` is spelled ``package/msg/Name``; ``encoding``: ros1, cdr, json...

    ``definition`` is the type's text in the file, in the format ``definition_form``: ros1msg, ros2msg, ros2idl or as
    the file says; empty if the file has none.
    """

    topic: str
    type: str
    encoding: str
    definition: str = ""
    definition_form: str = ""


class BagMessage(NamedTuple):
    """One message. ``at_ns`` is its recording time by the bag's clock; ``fraction`` of the bag is read so far."""

    at_ns: int
    channel: BagChannel
    data: bytes
    fraction: float


@dataclass(slots=True)
class ReadNotes:
    """Reader's remarks on the file: unique sentences."""

    sentences: list[str] = field(default_factory=list)

    def add(self, sentence: str) -> None:
        if sentence not in self.sentences:
            self.sentences.append(sentence)


class Bag(Value):
    """Bag to be read. ``kind`` is for display; ``messages`` gives all messages in file order, and raises BagError and
    OSError.
    """

    kind: str
    messages: Callable[[ReadNotes], Iterator[BagMessage]]


def is_probably_bag(path: Path) -> bool:
    """True if ``path`` begins like a file that :func:`open_bag` reads."""
    try:
        if path.is_dir():
            return not is_session(path) and bool(_storage_files(path))
        with path.open("rb") as file:
            return file.read(16).startswith((_ROS1_MAGIC, _MCAP_MAGIC, _SQLITE_MAGIC))
    except OSError:
        return False


def open_bag(path: Path, *, scratch: Path) -> Bag:
    """Open the bag at ``path``. ``scratch`` is a folder for decompressing whole files.

    Raises BagError if it is none that can be read.
    """
    try:
        if path.is_dir():
            return _open_folder(path, scratch)
        size_bytes = path.stat().st_size
        with path.open("rb") as file:
            start = file.read(16)
    except FileNotFoundError as error:
        raise BagError(f"{path} does not exist.") from error
    except OSError as error:
        raise BagError(f"{path} cannot be read: {error.strerror or error}.") from error
    if not size_bytes:
        raise BagError(f"{path} is empty: it contains no recording.")
    if start.startswith(_ROS1_MAGIC):
        return Bag("ROS 1 bag", partial(_ros1_messages, path))
    if start.startswith(_MCAP_MAGIC):
        return Bag("MCAP file", partial(_mcap_messages, path))
    if start.startswith(_SQLITE_MAGIC):
        return Bag("rosbag2 database", partial(_sqlite_messages, path))
    if start.startswith(b"#ROSBAG V1"):
        raise BagError(f"{path} is a bag in an old format. Update it with 'rosbag fix', then import it.")
    if start.startswith(_ZSTD_MAGIC):
        raise BagError(
            f"{path} is a single compressed file of a rosbag2. Import the folder that contains metadata.yaml."
        )
    raise BagError(f"{path} is not a ROS 1 bag, an MCAP file or a rosbag2 database.")


def in_order_of_time(messages: Iterable[BagMessage]) -> Iterator[BagMessage]:
    """Sort messages that are up to a second out of order, in bounded memory."""
    waiting: list[tuple[int, int, BagMessage]] = []
    newest_ns, waiting_bytes = 0, 0
    for number, message in enumerate(messages):
        heapq.heappush(waiting, (message.at_ns, number, message))
        newest_ns = max(newest_ns, message.at_ns)
        waiting_bytes += len(message.data)
        while waiting and (waiting[0][0] <= newest_ns - REORDER_NS or waiting_bytes > _REORDER_BYTES):
            _, _, oldest = heapq.heappop(waiting)
            waiting_bytes -= len(oldest.data)
            yield oldest
    yield from (message for _, _, message in sorted(waiting))


def sorted_by_time(messages: Iterable[BagMessage], scratch: Path) -> Iterator[BagMessage]:
    """Sort messages through a file in ``scratch``, for bags that were written topic by topic. Raises BagError."""
    channels: dict[BagChannel, int] = {}
    try:
        with closing(sqlite3.connect(scratch / "sorted.db")) as database:
            database.execute("PRAGMA journal_mode = OFF")
            database.execute("PRAGMA synchronous = OFF")
            database.execute("CREATE TABLE messages (at_ns INTEGER, channel INTEGER, data BLOB, fraction REAL)")
            rows = (
                (message.at_ns, channels.setdefault(message.channel, len(channels)), message.data, message.fraction)
                for message in messages
            )
            database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
            # Sorting by the index keeps the data in the file.
            database.execute("CREATE INDEX by_time ON messages (at_ns)")
            known = list(channels)
            for at_ns, number, data, fraction in database.execute(
                "SELECT * FROM messages INDEXED BY by_time ORDER BY at_ns, rowid"
            ):
                yield BagMessage(at_ns, known[number], data, fraction)
    except sqlite3.Error as error:
        raise BagError(f"The messages could not be sorted by time in {scratch.parent}: {error}.") from error


def type_spelling(name: str) -> str:
    """Canonical type name, such as ``sensor_msgs/msg/LaserScan``."""
    parts = [part for part in name.replace("::", "/").split("/") if part not in ("", "msg")]
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else name


# ROS 1


_MESSAGE, _HEADER, _CHUNK, _CONNECTION = 2, 3, 5, 7


def _ros1_messages(path: Path, notes: ReadNotes) -> Iterator[BagMessage]:
    """Messages of a ROS 1 bag, format 2.0. Read sequentially, so that truncated and unclosed bags work."""
    size_bytes = path.stat().st_size
    channels: dict[int, BagChannel] = {}
    with path.open("rb") as file:
        file.seek(len(_ROS1_MAGIC))
        while True:
            at = file.tell()
            try:
                record = _ros1_record(file, kinds=(_HEADER, _CHUNK, _CONNECTION, _MESSAGE))
            except _CutError as error:
                notes.add(f"The bag is truncated or damaged at byte {at} ({error}); the data before that was read.")
                return
            if record is None:
                return
            try:
                yield from _ros1_messages_in(file, record, channels, notes, min(1.0, file.tell() / size_bytes))
            except (_CutError, _TooLargeError) as error:
                notes.add(f"The part of the bag at byte {at} is damaged ({error}); the rest of it was skipped.")


def _ros1_messages_in(
    file: IO[bytes],
    record: tuple[dict[str, bytes], bytes, bool],
    channels: dict[int, BagChannel],
    notes: ReadNotes,
    fraction: float,
) -> Iterator[BagMessage]:
    fields, data, is_whole = record
    kind = fields["op"][0]
    if kind == _HEADER:
        if not _read_connections(file, fields, channels):
            notes.add("The bag was never closed properly; it was read without its index.")
    elif kind == _CONNECTION:
        _connect(fields, data, channels)
    elif kind == _MESSAGE:
        channel = channels.get(_u32(fields.get("conn", b"")))
        time = fields.get("time", b"")
        if channel is None or len(time) != 8:
            raise _CutError("a message without a topic")
        seconds, nanoseconds = struct.unpack("<LL", time)
        yield BagMessage(seconds * 1_000_000_000 + nanoseconds, channel, data, fraction)
    elif kind == _CHUNK:
        compressed = fields.get("compression", b"none") != b"none"
        if not is_whole:
            notes.add("The bag is truncated; everything before that point was read.")
            if compressed:
                return
        if compressed:
            data = _unfolded(data, fields["compression"].decode("ascii", "replace"), _u32(fields.get("size", b"")))
        chunk = io.BytesIO(data)
        while (inner := _ros1_record(chunk, kinds=(_CONNECTION, _MESSAGE))) is not None:
            yield from _ros1_messages_in(chunk, inner, channels, notes, fraction)


def _read_connections(file: IO[bytes], header: dict[str, bytes], channels: dict[int, BagChannel]) -> bool:
    """Read the topic list at the end, since earlier connection records may be damaged. False without a list."""
    index_at = int.from_bytes(header.get("index_pos", b"")[:8], "little")
    before, listed = file.tell(), False
    if not before <= index_at < 2**62:
        return False
    try:
        file.seek(index_at)
        while (record := _ros1_record(file, kinds=(_CONNECTION,))) is not None:
            if record[0]["op"][0] != _CONNECTION:
                break
            _connect(record[0], record[1], channels)
            listed = True
    except _CutError:
        _log.debug("a bag without a list of topics", exc_info=True)
        return False
    finally:
        file.seek(before)
    return listed


def _ros1_record(file: IO[bytes], *, kinds: tuple[int, ...]) -> tuple[dict[str, bytes], bytes, bool] | None:
    """Next record, and whether it is complete; the data of unwanted ones is skipped.

    Only chunks may be truncated: they may still hold whole messages.
    """
    head = file.read(4)
    if not head:
        return None
    size_bytes = _u32(head)
    if size_bytes > _MAX_HEADER_BYTES:
        raise _CutError(f"a record of {size_bytes} bytes")
    header = file.read(size_bytes)
    if len(header) != size_bytes:
        raise _CutError("the end is missing")
    fields = _ros1_fields(header)
    if len(fields.get("op", b"")) != 1:
        raise _CutError("a record without a type")
    length, kind = _u32(file.read(4)), fields["op"][0]
    if kind not in kinds:
        file.seek(length, io.SEEK_CUR)
        return fields, b"", True
    if length > _MAX_CHUNK_BYTES:
        raise _CutError(f"a record of {length} bytes")
    data = file.read(length)
    if kind != _CHUNK and len(data) != length:
        raise _CutError("the end is missing")
    return fields, data, len(data) == length


def _connect(fields: dict[str, bytes], data: bytes, channels: dict[int, BagChannel]) -> None:
    connection = _ros1_fields(data)
    channels[_u32(fields.get("conn", b""))] = BagChannel(
        topic=_topic(fields.get("topic", b"").decode("utf-8", "replace")),
        type=type_spelling(connection.get("type", b"").decode("utf-8", "replace")),
        encoding="ros1",
        definition=connection.get("message_definition", b"").decode("utf-8", "replace"),
        definition_form="ros1msg",
    )


def _ros1_fields(content: bytes) -> dict[str, bytes]:
    fields, at = {}, 0
    while at < len(content):
        length = _u32(content[at : at + 4])
        name, equals, value = content[at + 4 : at + 4 + length].partition(b"=")
        if not equals or at + 4 + length > len(content):
            raise _CutError("an unreadable field")
        fields[name.decode("utf-8", "replace")] = value
        at += 4 + length
    return fields


# MCAP


def _mcap_messages(path: Path, notes: ReadNotes) -> Iterator[BagMessage]:
    """Messages of an MCAP file with ROS messages. Read without its index, so that truncated files work."""
    from mcap.records import Channel, Chunk, Header, Message, Schema
    from mcap.stream_reader import StreamReader

    size_bytes = path.stat().st_size
    schemas, channels = _listed_channels(path)
    with path.open("rb") as file:
        reader = StreamReader(file, emit_chunks=True, record_size_limit=min(size_bytes, _MAX_CHUNK_BYTES))
        records = iter(reader.records)
        while True:
            at = file.tell()
            try:
                record = next(records)
            except StopIteration:
                return
            except Exception as error:
                # Truncated or damaged bytes raise many kinds of errors (struct, overflow, memory, mcap's own).
                _log.info("%s breaks off at byte %d (%r)", path, at, error)
                notes.add(f"The file is truncated or damaged at byte {at}{_why(error)}; the data before that was read.")
                return
            try:
                inner = _records_of_chunk(record) if isinstance(record, Chunk) else [record]
            except Exception as error:
                _log.info("%s: the chunk at byte %d is left out (%r)", path, at, error)
                notes.add(f"The part of the file at byte {at} is damaged{_why(error)}; it was skipped.")
                continue
            fraction = min(1.0, file.tell() / size_bytes)
            for item in inner:
                if isinstance(item, Header) and item.library.startswith("caris-desktop") and not item.profile:
                    raise BagError(f"{path} belongs to a CARIS Desktop session. Open the session folder instead.")
                if isinstance(item, Schema):
                    schemas[item.id] = item
                elif isinstance(item, Channel):
                    channels[item.id] = _mcap_channel(item, schemas.get(item.schema_id))
                elif isinstance(item, Message) and item.channel_id in channels:
                    yield BagMessage(item.log_time, channels[item.channel_id], item.data, fraction)


def _listed_channels(path: Path) -> tuple[dict[int, Any], dict[int, BagChannel]]:
    """Topics of the summary section, since earlier channel records may be damaged."""
    from mcap.reader import make_reader

    try:
        with path.open("rb") as file:
            summary = make_reader(file, record_size_limit=_MAX_CHUNK_BYTES).get_summary()
    except Exception:
        # As above: many kinds of errors, and many files have no summary.
        _log.debug("%s has no list of topics", path, exc_info=True)
        return {}, {}
    schemas = {} if summary is None else dict(summary.schemas)
    listed = {} if summary is None else summary.channels
    return schemas, {key: _mcap_channel(item, schemas.get(item.schema_id)) for key, item in listed.items()}


def _mcap_channel(channel: Any, schema: Any) -> BagChannel:
    return BagChannel(
        topic=_topic(channel.topic),
        type=type_spelling(schema.name if schema is not None else ""),
        encoding=channel.message_encoding,
        definition=schema.data.decode("utf-8", "replace") if schema is not None else "",
        definition_form=schema.encoding if schema is not None else "",
    )


def _records_of_chunk(chunk: Any) -> list[Any]:
    from mcap.stream_reader import breakup_chunk

    content = _unfolded(chunk.data, chunk.compression, chunk.uncompressed_size)
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise _CutError("its checksum is invalid")
    records: list[Any] = breakup_chunk(replace(chunk, compression="", data=content))
    return records


# rosbag2


def _sqlite_messages(path: Path, notes: ReadNotes) -> Iterator[BagMessage]:
    """Messages of the SQLite database of a rosbag2."""
    wal = path.with_name(f"{path.name}-wal")
    if wal.exists() and wal.stat().st_size:
        notes.add(f"{path.name} was not closed properly; data that is only in {wal.name} was skipped.")
    # Immutable: SQLite must not create files next to the bag.
    address = f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1"
    try:
        with closing(sqlite3.connect(address, uri=True)) as database:
            yield from _rows(path, database, notes)
    except sqlite3.Error as error:
        _log.info("%s", path, exc_info=True)
        notes.add(f"{path.name} is damaged ({error}); only the readable part was read.")


def _rows(path: Path, database: sqlite3.Connection, notes: ReadNotes) -> Iterator[BagMessage]:
    computed = "SELECT name FROM sqlite_master WHERE rootpage = 0 AND type IN ('table', 'view')"
    if found := database.execute(computed).fetchone():
        # Its rows could be without end.
        raise sqlite3.DatabaseError(f"{found[0]} is a view")
    definitions: dict[str, tuple[str, str]] = {}
    try:
        rows = database.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        ).fetchall()
        definitions = {str(row[0]): (str(row[1]), str(row[2])) for row in rows}
    except sqlite3.OperationalError:
        _log.debug("%s is of a version that carries no message definitions", path)
    channels = {}
    for number, topic, type_name, encoding in database.execute(
        "SELECT id, name, type, serialization_format FROM topics"
    ):
        # SQLite holds whatever was written, whatever type a column is declared with.
        form, text = definitions.get(str(type_name), ("", ""))
        channels[number] = BagChannel(_topic(str(topic)), type_spelling(str(type_name)), str(encoding), text, form)
    (count,) = database.execute("SELECT count(*) FROM messages").fetchone()
    # As they were written: times go back where the clock was set.
    query = "SELECT topic_id, timestamp, CASE WHEN length(data) <= ? THEN data END FROM messages ORDER BY id"
    for number, row in enumerate(database.execute(query, (MAX_MESSAGE_BYTES,)), start=1):
        topic_id, at_ns, data = row
        channel = channels.get(topic_id)
        if channel is None:
            continue
        if not isinstance(data, bytes):
            notes.add(f"A message of {channel.topic} is far too large; it was skipped.")
            continue
        if not isinstance(at_ns, int):
            notes.add(f"A message of {channel.topic} has no time; it was skipped.")
            continue
        yield BagMessage(at_ns, channel, data, number / max(1, count))


def _folder_messages(parts: list[Bag], folder_notes: ReadNotes, notes: ReadNotes) -> Iterator[BagMessage]:
    """Messages of the files of a rosbag2 folder in sequence, also if each message is compressed separately."""
    for sentence in folder_notes.sentences:
        notes.add(sentence)
    for number, part in enumerate(parts):
        for message in part.messages(notes):
            # By their first bytes: metadata.yaml is missing where the recording was not closed.
            folded = message.channel.encoding == "cdr" and message.data.startswith(_ZSTD_MAGIC)
            try:
                data = _unfolded(message.data, "zstd", None) if folded else message.data
            except ValueError as error:
                notes.add(f"A message of {message.channel.topic} was skipped: {error}.")
            else:
                yield message._replace(data=data, fraction=(number + message.fraction) / len(parts))


def _open_folder(folder: Path, scratch: Path) -> Bag:
    if is_session(folder):
        raise BagError(f"{folder} is already a session. Open it directly.")
    notes = ReadNotes()
    metadata = _metadata(folder / "metadata.yaml")
    if metadata is None:
        files = _without_copies(_storage_files(folder), notes)
        if files:
            notes.add("The folder has no metadata.yaml: the recording was not closed properly.")
    else:
        # Only the names: a path could lead out of the folder.
        paths = metadata.get("relative_file_paths") or ()
        names = list(dict.fromkeys(PurePosixPath(str(path)).name for path in paths))
        files = [folder / name for name in names if (folder / name).is_file()]
        mode = str(metadata.get("compression_mode") or "").lower()
        missing = [name for name in names if not (folder / name).is_file()]
        if missing:
            notes.add(f"Files listed in metadata.yaml are missing: {', '.join(missing)}.")
        if unlisted := [path.name for path in _storage_files(folder) if path not in files]:
            notes.add(f"Files that metadata.yaml does not list were not read: {', '.join(unlisted)}.")
        if mode not in ("", "none") and str(metadata.get("compression_format")) != "zstd":
            raise BagError(
                f"{folder} uses the compression {metadata.get('compression_format')}, which is not supported."
            )
    if not files:
        raise BagError(f"{folder} is not a rosbag2: it contains no .mcap or .db3 file.")
    parts: list[Bag] = []
    for path in files:
        unfolded = _unfold_file(path, scratch) if path.suffix == ".zstd" else path
        with unfolded.open("rb") as file:
            start = file.read(16)
        if start.startswith(_MCAP_MAGIC):
            parts.append(Bag("MCAP file", partial(_mcap_messages, unfolded)))
        elif start.startswith(_SQLITE_MAGIC):
            parts.append(Bag("rosbag2 database", partial(_sqlite_messages, unfolded)))
        elif not start:
            notes.add(f"{path.name} is empty.")
        else:
            raise BagError(f"{path} is neither an MCAP file nor a rosbag2 database.")
    return Bag("ROS 2 bag", partial(_folder_messages, parts, notes))


def _metadata(path: Path) -> dict[str, Any] | None:
    try:
        if not path.stat().st_size:
            return None  # as after a power failure
        if path.stat().st_size > _MAX_METADATA_BYTES:
            raise BagError(f"{path} is far too large for bag metadata.")
        document = parse_yaml(path.read_text(encoding="utf-8"), finite=False).data
        information = document["rosbag2_bagfile_information"]
        if not isinstance(information, dict):
            raise TypeError("no description of a bag")  # noqa: TRY301 - reported with the others
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BagError(f"{path} does not contain bag metadata ({type(error).__name__}).") from error
    return information


def _storage_files(folder: Path) -> list[Path]:
    """Storage files of a folder in numeric order."""
    found = [path for path in folder.iterdir() if re.search(r"\.(mcap|db3)(\.zstd)?$", path.name) and path.is_file()]
    return sorted(
        found, key=lambda path: [int(part) if part.isdigit() else 0 for part in re.split(r"(\d+)", path.name)]
    )


def _without_copies(files: list[Path], notes: ReadNotes) -> list[Path]:
    """Files without those that would give the same messages again: equal ones, and compressed ones beside the other."""
    kept: list[Path] = []
    for path in files:
        size_bytes = path.stat().st_size
        equal = [one for one in kept if one.stat().st_size == size_bytes and digest_of(one) == digest_of(path)]
        if size_bytes and (equal or (path.suffix == ".zstd" and path.with_suffix("") in files)):
            notes.add(f"{path.name} contains the same as another file; it was not read.")
        else:
            kept.append(path)
    return kept


def _unfold_file(path: Path, scratch: Path) -> Path:
    import zstandard

    target = scratch / path.stem
    room = min(_MAX_UNFOLDED_FILE_BYTES, shutil.disk_usage(scratch).free // 2)
    written = 0
    try:
        with path.open("rb") as file, target.open("wb") as out:
            unfolding = zstandard.ZstdDecompressor(max_window_size=_MAX_CHUNK_BYTES).stream_reader(file)
            while block := unfolding.read(1 << 20):
                written += len(block)
                if written > room:
                    raise BagError(f"{path} is too large to decompress on this disk.")
                out.write(block)
    except zstandard.ZstdError as error:
        raise BagError(f"{path} cannot be decompressed: {error}.") from error
    return target


# Bytes


class _CutError(ValueError):
    """Missing or invalid bytes."""


class _TooLargeError(ValueError):
    """Part that exceeds the limit for decompressed data."""


def _why(error: Exception) -> str:
    limited = isinstance(error, _TooLargeError) or type(error).__name__ == "RecordLengthLimitExceeded"
    return ": a part of it is far too large" if limited else ""


def _unfolded(data: bytes, compression: str, size_bytes: int | None) -> bytes:
    """Decompress ``data`` to ``size_bytes``. Raises ValueError for any other result."""
    import zstandard

    most = MAX_MESSAGE_BYTES if size_bytes is None else size_bytes
    if most > _MAX_CHUNK_BYTES:
        raise _TooLargeError(f"a part of {size_bytes} bytes, which is far too large")
    try:
        if compression == "":
            content = data
        elif compression == "zstd":
            # Not by the size that the frame claims: that much would be allocated at once.
            unfolding = zstandard.ZstdDecompressor(max_window_size=_MAX_CHUNK_BYTES).stream_reader(io.BytesIO(data))
            content = unfolding.read(most + 1)
        elif compression == "lz4":
            import lz4.frame

            content = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most + 1)
        elif compression == "bz2":
            content = bz2.BZ2Decompressor().decompress(data, max_length=most + 1)
        else:
            raise _CutError(f"an unknown compression {compression!r}")
    except (zstandard.ZstdError, OSError, EOFError, RuntimeError) as error:
        raise _CutError(f"it cannot be decompressed: {error}") from error
    if len(content) > most:
        raise _TooLargeError("a part that is larger than its declared size")
    if size_bytes is not None and len(content) != size_bytes:
        raise _CutError("a part that is smaller than its declared size")
    return content


def _u32(content: bytes) -> int:
    if len(content) != 4:
        raise _CutError("the end is missing")
    return int.from_bytes(content, "little")


def _topic(name: str) -> str:
    return "/" + "/".join(part for part in name.split("/") if part)
