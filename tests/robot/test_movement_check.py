"""Comparison of commanded motion with the odometry: states, and reactions of the link."""

import asyncio
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import CommandSent, MovementChanged
from caris_desktop.domain.geometry import ZERO_TWIST, Pose2D, Twist2D, moved_by, moves
from caris_desktop.domain.link_commands import Drive, Release, RenewLease, SetEmergencyStop, StopMotion
from caris_desktop.domain.sensing import Odometry
from caris_desktop.robot.movement_check import MovementCheck
from caris_desktop.robot.profile_model import RobotProfile, TopicSource, VelocityTopic
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ros.message_conversion import decode_twist, encode_odometry, encode_twist, encode_twist_stamped
from tests.robot.loop_bench import LoopBench, inventory, with_link

ROBOT = RobotProfile("test", "Test", odometry=TopicSource("/odom"))
Told = Callable[[float], Twist2D]


class Base:
    """Base in simulated time that moves as ``moves`` specifies, with commands and odometry at 20 Hz."""

    def __init__(self, profile: RobotProfile = ROBOT) -> None:
        self.check = MovementCheck(profile)
        self.check.forget(0.0)
        self.now_s = 0.0
        self.states: list[str] = []
        self.pose = Pose2D(0.0, 0.0, 0.0)

    def run(
        self, duration_s: float, *, sent: Twist2D | None = None, moves: Told | Twist2D = ZERO_TWIST,
        others: Twist2D | None = None, odometry: bool = True, speeds: bool = True, poses: bool = True,
    ) -> list[str]:  # fmt: skip
        """States in this period, without repetitions."""
        begin_s, self.states = self.now_s, []
        for _ in range(round(duration_s * 20)):
            self.now_s += 0.05
            twist = moves if isinstance(moves, Twist2D) else moves(self.now_s - begin_s)
            self.pose = self.pose @ moved_by(twist, 0.05)
            if sent is not None:
                self.check.sent(sent, self.now_s)
                self.check.commanded(sent, self.now_s)  # the echo
            if others is not None:
                self.check.commanded(others, self.now_s)
            if odometry:
                told = Odometry(
                    round(self.now_s * 1e9), None, self.pose if poses else Pose2D(0.0, 0.0, 0.0),
                    twist if speeds else ZERO_TWIST,
                )  # fmt: skip
                self.check.add_odometry(told)
            state = self.check.state(self.now_s)
            if not self.states or self.states[-1] != state:
                self.states.append(state)
        return self.states


def ramp(twist: Twist2D, *, after_s: float = 0.2, to: Twist2D = ZERO_TWIST, braking_s: float = 0.6) -> Told:
    """Base that continues for a moment and then brakes."""

    def at(at_s: float) -> Twist2D:
        share = min(max((at_s - after_s) / braking_s, 0.0), 1.0)
        return Twist2D(
            *(
                a + share * (b - a)
                for a, b in zip(
                    (twist.forward_mps, twist.left_mps, twist.turn_radps),
                    (to.forward_mps, to.left_mps, to.turn_radps),
                    strict=True,
                )
            )
        )

    return at


@pytest.mark.parametrize("speeds", [True, False], ids=["speeds", "poses only"])
@pytest.mark.parametrize("twist", [Twist2D(0.5), Twist2D(-0.3), Twist2D(0.0, 0.0, 1.0), Twist2D(0.4, 0.0, -0.5)])
def test_an_obedient_robot_is_never_suspected(twist: Twist2D, speeds: bool) -> None:
    base = Base()
    assert base.run(2.0)[-1] == "standing"
    for _ in range(3):
        assert set(base.run(2.0, sent=twist, moves=ramp(ZERO_TWIST, to=twist), speeds=speeds)) <= {"standing", "moving"}
        assert set(base.run(0.5, sent=ZERO_TWIST, moves=ramp(twist), speeds=speeds)) <= {"moving"}
        rest = base.run(2.0, moves=ramp(twist, after_s=-0.3), speeds=speeds)
        assert rest in (["moving", "standing"], ["standing"])


@pytest.mark.parametrize("twist", [Twist2D(0.3), Twist2D(-0.2), Twist2D(0.0, 0.0, -0.5), Twist2D(0.0, 0.2)])
@pytest.mark.parametrize("speeds", [True, False], ids=["speeds", "poses only"])
def test_a_robot_that_is_held_does_not_follow(twist: Twist2D, speeds: bool) -> None:
    base = Base()
    base.run(2.0)
    assert base.run(3.0, sent=twist, speeds=speeds) == ["standing", "not_following"]
    noise = Twist2D(0.004, 0.0, -0.01)
    assert base.run(1.0, sent=twist, moves=noise, speeds=speeds) == ["not_following"]
    assert base.run(2.0, sent=twist, moves=ramp(ZERO_TWIST, to=twist), speeds=speeds)[-1] == "moving"


def test_the_opposite_direction_is_not_following() -> None:
    base = Base()
    base.run(2.0)
    assert base.run(3.0, sent=Twist2D(0.3), moves=Twist2D(-0.3))[-1] == "not_following"


@pytest.mark.parametrize("moves", [Twist2D(0.3), Twist2D(-0.1), Twist2D(0.0, 0.0, 0.3), Twist2D(0.0, 0.15, 0.0)])
@pytest.mark.parametrize("speeds", [True, False], ids=["speeds", "poses only"])
def test_a_robot_that_moves_though_nothing_here_reports_it_to_is_noticed_at_once(moves: Twist2D, speeds: bool) -> None:
    base = Base()
    base.run(3.0)
    assert base.run(1.0, moves=moves, speeds=speeds)[-1] == "uncommanded"
    if speeds:
        base.run(2.0)
        assert base.run(0.15, moves=moves)[-1] == "uncommanded", "with the second odometry"
    assert base.run(2.0)[-1] == "standing"


@pytest.mark.parametrize("creeps", [Twist2D(0.025), Twist2D(0.0, -0.025), Twist2D(0.0, 0.0, 0.055)])
def test_motion_in_the_odometry_is_not_called_still_and_is_no_alarm(creeps: Twist2D) -> None:
    base = Base()
    base.run(3.0)
    assert moves(creeps)
    assert base.run(1.0, moves=creeps) == ["moving"]


def test_a_robot_that_does_not_stop_is_noticed_once_it_should_have_braked() -> None:
    base = Base()
    base.run(2.0)
    base.run(2.0, sent=Twist2D(0.5), moves=Twist2D(0.5))
    states = base.run(3.0, sent=ZERO_TWIST, moves=Twist2D(0.5))
    assert states == ["moving", "uncommanded"]


def test_a_goal_and_a_control_move_it_on_behalf_of_this_console() -> None:
    base = Base()
    base.run(2.0)
    base.check.control_used(base.now_s)
    assert "uncommanded" not in base.run(8.0, moves=Twist2D(0.3))
    base.run(4.0)
    assert base.run(1.0, moves=Twist2D(0.3))[-1] == "uncommanded", "it had stood meanwhile"
    base.check.control_used(base.now_s)
    base.check.stopped()
    base.run(2.0)
    assert base.run(1.0, moves=Twist2D(0.3))[-1] == "uncommanded", "the control was stopped"


def test_commands_of_others_are_distinguished_from_the_echo_of_ours() -> None:
    base = Base()
    base.run(2.0)
    assert "commanded_elsewhere" not in base.run(2.0, sent=Twist2D(0.123456, 0.0, 0.3), moves=Twist2D(0.12, 0.0, 0.3))
    base.run(3.0)
    assert base.run(0.2, others=Twist2D(0.3))[-1] == "commanded_elsewhere"
    assert base.run(1.0, others=ZERO_TWIST)[-1] == "standing"
    without = Base(replace(ROBOT, odometry=None))
    assert without.run(4.0, odometry=False) == ["unknown"]
    assert without.run(0.2, others=Twist2D(0.3), odometry=False)[-1] == "commanded_elsewhere"


def test_late_commands_of_a_stopped_rosbridge_are_not_of_others() -> None:
    base = Base()
    base.run(2.0)
    base.run(1.0, sent=Twist2D(0.3), moves=Twist2D(0.3))
    base.run(5.0, odometry=False)
    base.check.forget(base.now_s)
    base.run(2.0)
    assert base.run(0.2, others=Twist2D(0.3)) == ["standing"], "an echo of then"
    assert base.run(0.2, others=Twist2D(0.2))[-1] == "commanded_elsewhere"


def test_silence_is_no_standing_still() -> None:
    base = Base()
    assert base.run(2.0, odometry=False) == ["unknown"]
    assert base.run(3.0, odometry=False)[-1] == "silent"
    assert base.run(2.0)[-1] == "standing"
    assert base.run(2.0, odometry=False) == ["standing", "silent"]
    assert base.run(2.0, sent=Twist2D(0.3), odometry=False) == ["silent"]


def test_odometry_that_is_set_elsewhere_is_no_movement() -> None:
    base = Base()
    base.run(3.0, speeds=False)
    base.pose = Pose2D(5.0, 1.0, 2.0)
    assert base.run(2.0, speeds=False) == ["standing"]


# In the link


async def tell(bench: LoopBench, twist: Twist2D) -> None:
    odometry = Odometry(0, None, Pose2D(0.0, 0.0, 0.0), twist)
    await bench.bridge.publish("/odom", encode_odometry(Dialect.ROS1, odometry, stamp_ns=now_ns()))


async def tell_until(bench: LoopBench, twist: Twist2D, observe: Callable[[], Any], what: str) -> None:
    """Send odometry at 20 Hz until ``observe`` is true."""

    async def told() -> None:
        while True:
            await tell(bench, twist)
            await asyncio.sleep(0.05)

    task = asyncio.create_task(told())
    try:
        await bench.until(observe, what)
    finally:
        task.cancel()


def state(bench: LoopBench) -> MovementChanged:
    return bench.of(MovementChanged)[-1]


def zeros(bench: LoopBench) -> int:
    """Number of zero commands of a stop, without those of a new connection."""
    return sum(sent.source == "stop" and not sent.twist.moving for sent in bench.of(CommandSent))


def test_motion_under_a_latched_stop_is_reported_at_once_with_who_and_fought_with_zeros() -> None:
    async def test(bench: LoopBench) -> None:
        bench.bridge.answers["/rosapi/publishers"] = {"publishers": ["/rosbridge_websocket", "/joy_teleop"]}
        bench.send(SetEmergencyStop(now_ns(), latched=True))
        await tell_until(bench, ZERO_TWIST, lambda: state(bench).state == "standing", "it stands")
        quiet = zeros(bench)
        await tell_until(bench, Twist2D(0.3), lambda: state(bench).state == "uncommanded", "the alarm")
        assert state(bench).stopped
        await bench.until(lambda: state(bench).publishers == ("/joy_teleop", "/rosbridge_websocket"), "who drives it")
        await tell_until(bench, Twist2D(0.3), lambda: zeros(bench) > quiet + 25, "zeros beyond their half second")
        await tell_until(bench, ZERO_TWIST, lambda: state(bench).state == "standing", "it stands again")
        assert not any(sent.twist.moving for sent in bench.of(CommandSent))

    with_link(ROBOT, test, prepare=lambda bridge: bridge.answers.update(inventory()))


@pytest.mark.parametrize("stamped", [False, True], ids=["Twist", "TwistStamped"])
def test_commands_of_others_are_notified_also_where_the_robot_has_no_odometry(stamped: bool) -> None:
    robot = replace(ROBOT, odometry=None, velocity=VelocityTopic("/cmd_vel", "TwistStamped" if stamped else "Twist"))

    async def others(bench: LoopBench) -> None:
        twist = Twist2D(0.2, 0.0, 0.1)
        message = encode_twist_stamped(Dialect.ROS1, twist, stamp_ns=1) if stamped else encode_twist(twist)
        await bench.bridge.publish("/cmd_vel", message)

    async def test(bench: LoopBench) -> None:
        bench.send(SetEmergencyStop(now_ns(), latched=True))
        loop = asyncio.get_running_loop()
        free_s = bench.link._movement._may_move_until_s
        await bench.until(lambda: loop.time() > free_s, "the first moment of the connection is over")
        before = zeros(bench)
        await others(bench)
        await bench.until(lambda: state(bench).state == "commanded_elsewhere", "it is told")
        await bench.until(lambda: zeros(bench) > before, "zero")
        assert state(bench).stopped

    with_link(robot, test)


def test_after_a_stop_zeros_continue_until_the_robot_stood_and_not_against_later_commands() -> None:
    async def test(bench: LoopBench) -> None:
        await tell_until(bench, ZERO_TWIST, lambda: state(bench).state == "standing", "it stands")
        bench.send(StopMotion(now_ns()))
        await tell_until(bench, Twist2D(0.3), lambda: zeros(bench) > 25, "more than the zeros of a stop")
        assert state(bench) == replace(state(bench), state="uncommanded", stopped=True)
        await tell_until(bench, ZERO_TWIST, lambda: state(bench).state == "standing", "it stands")
        assert not state(bench).stopped
        loop = asyncio.get_running_loop()
        await bench.until(lambda: bench.link._lease.due_s() == math.inf, "silence")
        after, at_s = zeros(bench), loop.time()
        await tell_until(bench, Twist2D(0.3), lambda: state(bench).state == "uncommanded", "it is told")
        await tell_until(bench, Twist2D(0.3), lambda: loop.time() > at_s + 0.5, "a while")
        assert (zeros(bench), state(bench).stopped) == (after, False), "somebody else's goal is not fought"

    with_link(ROBOT, test)


def test_a_drive_that_is_not_followed_is_reported_and_one_that_is_not_is_quiet() -> None:
    async def test(bench: LoopBench) -> None:
        await tell_until(bench, ZERO_TWIST, lambda: state(bench).state == "standing", "it stands")

        def driven() -> str:
            bench.send(Drive(now_ns(), Twist2D(0.3), "keyboard"), RenewLease(now_ns()))
            return state(bench).state

        await tell_until(bench, ZERO_TWIST, lambda: driven() == "not_following", "it is told")
        await tell_until(bench, Twist2D(0.3), lambda: driven() == "moving", "it follows")
        bench.send(Release(now_ns(), ""))
        await tell_until(bench, ZERO_TWIST, lambda: state(bench).state == "standing", "it stands")
        assert "uncommanded" not in [changed.state for changed in bench.of(MovementChanged)]

    with_link(ROBOT, test)


class TwistMux:
    """Base behind twist_mux: the input with the highest priority that is at most half a second old passes, unless a
    lock of at least its priority masks it.
    """

    _EXPIRES_S, _PRIORITIES, _LOCK = 0.5, {"/key_vel": 10, "/joy_vel": 100}, 255

    def __init__(self, bench: LoopBench) -> None:
        self._bench = bench
        self._loop = asyncio.get_running_loop()
        self._came: dict[str, tuple[float, Twist2D]] = {}
        self._taken = 0
        self.locked = False
        self.joystick = ZERO_TWIST

    def moves(self) -> Twist2D:
        now_s = self._loop.time()
        published = self._bench.bridge.published("/key_vel")
        if len(published) > self._taken:
            self._taken = len(published)
            self._came["/key_vel"] = now_s, decode_twist(published[-1])
        if self.joystick.moving:
            self._came["/joy_vel"] = now_s, self.joystick
        alive = {name: twist for name, (at_s, twist) in self._came.items() if now_s - at_s <= self._EXPIRES_S}
        masked_to = self._LOCK if self.locked else 0
        passing = [name for name in alive if self._PRIORITIES[name] >= masked_to]
        return alive[max(passing, key=self._PRIORITIES.__getitem__)] if passing else ZERO_TWIST

    async def drive(self) -> None:
        while True:
            await tell(self._bench, self.moves())
            await asyncio.sleep(0.05)


@pytest.mark.parametrize("held_by", ["lock", "joystick"])
@pytest.mark.long("joystick")
def test_a_twist_mux_that_lets_others_pass_is_reported_and_never_called_still(held_by: str) -> None:
    robot = replace(ROBOT, velocity=VelocityTopic("/key_vel", "Twist"))

    async def test(bench: LoopBench) -> None:
        mux = TwistMux(bench)
        base = asyncio.create_task(mux.drive())
        try:
            await bench.until(lambda: state(bench).state == "standing", "it stands")

            def driven() -> str:
                bench.send(Drive(now_ns(), Twist2D(0.3), "keyboard"), RenewLease(now_ns()))
                return state(bench).state

            await bench.until(lambda: driven() == "moving", "it follows")
            mux.locked, mux.joystick = held_by == "lock", Twist2D(-0.3) if held_by == "joystick" else ZERO_TWIST
            await bench.until(lambda: driven() == "not_following", "it is told")
            bench.send(StopMotion(now_ns()))
            # Zero does not override a higher priority: the wizard is informed of the motion in spite of the stop.
            wanted = ("standing", False) if held_by == "lock" else ("uncommanded", True)
            await bench.until(lambda: (state(bench).state, state(bench).stopped) == wanted, f"it is {wanted}")
            mux.locked, mux.joystick = False, ZERO_TWIST
            await bench.until(lambda: state(bench).state == "standing" and not state(bench).stopped, "it stands")
            await bench.until(lambda: driven() == "moving", "it follows again")
        finally:
            base.cancel()

    with_link(robot, test)
