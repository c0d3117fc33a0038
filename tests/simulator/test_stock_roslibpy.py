"""Unmodified roslibpy with the simulated robot in ROS 1 and ROS 2."""

import base64
import math
import time
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest
import roslibpy
from roslibpy.ros1 import actionlib

from tests.support.polling import wait_for
from tests.support.simulated_robot import SimulatedRobot

TYPES = {
    1: {
        "twist": "geometry_msgs/Twist",
        "scan": "sensor_msgs/LaserScan",
        "image": "sensor_msgs/CompressedImage",
        "odom": "nav_msgs/Odometry",
        "text": "std_msgs/String",
        "bool": "std_msgs/Bool",
        "empty": "std_msgs/Empty",
    },
    2: {
        "twist": "geometry_msgs/msg/Twist",
        "scan": "sensor_msgs/msg/LaserScan",
        "image": "sensor_msgs/msg/CompressedImage",
        "odom": "nav_msgs/msg/Odometry",
        "text": "std_msgs/msg/String",
        "bool": "std_msgs/msg/Bool",
        "empty": "std_msgs/msg/Empty",
    },
}
NEAR_THE_START = {"position": {"x": 1.4, "y": 2.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.5, "w": 0.866}}
FAR_AWAY = {"position": {"x": 12.9, "y": 7.6, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}


@pytest.fixture(scope="module", params=[1, 2], ids=["ros1", "ros2"])
def robot(request: pytest.FixtureRequest) -> Iterator[SimulatedRobot]:
    # roslibpy has one websocket, which a goal would block until its end.
    with SimulatedRobot("--send-action-goals-in-new-thread", ros=request.param) as running:
        yield running


@pytest.fixture(scope="module")
def ros(robot: SimulatedRobot) -> Iterator[roslibpy.Ros]:
    client = roslibpy.Ros("127.0.0.1", robot.port, transport="asyncio")
    client.run(timeout=10)
    yield client
    client.close()


def listen(ros: roslibpy.Ros, name: str, type_name: str) -> tuple[roslibpy.Topic, list[Any]]:
    received: list[Any] = []
    topic = roslibpy.Topic(ros, name, type_name, queue_length=1)
    topic.subscribe(received.append)
    return topic, received


def stamp_s(message: Any) -> float:
    stamp = message["header"]["stamp"]
    return float(stamp["secs"] + stamp["nsecs"] * 1e-9 if "secs" in stamp else stamp["sec"] + stamp["nanosec"] * 1e-9)


@pytest.mark.long
def test_it_lists_what_a_ros_user_expects(robot: SimulatedRobot, ros: roslibpy.Ros) -> None:
    types = TYPES[robot.ros]
    expected = {"/cmd_vel", "/scan", "/odom", "/map", "/tf", "/amcl_pose", "/battery_state", "/tts"}
    assert expected | {"/camera/image_raw/compressed"} <= set(ros.get_topics())
    assert ros.get_topic_type("/scan") == types["scan"]
    assert ros.get_topics_for_type(types["twist"]) == ["/cmd_vel"]
    assert "/emergency_stop/set" in ros.get_services()
    assert ros.get_service_type("/emergency_stop/set").endswith("SetBool")
    # Ros.get_time() itself supports only the time fields of ROS 1
    now = roslibpy.Service(ros, "/rosapi/get_time", "rosapi/GetTime").call({}, timeout=10)["time"]
    assert abs(now["secs" if robot.ros == 1 else "sec"] - time.time()) < 5


@pytest.mark.long("ros1")
def test_scans_and_pictures_arrive(robot: SimulatedRobot, ros: roslibpy.Ros) -> None:
    types = TYPES[robot.ros]
    scan_topic, scans = listen(ros, "/scan", types["scan"])
    image_topic, images = listen(ros, "/camera/image_raw/compressed", types["image"])
    wait_for(lambda: len(scans) >= 5 and len(images) >= 5, "scans and pictures")
    scan_topic.unsubscribe()
    image_topic.unsubscribe()
    scan = scans[-1]
    assert len(scan["ranges"]) == 720
    assert scan["angle_max"] - scan["angle_min"] == pytest.approx(2 * math.pi, abs=0.02)
    assert any(distance is not None and distance < 2.0 for distance in scan["ranges"])
    assert abs(stamp_s(scan) - time.time()) < 5
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(images[-1]["data"]), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (480, 640, 3)
    assert picture.std() > 20
    assert "jpeg" in images[-1]["format"]


def test_it_drives_and_stops_automatically(robot: SimulatedRobot, ros: roslibpy.Ros) -> None:
    types = TYPES[robot.ros]
    odom_topic, odometry = listen(ros, "/odom", types["odom"])
    drive = roslibpy.Topic(ros, "/cmd_vel", types["twist"])

    def speed() -> float:
        return float(odometry[-1]["twist"]["twist"]["angular"]["z"]) if odometry else 0.0

    def turn() -> bool:
        drive.publish({"linear": {"x": 0.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.8}})
        return speed() > 0.7

    wait_for(turn, "the robot turns", every_s=0.05)
    last_command_s = time.monotonic()
    wait_for(lambda: speed() == 0.0, "the robot stops by itself", every_s=0.005)
    assert 0.4 < time.monotonic() - last_command_s < 3.0
    odom_topic.unsubscribe()


def test_it_speaks_and_can_be_interrupted(robot: SimulatedRobot, ros: roslibpy.Ros) -> None:
    types = TYPES[robot.ros]
    speaking_topic, speaking = listen(ros, "/tts/speaking", types["bool"])
    wait_for(lambda: speaking, "the latched state of the voice")
    roslibpy.Topic(ros, "/tts", types["text"]).publish({"data": "Hello, I am a robot with a very long sentence. " * 5})
    wait_for(lambda: speaking[-1]["data"], "it speaks")
    roslibpy.Topic(ros, "/tts/stop", types["empty"]).publish({})
    wait_for(lambda: not speaking[-1]["data"], "it is silent")
    speaking_topic.unsubscribe()


@pytest.mark.parametrize("robot", [1], ids=["ros1"], indirect=True)
@pytest.mark.long
def test_goals_of_ros1_are_reached_and_cancelled(robot: SimulatedRobot, ros: roslibpy.Ros) -> None:
    client = actionlib.ActionClient(ros, "/move_base", "move_base_msgs/MoveBaseAction")
    feedback: list[Any] = []
    near = actionlib.Goal(client, {"target_pose": {"header": {"frame_id": "map"}, "pose": NEAR_THE_START}})
    near.on("feedback", feedback.append)
    near.send()
    near.wait(25)
    assert near.status["status"] == actionlib.GoalStatus.SUCCEEDED
    assert feedback[-1]["base_position"]["pose"]["position"]["x"] == pytest.approx(1.4, abs=0.3)
    assert math.dist((robot.state()["pose"]["x_m"], robot.state()["pose"]["y_m"]), (1.4, 2.0)) < 0.15

    far = actionlib.Goal(client, {"target_pose": {"header": {"frame_id": "map"}, "pose": FAR_AWAY}})
    far.send()
    wait_for(lambda: robot.state()["speed_mps"] > 0.1, "it is on its way")
    far.cancel()
    far.wait(5)
    assert far.status["status"] == actionlib.GoalStatus.PREEMPTED
    wait_for(lambda: robot.state()["speed_mps"] == 0.0, "it stands")
    client.dispose()


@pytest.mark.parametrize("robot", [2], ids=["ros2"], indirect=True)
def test_goals_of_ros2_are_reached_and_cancelled(robot: SimulatedRobot, ros: roslibpy.Ros) -> None:
    client = roslibpy.ActionClient(ros, "/navigate_to_pose", "nav2_msgs/action/NavigateToPose")
    results: list[Any] = []
    feedback: list[Any] = []
    failures: list[Any] = []

    def send(pose: dict[str, Any]) -> Any:
        goal = roslibpy.Goal({"pose": {"header": {"frame_id": "map"}, "pose": pose}, "behavior_tree": ""})
        return client.send_goal(goal, results.append, feedback.append, failures.append)

    near = send(NEAR_THE_START)
    client.wait_goal(near, 25)
    assert results[-1]["status"] == roslibpy.GoalStatus.SUCCEEDED
    assert feedback[0]["distance_remaining"] > 0.3
    assert math.dist((robot.state()["pose"]["x_m"], robot.state()["pose"]["y_m"]), (1.4, 2.0)) < 0.15

    far = send(FAR_AWAY)
    wait_for(lambda: robot.state()["speed_mps"] > 0.1, "it is on its way")
    client.cancel_goal(far)
    client.wait_goal(far, 5)
    assert results[-1]["status"] == roslibpy.GoalStatus.CANCELED
    assert failures == []
    wait_for(lambda: robot.state()["speed_mps"] == 0.0, "it stands")

    again = send(FAR_AWAY)
    wait_for(lambda: robot.state()["speed_mps"] > 0.1, "it is on its way again")
    cancel = roslibpy.Service(ros, "/navigate_to_pose/_action/cancel_goal", "action_msgs/srv/CancelGoal")
    somebody_elses = {"goal_info": {"goal_id": {"uuid": [*range(16)]}, "stamp": {"sec": 0, "nanosec": 0}}}
    assert cancel.call(somebody_elses, timeout=10)["return_code"] == 2
    assert robot.state()["goal_id"]
    # An empty id with time zero means every goal, and ROS fills missing fields with zero.
    assert cancel.call({}, timeout=10)["return_code"] == 0
    client.wait_goal(again, 5)
    assert results[-1]["status"] == roslibpy.GoalStatus.CANCELED


def test_a_service_that_fails_says_why(ros: roslibpy.Ros) -> None:
    with pytest.raises(Exception, match="unknown fault 'set fire'; available: "):
        roslibpy.Service(ros, "/simulator/fault", "simulator/Fault").call({"command": "set fire"}, timeout=10)
