"""Written MCAP files, read by the ``mcap`` package with every checksum, by index and sequentially."""

import errno
import hashlib
from pathlib import Path

import pytest
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message, Statistics
from mcap.stream_reader import StreamReader

from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.session.events_file import McapFile

TOPICS = ("/a", "/b/ü", "/c")


def write(path: Path, messages: int, *, finish: bool = True) -> None:
    """Messages in chunks of seven, with unordered times; ``/c`` has no message."""
    file = DiskFile(path)
    writer = McapFile(file)
    writer.add_metadata("session", {"who": "tëst", "empty": ""})
    schema = writer.add_schema("thing", b"{}")
    channels = [writer.add_channel(topic, schema) for topic in TOPICS]
    for number in range(messages):
        log_time = 1_000_000 + number * 10 + (5 if number % 2 else -5)
        data = b'{"n":%d}' % number
        writer.add_message(channels[number % 2], data, log_time=log_time, publish_time=number, sequence=number)
        if number % 7 == 6:
            writer.flush()
            writer.flush()
    if finish:
        writer.finish()
    file.close()


def test_another_reader_finds_everything_by_the_index(tmp_path: Path) -> None:
    write(tmp_path / "f.mcap", 100)
    with (tmp_path / "f.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = list(reader.iter_messages())
        assert [message.log_time for _, _, message in found] == sorted(message.log_time for _, _, message in found)
        assert sorted(message.publish_time for _, _, message in found) == list(range(100))
        assert {channel.topic for _, channel, _ in found} == {"/a", "/b/ü"}
        assert all(message.data == b'{"n":%d}' % message.sequence for _, _, message in found)
        some = [message.sequence for _, _, message in reader.iter_messages(topics=["/a"], starting_at=1_000_500)]
        assert some == [number for number in range(100) if number % 2 == 0 and number * 10 - 5 >= 500]
        assert [(entry.name, entry.metadata) for entry in reader.iter_metadata()] == [
            ("session", {"who": "tëst", "empty": ""})
        ]
        summary = reader.get_summary()
        assert summary is not None
        statistics = summary.statistics
        assert isinstance(statistics, Statistics)
        assert (statistics.message_count, statistics.chunk_count, statistics.channel_count) == (100, 15, 3)
        assert (statistics.message_start_time, statistics.message_end_time) == (999_995, 1_000_995)
        assert statistics.channel_message_counts == {1: 50, 2: 50}
        assert sorted(channel.topic for channel in summary.channels.values()) == sorted(TOPICS)


def test_another_reader_finds_everything_record_by_record(tmp_path: Path) -> None:
    write(tmp_path / "f.mcap", 100)
    with (tmp_path / "f.mcap").open("rb") as file:
        names = [type(record).__name__ for record in StreamReader(file, emit_chunks=False, validate_crcs=True).records]
    assert names.count("Message") == 100
    assert names[0] == "Header"
    assert names[-1] == "Footer"


def test_without_its_end_every_flushed_message_is_there(tmp_path: Path) -> None:
    write(tmp_path / "f.mcap", 100, finish=False)
    found = []
    with (tmp_path / "f.mcap").open("rb") as file, pytest.raises(EndOfFile):
        for record in StreamReader(file, validate_crcs=True).records:
            if isinstance(record, Message):
                found.append(record.sequence)
    assert found == list(range(98))


@pytest.mark.parametrize("messages", [0, 1])
def test_a_file_with_hardly_anything_in_it_is_complete(tmp_path: Path, messages: int) -> None:
    write(tmp_path / "f.mcap", messages)
    with (tmp_path / "f.mcap").open("rb") as file:
        assert len(list(make_reader(file, validate_crcs=True).iter_messages())) == messages


def test_large_messages_do_not_wait_for_a_flush(tmp_path: Path) -> None:
    file = DiskFile(tmp_path / "f.mcap")
    writer = McapFile(file)
    channel = writer.add_channel("/map", writer.add_schema("map", b"{}"))
    before = file.size_bytes
    for number in range(5):
        data = bytes(number for _ in range(1_500_000))
        writer.add_message(channel, data, log_time=1, publish_time=1, sequence=number)
    assert file.size_bytes > before
    writer.finish()
    file.close()
    with (tmp_path / "f.mcap").open("rb") as read:
        found = [message for _, _, message in make_reader(read, validate_crcs=True).iter_messages()]
    assert [len(message.data) for message in found] == [1_500_000] * 5


class NarrowDisk(DiskFile):
    """Accepts only ``room_bytes``."""

    room_bytes = 10_000_000

    def write(self, data: bytes) -> int:
        if self.size_bytes + len(data) > self.room_bytes:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data)


def test_data_refused_by_a_full_disk_is_written_once_it_has_room(tmp_path: Path) -> None:
    file = NarrowDisk(tmp_path / "f.mcap")
    writer = McapFile(file)
    channel = writer.add_channel("/a", writer.add_schema("thing", b"{}"))
    added = []
    for number in range(60):
        file.room_bytes = file.size_bytes if 20 <= number < 40 else NarrowDisk.room_bytes
        try:
            noise = hashlib.shake_128(b"%d" % number).digest(90_000)
            writer.add_message(channel, noise, log_time=number, publish_time=number, sequence=number)
            added.append(number)
        except OSError:
            pass  # the present chunk reaches its maximum size
    assert set(range(20)) | set(range(41, 60)) <= set(added) and len(added) < 60
    file.room_bytes = file.size_bytes
    with pytest.raises(OSError, match="No space left"):
        writer.finish()
    whole = file.size_bytes
    file.room_bytes = NarrowDisk.room_bytes
    writer.finish()
    file.close()
    assert whole < file.size_bytes
    with (tmp_path / "f.mcap").open("rb") as read:
        reader = make_reader(read, validate_crcs=True)
        assert [message.sequence for _, _, message in reader.iter_messages()] == added
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        assert summary.statistics.message_count == len(added)
