"""Navigation goals on a lost link: cancelled, with the result reported by the robot."""

from typing import Any

import pytest

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import GoalChanged, Problem
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.link_commands import GoTo
from caris_desktop.robot import navigation_client
from caris_desktop.robot.profile_model import NavigationServer, RobotProfile
from tests.robot.loop_bench import LoopBench, with_link

ROBOT = RobotProfile("test", "Test", navigation=NavigationServer("move_base", "/move_base"))


async def under_way_when_the_link_is_lost(bench: LoopBench) -> str:
    """Lose the link while driving to a goal; returns the goal's identifier after the reconnect."""
    bench.send(GoTo(now_ns(), "g", Pose2D(3.0, 4.0, 0.0)))
    [goal] = await bench.until(lambda: bench.bridge.published("/move_base/goal"), "the goal")
    goal_id: str = goal["goal_id"]["id"]
    await tell(bench, goal_id, 1)
    await bench.until(lambda: bench.of(GoalChanged)[-1].state == "active", "active")
    await bench.bridge.drop()
    await bench.until(lambda: bench.state == "lost", "the loss")
    assert "cancelled when the robot is connected again" in bench.of(GoalChanged)[-1].detail
    await bench.until(lambda: bench.state == "connected", "the link")
    return goal_id


async def tell(bench: LoopBench, goal_id: str, number: int) -> None:
    status: dict[str, Any] = {
        "goal_id": {"stamp": {"secs": 0, "nsecs": 0}, "id": goal_id},
        "status": number,
        "text": "",
    }
    await bench.bridge.publish("/move_base/status", {"status_list": [status]})


@pytest.mark.parametrize(("number", "state"), [(3, "reached"), (2, "cancelled")])
def test_the_end_of_a_goal_is_reported_by_its_status_when_the_link_is_back(number: int, state: str) -> None:
    async def test(bench: LoopBench) -> None:
        goal_id = await under_way_when_the_link_is_lost(bench)
        cancels = await bench.until(lambda: bench.bridge.published("/move_base/cancel"), "the cancellation")
        assert cancels[0]["id"] == goal_id
        await tell(bench, goal_id, number)
        await bench.until(lambda: bench.of(GoalChanged)[-1].state == state, state)
        assert "failed" not in [change.state for change in bench.of(GoalChanged)]

    with_link(ROBOT, test)


def test_a_robot_that_reports_no_end_of_a_goal_may_still_be_moving(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(navigation_client, "FATE_WITHIN_S", 0.4)

    async def test(bench: LoopBench) -> None:
        await under_way_when_the_link_is_lost(bench)
        await bench.until(lambda: bench.of(GoalChanged)[-1].state == "failed", "given up")
        assert "outcome is unknown" in bench.of(GoalChanged)[-1].detail
        [problem] = [problem for problem in bench.of(Problem) if "navigation goal" in problem.what]
        assert problem.meaning == "The robot may still be moving autonomously."

    with_link(ROBOT, test)


@pytest.mark.parametrize("ros", [1, 2])
def test_a_process_that_follows_a_crash_cancels_what_the_robot_still_does(ros: int) -> None:
    action = "/navigate_to_pose" if ros == 2 else "/move_base"
    kind = "navigate_to_pose" if ros == 2 else "move_base"
    profile = RobotProfile("test", "Test", ros=ros, navigation=NavigationServer(kind, action))  # type: ignore[arg-type]

    async def test(bench: LoopBench) -> None:
        def cancels() -> list[Any]:
            service = bench.bridge.operations("call_service", f"{action}/_action/cancel_goal")
            return [call["args"] for call in service] if ros == 2 else bench.bridge.published(f"{action}/cancel")

        first = await bench.until(cancels, "the cancel of every goal")
        named = first[0]["goal_info"]["goal_id"]["uuid"] if ros == 2 else first[0]["id"]
        assert not any(named)
        await bench.bridge.drop()
        await bench.until(lambda: bench.state == "lost", "the loss")
        await bench.until(lambda: bench.state == "connected", "the link")
        seen = len(cancels())
        bench.send(GoTo(now_ns(), "g", Pose2D(3.0, 4.0, 0.0)))
        op, name = ("send_action_goal", action) if ros == 2 else ("publish", f"{action}/goal")
        await bench.until(lambda: bench.bridge.operations(op, name), "a goal of its own")
        assert len(cancels()) <= max(seen, 3), "only once"

    with_link(profile, test, follows_crash=True)
