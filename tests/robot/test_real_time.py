"""Real-time priority of the control link: with the user's permission, through RealtimeKit, and given up if required."""

import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from jeepney import Message, MessageFlag, MessageType, Parser, new_error, new_method_return

from caris_desktop.robot import transport
from caris_desktop.robot.real_time import LARGE_BYTES
from tests.robot.link_bench import BridgeDouble, LinkProcess
from tests.support.polling import wait_for

pytestmark = [
    pytest.mark.alone,
    pytest.mark.skipif(sys.platform != "linux", reason="the scheduling of Linux"),
]

TRY = """
import json, logging, os, sys, threading, time
from caris_desktop.robot import real_time

take = os.sched_setscheduler
def as_an_ordinary_user(tid, policy, param):
    if policy & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR:
        raise PermissionError(1, "Operation not permitted")
    take(tid, policy, param)

logging.basicConfig(level=logging.INFO, stream=sys.stderr)
if sys.argv[1] == "ordinary":
    os.sched_setscheduler = as_an_ordinary_user
threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
real_time.request_realtime_priority()
for thread in threading.enumerate():
    if thread.name == "real-time":
        thread.join(10)
first = real_time.has_realtime_priority()
for _ in range(30):
    time.sleep(0.002)
    for _ in range(1000): pass
stayed = real_time.has_realtime_priority()
until = time.monotonic() + 20
while real_time.has_realtime_priority() and time.monotonic() < until:
    pass
print(json.dumps({"first": first, "stayed": stayed, "after_long": real_time.has_realtime_priority()}))
"""


def tried(user: str, *, bus: str = "unix:path=/nobody/there") -> tuple[dict[str, bool], str]:
    ended = subprocess.run(
        [sys.executable, "-c", TRY, user],
        env={**os.environ, "DBUS_SYSTEM_BUS_ADDRESS": bus},
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    return json.loads(ended.stdout), ended.stderr


def may_come_first() -> bool:
    """True if this user may use real-time scheduling."""
    asked = "import os; os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))"
    return subprocess.run([sys.executable, "-c", asked], capture_output=True, check=False).returncode == 0


needs_leave = pytest.mark.skipif(not may_come_first(), reason="this user may not have real-time scheduling")


@needs_leave
def test_a_permitted_process_has_priority_until_it_computes_for_long() -> None:
    found, said = tried("privileged")
    assert found == {"first": True, "stayed": True, "after_long": False}
    assert "other programs have their turn again" in said


def test_without_leave_and_without_realtime_kit_it_waits_for_its_turn() -> None:
    found, said = tried("ordinary")
    assert found == {"first": False, "stayed": False, "after_long": False}
    assert "Traceback" not in said


@needs_leave
def test_realtime_kit_gives_it_to_who_has_no_leave(kit: "RealtimeKitDouble") -> None:
    found, said = tried("ordinary", bus=kit.address)
    assert found == {"first": True, "stayed": True, "after_long": False}, said
    assert len(kit.asked) == 2, "both threads"
    assert {priority for _tid, priority in kit.asked} == {1}
    assert "other programs have their turn again" in said


def test_a_refusal_of_realtime_kit_changes_nothing(kit: "RealtimeKitDouble") -> None:
    kit.refuses = True
    found, said = tried("ordinary", bus=kit.address)
    assert not any(found.values())
    assert kit.asked
    assert "Traceback" not in said


@needs_leave
def test_the_control_link_comes_first_until_a_message_comes_that_takes_long_to_read() -> None:
    bridge = BridgeDouble()
    link = LinkProcess(bridge.address)
    try:
        link.wait_for_state("connected")
        assert os.SCHED_RR in scheduled(link.process.pid)
        bridge.publish("/odom", {"data": "x" * LARGE_BYTES})
        wait_for(lambda: scheduled(link.process.pid) == {os.SCHED_OTHER}, "that it waits for its turn again")
        assert link.process.is_alive()
    finally:
        link.close()
        bridge.kill()


def test_no_message_that_a_robot_sends_all_the_time_is_as_large() -> None:
    assert 10 * 40_000 < LARGE_BYTES < transport.CONTROL_SIZES.message_bytes


def scheduled(pid: int | None) -> set[int]:
    """Scheduling policies of the threads of a process."""
    return {os.sched_getscheduler(int(thread.name)) for thread in Path(f"/proc/{pid}/task").iterdir()}


@pytest.fixture
def kit(tmp_path: Path) -> Iterator["RealtimeKitDouble"]:
    double = RealtimeKitDouble(tmp_path / "bus")
    yield double
    double.close()


class RealtimeKitDouble:
    """System bus with RealtimeKit, which refuses callers without their own resource limit, as the real one does."""

    def __init__(self, path: Path) -> None:
        self.address = f"unix:path={path}"
        self.asked: list[tuple[int, int]] = []
        self.refuses = False
        self._server = socket.socket(socket.AF_UNIX)
        self._server.bind(str(path))
        self._server.listen()
        threading.Thread(target=self._serve, daemon=True).start()

    def close(self) -> None:
        self._server.close()

    def _serve(self) -> None:
        client, _ = self._server.accept()
        said = b""
        while b"BEGIN\r\n" not in said:
            if said.endswith(b"\r\n") and b"AUTH" in said:
                client.sendall(b"OK 1234\r\n")
                said = b""
            said += client.recv(4096)
        parser, number = Parser(), 0
        # The first message may come in the same packet as the greeting.
        content = said.partition(b"BEGIN\r\n")[2] or client.recv(4096)
        while content:
            for message in parser.feed(content):
                number += 1
                if not message.header.flags & MessageFlag.no_reply_expected:
                    client.sendall(self._answer(message).serialise(serial=number))
            content = client.recv(4096)

    def _answer(self, message: Message) -> Message:
        assert message.header.message_type is MessageType.method_call
        if "Hello" in message.header.fields.values():
            return new_method_return(message, "s", (":1.1",))
        tid, priority = message.body
        self.asked.append((tid, priority))
        limits = Path(f"/proc/{tid}/limits").read_text()
        limited = next(line.split()[-2] for line in limits.splitlines() if "realtime timeout" in line)
        if self.refuses or limited == "unlimited" or int(limited) > 200_000:
            return new_error(message, "org.freedesktop.DBus.Error.AccessDenied", "s", ("Operation not permitted",))
        os.sched_setscheduler(tid, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
        return new_method_return(message)
