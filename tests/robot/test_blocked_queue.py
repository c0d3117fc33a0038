"""Stops with a rosbridge that handles the operations of a websocket in sequence, as versions 2.0 and 2.1 do."""

import asyncio
from collections.abc import Awaitable
from typing import Any

import pytest

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.control_definitions import CallService, RobotControl, SendActionGoal
from caris_desktop.domain.events import ControlUsed, GoalChanged, LinkChanged, Problem
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.link_commands import Drive, GoTo, RequestMap, SetEmergencyStop, StopMotion, UseControl
from caris_desktop.robot import action_client, control_interfaces, handled_operations, navigation_client
from caris_desktop.robot.profile_model import EmergencyStopInterface, MapServices, NavigationServer, RobotProfile
from caris_desktop.robot.transport import MOST_CALLS
from caris_desktop.robot.unread import MOST_UNREAD
from tests.robot.loop_bench import Bridge, LoopBench, with_link

CANCEL = "/navigate_to_pose/_action/cancel_goal"
SLOW = RobotControl("slow", "Slow", "button", CallService("/slow", "std_srvs/Trigger", {}))
WAVE = RobotControl("wave", "Wave", "button", SendActionGoal("/wave", "test_msgs/Fibonacci", {"order": 1}))
ROBOT = RobotProfile(
    "test",
    "Test",
    ros=2,
    navigation=NavigationServer("navigate_to_pose", "/navigate_to_pose"),
    emergency_stop=EmergencyStopInterface(service="/e_stop"),
    controls=(SLOW, WAVE),
    maps=MapServices(map_saver="/map_saver"),
)


def blocking(bridge: Bridge) -> None:
    """Goals never end, and the slow service and rosapi never answer: each blocks its websocket."""
    held = asyncio.Event()

    def hold(operation: dict[str, Any]) -> Awaitable[None] | None:
        service = operation.get("service", "")
        holds = operation["op"] == "send_action_goal" or service == "/slow" or service.startswith("/rosapi/")
        return None if not holds else wait()

    async def wait() -> None:
        await held.wait()

    bridge.on_operation = hold
    bridge.answers = {"/e_stop": {"success": True}, CANCEL: {"return_code": 0, "goals_canceling": []}}


def zeros(bench: LoopBench) -> list[Any]:
    return [twist for twist in bench.bridge.published("/cmd_vel") if not twist["linear"]["x"]]


def moving(bench: LoopBench) -> list[Any]:
    return [twist for twist in bench.bridge.published("/cmd_vel") if twist["linear"]["x"]]


def drive() -> Drive:
    return Drive(now_ns(), Twist2D(0.3, 0.0, 0.0), "keyboard")


@pytest.mark.logs(r"robot\.")
def test_stop_emergency_stop_cancel_and_driving_pass_by_a_goal_and_services_that_hold_their_queue() -> None:
    async def test(bench: LoopBench) -> None:
        bench.send(
            GoTo(now_ns(), "g", Pose2D(3.0, 4.0, 0.0)),
            UseControl(now_ns(), "r", "slow", True),
            RequestMap(now_ns(), "m", "save", "map"),
        )
        await bench.until(
            lambda: (
                bench.bridge.operations("send_action_goal")
                and bench.bridge.operations("call_service", "/slow")
                and bench.bridge.operations("call_service", "/map_saver/save_map")
            ),
            "the goal and both calls",
        )
        bench.bridge.lines.clear()
        bench.send(StopMotion(now_ns()), SetEmergencyStop(now_ns(), True))
        await bench.until(lambda: zeros(bench), "zero")
        await bench.until(lambda: bench.bridge.operations("call_service", "/e_stop"), "the emergency stop")
        await bench.until(lambda: bench.bridge.operations("cancel_action_goal"), "the cancel")
        await bench.until(lambda: bench.bridge.operations("call_service", CANCEL), "the cancel of every goal")
        await bench.until(lambda: bench.of(GoalChanged)[-1].state == "cancelled", "the end of the goal")
        bench.send(SetEmergencyStop(now_ns(), False))
        await bench.until(lambda: bench.send(drive()) or moving(bench), "driving")
        assert [change.state for change in bench.of(LinkChanged)] == ["connecting", "connected"]

    with_link(ROBOT, test, prepare=blocking)


@pytest.mark.logs(r"robot\.")
def test_goals_that_are_never_answered_do_not_use_up_the_websockets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(navigation_client, "NO_ANSWER_S", 0.05)

    async def test(bench: LoopBench) -> None:
        for number in range(20):
            bench.send(GoTo(now_ns(), f"g{number}", Pose2D(3.0, 4.0, 0.0)))
            await bench.until(
                lambda number=number: (
                    (last := bench.of(GoalChanged)[-1:])
                    and last[0].goal_id == f"g{number}"
                    and last[0].state == "failed"
                ),
                f"the end of goal {number}",
            )
        # A call cancelled before its websocket is open is not sent.
        assert len(bench.bridge.operations("send_action_goal")) > MOST_CALLS
        await bench.until(lambda: len(bench.bridge.clients) <= 6, "no more websockets than at first")

    with_link(ROBOT, test, prepare=blocking)


@pytest.mark.logs(r"robot\.")
@pytest.mark.parametrize("stopped", [False, True])
def test_goals_of_controls_that_are_never_answered_do_not_use_up_the_websockets(
    monkeypatch: pytest.MonkeyPatch, stopped: bool
) -> None:
    """rosbridge for ROS 2 never says that a goal was refused."""
    monkeypatch.setattr(action_client, "_CANCELLED_WITHIN_S", 0.05)
    monkeypatch.setattr(control_interfaces, "NO_ANSWER_S", 4.0 if stopped else 0.05)

    async def test(bench: LoopBench) -> None:
        for number in range(2 * MOST_CALLS):
            bench.send(UseControl(now_ns(), f"r{number}", "wave", True))
            await bench.until(lambda number=number: len(bench.bridge.operations("send_action_goal")) > number, "a goal")
            if stopped:
                bench.send(StopMotion(now_ns()))
            await bench.until(lambda number=number: failed(bench) > number, "its end")
            await bench.until(lambda: len(bench.bridge.clients) <= 6, "no more websockets than at first")

    def failed(bench: LoopBench) -> int:
        return sum(used.state == "failed" for used in bench.of(ControlUsed))

    with_link(ROBOT, test, prepare=blocking)


@pytest.mark.logs(r"robot\.")
def test_a_goal_that_cannot_be_sent_says_why() -> None:
    async def test(bench: LoopBench) -> None:
        for number in range(MOST_CALLS + 1):
            bench.send(UseControl(now_ns(), f"r{number}", "wave", True))
        await bench.until(
            lambda: [used for used in bench.of(ControlUsed) if "has not yet responded" in used.detail], "the reason"
        )

    with_link(ROBOT, test, prepare=blocking)


@pytest.mark.logs(r"robot\.")
def test_calls_that_are_never_answered_are_bounded_and_leave_room_for_the_emergency_stop() -> None:
    async def test(bench: LoopBench) -> None:
        for number in range(30):
            bench.send(UseControl(now_ns(), f"r{number}", "slow", True))
        refused = await bench.until(
            lambda: [used for used in bench.of(ControlUsed) if used.state == "failed"], "calls that are too many"
        )
        assert "has not yet responded" in refused[0].detail
        assert not bench.bridge.operations("call_service", "/e_stop")
        bench.send(SetEmergencyStop(now_ns(), True))
        await bench.until(lambda: bench.bridge.operations("call_service", "/e_stop"), "the emergency stop")

    with_link(ROBOT, test, prepare=blocking)


@pytest.mark.logs(r"robot\.")
def test_commands_that_are_read_and_not_handled_are_few_and_end_in_a_new_connection_with_zero_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(handled_operations, "UNHANDLED_AFTER_S", 0.2)

    async def test(bench: LoopBench) -> None:
        held: list[Any] = []
        stuck = asyncio.Event()

        def hold(operation: dict[str, Any]) -> Awaitable[None] | None:
            # Pings are still answered.
            moves = operation.get("topic") == "/cmd_vel" and operation["op"] == "publish" and not held
            if moves and operation["msg"]["linear"]["x"]:
                held.append(operation)
                return wait()
            return None

        async def wait() -> None:
            await stuck.wait()

        bench.bridge.on_operation = hold
        await bench.until(lambda: bench.send(drive()) or held, "a command that holds everything behind it")
        sent = len(bench.bridge.published("/cmd_vel"))
        await bench.until(
            lambda: bench.send(drive()) or [change for change in bench.of(LinkChanged) if change.state == "lost"],
            "the loss",
        )
        [alarm] = [problem for problem in bench.of(Problem) if problem.cause == "not_handled"]
        assert "does not execute them" in alarm.what
        assert len(bench.bridge.published("/cmd_vel")) == sent
        await bench.until(lambda: bench.bridge.published("/cmd_vel")[sent:], "words on the new connection")
        assert bench.bridge.published("/cmd_vel")[sent]["linear"]["x"] == 0.0
        stuck.set()
        await bench.until(lambda: bench.state == "connected", "the link")
        await asyncio.sleep(0)
        # Commands read before are executed now.
        assert len(held) <= MOST_UNREAD

    with_link(ROBOT, test)


@pytest.mark.logs(r"robot\.")
def test_a_server_that_shows_nothing_of_what_it_handles_is_driven_by_its_pings_and_that_is_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(handled_operations, "_WAITED_FOR_AT_MOST_S", 0.2)

    def restricted(bridge: Bridge) -> None:
        bridge.restricted = True

    async def test(bench: LoopBench) -> None:
        [told] = await bench.until(
            lambda: [problem for problem in bench.of(Problem) if problem.cause == "handling_unproven"], "the warning"
        )
        assert handled_operations.HANDLED_TOPIC in told.advice
        await bench.until(lambda: bench.send(drive()) or len(moving(bench)) > 2 * MOST_UNREAD, "driving")
        assert "lost" not in [change.state for change in bench.of(LinkChanged)]

    with_link(ROBOT, test, prepare=restricted)
