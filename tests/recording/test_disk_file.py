"""Files of a running session, without a really full disk (which is tested with the recorder)."""

import errno
import os
from pathlib import Path

import pytest

from caris_desktop.recording.disk_file import DiskFile, Reserve


def held_back(path: Path) -> DiskFile:
    """A body on disk, with a changed header and an index that are pending until the commit."""
    file = DiskFile(path)
    file.write(b"front body")
    file.hold_back()
    file.seek(0)
    file.write(b"FRONT")
    file.seek(0, os.SEEK_END)
    file.write(b" index")
    return file


def test_delayed_writes_change_the_front_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = held_back(tmp_path / "f")
    assert (tmp_path / "f").read_bytes() == b"front body"
    seen_at_sync: list[bytes] = []
    monkeypatch.setattr(os, "fdatasync", lambda _descriptor: seen_at_sync.append((tmp_path / "f").read_bytes()))
    file.commit()
    assert seen_at_sync == [b"front body index"]
    assert (tmp_path / "f").read_bytes() == b"FRONT body index"
    file.close()


def test_an_index_that_finds_no_room_leaves_the_file_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = held_back(tmp_path / "f")
    write = os.write

    def write_three_bytes(descriptor: int, data: memoryview) -> int:
        if os.lseek(descriptor, 0, os.SEEK_CUR) >= 13:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(descriptor, data[:3])

    monkeypatch.setattr(os, "write", write_three_bytes)
    with pytest.raises(OSError, match="No space left"):
        file.commit()
    assert (tmp_path / "f").read_bytes() == b"front body"
    file.close()


def test_a_write_continues_where_it_stopped_once_there_is_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reserve = Reserve(tmp_path, 4096)
    assert not any(tmp_path.iterdir())
    file = DiskFile(tmp_path / "f", on_full=reserve.release)
    write = os.write

    def write_while_there_is_room(descriptor: int, data: memoryview) -> int:
        if reserve.held_bytes and os.lseek(descriptor, 0, os.SEEK_CUR) >= 4:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(descriptor, data[:4])

    monkeypatch.setattr(os, "write", write_while_there_is_room)
    file.write(b"a whole record")
    assert (tmp_path / "f").read_bytes() == b"a whole record"
    assert not reserve.held_bytes
    assert not reserve.release()
    file.close()


def test_a_reserve_is_given_back_step_by_step(tmp_path: Path) -> None:
    reserve = Reserve(tmp_path, 10_000, steps=4)
    left = []
    while reserve.release_step():
        left.append(reserve.left_bytes)
    assert left == [7500, 5000, 2500, 0]
    assert not reserve.release() and not reserve.held_bytes


def test_steps_keep_what_the_end_needs(tmp_path: Path) -> None:
    reserve = Reserve(tmp_path, 10_000, steps=2, kept_bytes=4000)
    held = []
    while reserve.release_step():
        held.append(reserve.held_bytes)
    assert held == [7000, 4000] and not reserve.left_bytes
    assert reserve.release(down_to_bytes=1000) and not reserve.release_step() and reserve.held_bytes == 1000
    assert reserve.release() and not reserve.held_bytes


def test_a_partial_write_on_a_full_disk_is_undone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = DiskFile(tmp_path / "f")
    file.write(b"whole. ")
    write, full = os.write, [True]

    def write_until_it_is_full(descriptor: int, data: memoryview) -> int:
        if full[0] and os.lseek(descriptor, 0, os.SEEK_CUR) >= 10:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(descriptor, data[:3])

    monkeypatch.setattr(os, "write", write_until_it_is_full)
    with pytest.raises(OSError, match="No space left"):
        file.write(b"a half record")
    assert (tmp_path / "f").read_bytes() == b"whole. "
    full[0] = False
    file.write(b"another")
    assert (tmp_path / "f").read_bytes() == b"whole. another"
    file.close()


def test_a_file_can_be_patched_and_extended_while_it_grows(tmp_path: Path) -> None:
    file = DiskFile(tmp_path / "f")
    file.write(b"head body")
    file.patch(0, b"HEAD")
    file.end_at(12)
    file.write(b"tail")
    assert (tmp_path / "f").read_bytes() == b"HEAD body\0\0\0tail"
    assert file.sync()
    assert not file.sync()
    file.write(b"!")
    assert file.sync()
    file.close()
    assert not file.sync()


def test_an_existing_file_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "f").write_bytes(b"precious")
    with pytest.raises(FileExistsError):
        DiskFile(tmp_path / "f")
