"""Speed limit of navigation goals: set on planners that support it, reported otherwise."""

from typing import Any

import pytest

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import GoalChanged, NavigationSpeedChanged, Problem
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.link_commands import GoTo, LimitGoals
from caris_desktop.robot.profile_model import NavigationServer, RobotProfile, SpeedLimitInterface
from tests.robot.loop_bench import LoopBench, with_link

PLANNER = "/move_base/DWAPlannerROS"
SET = f"{PLANNER}/set_parameters"
ROS1 = RobotProfile(
    "test", "Test",
    navigation=NavigationServer("move_base", "/move_base", 0.6, SpeedLimitInterface(reconfigure=PLANNER)),
)  # fmt: skip
ROS2 = RobotProfile(
    "test", "Test", ros=2,
    navigation=NavigationServer("navigate_to_pose", "/navigate_to_pose", None, SpeedLimitInterface("/speed_limit")),
)  # fmt: skip


def asked_for(bench: LoopBench) -> list[dict[str, float]]:
    """Maximum speeds requested from the planner, by parameter."""
    calls = [call["args"]["config"]["doubles"] for call in bench.bridge.operations("call_service", SET)]
    return [{double["name"]: double["value"] for double in doubles} for doubles in calls]


def kept(bench: LoopBench) -> list[float | None]:
    return [change.limit_mps for change in bench.of(NavigationSpeedChanged)]


def both(speed_mps: float) -> dict[str, float]:
    return {"max_vel_x": speed_mps, "max_vel_trans": speed_mps}


def test_a_planner_of_ros1_is_reported_before_the_goal_and_gets_its_own_speed_back() -> None:
    async def test(bench: LoopBench) -> None:
        bench.bridge.answers[SET] = lambda request: request
        bench.send(LimitGoals(now_ns(), 0.3))
        await bench.until(lambda: kept(bench) == [0.3], "the limit")
        bench.send(GoTo(now_ns(), "g", Pose2D(3.0, 4.0, 0.0)))
        await bench.until(lambda: bench.bridge.published("/move_base/goal"), "the goal")
        operations = [
            line["op"] for line in bench.bridge.lines if SET in line.values() or line.get("topic") == "/move_base/goal"
        ]
        assert operations[-2:] == ["call_service", "publish"], "whoever set it meanwhile does not count"
        bench.send(LimitGoals(now_ns(), 0.9))
        await bench.until(lambda: kept(bench) == [0.3, 0.6], "never more than it is set up to")
        assert asked_for(bench) == [both(0.3), both(0.3), both(0.6)]
        bench.send(LimitGoals(now_ns(), 0.15))
        await bench.until(lambda: kept(bench)[-1] == 0.15, "the lower limit")
        assert bench.of(Problem) == []
        used.append(bench)

    used: list[LoopBench] = []
    with_link(ROS1, test)
    assert asked_for(used[0])[-1] == both(0.6), "the console has left"


@pytest.mark.logs(r"robot\.navigation_client: ")
def test_a_planner_that_does_not_take_it_is_reported_to_the_wizard_once() -> None:
    async def test(bench: LoopBench) -> None:
        def stays(_request: dict[str, Any]) -> dict[str, Any]:
            return {"config": {"doubles": [{"name": "max_vel_x", "value": 0.6}]}}

        bench.bridge.answers[SET] = stays
        bench.send(LimitGoals(now_ns(), 0.3))
        [problem] = await bench.until(lambda: bench.of(Problem), "the problem")
        assert "did not accept max_vel_x" in problem.what
        assert "up to 0.60 m/s" in problem.meaning
        bench.bridge.answers[SET] = "there is no such service"
        bench.send(LimitGoals(now_ns(), 0.2), GoTo(now_ns(), "g", Pose2D(3.0, 4.0, 0.0)))
        await bench.until(lambda: len(asked_for(bench)) >= 3, "asked again")
        await bench.until(lambda: bench.of(GoalChanged), "the goal goes all the same")
        assert kept(bench) == []
        assert len(bench.of(Problem)) == 1

    with_link(ROS1, test)


@pytest.mark.logs(r"robot\.navigation_client: ")
def test_nav2_is_set_on_its_topic_which_needs_a_subscriber() -> None:
    async def test(bench: LoopBench) -> None:
        bench.bridge.answers["/rosapi/subscribers"] = {"subscribers": ["/controller_server"]}
        bench.send(LimitGoals(now_ns(), 0.3))
        await bench.until(lambda: kept(bench) == [0.3], "the limit")
        [told] = bench.bridge.published("/speed_limit")
        assert (told["speed_limit"], told["percentage"]) == (0.3, False)
        bench.bridge.answers["/rosapi/subscribers"] = {"subscribers": []}
        bench.send(LimitGoals(now_ns(), 0.4))
        await bench.until(lambda: kept(bench) == [0.3, None], "nobody listens any more")
        assert "nothing subscribes to /speed_limit" in bench.of(Problem)[0].what
        bench.bridge.answers["/rosapi/subscribers"] = {"subscribers": ["/controller_server"]}
        bench.send(LimitGoals(now_ns(), 0.5))
        await bench.until(lambda: kept(bench)[-1] == 0.5, "back")
        used.append(bench)

    used: list[LoopBench] = []
    with_link(ROS2, test)
    assert used[0].bridge.published("/speed_limit")[-1]["speed_limit"] == 0.0, "no limit of ours stays"


def test_after_a_lost_link_it_is_reported_again() -> None:
    async def test(bench: LoopBench) -> None:
        bench.bridge.answers[SET] = lambda request: request
        bench.send(LimitGoals(now_ns(), 0.3))
        await bench.until(lambda: kept(bench) == [0.3], "the limit")
        await bench.bridge.drop()
        await bench.until(lambda: kept(bench) == [0.3, None], "nobody knows")
        await bench.until(lambda: kept(bench) == [0.3, None, 0.3], "told anew")

    with_link(ROS1, test)
