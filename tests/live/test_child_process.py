"""Child processes: start, messages, end, and detection of their death."""

import os
import queue
import resource
import signal
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import psutil
import pytest

from caris_desktop.domain.events import Marked
from caris_desktop.live.child_process import ChildProcess, ProcessSpec, RingToWrite
from caris_desktop.live.frame_ring import FrameRing
from tests.live import bodies


def _start(
    body: ProcessSpec,
) -> tuple[ChildProcess, "queue.Queue[tuple[Any, bytes]]", "queue.Queue[int | None]"]:
    messages: queue.Queue[tuple[Any, bytes]] = queue.Queue()
    exits: queue.Queue[int | None] = queue.Queue()
    child = ChildProcess(body, on_message=lambda value, raw: messages.put((value, raw)), on_exit=exits.put)
    child.start()
    return child, messages, exits


def test_messages_pass_in_both_directions_and_the_last_ones_arrive() -> None:
    child, messages, exits = _start(ProcessSpec("echo", bodies.echo))
    assert child.send(Marked(1, "hello"))
    value, raw = messages.get(timeout=20)
    assert value == Marked(1, "hello")
    assert child.send_raw(raw)
    assert messages.get(timeout=20)[0] == Marked(1, "hello")
    child.stop(grace_s=10)
    assert messages.get(timeout=1)[0].label == "farewell"
    assert exits.empty(), "an end that was asked for is not an accident"
    assert not child.send(Marked(2, "too late"))


def test_a_child_starts_without_the_log_that_was_deleted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CARIS_LOG_FILE", str(tmp_path / "deleted" / "console.log"))
    child, messages, exits = _start(ProcessSpec("echo", bodies.echo))
    child.send(Marked(1, "hello"))
    assert messages.get(timeout=20)[0] == Marked(1, "hello")
    child.stop(grace_s=10)
    assert exits.empty()


@pytest.mark.logs("ended by itself with exit code")
def test_a_child_that_dies_is_noticed() -> None:
    child, _messages, exits = _start(ProcessSpec("crash", bodies.crash))
    child.send(Marked(1, "die"))
    assert exits.get(timeout=20) == -signal.SIGABRT
    child.stop(grace_s=1)


def test_a_child_that_does_not_read_blocks_nobody_and_is_killed_in_the_end() -> None:
    child, messages, _exits = _start(ProcessSpec("deaf", bodies.deaf))
    pid = messages.get(timeout=20)[0].stamp_ns
    accepted = 0
    while child.send(Marked(0, "x" * 1000)):
        accepted += 1
        assert accepted < 100_000, "an unread pipe must fill up"
    child.stop(grace_s=0.2)
    assert not psutil.pid_exists(pid)


@pytest.fixture
def many_open_files() -> Iterator[None]:
    """Open so many files that the next descriptor is above 1023, the limit of select()."""
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(limits[0], 2048), max(limits[1], 2048)))
    with ExitStack() as files:
        while files.enter_context(Path(os.devnull).open()).fileno() < 1024:
            pass
        yield
    resource.setrlimit(resource.RLIMIT_NOFILE, limits)


@pytest.mark.usefixtures("many_open_files")
def test_a_child_is_spoken_to_however_many_files_are_open() -> None:
    child, messages, _exits = _start(ProcessSpec("echo", bodies.echo))
    assert child.send(Marked(1, "hello"))
    assert messages.get(timeout=20)[0] == Marked(1, "hello")
    child.stop(grace_s=10)


def test_rings_are_attached_in_the_child() -> None:
    ring = FrameRing.create(max_frame_bytes=8 * 6 * 3)
    child, messages, _exits = _start(ProcessSpec("writer", bodies.write_frames, (3, RingToWrite(ring.name))))
    refs = [messages.get(timeout=20)[0] for _ in range(3)]
    for number, ref in enumerate(refs):
        image = ring.read(ref)
        assert image is not None and (image == number).all()
    child.stop(grace_s=5)
    ring.close()


@pytest.mark.logs("ended by itself with exit code")
def test_a_killed_child_is_noticed() -> None:
    child, messages, exits = _start(ProcessSpec("echo", bodies.echo))
    child.send(Marked(1, "up"))
    messages.get(timeout=20)
    assert child.pid is not None
    os.kill(child.pid, signal.SIGKILL)
    assert exits.get(timeout=10) == -signal.SIGKILL
    child.stop(grace_s=1)


@pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="looks where Linux tells of processes")
@pytest.mark.parametrize(("name", "title"), [("inference", "caris: people detection"), ("echo", "caris: echo")])
def test_a_child_is_called_after_what_it_does(name: str, title: str) -> None:
    child, messages, _exits = _start(ProcessSpec(name, bodies.echo))
    child.send(Marked(1, "up"))
    messages.get(timeout=20)
    assert Path(f"/proc/{child.pid}/cmdline").read_bytes().rstrip(b"\0").decode() == title
    child.stop(grace_s=5)


@pytest.mark.skipif(not hasattr(os, "getsid"), reason="sessions of processes are a matter of Unix")
def test_a_child_has_a_session_of_its_own() -> None:
    """The scheduler shares the processor among sessions first, so a child does not reduce the share of the window."""
    child, messages, _exits = _start(ProcessSpec("deaf", bodies.deaf))
    try:
        pid = messages.get(timeout=20)[0].stamp_ns
        assert os.getsid(pid) == child.pid == pid
    finally:
        child.stop(grace_s=0.1)


@pytest.mark.logs("ended by itself with exit code")
@pytest.mark.parametrize("how", ["send_raw", "send_raw_waiting"])
def test_the_connection_is_not_closed_while_a_person_sends(monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    """Otherwise the next opened file would get its number, and then the message."""
    child, messages, exits = _start(ProcessSpec("deaf", bodies.deaf))
    messages.get(timeout=20)
    sending, closed = threading.Event(), threading.Event()
    closed_meanwhile: list[bool] = []
    close, send_bytes = Connection.close, Connection.send_bytes

    def noted_close(connection: Any) -> None:
        close(connection)
        closed.set()

    def slow_send(connection: Any, raw: bytes) -> None:
        sending.set()
        # The child is dead, and its end is being handled.
        closed_meanwhile.append(closed.wait(1.0))
        send_bytes(connection, raw)

    monkeypatch.setattr(Connection, "close", noted_close)
    monkeypatch.setattr(Connection, "send_bytes", slow_send)
    answers: queue.Queue[bool] = queue.Queue()
    sender = threading.Thread(target=lambda: answers.put(getattr(child, how)(b"x")))
    sender.start()
    assert sending.wait(20)
    child.kill()
    assert answers.get(timeout=20) is False
    sender.join()
    assert closed_meanwhile == [False]
    assert exits.get(timeout=20) == -signal.SIGKILL
    assert closed.is_set() and not getattr(child, how)(b"x")
    child.stop(grace_s=1)


def test_a_waiting_sender_is_released_when_the_process_is_gone() -> None:
    child, messages, _ = _start(ProcessSpec("deaf", bodies.deaf))
    messages.get(timeout=20)
    answers: queue.Queue[bool] = queue.Queue()
    sender = threading.Thread(target=lambda: answers.put(child.send_raw_waiting(bytes(8_000_000))))
    sender.start()
    child.stop(grace_s=0.2)
    assert answers.get(timeout=20) is False
    sender.join()
