"""Operations that the control link sends on a new connection."""

from dataclasses import replace
from typing import Any

import pytest

from caris_desktop.domain.events import CommandSent
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import Odometry
from caris_desktop.robot import control_link
from caris_desktop.robot.profile_model import RobotProfile, TopicSource
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ros.message_conversion import encode_odometry
from tests.robot.loop_bench import LoopBench, with_link

ROBOT = RobotProfile("test", "Test", odometry=TopicSource("/odom"))


def odometry(turn_radps: float) -> dict[str, Any]:
    told = Odometry(0, None, Pose2D(0.0, 0.0, 0.0), Twist2D(0.0, 0.0, turn_radps))
    return encode_odometry(Dialect.ROS1, told, stamp_ns=1, frame_id="odom", child_frame_id="base_link")


def test_zero_is_repeated_while_the_odometry_reports_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control_link, "ZERO_AGAIN_S", ())
    monkeypatch.setattr(control_link, "ZERO_WHILE_MOVING_S", (0.8, 0.9, 1.0))

    async def test(bench: LoopBench) -> None:
        await bench.bridge.publish("/odom", odometry(0.4))
        await bench.until(lambda: len(bench.of(CommandSent)) >= 13, "half a second of zeros, and three more")
        sent = bench.of(CommandSent)
        assert not any(command.twist.moving for command in sent)
        assert [line["topic"] for line in bench.bridge.lines[:2]] == ["/cmd_vel", "/cmd_vel"]
        assert (sent[-1].stamp_ns - sent[0].stamp_ns) / 1e9 > 0.9

    with_link(ROBOT, test)


@pytest.mark.parametrize("odometry_topic", [None, TopicSource("/odom")])
def test_zero_is_repeated_until_the_odometry_arrives(
    monkeypatch: pytest.MonkeyPatch, odometry_topic: TopicSource | None
) -> None:
    """A restarted rosbridge may reach the base before it receives the odometry."""
    monkeypatch.setattr(control_link, "ZERO_AGAIN_S", ())
    monkeypatch.setattr(control_link, "ZERO_WHILE_MOVING_S", (0.8, 0.9))
    monkeypatch.setattr(control_link, "ZERO_UNLESS_STILL_S", ())
    again: list[bool] = []
    monkeypatch.setattr(control_link.ControlLink, "_repeat_zero", lambda _link: again.append(True))

    async def test(bench: LoopBench) -> None:
        timers = list(bench.link._zeros_again)
        await bench.until(lambda: all(timer.when() < bench.link._loop.time() - 0.1 for timer in timers), "both times")
        assert len(again) == (0 if odometry_topic is None else 2)

    with_link(replace(ROBOT, odometry=odometry_topic), test)


@pytest.mark.parametrize("turn_radps", [None, 0.0])
def test_zero_is_sent_until_the_odometry_shows_that_the_robot_stands(
    monkeypatch: pytest.MonkeyPatch, turn_radps: float | None
) -> None:
    monkeypatch.setattr(control_link, "ZERO_AGAIN_S", ())
    monkeypatch.setattr(control_link, "ZERO_WHILE_MOVING_S", ())
    monkeypatch.setattr(control_link, "ZERO_UNLESS_STILL_S", (0.8, 0.9))
    monkeypatch.setattr(control_link, "_ODOMETRY_COUNTS_S", 60.0)
    again: list[bool] = []
    motion: list[bool | None] = []
    moves = control_link.ControlLink._moves

    def noted_motion(link: control_link.ControlLink) -> bool | None:
        motion.append(moves(link))
        return motion[-1]

    monkeypatch.setattr(control_link.ControlLink, "_moves", noted_motion)
    monkeypatch.setattr(control_link.ControlLink, "_repeat_zero", lambda _link: again.append(True))

    async def test(bench: LoopBench) -> None:
        if turn_radps is not None:
            await bench.bridge.publish("/odom", odometry(turn_radps))
        await bench.until(lambda: len(motion) == 2, "both times")
        assert motion == [None if turn_radps is None else False] * 2
        assert len(again) == (2 if turn_radps is None else 0), "it may not have been reachable before"

    with_link(ROBOT, test)


def test_a_robot_that_stands_is_left_alone_after_half_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control_link, "ZERO_AGAIN_S", (1.4,))
    monkeypatch.setattr(control_link, "ZERO_WHILE_MOVING_S", (1.0, 1.1))

    async def test(bench: LoopBench) -> None:
        await bench.bridge.publish("/odom", odometry(0.0))

        def since_first_s() -> list[float]:
            sent = bench.of(CommandSent)
            return [(command.stamp_ns - sent[0].stamp_ns) / 1e9 for command in sent]

        await bench.until(lambda: since_first_s()[-1] > 1.3, "the last zero")
        assert not [at_s for at_s in since_first_s() if 0.8 < at_s < 1.3]

    with_link(ROBOT, test)
