"""MCAP files chunk by chunk: of other writers, with junk in between, and with wrong chunk headers."""

import io
import struct
from pathlib import Path

import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.session import events_file
from caris_desktop.recording.session.events_file import BlockIndex, DamagedBlockError, rewrite

COUNT = 60


def written(*, finish: bool = True, **options: object) -> bytes:
    """Two alternating channels; the second is declared in the last chunk."""
    file = io.BytesIO()
    writer = Writer(file, chunk_size=400, **options)  # type: ignore[arg-type]
    writer.start()
    writer.add_metadata("session", {"scenario": "Tour"})
    writer.add_attachment(5, 6, "nöte.txt", "text/plain", b"hello")
    schema = writer.register_schema("x", "jsonschema", b"{}")
    channel = writer.register_channel("/a", "json", schema)
    for number in range(COUNT):
        if number == COUNT - 5:
            channel = writer.register_channel("/b", "json", schema)
        writer.add_message(channel, 1000 + number, f'{{"number": {number}, "pad": "{"x" * 40}"}}'.encode(), number)
    if finish:
        writer.finish()
    return file.getvalue()


def read(path: Path) -> tuple[BlockIndex, list[int]]:
    index = events_file.read_index(path)
    times: list[int] = []
    with path.open("rb") as file:
        for number in range(index.count):
            content = events_file.read_block(file, index, number)
            times += [message.log_ns for message in events_file.messages_of(content)]
    return index, times


@pytest.mark.parametrize("finish", [True, False])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": CompressionType.NONE},
        {"use_chunking": False},
        {"index_types": IndexType.NONE},
        {"use_statistics": False, "use_summary_offsets": False},
    ],
)
def test_files_of_any_make_are_read_and_rewritten(tmp_path: Path, options: dict[str, object], finish: bool) -> None:
    path = tmp_path / "events.mcap"
    path.write_bytes(written(finish=finish, **options))
    index, times = read(path)
    assert len(times) > COUNT - 12
    assert times == [1000 + number for number in range(len(times))]
    assert {channel.topic for channel in index.channels.values()} >= {"/a"}

    seen: list[bytes] = []
    target = DiskFile(tmp_path / "again.mcap")
    with path.open("rb") as file:
        rewrite(file, events_file.scan(file), target, lambda content: seen.append(content) or content)
    target.close()
    assert len(seen) > 0
    with target.path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert [message.log_time for _, _, message in reader.iter_messages()] == times
        assert [record.metadata for record in reader.iter_metadata()] == [{"scenario": "Tour"}]
        assert [(record.name, record.data) for record in reader.iter_attachments()] == [("nöte.txt", b"hello")]
    rewritten, times_again = read(target.path)
    assert rewritten.has_summary
    assert times_again == times


def test_junk_between_chunks_is_passed_over(tmp_path: Path) -> None:
    content = written(finish=False)
    path = tmp_path / "events.mcap"
    path.write_bytes(content)
    index, times = read(path)
    at = int(index.offsets[index.count // 2])
    path.write_bytes(content[:at] + b"\x07" * 333 + content[at:])
    damaged, found = read(path)
    assert found == times
    assert damaged.damaged_bytes == 333


@pytest.mark.logs("index of .* is damaged")
@pytest.mark.parametrize("thorough", [True, False])
def test_a_chunk_that_is_there_twice_is_read_once(tmp_path: Path, *, thorough: bool) -> None:
    content = written()
    path = tmp_path / "events.mcap"
    path.write_bytes(content)
    before = events_file.read_index(path)
    at, length = int(before.offsets[2]), int(before.offsets[3] - before.offsets[2])
    path.write_bytes(content[: at + length] + content[at : at + length] + content[at + length :])
    with path.open("rb") as file:
        index = events_file.scan(file, thorough=thorough)
    assert index.count == before.count and not index.damaged_bytes
    assert len(read(path)[1]) == COUNT


def test_messages_whose_channel_was_lost_are_left_out_of_a_rewritten_file(tmp_path: Path) -> None:
    content = bytearray(written(finish=False))
    path = tmp_path / "events.mcap"
    path.write_bytes(content)
    index, _ = read(path)
    first = int(index.offsets[0])
    content[first + 60 : first + 90] = bytes(30)
    path.write_bytes(content)
    target = DiskFile(tmp_path / "again.mcap")
    with path.open("rb") as file:
        rewrite(file, events_file.scan(file), target, lambda content: content)
    target.close()
    with target.path.open("rb") as file:
        topics = {channel.topic for _, channel, _ in make_reader(file, validate_crcs=True).iter_messages()}
    assert topics <= {"/b"}


@pytest.mark.parametrize(
    ("claimed_bytes", "folded", "compression"),
    [
        (10, zstandard.compress(bytes(50_000_000)), b"zstd"),
        (2**40, zstandard.compress(b"x"), b"zstd"),
        (5, zstandard.compress(b"abcd"), b"zstd"),
        (4, b"no zstd", b"zstd"),
        (4, b"abcd", b"own"),
        (4, b"abcd", b""),
    ],
)
def test_a_chunk_that_lies_about_itself_is_damaged(claimed_bytes: int, folded: bytes, compression: bytes) -> None:
    body = struct.pack("<QQQII", 1, 2, claimed_bytes, 12345, len(compression)) + compression
    body += struct.pack("<Q", len(folded)) + folded
    with pytest.raises(DamagedBlockError):
        events_file.decompress(struct.pack("<BQ", 6, len(body)) + body)
