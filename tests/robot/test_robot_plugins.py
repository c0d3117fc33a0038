"""Robot plug-ins: their server on loopback, their process below a link, and what ends when one of them ends.

The robot of these tests writes what it gets to a file; ``test_native_ros2`` uses the real rclpy.
"""

import array
import asyncio
import base64
import json
import math
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from caris_desktop.domain.link_commands import StopMotion
from caris_desktop.live.confirmed_files import profile_references
from caris_desktop.robot import bridge_server, ros2_robot
from caris_desktop.robot.bridge_process import BridgeProcess
from caris_desktop.robot.bridge_security import LinkError
from caris_desktop.robot.bridge_server import LAPSE_S, BridgeServer
from caris_desktop.robot.profile import load_profile, parse_profile, profile_file
from caris_desktop.robot.profile_model import ProfileError, check_address
from caris_desktop.ros.rosbridge import decode_cbor, decode_json
from caris_desktop.ui.robot_dialog import names_plugin
from tests.robot.link_bench import LinkProcess
from tests.support.native_robot import bridges_below, wait_for_bridge
from tests.support.plugins import install
from tests.support.polling import wait_for

TWIST = "geometry_msgs/msg/Twist"

WRITER = """
import json, threading, time

class Plugin:
    caris_interface = 1

    def __init__(self, target):
        self._file = open(target, "a", buffering=1)
        self._lock = threading.Lock()

    def _write(self, **line):
        with self._lock:
            self._file.write(json.dumps({"at_s": time.monotonic(), **line}) + "\\n")

    def interfaces(self):
        return {
            "topics": {"/cmd_vel": "geometry_msgs/msg/Twist", "/odom": "nav_msgs/msg/Odometry"},
            "services": {"/slow": "std_srvs/srv/Trigger", "/stop": "std_srvs/srv/SetBool"},
            "actions": {"/go": "test_msgs/action/Fibonacci"},
        }

    def subscribe(self, topic, type_name, deliver, queue_length):
        self._write(subscribed=topic)
        return lambda: self._write(unsubscribed=topic)

    def publish(self, topic, type_name, message, *, latch):
        if message is not None:
            forward_mps = message.get("linear", {}).get("x", 0.0)
            turn_radps = message.get("angular", {}).get("z", 0.0)
            self._write(topic=topic, moves=bool(forward_mps or turn_radps))

    def call(self, service, request, timeout_s):
        if service == "/slow":
            time.sleep(5.0)
        return {"success": True, "message": ""}

    def run_goal(self, action, type_name, goal, feedback, cancelled):
        if action != "/go":
            raise LookupError("the robot refused the goal")
        self._write(goal="begun")
        while not cancelled.wait(0.02):
            feedback({"sequence": [1]})
        self._write(goal="cancelled")
        return 5, {"sequence": []}

    def close(self):
        self._write(closed=True)
"""


class Log:
    """What the robot of these tests got."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def lines(self) -> list[dict[str, Any]]:
        text = self.path.read_text("utf-8") if self.path.exists() else ""
        return [json.loads(line) for line in text.splitlines()]

    def velocities(self) -> list[dict[str, Any]]:
        return [line for line in self.lines() if line.get("topic") == "/cmd_vel"]

    def stands(self) -> bool:
        return bool(self.velocities()) and not self.velocities()[-1]["moves"]

    def moves(self) -> bool:
        return bool(self.velocities()) and bool(self.velocities()[-1]["moves"])

    def goals(self) -> list[str]:
        return [line["goal"] for line in self.lines() if "goal" in line]


# The server


@pytest.fixture
def log(tmp_path: Path) -> Log:
    return Log(tmp_path / "robot.jsonl")


@pytest.fixture
def server(log: Log) -> Iterator[str]:
    """Address of a server with the robot above."""
    names: dict[str, Any] = {}
    exec(WRITER, names)  # noqa: S102 - the text above
    listener = socket.create_server(("127.0.0.1", 0))
    ready = threading.Event()
    running = BridgeServer(names["Plugin"](str(log.path)), listener, "secret", lambda _line: ready.set())
    running.start()
    assert ready.wait(5.0)
    yield f"ws://127.0.0.1:{listener.getsockname()[1]}/secret"
    running.close()
    listener.close()


def send(client: ClientConnection, **operation: Any) -> None:
    client.send(json.dumps(operation))


def answer(client: ClientConnection, op: str) -> dict[str, Any]:
    """Next operation of this kind."""
    while True:
        received = json.loads(client.recv(timeout=10.0))
        if received["op"] == op:
            return dict(received)


def drive(client: ClientConnection, forward_mps: float) -> None:
    send(client, op="publish", topic="/cmd_vel", msg={"linear": {"x": forward_mps}})


@pytest.mark.parametrize("path", ["", "/", "/Secret", "/secret/x"])
def test_only_the_link_gets_in(server: str, path: str) -> None:
    with pytest.raises(InvalidStatus, match="403"), connect(server.removesuffix("/secret") + path):
        pass


def test_a_velocity_that_is_not_renewed_is_followed_by_zero(server: str, log: Log) -> None:
    with connect(server) as client:
        send(client, op="advertise", topic="/cmd_vel", type=TWIST)
        for _ in range(10):
            drive(client, 0.2)
            time.sleep(LAPSE_S / 4)
        assert all(line["moves"] for line in log.velocities())
        wait_for(log.stands, "zero")
        moving, zero = (
            max(line["at_s"] for line in log.velocities() if line["moves"]),
            min(line["at_s"] for line in log.velocities() if not line["moves"]),
        )
        assert zero - moving >= LAPSE_S * 0.9
        drive(client, 0.2)
        wait_for(log.moves, "another drive")


def test_zero_needs_no_renewal(server: str, log: Log) -> None:
    with connect(server) as client:
        send(client, op="advertise", topic="/cmd_vel", type=TWIST)
        drive(client, 0.0)
        time.sleep(2.0 * LAPSE_S)
        assert len(log.velocities()) == 1, "navigation is not disturbed"


def test_the_end_of_a_connection_stops_what_it_set_in_motion(server: str, log: Log) -> None:
    with connect(server) as other, connect(server) as client:
        send(client, op="advertise", topic="/cmd_vel", type=TWIST)
        send(client, op="send_action_goal", id="1", action="/go", action_type="test_msgs/action/Fibonacci", args={})
        wait_for(lambda: log.goals() == ["begun"], "the goal")
        drive(client, 0.2)
        wait_for(log.moves, "a drive")
        client.socket.shutdown(socket.SHUT_RDWR)
        wait_for(log.stands, "zero")
        wait_for(lambda: log.goals() == ["begun", "cancelled"], "the goal is cancelled")
        send(other, op="call_service", id="2", service="/stop", args={"data": True})
        assert answer(other, "service_response")["result"] is True


def test_nothing_slow_keeps_a_velocity_or_a_stop_waiting(server: str, log: Log) -> None:
    with connect(server) as client:
        send(client, op="advertise", topic="/cmd_vel", type=TWIST)
        send(client, op="call_service", id="slow", service="/slow", args={})
        send(client, op="send_action_goal", id="go", action="/go", action_type="test_msgs/action/Fibonacci", args={})
        drive(client, 0.2)
        drive(client, 0.0)
        send(client, op="call_service", id="stop", service="/stop", args={"data": True})
        assert answer(client, "service_response")["id"] == "stop"
        assert log.stands()
        send(client, op="cancel_action_goal", id="go", action="/go")
        result = answer(client, "action_result")
        assert (result["id"], result["status"], result["result"]) == ("go", 5, False)


def test_a_refused_goal_and_an_unknown_service_are_answered(server: str) -> None:
    with connect(server) as client:
        send(client, op="send_action_goal", id="1", action="/no", action_type="test_msgs/action/Fibonacci", args={})
        refused = answer(client, "action_result")
        assert refused["result"] is False and refused["values"] == "the robot refused the goal"
        send(client, op="call_service", id="2", service="/caris_desktop/no_such_service")
        assert answer(client, "service_response")["result"] is False
        send(client, op="call_service", id="3", service="/rosapi/topics")
        assert "/cmd_vel" in answer(client, "service_response")["values"]["topics"]
        send(client, op="nonsense")
        assert answer(client, "status")["level"] == "error"


def test_the_proof_comes_behind_the_commands(server: str, log: Log) -> None:
    with connect(server) as client:
        send(client, op="advertise", topic="/cmd_vel", type=TWIST)
        for number in range(5):
            drive(client, 0.2)
            send(client, op="publish", topic="/caris_desktop/handled", msg={"data": str(number)})
            assert answer(client, "publish")["msg"]["data"] == str(number)
            assert len(log.velocities()) == number + 1


def test_a_frame_that_is_not_allowed_ends_the_connection(server: str) -> None:
    with connect(server) as client:
        client.socket.sendall(b"\x81\x02{}")  # unmasked
        with pytest.raises(ConnectionClosed):
            client.recv(timeout=5.0)


def test_messages_arrive_as_from_rosbridge() -> None:
    ranges = array.array("f", [1.0, math.inf, 2.5])
    message = {
        "op": "publish", "text": "ä", "yes": True, "none": None, "numbers": [1, -300, 2**40, 0.5],
        "ranges": ranges, "cells": array.array("b", [-1, 100]), "data": array.array("B", b"jpeg"),
        "raw": b"\x01\x02", "fixed": np.arange(3, dtype=np.float64), "long": np.arange(3, dtype=np.int64),
    }  # fmt: skip
    binary = decode_cbor(bridge_server._cbor(message))
    assert binary["ranges"].dtype == np.float32 and np.array_equal(binary["ranges"], np.array(ranges))
    assert binary["cells"].tolist() == [-1, 100] and binary["long"].tolist() == [0, 1, 2]
    assert binary["data"] == b"jpeg" and binary["raw"] == b"\x01\x02"
    text = decode_json(bridge_server._json(message).decode())
    assert text["ranges"] == [1.0, None, 2.5] and base64.b64decode(text["data"]) == b"jpeg"
    for same in ("text", "yes", "none", "numbers"):
        assert binary[same] == text[same] == message[same]


# The process below a link


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    install(tmp_path / "packages", "robots", "writer", WRITER, monkeypatch)
    return tmp_path / "packages"


@pytest.fixture
def link(packages: Path, log: Log) -> Iterator[LinkProcess]:
    link = LinkProcess(f"writer:{log.path}", "simulated-ros2")
    link.wait_for_state("connected", timeout_s=30.0)
    yield link
    link.close()


def test_a_killed_link_leaves_a_robot_that_stands(link: LinkProcess, log: Log) -> None:
    link.drive_until(log.moves, "a drive", turn_radps=0.3)
    (bridge,) = bridges_below(link.process.pid)
    link.process.kill()
    wait_for(log.stands, "zero")
    wait_for(lambda: not Path(f"/proc/{bridge}").exists(), "the process of the plug-in ends")
    assert log.lines()[-1].get("closed")


def test_a_link_that_hangs_stops_driving(link: LinkProcess, log: Log) -> None:
    link.drive_until(log.moves, "a drive", turn_radps=0.3)
    os.kill(link.process.pid, signal.SIGSTOP)
    wait_for(log.stands, "zero")
    os.kill(link.process.pid, signal.SIGCONT)


def test_a_killed_plug_in_is_started_again_and_gets_zero_first(link: LinkProcess, log: Log) -> None:
    link.drive_until(log.moves, "a drive", turn_radps=0.3)
    killed = wait_for_bridge(link.process.pid)
    before = len(link.states())
    count = len(log.velocities())
    os.kill(killed, signal.SIGKILL)
    link.wait_for_state("lost", after=before)
    link.wait_for_state("connected", after=before, timeout_s=30.0)
    wait_for(lambda: len(log.velocities()) > count, "a command")
    assert log.stands() and wait_for_bridge(link.process.pid) != killed


def test_a_plug_in_that_hangs_ends_driving_by_the_rules_of_the_link(link: LinkProcess, log: Log) -> None:
    link.drive_until(log.moves, "a drive", turn_radps=0.3)
    bridge = wait_for_bridge(link.process.pid)
    before, count = len(link.states()), len(log.velocities())
    os.kill(bridge, signal.SIGSTOP)
    link.send(StopMotion(time.monotonic_ns()))
    link.wait_for_state("lost", after=before)
    os.kill(bridge, signal.SIGCONT)
    link.wait_for_state("connected", after=before, timeout_s=30.0)
    wait_for(log.stands, "zero")
    assert sum(line["moves"] for line in log.velocities()[count:]) <= 4


# Plug-ins that cannot be used


async def first_url(address: str) -> str:
    bridge = BridgeProcess(address)
    try:
        return await bridge.url()
    finally:
        await bridge.close()


@pytest.mark.parametrize(
    ("name", "source", "reason"),
    [
        ("later", WRITER.replace("caris_interface = 1", "caris_interface = 2"), "version 2 of the interface"),
        ("broken", "import nothing_of_this_name", "No module named"),
        ("deadly", "import os\nos._exit(3)", "its process ended with code 3"),
        ("failing", WRITER.replace("self._lock = threading.Lock()", "raise ValueError('no battery')"), "no battery"),
        (
            "worded",
            WRITER.replace("self._lock = threading.Lock()", "raise OSError('It sleeps.', 'Wake it.')"),
            "sleeps",
        ),
    ],
)
def test_a_plug_in_that_cannot_be_used_is_named(
    name: str, source: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path / "packages", "robots", name, source, monkeypatch)
    with pytest.raises(LinkError) as refused:
        asyncio.run(first_url(f"{name}:{tmp_path / 'log'}"))
    assert reason in refused.value.what
    assert (name in refused.value.what) is not (name == "worded")
    assert refused.value.advice


def test_ros2_says_what_it_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CARIS_ROS2_PYTHON", "/nonexistent/python")
    with pytest.raises(LinkError, match="CARIS_ROS2_PYTHON names /nonexistent/python"):
        asyncio.run(first_url("ros2:"))
    monkeypatch.delenv("CARIS_ROS2_PYTHON")
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    with pytest.raises(LinkError, match=r"No ROS 2 was found") as refused:
        asyncio.run(first_url("ros2:"))
    assert "packaging/ros2.sh" in refused.value.advice


def test_addresses_of_plug_ins() -> None:
    profile = load_profile("ros2:5")
    assert (profile.address, profile.ros) == ("ros2:5", 2) and profile_file("ros2:") is None
    with pytest.raises(ProfileError, match="it is not installed; installed are ros2"):
        check_address("roz2:5")
    with pytest.raises(ProfileError):
        check_address("ws:9090")
    text = 'version: 1\nros: 2\naddress: "ros2:"\nvelocity: {topic: /cmd_vel}\n'
    assert parse_profile(text, file_name="lab.yaml", name="lab").address == "ros2:"


def test_a_file_that_names_a_plug_in_asks_first(packages: Path) -> None:
    def named(address: str) -> set[tuple[str, str]]:
        profile = replace(load_profile("generic-ros2"), address=address)
        return {(one.kind, one.text) for one in profile_references(profile)}

    assert ("address", "ros2:5") in named("ros2:5") and not any(kind == "plugin" for kind, _ in named("ros2:5"))
    assert ("plugin", "writer (lab-writer 2.1)") in named("writer:/tmp/log")


@pytest.mark.parametrize(
    ("address", "of_plugin"),
    [("ros2:", True), ("ros2:5", True), ("robot:9090", False), ("dot:left", True), ("pi", False)],
)
def test_the_dialog_tells_plug_ins_from_hosts(address: str, of_plugin: bool) -> None:
    assert names_plugin(address) is of_plugin


def test_an_older_python_reads_what_runs_in_it() -> None:
    import ast

    for name in ("bridge_server.py", "ros2_robot.py"):
        source = Path(bridge_server.__file__).with_name(name).read_text("utf-8")
        ast.parse(source, feature_version=(3, 10))
        imported = {node.module or "" for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ImportFrom)}
        assert not [module for module in imported if module.startswith("caris_desktop")]


@pytest.mark.parametrize(
    "name", ["lab_tricks/msg/Pose", "lab_tricks/Pose", "../lab_tricks/msg/Pose", "lab_tricks.msg/Pose"]
)
def test_a_type_name_imports_no_module_but_generated_messages(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file, or whoever joins the ROS 2 domain, chooses the name."""
    for package, generated in (("lab_tricks", False), ("lab_msgs", True)):
        (tmp_path / package / "msg").mkdir(parents=True)
        (tmp_path / package / "__init__.py").touch()
        (tmp_path / package / "msg" / "__init__.py").write_text("class Pose: pass", "utf-8")
        if generated:
            (tmp_path / package / f"{package}_s__rosidl_typesupport_c.so").touch()
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(LookupError, match="is not installed in this ROS 2"):
        ros2_robot._type(name)
    assert "lab_tricks" not in sys.modules
    assert ros2_robot._type("lab_msgs/msg/Pose").__name__ == "Pose"
    assert ros2_robot._type("lab_msgs/Pose").__name__ == "Pose"
