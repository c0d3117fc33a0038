"""Guarantees of atomic file replacement."""

import errno
import os
import stat
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from caris_desktop.domain.file_replacement import replace_file


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "people.json"
    path.write_bytes(b"old")
    return path


def only_the_old_file_is_there(path: Path) -> bool:
    return [(entry.name, entry.read_bytes()) for entry in path.parent.iterdir()] == [(path.name, b"old")]


def failing(number: int) -> Callable[..., int]:
    def fail(*_: object) -> int:
        raise OSError(number, os.strerror(number))

    return fail


@pytest.mark.parametrize("call", ["write", "fsync", "replace"])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    monkeypatch.setattr(os, call, failing(errno.EIO))
    with pytest.raises(OSError, match="Input/output error"):
        replace_file(path, b"new", durable=True)
    monkeypatch.undo()
    assert only_the_old_file_is_there(path)


def test_content_that_breaks_off_leaves_the_old_file_and_nothing_else(path: Path) -> None:
    def breaking_off() -> Iterator[bytes]:
        yield b"ne"
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        replace_file(path, breaking_off(), durable=False)
    assert only_the_old_file_is_there(path)


def test_parts_follow_one_another(path: Path) -> None:
    replace_file(path, iter([b"ne", b"", b"w"]), durable=False)
    assert path.read_bytes() == b"new"


def test_a_reader_never_finds_a_part_and_two_writers_do_not_mix(path: Path) -> None:
    contents = {b"old", b"a" * 300_000, b"b" * 400_000}

    def write(content: bytes) -> None:
        for _ in range(30):
            replace_file(path, content, durable=False)

    writers = [threading.Thread(target=write, args=(content,)) for content in contents - {b"old"}]
    for writer in writers:
        writer.start()
    found = set()
    while any(writer.is_alive() for writer in writers):
        found.add(path.read_bytes())
    for writer in writers:
        writer.join()
    assert found <= contents
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("mode", [0o600, 0o664])
def test_permissions_stay_as_they_were(path: Path, mode: int) -> None:
    path.chmod(mode)
    replace_file(path, b"new", durable=False)
    assert stat.S_IMODE(path.stat().st_mode) == mode
    assert path.read_bytes() == b"new"


def test_nobody_else_can_read_what_is_being_written_of_a_private_file(path: Path) -> None:
    path.chmod(0o600)
    seen = []

    def looked_at() -> Iterator[bytes]:
        seen.extend(stat.S_IMODE(entry.stat().st_mode) for entry in path.parent.iterdir())
        yield b"new"

    replace_file(path, looked_at(), durable=False)
    assert seen == [0o600, 0o600]


def test_a_new_file_has_the_permissions_of_the_folder(tmp_path: Path) -> None:
    replace_file(tmp_path / "new", b"", durable=False)
    (tmp_path / "usual").touch(mode=0o644)
    assert (tmp_path / "new").stat().st_mode == (tmp_path / "usual").stat().st_mode


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc to tell what is synced")
@pytest.mark.parametrize("durable", [True, False])
def test_content_then_name_are_brought_to_the_disk_where_the_caller_asks(
    path: Path, monkeypatch: pytest.MonkeyPatch, durable: bool
) -> None:
    synced: list[tuple[str, bytes]] = []
    sync = os.fsync

    def noted(descriptor: int) -> None:
        of = Path(f"/proc/self/fd/{descriptor}").readlink()
        synced.append(("the folder" if of.is_dir() else "a file beside it", path.read_bytes()))
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", noted)
    replace_file(path, b"new", durable=durable)
    assert synced == ([("a file beside it", b"old"), ("the folder", b"new")] if durable else [])


def test_a_full_disk_frees_its_reserve_and_the_write_continues(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = os.write
    room = [3]

    def little_room(descriptor: int, data: memoryview) -> int:
        if not room[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        count = write(descriptor, data[: room[0]])
        room[0] -= count
        return count

    def make_room() -> bool:
        room[0] = 4
        return True

    monkeypatch.setattr(os, "write", little_room)
    replace_file(path, b"0123456", durable=False, on_full=make_room)
    assert path.read_bytes() == b"0123456"
    room[0] = 2
    with pytest.raises(OSError, match="No space left"):
        replace_file(path, b"0123456", durable=False, on_full=lambda: False)
    assert [(entry.name, entry.read_bytes()) for entry in path.parent.iterdir()] == [(path.name, b"0123456")]


def test_a_link_is_replaced_and_not_followed(path: Path) -> None:
    link = path.with_name("link")
    link.symlink_to(path)
    replace_file(link, b"new", durable=False)
    assert (path.read_bytes(), link.read_bytes(), link.is_symlink()) == (b"old", b"new", False)


def test_a_name_of_any_length_can_be_replaced(tmp_path: Path) -> None:
    path = tmp_path / ("ü" * 127)
    replace_file(path, b"new", durable=False)
    assert path.read_bytes() == b"new"
