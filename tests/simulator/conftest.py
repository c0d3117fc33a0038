"""Simulated robot in both ROS versions, shared by the tests of a file."""

from collections.abc import Iterator

import pytest

from tests.support.simulated_robot import RosbridgeClient, SimulatedRobot


@pytest.fixture(scope="module")
def robot() -> Iterator[SimulatedRobot]:
    with SimulatedRobot() as running:
        yield running


@pytest.fixture(scope="module")
def robot_ros2() -> Iterator[SimulatedRobot]:
    with SimulatedRobot(ros=2) as running:
        yield running


@pytest.fixture
def client(robot: SimulatedRobot) -> Iterator[RosbridgeClient]:
    with RosbridgeClient(robot.address) as connected:
        yield connected
