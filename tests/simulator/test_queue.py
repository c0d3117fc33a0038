"""Queue per client, as in rosbridge of ROS 2: a goal or a call blocks later operations."""

from typing import Any

import pytest

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.ros.action_messages import encode_navigate_to_pose_goal
from tests.support.polling import wait_for
from tests.support.simulated_robot import RosbridgeClient, SimulatedRobot

FAR_AWAY = encode_navigate_to_pose_goal(Pose2D(12.9, 7.6, 0.0), stamp_ns=0, frame_id="map")
NAVIGATE = {"action": "/navigate_to_pose", "action_type": "nav2_msgs/action/NavigateToPose", "args": FAR_AWAY}


def answers(client: RosbridgeClient, request_id: str) -> list[dict[str, Any]]:
    return [operation for operation in client.operations() if operation.get("id") == request_id]


def handled(client: RosbridgeClient, request_id: str) -> None:
    """Send a request that is refused immediately when its turn comes in the queue."""
    client.send(op="call_service", id=request_id, service="/no_such_service", args={})


@pytest.mark.long("/slow", "goal that nobody takes")
@pytest.mark.parametrize("service", ["/slow", "goal", "goal that nobody takes"])
def test_a_goal_and_a_slow_service_hold_their_client_and_no_other(service: str) -> None:
    with (
        SimulatedRobot(ros=2) as robot,
        RosbridgeClient(robot.address) as client,
        RosbridgeClient(robot.address) as other,
    ):
        if service == "/slow":
            robot.fault("slow_services:600")
            client.send(op="call_service", id="slow", service="/eyes/set", args={"data": True})
        else:
            action = "/nobody" if service != "goal" else NAVIGATE["action"]
            client.send(op="send_action_goal", id="goal", **{**NAVIGATE, "action": action})
        handled(client, "behind it")
        handled(other, "elsewhere")
        wait_for(lambda: answers(other, "elsewhere"), "the other client is served")
        handled(other, "again")
        wait_for(lambda: answers(other, "again"), "the other client is served again")
        assert answers(client, "behind it") == []
        if service == "goal":
            other.send(op="cancel_action_goal", id="goal", action=NAVIGATE["action"])
            wait_for(lambda: answers(client, "behind it"), "served when the goal has ended")


def test_in_new_threads_nothing_is_held() -> None:
    switches = ("--send-action-goals-in-new-thread", "--call-services-in-new-thread")
    with SimulatedRobot(*switches, ros=2) as robot, RosbridgeClient(robot.address) as client:
        client.send(op="send_action_goal", id="goal", **NAVIGATE)
        robot.fault("slow_services:600")
        client.send(op="call_service", id="slow", service="/eyes/set", args={"data": True})
        handled(client, "behind it")
        wait_for(lambda: answers(client, "behind it"), "it is served")
