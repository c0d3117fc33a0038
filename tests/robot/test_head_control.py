"""Head control: commands to the robot, and its reported position."""

import pytest

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import HeadMoved, Problem
from caris_desktop.domain.link_commands import MoveHead, SetEmergencyStop
from caris_desktop.domain.sensing import HeadState
from caris_desktop.robot.profile_model import HeadInterface, RobotProfile
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ros.message_conversion import (
    decode_joint_angles_with_speed,
    decode_joint_trajectory,
    encode_joint_state,
)
from tests.robot.loop_bench import LoopBench, with_link

TRAJECTORY = HeadInterface(
    "joint_trajectory",
    "/head_controller/command",
    "head_1_joint",
    "head_2_joint",
    pan_range_rad=(-1.0, 1.0),
    tilt_range_rad=(-0.5, 0.5),
    speed_radps=0.5,
    tilt_sign=-1,
)
NAOQI = HeadInterface("joint_angles", "/joint_angles", "HeadYaw", "HeadPitch", speed_radps=0.8)


def robot(head: HeadInterface | None, ros: int = 1) -> RobotProfile:
    return RobotProfile("test", "Test", ros=ros, head=head)  # type: ignore[arg-type]


@pytest.mark.parametrize("dialect", list(Dialect))
def test_it_turns_within_its_range_and_no_faster_than_it_may(dialect: Dialect) -> None:
    async def test(bench: LoopBench) -> None:
        state = encode_joint_state(dialect, {"wheel": 7.0, "head_1_joint": 0.5, "head_2_joint": 0.1}, stamp_ns=9)
        await bench.bridge.publish("/joint_states", {**state, "position": state["position"].tolist()})
        told = (await bench.until(lambda: bench.of(HeadState), "the head's state"))[0]
        assert (told.robot_stamp_ns, told.pan_rad, told.tilt_rad) == (9, 0.5, pytest.approx(-0.1))
        bench.send(MoveHead(now_ns(), 3.0, 0.2))
        sent = await bench.until(lambda: bench.bridge.published(TRAJECTORY.topic), "a trajectory")
        positions, duration_s = decode_joint_trajectory(sent[0])
        assert positions == pytest.approx({"head_1_joint": 1.0, "head_2_joint": -0.2})
        assert duration_s == pytest.approx(1.0)
        assert [(moved.pan_rad, moved.tilt_rad) for moved in bench.of(HeadMoved)] == [(1.0, 0.2)]

    with_link(robot(TRAJECTORY, dialect.value), test)


def test_of_many_commands_the_newest_is_sent() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(*(MoveHead(now_ns(), 0.01 * step, 0.0) for step in range(50)))
        moved = await bench.until(
            lambda: [move for move in bench.of(HeadMoved) if move.pan_rad == pytest.approx(0.49)], "the newest"
        )
        assert moved
        assert len(bench.of(HeadMoved)) == 2

    with_link(robot(TRAJECTORY), test)


def test_naoqi_gets_angles_and_a_fraction_of_its_speed() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(MoveHead(now_ns(), 0.25, 0.125))
        sent = await bench.until(lambda: bench.bridge.published("/joint_angles"), "angles")
        positions, fraction = decode_joint_angles_with_speed(sent[0])
        assert positions == {"HeadYaw": 0.25, "HeadPitch": 0.125}
        assert fraction == pytest.approx(0.1)
        [advertised] = bench.bridge.operations("advertise", "/joint_angles")
        assert advertised["type"] == "naoqi_bridge_msgs/JointAnglesWithSpeed"

    with_link(robot(NAOQI), test)


def test_the_emergency_stop_holds_the_head_where_it_is() -> None:
    async def test(bench: LoopBench) -> None:
        joints = {"name": ["head_1_joint", "head_2_joint"], "position": [0.3, 0.0]}
        await bench.bridge.publish("/joint_states", joints)
        await bench.until(lambda: bench.of(HeadState), "the head's state")
        bench.send(MoveHead(now_ns(), 1.0, 0.0))
        bench.send(SetEmergencyStop(now_ns(), True))
        sent = await bench.until(lambda: bench.bridge.published(TRAJECTORY.topic)[1:], "a goal to stay")
        assert decode_joint_trajectory(sent[0])[0]["head_1_joint"] == pytest.approx(0.3)
        bench.send(MoveHead(now_ns(), 1.0, 0.0))
        [problem] = [problem for problem in bench.of(Problem) if "head" in problem.what]
        assert problem.what == "The head was not turned: the emergency stop is active."
        bench.send(SetEmergencyStop(now_ns(), False), MoveHead(now_ns(), 1.0, 0.0))
        await bench.until(lambda: len(bench.of(HeadMoved)) == 2, "it turns again")

    with_link(robot(TRAJECTORY), test)


def test_without_a_link_nothing_is_retained_for_later() -> None:
    async def test(bench: LoopBench) -> None:
        # Close only after the link has advertised its topics.
        await bench.until(lambda: bench.bridge.operations("advertise", TRAJECTORY.topic), "advertised")
        await bench.bridge.close()
        await bench.until(lambda: bench.state == "lost", "the loss")
        bench.send(MoveHead(now_ns(), 1.0, 0.0))
        assert bench.of(HeadMoved) == []
        await bench.bridge.open()
        await bench.until(lambda: len(bench.bridge.operations("advertise", TRAJECTORY.topic)) >= 2, "advertised again")
        assert bench.bridge.published(TRAJECTORY.topic) == []
        assert [problem.what for problem in bench.of(Problem)] == [
            "The head was not turned: the robot is not connected."
        ]

    with_link(robot(TRAJECTORY), test)


def test_a_robot_without_a_head_says_so() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(MoveHead(now_ns(), 1.0, 0.0))
        assert ["this robot's profile does not define a head" in problem.what for problem in bench.of(Problem)] == [
            True
        ]

    with_link(robot(None), test)
