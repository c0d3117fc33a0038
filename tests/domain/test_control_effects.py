"""Effect of a control on the robot: decided by names, types and values, never by the file's claim."""

import random
from dataclasses import replace
from typing import Any

import pytest

from caris_desktop.domain.control_definitions import CallService, PublishMessage, RobotControl, SendActionGoal, decided
from caris_desktop.domain.control_effects import ControlClass, RobotInterfaceNames, StopField, control_class

ROBOT = RobotInterfaceNames(
    motion=("/base/twists", "/go", "/where", "/top_speed", "/local_planner_node", "/pan_tilt"),
    stop=(StopField("/halt_all", "on", True), StopField("/motor_power", "data", False), StopField("/set_it")),
    stop_release=("/let_go",),
)
Case = tuple[str, str, dict[str, Any], ControlClass]
CASES: list[Case] = [
    # Goals, poses, trajectories, heads, joysticks, velocities, parameters: by type or by name.
    ("/move_base/goal", "move_base_msgs/MoveBaseActionGoal", {}, "motion"),
    ("/move_base_simple/goal", "geometry_msgs/PoseStamped", {}, "motion"),
    ("/x", "geometry_msgs/msg/PoseStamped", {}, "motion"),
    ("/navigate_to_pose", "nav2_msgs/action/NavigateToPose", {}, "motion"),
    ("/follow_waypoints", "nav2_msgs/action/FollowWaypoints", {}, "motion"),
    ("/backup", "nav2_msgs/action/BackUp", {}, "motion"),
    ("/lamp", "nav2_msgs/action/Spin", {}, "motion"),
    ("/initialpose", "geometry_msgs/PoseWithCovarianceStamped", {}, "motion"),
    ("/set_pose", "robot_localization/SetPose", {}, "motion"),
    ("/arm_controller/command", "trajectory_msgs/JointTrajectory", {}, "motion"),
    ("/leds", "trajectory_msgs/msg/JointTrajectory", {}, "motion"),
    ("/position_controller/commands", "std_msgs/msg/Float64MultiArray", {}, "motion"),
    ("/leds", "std_msgs/msg/Float64MultiArray", {}, "motion"),
    ("/volume", "std_msgs/Int16MultiArray", {}, "motion"),
    ("/screen", "geometry_msgs/msg/Twist", {}, "motion"),
    ("/joint_angles", "naoqi_bridge_msgs/JointAnglesWithSpeed", {}, "motion"),
    ("/head_controller/point_head_action", "control_msgs/PointHeadAction", {}, "motion"),
    ("/play_motion", "play_motion_msgs/PlayMotionAction", {}, "motion"),
    ("/animated_speech", "std_msgs/String", {}, "motion"),
    ("/face_tracker/enable", "std_srvs/SetBool", {"data": True}, "motion"),
    ("/joy", "sensor_msgs/Joy", {}, "motion"),
    ("/ackermann_cmd", "ackermann_msgs/AckermannDriveStamped", {}, "motion"),
    ("/cmdvel_light", "std_msgs/String", {}, "motion"),
    ("/moveBase/go", "std_srvs/Trigger", {}, "motion"),
    ("/motors/enable", "std_srvs/SetBool", {"data": True}, "motion"),
    ("/dwb/set_parameters", "dynamic_reconfigure/Reconfigure", {}, "motion"),
    ("/controller_server/set_parameters", "rcl_interfaces/srv/SetParameters", {}, "motion"),
    ("/rosapi/set_param", "rosapi/SetParam", {}, "motion"),
    ("/mux/select", "topic_tools/MuxSelect", {}, "motion"),
    # Interfaces used for motion in the profile, whatever their name and type.
    ("/base/twists", "my_msgs/Numbers", {}, "motion"),
    ("go/goal", "my_msgs/Numbers", {}, "motion"),
    ("/where", "std_msgs/String", {}, "motion"),
    ("/top_speed", "std_msgs/Float32", {}, "motion"),
    ("/local_planner_node/set_parameters", "my_msgs/Set", {}, "motion"),
    ("/pan_tilt", "std_msgs/String", {}, "motion"),
    # Release of a stop, by names in the profile and common names of drivers.
    ("/halt_all", "my_msgs/Halt", {"on": False}, "stop_release"),
    ("/halt_all", "my_msgs/Halt", {"on": "$value"}, "stop_release"),
    ("halt_all/", "my_msgs/Halt", {}, "stop_release"),
    ("/motor_power", "std_srvs/SetBool", {"data": True}, "stop_release"),
    ("/let_go", "std_srvs/Trigger", {}, "stop_release"),
    ("/e_stop", "irobot_create_msgs/srv/EStop", {"e_stop_on": False}, "stop_release"),
    ("/hardware/e_stop_reset", "std_srvs/srv/Trigger", {}, "stop_release"),
    ("/emergency_stop", "std_msgs/Bool", {"data": False}, "stop_release"),
    ("/emergency_stop", "std_msgs/Bool", {"data": "$value"}, "stop_release"),
    ("/emergency_stop", "std_msgs/Bool", {}, "stop_release"),
    ("/safety/override", "std_srvs/SetBool", {"data": True}, "stop_release"),
    ("/brake/release", "std_srvs/Trigger", {}, "stop_release"),
    # Stop and cancel always pass.
    ("/halt_all", "my_msgs/Halt", {"on": True}, "stop"),
    ("/motor_power", "std_srvs/SetBool", {"data": False}, "stop"),
    ("/set_it", "std_srvs/Trigger", {}, "stop"),
    ("/move_base/cancel", "actionlib_msgs/GoalID", {}, "stop"),
    ("/emergency_stop", "std_msgs/Bool", {"data": True}, "stop"),
    ("/speech/stop", "std_srvs/Trigger", {}, "stop"),
    # Known harmless types, and unknown ones.
    ("/leds/color", "std_msgs/ColorRGBA", {}, "harmless"),
    ("/eyes/set", "std_srvs/srv/SetBool", {"data": "$value"}, "harmless"),
    ("/volume", "std_msgs/Float32", {"data": "$value"}, "harmless"),
    ("/screen/text", "std_msgs/String", {"data": "$value"}, "harmless"),
    ("/hmi/display/message", "std_msgs/msg/String", {}, "harmless"),
    ("/cmd_lightring", "irobot_create_msgs/msg/LightringLeds", {}, "harmless"),
    ("/sound", "turtlebot3_msgs/srv/Sound", {"value": 1}, "harmless"),
    ("/lamp", "my_msgs/Whatever", {}, "unknown"),
    # A number for an eye or a face may turn it.
    ("/eyes", "std_msgs/Float64", {"data": "$value"}, "unknown"),
    ("/face", "std_msgs/msg/Float32", {"data": "$value"}, "unknown"),
    ("/face/show", "std_msgs/String", {"data": "$value"}, "harmless"),
    ("/voice/commands", "std_msgs/String", {}, "unknown"),
    ("/quiz/next", "std_srvs/Trigger", {}, "unknown"),
    ("/emergency_light", "std_msgs/Bool", {"data": "$value"}, "unknown"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "type_name", "message", "wanted"), CASES)
def test_the_sent_value_states_what_a_control_does(
    name: str, type_name: str, message: dict[str, Any], wanted: ControlClass
) -> None:
    assert control_class(name, type_name, message, ROBOT) == wanted


def test_no_claim_of_a_file_makes_motion_or_a_release_harmless() -> None:
    chance = random.Random(25)  # noqa: S311 - a test, not cryptography
    effects = (PublishMessage, CallService, SendActionGoal)
    for _ in range(200):
        name, type_name, message, wanted = chance.choice(CASES)
        package, _, base = (
            type_name.replace("/msg/", "/").replace("/srv/", "/").replace("/action/", "/").rpartition("/")
        )
        spelled = f"{package}/{chance.choice(['', 'msg/', 'srv/', 'action/'])}{base}"
        spelled_name = chance.choice(["", "/"]) + name.strip("/")
        effect = chance.choice(effects)(spelled_name, spelled, message)
        control = decided(RobotControl("x", "Lamp", "button", effect, moves=False, group="Lights"), ROBOT)
        assert control.control_class == wanted, effect
        assert control.is_motion == (wanted in ("motion", "stop_release"))
        assert control.is_held_by_stop == (wanted not in ("stop", "harmless"))
        assert control.releases_stop == (wanted == "stop_release")
        louder = replace(control, moves=True)
        assert louder.is_held_by_stop == (wanted != "stop")


@pytest.mark.parametrize("prefix", ["robot1", "ns/robot_2"])
def test_a_namespace_changes_nothing(prefix: str) -> None:
    for name, type_name, message, wanted in CASES:
        if wanted in ("motion", "stop_release") and not any(
            name.strip("/").startswith(own.strip("/"))
            for own in (*ROBOT.motion, *ROBOT.stop_release, *(one.name for one in ROBOT.stop))
        ):
            assert control_class(f"/{prefix}/{name.strip('/')}", type_name, message, ROBOT) == wanted
