"""Identification of the console's goal on the ROS 2 status topic, so that no goal of another client is cancelled."""

from typing import Any

import pytest

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import GoalChanged
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.link_commands import CancelGoal, GoTo
from caris_desktop.robot import action_client, navigation_client
from caris_desktop.robot.profile_model import NavigationServer, RobotProfile
from caris_desktop.ros.rosbridge import encode_json
from tests.robot.loop_bench import LoopBench, with_link

NAME = "/navigate_to_pose"
ROBOT = RobotProfile("test", "Test", ros=2, navigation=NavigationServer("navigate_to_pose", NAME))
EXECUTING = 2


async def tell(bench: LoopBench, *uuids: int) -> None:
    entries = [
        {"goal_info": {"goal_id": {"uuid": [number] * 16}, "stamp": {"sec": 1, "nanosec": 0}}, "status": EXECUTING}
        for number in uuids
    ]
    await bench.bridge.publish(f"{NAME}/_action/status", {"status_list": entries})


def cancelled_uuids(bench: LoopBench) -> list[int]:
    requests = bench.bridge.operations("call_service", f"{NAME}/_action/cancel_goal")
    return [request["args"]["goal_info"]["goal_id"]["uuid"][0] for request in requests]


async def go(bench: LoopBench) -> dict[str, Any]:
    before = len(bench.bridge.operations("send_action_goal"))
    bench.send(GoTo(now_ns(), f"g{before}", Pose2D(1.0, 0.0, 0.0)))
    await bench.until(lambda: len(bench.bridge.operations("send_action_goal")) > before, "the goal")
    return bench.bridge.operations("send_action_goal")[-1]


async def cancel(bench: LoopBench) -> None:
    bench.send(CancelGoal(now_ns()))
    await bench.until(lambda: bench.bridge.operations("cancel_action_goal"), "the cancel")


@pytest.mark.parametrize("feedback_first", [True, False])
def test_the_one_that_turns_up_after_ours_was_sent_and_with_feedback_of_ours_is_ours(feedback_first: bool) -> None:
    async def test(bench: LoopBench) -> None:
        await tell(bench, 7)
        client = bench.link._navigator._server
        await bench.until(lambda: client._known_uuids == {"07" * 16}, "somebody else's is known")
        goal = await go(bench)
        feedback = {"op": "action_feedback", "id": goal["id"], "action": NAME, "values": {"distance_remaining": 1.0}}
        if feedback_first:
            await bench.bridge.send(encode_json(feedback))
            await bench.until(lambda: client._with_feedback == goal["id"], "feedback")
        await tell(bench, 7, 8)
        await bench.until(lambda: "active" in [goal.state for goal in bench.of(GoalChanged)], "it is active")
        if not feedback_first:
            await bench.bridge.send(encode_json(feedback))
            await bench.until(lambda: client._with_feedback == goal["id"], "feedback")
        await cancel(bench)
        await bench.until(lambda: cancelled_uuids(bench), "it is cancelled by its name")
        assert set(cancelled_uuids(bench)) == {8}

    with_link(ROBOT, test)


@pytest.mark.logs("robot")
def test_a_stranger_s_goal_alone_is_not_cancelled_by_name_where_ours_was_refused_without_an_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Not the cancelling of all goals that follows a missing confirmation.
    monkeypatch.setattr(navigation_client, "UNCONFIRMED_CANCEL_S", 60.0)

    async def test(bench: LoopBench) -> None:
        client = bench.link._navigator._server
        await go(bench)
        await tell(bench, 8)
        await bench.until(lambda: client._known_uuids == {"08" * 16}, "the stranger's is known")
        await cancel(bench)
        await bench.until(lambda: cancelled_uuids(bench), "whatever moves the robot is cancelled")
        assert set(cancelled_uuids(bench)) == {0}

    with_link(ROBOT, test)


@pytest.mark.logs("robot")
def test_a_cancelled_goal_that_still_reports_is_cancelled_with_all_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """A restarted rosbridge loses its acceptance and its listing, so that neither cancel has an effect."""
    monkeypatch.setattr(navigation_client, "UNCONFIRMED_CANCEL_S", 60.0)
    monkeypatch.setattr(action_client, "_PROVEN_WITHIN_S", 0.0)

    async def test(bench: LoopBench) -> None:
        goal = await go(bench)
        await cancel(bench)
        assert cancelled_uuids(bench) == []
        feedback = {"op": "action_feedback", "id": goal["id"], "action": NAME, "values": {"distance_remaining": 1.0}}
        await bench.bridge.send(encode_json(feedback))
        await bench.until(lambda: cancelled_uuids(bench) == [0], "whatever moves the robot is cancelled")

    with_link(ROBOT, test)


@pytest.mark.parametrize("apart", [False, True], ids=["in one message", "one after the other"])
def test_of_two_that_turn_up_none_is_cancelled_by_name(apart: bool) -> None:
    async def test(bench: LoopBench) -> None:
        await go(bench)
        if apart:
            await tell(bench, 8)
        await tell(bench, 8, 9)
        await bench.until(lambda: "active" in [goal.state for goal in bench.of(GoalChanged)], "it is active")
        client = bench.link._navigator._server
        await bench.until(lambda: client._known_uuids == {"08" * 16, "09" * 16}, "both were told")
        await cancel(bench)
        assert cancelled_uuids(bench) == []

    with_link(ROBOT, test)


@pytest.mark.parametrize("refused", [True, False], ids=["refused", "never answered"])
def test_another_person_s_later_goal_is_not_taken_for_one_that_never_turned_up(
    refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def test(bench: LoopBench) -> None:
        goal = await go(bench)
        client = bench.link._navigator._server
        if refused:
            answer = {
                "op": "action_result",
                "id": goal["id"],
                "action": NAME,
                "status": 6,
                "result": False,
                "values": "",
            }
            await bench.bridge.send(encode_json(answer))
            await bench.until(lambda: client._unknown is None, "the refusal")
        else:
            monkeypatch.setattr(action_client, "_ADOPTED_WITHIN_S", 0.0)
        await tell(bench, 8)
        await bench.until(lambda: client._known_uuids == {"08" * 16}, "it was told")
        assert client._uuid_of == {}
        client.cancel(goal["id"])
        assert cancelled_uuids(bench) == []

    with_link(ROBOT, test)
