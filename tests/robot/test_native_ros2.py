"""ROS 2 without rosbridge, against a robot on the real rclpy; ``test_random_stops`` stops it at random moments."""

import asyncio
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.link_commands import OfferControls, Release, SetEmergencyStop, StopMotion, UseControl
from caris_desktop.domain.sensing import LaserScan, Odometry
from caris_desktop.robot.discovery import ExploreError, check_streams, explore_robot
from caris_desktop.robot.link import check_robot
from caris_desktop.robot.profile import save_profile
from caris_desktop.robot.profile_proposal import profile_of
from tests.robot.link_bench import LinkProcess
from tests.support.native_robot import NativeRobot, bridges_below, needs_rclpy, wait_for_bridge
from tests.support.polling import wait_for

pytestmark = [pytest.mark.alone, needs_rclpy]


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[NativeRobot]:
    robot = NativeRobot(tmp_path_factory.mktemp("robot"))
    yield robot
    robot.close()


@pytest.fixture
def link(robot: NativeRobot, tmp_path: Path) -> Iterator[LinkProcess]:
    save_profile(robot.profile(), tmp_path / "native.yaml")
    link = LinkProcess(robot.address, str(tmp_path / "native.yaml"))
    link.wait_for_state("connected", timeout_s=60.0)
    wait_for(lambda: link.of(Odometry), "odometry")
    link.send(OfferControls(now_ns(), robot.profile().controls, driving_permitted=True))
    yield link
    link.close()


def velocities(robot: NativeRobot) -> list[dict[str, Any]]:
    return [line for line in robot.lines() if "velocity" in line]


def moves(robot: NativeRobot) -> bool:
    return bool(velocities(robot)) and any(velocities(robot)[-1]["velocity"])


def drive(link: LinkProcess, robot: NativeRobot) -> None:
    link.drive_until(lambda: moves(robot), "a drive", turn_radps=0.3)


def test_exploring_proposes_the_profile_that_fits(robot: NativeRobot) -> None:
    found = asyncio.run(explore_robot(robot.address, timeout_s=60.0))
    profile = profile_of(found.offer, found.proposal.chosen, name="found", title="Found", address=robot.address)
    assert (profile.ros, profile.velocity.topic, profile.velocity.type) == (2, "/cmd_vel", "Twist")
    assert profile.scan is not None and profile.scan.topic == "/scan"
    assert profile.odometry is not None and profile.odometry.topic == "/odom"
    assert profile.map is not None and profile.map.topic == "/map"
    assert profile.emergency_stop is not None and profile.emergency_stop.service == "/e_stop"
    assert found.offer.actions["/spin"] == "test_msgs/action/Fibonacci"


def test_best_effort_and_lasting_topics_are_received_and_the_profile_checked(robot: NativeRobot) -> None:
    checks = {check.field: check for check in asyncio.run(check_streams(robot.profile(), seconds=4.0))}
    for field in ("velocity", "scan", "odometry", "map", "emergency_stop.service", "controls.goal"):
        # A busy machine receives a stream at less than its rate.
        assert checks[field].state in ("good", "slow"), checks[field]
    assert checks["controls.never"].state == "nothing"
    assert "/robot" in checks["velocity"].detail


def test_another_domain_has_no_robot(robot: NativeRobot) -> None:
    other = f"ros2:{robot.domain + 101}"
    with pytest.raises(ExploreError, match=f"No robot was found in ROS 2 domain {robot.domain + 101}") as refused:
        asyncio.run(explore_robot(other, timeout_s=60.0))
    assert "ROS_DOMAIN_ID" in str(refused.value.advice)


def test_two_domains_are_kept_apart(robot: NativeRobot, link: LinkProcess, tmp_path: Path) -> None:
    other = NativeRobot(tmp_path, domain=robot.domain + 101)
    try:
        save_profile(other.profile(), tmp_path / "other.yaml")
        second = LinkProcess(other.address, str(tmp_path / "other.yaml"))
        second.wait_for_state("connected", timeout_s=60.0)
        before = len(velocities(robot))
        second.drive_until(lambda: moves(other), "a drive", turn_radps=0.3)
        assert not any(any(line["velocity"]) for line in velocities(robot)[before:])
        second.close()
    finally:
        other.close()


def test_streams_arrive_and_driving_is_prompt(robot: NativeRobot, link: LinkProcess) -> None:
    scan = wait_for(lambda: link.of(LaserScan), "a scan")[-1]
    assert len(scan.ranges_m) == 360
    drive(link, robot)
    count = len(velocities(robot))
    released_ns = time.monotonic_ns()
    link.send(Release(now_ns()))
    wait_for(lambda: len(velocities(robot)) > count and not moves(robot), "zero")
    zero_ms = (velocities(robot)[-1]["at_ns"] - released_ns) / 1e6
    print(f"release to zero: {zero_ms:.0f} ms")


@pytest.mark.parametrize("ending", ["stop", "emergency stop", "killed", "no link"])
def test_a_goal_ends_with(ending: str, robot: NativeRobot, link: LinkProcess) -> None:
    link.send(UseControl(now_ns(), "1", "goal", True))
    wait_for(lambda: robot.goals == 1, "the goal runs")
    if ending == "stop":
        link.send(StopMotion(now_ns()))
    elif ending == "emergency stop":
        link.send(SetEmergencyStop(now_ns(), latched=True))
        wait_for(lambda: any(line.get("stop") for line in robot.lines()), "the robot's own stop")
    elif ending == "killed":
        link.process.kill()
    else:
        link.disappear()
    wait_for(lambda: robot.goals == 0, "the goal is cancelled")


def test_a_slow_service_holds_nothing_back(robot: NativeRobot, link: LinkProcess) -> None:
    link.send(UseControl(now_ns(), "1", "slow", True))
    drive(link, robot)
    began_s = time.monotonic()
    link.send(StopMotion(now_ns()))
    wait_for(lambda: not moves(robot), "zero")
    assert time.monotonic() - began_s < 5.0, "the service takes ten seconds"


def test_a_killed_link_and_a_killed_bridge_leave_a_robot_that_stands(robot: NativeRobot, link: LinkProcess) -> None:
    drive(link, robot)
    os.kill(wait_for_bridge(link.process.pid), signal.SIGKILL)
    before = len(link.states())
    link.wait_for_state("connected", after=before, timeout_s=60.0)
    wait_for(lambda: not moves(robot), "zero from the next bridge")
    drive(link, robot)
    bridges = bridges_below(link.process.pid)
    link.process.kill()
    wait_for(lambda: not moves(robot), "zero from the bridge of the killed link")
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in bridges), "no process is left")


def test_a_robot_that_stops_answering_ends_driving(robot: NativeRobot, link: LinkProcess) -> None:
    """Commands that no DDS reader acknowledges are not handled, as with a network that is gone."""
    drive(link, robot)
    before = len(link.states())
    os.kill(robot.pid, signal.SIGSTOP)
    try:
        link.hold(lambda: "lost" in link.states()[before:], "the link is lost", timeout_s=20.0)
    finally:
        os.kill(robot.pid, signal.SIGCONT)
    link.wait_for_state("connected", after=before, timeout_s=60.0)
    wait_for(lambda: not moves(robot), "zero")


def test_a_profile_that_does_not_fit_is_reported(robot: NativeRobot) -> None:
    (missing,) = check_robot(robot.profile(), robot.address)
    assert "Never" in missing
