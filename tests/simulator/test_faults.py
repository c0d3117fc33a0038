"""Injected faults: their effects and their removal."""

import base64
import time
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest
from websockets.exceptions import InvalidStatus

from caris_desktop.simulator.faults import Faults, inject
from tests.support.polling import wait_for
from tests.support.simulated_robot import RosbridgeClient, SimulatedRobot

CAMERA = "/camera/image_raw/compressed"


@pytest.fixture(autouse=True)
def healed(robot: SimulatedRobot) -> Iterator[None]:
    yield
    robot.fault("clear")


def picture(message: dict[str, Any]) -> Any:
    return cv2.imdecode(np.frombuffer(base64.b64decode(message["data"]), np.uint8), cv2.IMREAD_COLOR)


@pytest.mark.long
def test_a_black_camera_and_its_recovery(robot: SimulatedRobot, client: RosbridgeClient) -> None:
    client.subscribe(CAMERA, queue_length=1)
    client.wait_for_messages(CAMERA)
    robot.fault("black_camera")
    wait_for(lambda: picture(client.messages(CAMERA)[-1]).max() == 0, "black pictures")
    robot.fault("clear")
    wait_for(lambda: picture(client.messages(CAMERA)[-1]).std() > 20, "pictures of the room")


@pytest.mark.long
def test_a_frozen_camera_repeats_itself_with_new_stamps(robot: SimulatedRobot, client: RosbridgeClient) -> None:
    client.subscribe(CAMERA, queue_length=1)
    client.wait_for_messages(CAMERA)
    robot.fault("freeze_camera")
    frozen_from = len(client.messages(CAMERA)) + 1
    last = client.wait_for_messages(CAMERA, frozen_from + 4)[frozen_from:]
    assert len({message["data"] for message in last}) == 1
    assert len({str(message["header"]["stamp"]) for message in last}) == len(last)


@pytest.mark.parametrize(("fault", "topic"), [("silent_lidar", "/scan"), ("silent_camera", CAMERA)])
def test_a_silent_sensor(robot: SimulatedRobot, client: RosbridgeClient, fault: str, topic: str) -> None:
    client.subscribe(topic, queue_length=1)
    client.wait_for_messages(topic)
    robot.fault(fault)

    def quiet() -> bool:
        before = len(client.messages(topic))
        later = robot.state()["time_s"] + 0.4
        wait_for(lambda: robot.state()["time_s"] > later, "time goes on")
        return len(client.messages(topic)) == before

    wait_for(quiet, f"{topic} is silent")
    robot.fault("clear")
    message_count = len(client.messages(topic))
    client.wait_for_messages(topic, message_count + 2)


def test_latency_delays_both_directions(robot: SimulatedRobot, client: RosbridgeClient) -> None:
    client.call("/rosapi/get_time")
    robot.fault("latency:200")
    start_s = time.monotonic()
    client.call("/rosapi/get_time")
    assert time.monotonic() - start_s >= 0.39
    robot.fault("clear")


def test_a_dropped_link_refuses_for_a_while_and_comes_back(robot: SimulatedRobot, client: RosbridgeClient) -> None:
    robot.fault("drop_link:0.7")
    wait_for(lambda: client.closed, "the client is cut off")
    with pytest.raises(InvalidStatus), RosbridgeClient(robot.address):
        pass

    def state() -> Any:
        try:
            return robot.state()
        except InvalidStatus:
            return None

    wait_for(state, "the robot is back")


@pytest.mark.parametrize("command", ["", "explode", "latency", "latency:-1", "latency:nan", "drop_link:x", "clear:3"])
def test_an_unknown_fault_is_refused_with_a_list(command: str) -> None:
    with pytest.raises(ValueError, match=r"; available: |requires a number"):
        inject(Faults(), command)


def test_faults_add_up_until_they_are_cleared() -> None:
    both = inject(inject(Faults(), "latency:50").faults, "black_camera").faults
    assert both == Faults(latency_s=0.05, camera_black=True)
    assert inject(both, "clear").faults == Faults()
