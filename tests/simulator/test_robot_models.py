"""Robot models: names and types in rosapi, motion, and sensor data in their frames."""

import contextlib
import math
from collections.abc import Iterator
from typing import Any

import pytest

from caris_desktop.ros.dialect import Dialect
from caris_desktop.simulator import typedefs
from caris_desktop.simulator.robot_models import UnknownRobotModel, robot_model_named, robot_model_names
from caris_desktop.simulator.shipped_data import shipped_data
from tests.support.leak_checks import share_in_module
from tests.support.polling import wait_for
from tests.support.simulated_robot import RosbridgeClient, SimulatedRobot

# robot model: velocity topic and type, scan, odometry, camera, frames of scan and of the odometry's child
PUBLISHED: dict[str, tuple[str, str, str | None, str, str, tuple[str, str]]] = {
    "tiago": (
        "/nav_vel",
        "geometry_msgs/Twist",
        "/scan",
        "/mobile_base_controller/odom",
        "/xtion/rgb/image_raw/compressed",
        ("base_laser_link", "base_footprint"),
    ),
    "turtlebot3": (
        "/cmd_vel",
        "geometry_msgs/msg/TwistStamped",
        "/scan",
        "/odom",
        "/camera/image_raw/compressed",
        ("base_scan", "base_footprint"),
    ),
    "turtlebot4": (
        "/cmd_vel",
        "geometry_msgs/msg/TwistStamped",
        "/scan",
        "/odom",
        "/oakd/rgb/preview/image_raw/compressed",
        ("rplidar_link", "base_link"),
    ),
    "pepper": (
        "/cmd_vel",
        "geometry_msgs/Twist",
        "/pepper_robot/laser",
        "/pepper_robot/odom",
        "/pepper_robot/camera/front/image_raw/compressed",
        ("base_footprint", "base_link"),
    ),
    "nao": (
        "/cmd_vel",
        "geometry_msgs/Twist",
        None,
        "/nao_robot/odom",
        "/nao_robot/camera/front/image_raw/compressed",
        ("", "base_link"),
    ),
}


class Wardrobe:
    """One robot of each requested model, started once."""

    def __init__(self) -> None:
        self._open = contextlib.ExitStack()
        self._robots: dict[str, SimulatedRobot] = {}

    def wearing(self, name: str) -> SimulatedRobot:
        if name not in self._robots:
            self._robots[name] = self._open.enter_context(SimulatedRobot("--empty", robot_model=name))
            share_in_module(self._robots[name].pid, self._robots[name].folder.name)
        return self._robots[name]

    def close(self) -> None:
        self._open.close()


@pytest.fixture(scope="module")
def wardrobe() -> Iterator[Wardrobe]:
    robots = Wardrobe()
    yield robots
    robots.close()


@pytest.mark.parametrize("name", sorted(PUBLISHED))
@pytest.mark.long
def test_a_robot_model_is_listed_moved_and_seen_by_its_own_names(wardrobe: Wardrobe, name: str) -> None:
    velocity, type_, scan, odometry, camera, (scan_frame, child_frame) = PUBLISHED[name]
    robot = wardrobe.wearing(name)
    with RosbridgeClient(robot.address) as client:
        listed = client.call("/rosapi/topics")
        types = dict(zip(listed["topics"], listed["types"], strict=True))
        assert types[velocity] == type_
        assert types[camera].endswith("CompressedImage")
        robot.fault("pose:9,5,90")
        for topic in (scan, odometry):
            if topic is not None:
                client.subscribe(topic, queue_length=1)
        assert client.wait_for_messages(odometry)[0]["child_frame_id"] == child_frame
        if scan is not None:
            seen = client.wait_for_messages(scan)[0]
            assert seen["header"]["frame_id"] == scan_frame
            # in the corridor, 0.74 m from the wall, independent of the scanner's pose
            assert _distance_ahead(seen, name) == pytest.approx(0.74 - _scanner_ahead_m(name), abs=0.06)
        twist = {"linear": {"x": 0.08}, "angular": {"z": 0.0}}
        client.publish(velocity, {"header": {}, "twist": twist} if type_.endswith("Stamped") else twist)
        wait_for(lambda: robot.state()["speed_mps"] > 0.05, "it moves")
        client.publish(velocity, twist if type_.endswith("Stamped") else {"twist": twist})
        wait_for(lambda: "does not have a field" in str(robot.state()["refusals"]), "the other type is refused")


def _distance_ahead(scan: dict[str, Any], name: str) -> float:
    mounted_rad = math.pi / 2 if name == "turtlebot4" else 0.0
    turns = (-mounted_rad - scan["angle_min"]) / scan["angle_increment"]
    return float(scan["ranges"][round(turns) % len(scan["ranges"])])


def _scanner_ahead_m(name: str) -> float:
    return {"tiago": 0.202, "turtlebot3": -0.064, "turtlebot4": -0.04, "pepper": 0.0}[name]


@pytest.mark.long
def test_pal_speech_needs_a_language_speaks_and_is_preempted(wardrobe: Wardrobe) -> None:
    robot = wardrobe.wearing("tiago")
    with RosbridgeClient(robot.address) as client:
        client.subscribe("/tts/result", type="pal_interaction_msgs/TtsActionResult")

        def say(goal_id: str, text: str, language: str) -> None:
            goal = {"rawtext": {"text": text, "lang_id": language}}
            client.publish("/tts/goal", {"goal_id": {"id": goal_id}, "goal": goal})

        def endings() -> dict[str, int]:
            results = client.messages("/tts/result")
            return {result["status"]["goal_id"]["id"]: result["status"]["status"] for result in results}

        say("silent", "Hello", "")
        say("long", "This sentence is so long that nobody will hear the end of it. " * 3, "en_GB")
        wait_for(lambda: robot.state()["speaking"].startswith("This"), "it speaks")
        say("short", "Hi", "en_GB")
        wait_for(lambda: len(endings()) == 3, f"all ended, have {endings()}")
        assert endings() == {"silent": 4, "long": 2, "short": 3}


def test_tiagos_tilt_joint_is_inverted_and_its_stop_button_reported(wardrobe: Wardrobe) -> None:
    robot = wardrobe.wearing("tiago")
    with RosbridgeClient(robot.address) as client:
        point = {"positions": [0.3, -0.4], "time_from_start": {"secs": 0, "nsecs": 300_000_000}}
        names = ["head_1_joint", "head_2_joint"]
        client.publish("/head_controller/command", {"joint_names": names, "points": [point]})
        wait_for(lambda: robot.state()["head"]["tilt_rad"] > 0.39, "it looks down")
        client.subscribe("/power/is_emergency")
        robot.fault("press_stop_button")
        wait_for(lambda: client.messages("/power/is_emergency")[-1:] == [{"data": True}], "it is told")
        client.publish("/key_vel", {"linear": {"x": 0.2}})
        assert robot.state()["speed_mps"] == 0.0
        robot.fault("release_stop_button")
        client.subscribe("/power/battery_level")
        assert 50.0 < client.wait_for_messages("/power/battery_level")[0]["data"] <= 100.0


@pytest.mark.long
def test_naoqi_turns_its_head_by_share_of_speed_and_walks_sideways(wardrobe: Wardrobe) -> None:
    robot = wardrobe.wearing("nao")
    with RosbridgeClient(robot.address) as client:
        message = {"joint_names": ["HeadYaw"], "joint_angles": [0.5], "speed": 0.2, "relative": 0}
        client.publish("/joint_angles", message)
        wait_for(lambda: robot.state()["head"]["pan_rad"] == pytest.approx(0.5, abs=0.01), "it looks left")
        client.publish("/joint_angles", {**message, "joint_angles": [-0.2], "relative": 1})
        wait_for(lambda: robot.state()["head"]["pan_rad"] == pytest.approx(0.3, abs=0.01), "a little less")
        client.publish("/cmd_vel", {"linear": {"x": 0.0, "y": 0.3}, "angular": {"z": 0.0}})
        wait_for(lambda: robot.state()["speed_left_mps"] == pytest.approx(0.1), "as fast as it can")
        client.publish("/speech", {"data": "Hi"})
        wait_for(lambda: robot.state()["speaking"] == "Hi", "it speaks")


def test_turtlebots_have_their_own_ways_to_cut_the_motors(wardrobe: Wardrobe) -> None:
    for name, service, cut, restored in (
        ("turtlebot4", "/e_stop", {"e_stop_on": True}, {"e_stop_on": False}),
        ("turtlebot3", "/motor_power", {"data": False}, {"data": True}),
    ):
        robot = wardrobe.wearing(name)
        assert robot.call(service, **cut)["success"] is True
        assert robot.state()["emergency_stopped"] is True
        robot.call(service, **restored)
        assert robot.state()["emergency_stopped"] is False


def test_a_namespace_is_put_before_relative_names_only() -> None:
    dress = robot_model_named("turtlebot4", namespace="robot1")
    assert dress.absolute(dress.odometry) == "/robot1/odom"
    assert dress.absolute("/simulator/state") == "/simulator/state"
    assert robot_model_named("pepper").absolute("odom") == "/pepper_robot/odom"
    assert robot_model_named("pepper", namespace="naoqi_driver").absolute("odom") == "/naoqi_driver/odom"


def test_an_unknown_robot_model_is_refused_with_a_list() -> None:
    with pytest.raises(
        UnknownRobotModel, match="generic, nao, pepper, tiago, tiago-base, turtlebot3, turtlebot3-humble, turtlebot4"
    ):
        robot_model_named("r2d2")
    with pytest.raises(UnknownRobotModel, match="ROS 2"):
        robot_model_named("turtlebot3", 1)
    assert robot_model_named("generic", 2).dialect is Dialect.ROS2
    assert robot_model_named("tiago", holonomic=True).body.base.left_mps > 0.0


def test_a_message_that_its_type_does_not_allow_is_a_misfit() -> None:
    def misfit(type_: str, message: Any) -> str:
        return typedefs.misfit(Dialect.ROS1, type_, message) or ""

    assert misfit("geometry_msgs/Twist", {"linear": {"x": 1}, "angular": {}}) == ""
    assert "does not have a field forward" in misfit("geometry_msgs/Twist", {"forward": 1.0})
    assert "linear.x must be a float64" in misfit("geometry_msgs/Twist", {"linear": {"x": "fast"}})
    assert "data must be a bool" in misfit("std_msgs/Bool", {"data": 1})
    assert "data must be a list" in misfit("nav_msgs/OccupancyGrid", {"data": 5})
    assert "must be a" in misfit("tf2_msgs/TFMessage", {"transforms": [5]})
    assert misfit("my_msgs/Unknown", {"anything": 1}) == ""


def test_commands_of_a_robot_model_are_noted_and_answered(wardrobe: Wardrobe) -> None:
    robot = wardrobe.wearing("nao")
    with RosbridgeClient(robot.address) as client:
        assert client.call("/nao_robot/pose/rest") == {}
        action = "/nao_robot/pose/body_pose_naoqi"
        client.subscribe(f"{action}/result")
        for goal_id, posture in (("sit", "Sit"), ("stand", "Stand")):
            client.publish(f"{action}/goal", {"goal_id": {"id": goal_id}, "goal": {"posture_name": posture}})
        client.publish(f"{action}/cancel", {"id": "stand"})
        client.publish(f"{action}/goal", {"goal": {"posture": "Crouch"}})
        wait_for(lambda: "does not have a field" in str(robot.state()["refusals"]), "there is no such field")
        results = client.wait_for_messages(f"{action}/result", 2)
        assert {r["status"]["goal_id"]["id"]: r["status"]["status"] for r in results} == {"stand": 2, "sit": 3}
        names = [order["name"] for order in robot.state()["orders"]]
        assert names == ["/nao_robot/pose/rest", action, action]


def test_every_definition_can_be_resolved_to_the_last_field() -> None:
    shipped = shipped_data("ros-types.yaml")
    for dialect in Dialect:
        for name in ("nav_msgs/Odometry", *shipped["both"], *shipped[dialect.name.lower()]):
            parts = [typedefs.typedefs_of(dialect, name, part) for part in range(3)]
            assert parts[0], name
            for typedef in (each for part in parts for each in part):
                assert len(typedef["fieldnames"]) == len(typedef["fieldtypes"]) == len(typedef["fieldarraylen"])
                nested = [kind for kind in typedef["fieldtypes"] if "/" in kind]
                assert all(typedefs.is_known(dialect, kind) for kind in nested), typedef["type"]
    assert set(robot_model_names()) == {"generic", "tiago-base", "turtlebot3-humble", *PUBLISHED}


def test_types_without_cbor_are_known_by_their_definition_and_content() -> None:
    def refused(dialect: Dialect, type_: str, message: dict[str, Any]) -> bool:
        return typedefs.cbor_refusal(dialect, type_, message) is not None

    for dialect in Dialect:
        assert refused(dialect, "nav_msgs/Odometry", {})
        assert refused(dialect, "sensor_msgs/CameraInfo", {})
        assert not refused(dialect, "sensor_msgs/LaserScan", {"ranges": [1.0]})
        assert not refused(dialect, "tf2_msgs/TFMessage", {"transforms": [{"child_frame_id": "x"}]})
        assert not refused(dialect, "sensor_msgs/JointState", {"name": []})
    assert refused(Dialect.ROS1, "sensor_msgs/JointState", {"name": ["pan"]})
    assert not refused(Dialect.ROS2, "sensor_msgs/JointState", {"name": ["pan"]})
    assert refused(Dialect.ROS2, "action_msgs/GoalStatusArray", {"status_list": [{"goal_info": {"goal_id": {}}}]})
    assert not refused(Dialect.ROS2, "action_msgs/GoalStatusArray", {"status_list": []})
