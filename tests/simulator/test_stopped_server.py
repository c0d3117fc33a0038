"""A stopped simulated robot executes the commands in its socket on waking, as the real rosbridge does."""

import json
import os
import signal
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.polling import wait_for
from tests.support.simulated_robot import RosbridgeClient, SimulatedRobot


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("obeyed") / "obeyed.jsonl"


@pytest.fixture(scope="module")
def robot(log: Path) -> Iterator[SimulatedRobot]:
    with SimulatedRobot("--empty", "--obeyed-log", str(log)) as robot:
        yield robot


def turns(log: Path) -> list[float]:
    lines = [json.loads(line) for line in log.read_text("utf-8").splitlines()]
    return [line["message"]["angular"]["z"] for line in lines if line.get("topic") == "/cmd_vel"]


def test_a_connected_client_is_obeyed_to_the_last_message(robot: SimulatedRobot, log: Path) -> None:
    before = len(turns(log))
    with RosbridgeClient(robot.address) as client:
        client.subscribe("/odom")
        client.wait_for_messages("/odom")
        os.kill(robot.pid, signal.SIGSTOP)
        for turn in (0.3, 0.2, 0.1, 0.0):
            client.drive(0.0, turn)
        os.kill(robot.pid, signal.SIGCONT)
        wait_for(lambda: turns(log)[before:] == [0.3, 0.2, 0.1, 0.0], "everything in its order")


@pytest.mark.parametrize("attempt", range(5))
def test_a_client_that_left_is_obeyed_but_perhaps_not_to_the_end(
    robot: SimulatedRobot, log: Path, attempt: int
) -> None:
    before = len(turns(log))
    with RosbridgeClient(robot.address) as client:
        client.subscribe("/odom")
        # Stopped during its work, it writes before it reads when it continues.
        client.wait_for_messages("/odom", 2 + attempt)
        os.kill(robot.pid, signal.SIGSTOP)
        for turn in (0.3, 0.2, 0.1, 0.0):
            client.drive(0.0, turn)
        client._socket.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        client._socket.socket.shutdown(socket.SHUT_RD)
        client._socket.close_socket()
        os.kill(robot.pid, signal.SIGCONT)
        wait_for(lambda: len(turns(log)) > before, "some of it")
    robot.state()
    obeyed = turns(log)[before:]
    assert obeyed == [0.3, 0.2, 0.1, 0.0][: len(obeyed)]
