"""Robot models: interface names and types of real robots, from what their makers publish.

Nothing here is copied from the profiles in ``resources/robots``: a mistake in one must show in the other.

- TIAGo and its base (ROS 1): pal-robotics/tiago_robot, pmb2_robot (twist_mux), tiago_tutorials, pal_msgs (TtsAction)
- TurtleBot3 (ROS 2 Jazzy and Humble): ROBOTIS-GIT/turtlebot3 (bringup, node, navigation2, cartographer)
- TurtleBot4 (ROS 2 Jazzy): turtlebot/turtlebot4, turtlebot4-user-manual, iRobotEducation/irobot_create_msgs
- Pepper, NAO (ROS 1): ros-naoqi/naoqi_driver and its documentation (topics of ``/pepper_robot`` and ``/nao_robot``)
"""

import math
from collections.abc import Callable
from dataclasses import replace

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.ros.dialect import Dialect
from caris_desktop.simulator.lidar import LidarModel
from caris_desktop.simulator.robot_interface import (
    AudioTopics,
    BatteryTopic,
    CameraTopics,
    HeadTopics,
    Navigation,
    Order,
    RobotInterface,
    SpeechAction,
    SpeechTopics,
    StopService,
    VelocityInput,
)
from caris_desktop.simulator.robot_simulation import Body
from caris_desktop.simulator.simulated_base import HOLONOMIC, BaseModel
from caris_desktop.simulator.simulated_head import FIXED, HeadModel

DEFAULT = "generic"


class UnknownRobotModel(ValueError):  # noqa: N818 - the user asked for what is not there; nothing is broken
    """Unknown robot model, or not for this ROS; the text lists the available ones."""


def robot_model_named(
    name: str, ros: int | None = None, *, namespace: str | None = None, holonomic: bool = False
) -> RobotInterface:
    """Robot model by name, for ROS 1 or 2 if it exists for both.

    Parameters
    ----------
    namespace
        Put before the names that are relative; None takes what the robot usually has.
    holonomic
        Also for robots whose wheels do not allow it, to practise.

    Raises
    ------
    UnknownRobotModel
        Otherwise.
    """
    cut = _DRESSES.get(name)
    if cut is None:
        raise UnknownRobotModel(f"Unknown robot model '{name}'. Available models: {', '.join(sorted(_DRESSES))}.")
    if ros is not None and ros not in cut:
        (only,) = cut
        raise UnknownRobotModel(f"The robot model '{name}' requires ROS {only}: omit --ros, or choose another model.")
    dress = cut[ros if ros is not None else min(cut)]()
    if namespace is not None:
        dress = replace(dress, namespace=namespace.strip("/"))
    if holonomic and not dress.body.base.left_mps:
        base = replace(dress.body.base, left_mps=HOLONOMIC.left_mps)
        dress = replace(dress, body=replace(dress.body, base=base))
    return dress


def robot_model_names() -> tuple[str, ...]:
    """Names of all models."""
    return tuple(sorted(_DRESSES))


def _generic(dialect: Dialect) -> RobotInterface:
    ros1 = dialect is Dialect.ROS1
    return RobotInterface(
        name="generic",
        dialect=dialect,
        body=Body(),
        velocity=(VelocityInput("/cmd_vel", "either"),),
        scan="/scan",
        odometry="/odom",
        tf="/tf",
        tf_static="/tf_static",
        pose="/amcl_pose",
        map="/map",
        map_updates="/map_updates",
        initial_pose="/initialpose",
        camera=CameraTopics("/camera/image_raw/compressed", "/camera/camera_info", "camera"),
        battery=BatteryTopic("/battery_state"),
        joint_states="/joint_states",
        head=HeadTopics("JointTrajectory", "/head_controller/command", "head_1_joint", "head_2_joint"),
        speech=SpeechTopics("/tts", speaking="/tts/speaking", stop="/tts/stop"),
        audio=AudioTopics("/audio/audio", "/speaker/audio"),
        navigation=(
            Navigation(
                "/move_base", "/move_base_simple/goal", "/move_base/NavfnROS/plan", planner="/move_base/DWAPlannerROS"
            )
            if ros1
            else Navigation("/navigate_to_pose", "/goal_pose", "/plan", speed_limit="/speed_limit")
        ),
        stop_state="/emergency_stop",
        stop_service=StopService("/emergency_stop/set", "std_srvs", "SetBool", "data"),
        slam_toolbox="/slam_toolbox",
        map_server=None if ros1 else "/map_server",
        map_saver=None if ros1 else "/map_saver",
        gadgets=True,
    )


def _tiago() -> RobotInterface:
    return RobotInterface(
        name="tiago",
        dialect=Dialect.ROS1,
        body=Body(
            base=BaseModel(radius_m=0.27, forward_mps=1.0, reverse_mps=0.2, turn_radps=math.radians(120.0)),
            # a SICK TiM5xx behind the gap in the cover of the base
            lidar=LidarModel(
                beams=666,
                angle_min_rad=-1.9199,
                angle_increment_rad=2.0 * 1.9199 / 665,
                range_min_m=0.05,
                range_max_m=25.0,
                robot_from_laser=Pose2D(0.202, 0.0, 0.0),
            ),
            laser_frame="base_laser_link",
            head=HeadModel(pan_range_rad=(-1.24, 1.24), tilt_range_rad=(-0.79, 0.98), fastest_radps=3.0),
            robot_from_camera=Pose2D(0.16, 0.0, 0.0),
            camera_height_m=1.1,
        ),
        # the inputs of the multiplexer, by ascending priority, and the controller behind it
        velocity=tuple(
            VelocityInput(topic)
            for topic in (
                "/nav_vel",
                "/tab_vel",
                "/key_vel",
                "/joy_vel",
                "/rviz_joy_vel",
                "/mobile_base_controller/cmd_vel",
            )
        ),
        scan="/scan",
        odometry="/mobile_base_controller/odom",
        tf="/tf",
        tf_static="/tf_static",
        base_frame="base_footprint",
        odometry_frame="base_footprint",
        same_as_base=("base_link",),
        pose="/amcl_pose",
        map="/map",
        initial_pose="/initialpose",
        camera=CameraTopics("/xtion/rgb/image_raw/compressed", "/xtion/rgb/camera_info", "xtion_rgb_frame"),
        battery=BatteryTopic("/power/battery_level", "Float32 percent"),
        joint_states="/joint_states",
        head=HeadTopics("JointTrajectory", "/head_controller/command", "head_1_joint", "head_2_joint", tilt_sign=-1),
        speech=SpeechAction("/tts"),
        navigation=Navigation("/move_base", "/move_base_simple/goal", "/move_base/GlobalPlanner/plan"),
        # state of the red button on its back, which cannot be pressed remotely
        stop_state="/power/is_emergency",
        orders=(
            Order("action", "/play_motion", "play_motion_msgs", "PlayMotion"),
            Order("topic", "/torso_controller/command", "trajectory_msgs", "JointTrajectory"),
        ),
    )


def _tiago_base() -> RobotInterface:
    """The base alone: no torso, no head, no camera."""
    tiago = _tiago()
    body = replace(tiago.body, head=FIXED)
    return replace(tiago, name="tiago-base", body=body, camera=None, head=None, orders=())


def _turtlebot3_humble() -> RobotInterface:
    return replace(_turtlebot3(), name="turtlebot3-humble", velocity=(VelocityInput("cmd_vel"),))


def _turtlebot3() -> RobotInterface:
    return RobotInterface(
        name="turtlebot3",
        dialect=Dialect.ROS2,
        body=Body(
            base=BaseModel(radius_m=0.14, forward_mps=0.26, reverse_mps=0.26, turn_radps=1.82),
            # LDS-01: counts from straight ahead once around
            lidar=LidarModel(
                beams=360,
                angle_min_rad=0.0,
                angle_increment_rad=math.radians(1.0),
                range_min_m=0.12,
                range_max_m=3.5,
                robot_from_laser=Pose2D(-0.064, 0.0, 0.0),
            ),
            laser_frame="base_scan",
            head=FIXED,
            robot_from_camera=Pose2D(0.076, 0.0, 0.0),
            camera_height_m=0.103,
        ),
        velocity=(VelocityInput("cmd_vel", "TwistStamped"),),
        scan="scan",
        odometry="odom",
        tf="/tf",
        tf_static="/tf_static",
        base_frame="base_footprint",
        odometry_frame="base_footprint",
        same_as_base=("base_link",),
        pose="amcl_pose",
        map="map",
        initial_pose="initialpose",
        camera=CameraTopics("camera/image_raw/compressed", "camera/camera_info", "camera_rgb_frame"),
        battery=BatteryTopic("battery_state", "BatteryState percent"),
        joint_states="joint_states",
        navigation=Navigation("navigate_to_pose", "goal_pose", "plan", speed_limit="speed_limit"),
        stop_service=StopService("motor_power", "std_srvs", "SetBool", "data", stopping=False),
        orders=(Order("service", "sound", "turtlebot3_msgs", "Sound"),),
        slam_toolbox="slam_toolbox",
        map_server="map_server",
        map_saver="map_saver",
    )


def _turtlebot4() -> RobotInterface:
    return RobotInterface(
        name="turtlebot4",
        dialect=Dialect.ROS2,
        body=Body(
            # with its own safety on
            base=BaseModel(radius_m=0.175, forward_mps=0.306, reverse_mps=0.306, turn_radps=1.9),
            # an RPLIDAR A1, mounted a quarter turn to the left
            lidar=LidarModel(range_min_m=0.15, range_max_m=12.0, robot_from_laser=Pose2D(-0.04, 0.0, math.pi / 2)),
            laser_frame="rplidar_link",
            head=FIXED,
            robot_from_camera=Pose2D(-0.06, 0.0, 0.0),
            camera_height_m=0.244,
        ),
        velocity=(VelocityInput("cmd_vel", "TwistStamped"),),
        scan="scan",
        odometry="odom",
        tf="tf",
        tf_static="tf_static",
        base_frame="base_link",
        odometry_frame="base_link",
        same_as_base=("base_footprint",),
        pose="amcl_pose",
        map="map",
        initial_pose="initialpose",
        camera=CameraTopics(
            "oakd/rgb/preview/image_raw/compressed", "oakd/rgb/preview/camera_info", "oakd_rgb_camera_frame"
        ),
        battery=BatteryTopic("battery_state"),
        joint_states="joint_states",
        navigation=Navigation("navigate_to_pose", "goal_pose", "plan", speed_limit="speed_limit"),
        stop_service=StopService("e_stop", "irobot_create_msgs", "EStop", "e_stop_on"),
        orders=(
            Order("topic", "hmi/display/message", "std_msgs", "String"),
            Order("topic", "cmd_lightring", "irobot_create_msgs", "LightringLeds"),
            Order("action", "dock", "irobot_create_msgs", "Dock"),
            Order("action", "undock", "irobot_create_msgs", "Undock"),
        ),
        slam_toolbox="slam_toolbox",
        map_server="map_server",
        map_saver="map_saver",
    )


_POSE_SERVICES = tuple(
    Order("service", f"pose/{name}", "std_srvs", "Empty") for name in ("wakeup", "rest", "life/enable", "life/disable")
)


def _naoqi(name: str, body: Body, *, scan: str | None) -> RobotInterface:
    """naoqi_driver and naoqi_pose as started by their bringup packages, with the ROS navigation stack if there is a
    scan.
    """
    return RobotInterface(
        name=name,
        dialect=Dialect.ROS1,
        body=body,
        namespace=f"{name}_robot",
        velocity=(VelocityInput("/cmd_vel"),),
        scan=scan,
        odometry="odom",
        tf="/tf",
        tf_static="/tf_static",
        base_frame="base_footprint" if scan else "base_link",
        odometry_frame="base_link",
        same_as_base=("base_link",) if scan else ("base_footprint",),
        pose="/amcl_pose" if scan else None,
        map="/map" if scan else None,
        initial_pose="/initialpose" if scan else None,
        camera=CameraTopics("camera/front/image_raw/compressed", "camera/front/camera_info", "CameraTop_frame"),
        joint_states="/joint_states",
        head=HeadTopics("JointAnglesWithSpeed", "/joint_angles", "HeadYaw", "HeadPitch", frames=("Neck", "Head")),
        speech=SpeechTopics("/speech"),
        navigation=Navigation(
            "/move_base" if scan else None, "/move_base_simple/goal", "/move_base/NavfnROS/plan" if scan else None
        ),
        orders=(Order("action", "pose/body_pose_naoqi", "naoqi_bridge_msgs", "BodyPoseWithSpeed"), *_POSE_SERVICES),
    )


def _pepper() -> RobotInterface:
    # three scanners of 15 beams each, merged into 61 with two blind gaps of 8
    lidar = LidarModel(
        beams=61,
        angle_min_rad=-2.0944,
        angle_increment_rad=2.0 * 2.0944 / 61,
        range_min_m=0.1,
        range_max_m=3.0,
        robot_from_laser=Pose2D(0.0, 0.0, 0.0),
        blind=((15, 23), (38, 46)),
    )
    body = Body(
        base=BaseModel(radius_m=0.25, forward_mps=0.55, reverse_mps=0.55, left_mps=0.55, turn_radps=2.0),
        lidar=lidar,
        laser_frame="base_footprint",
        head=HeadModel((-2.0857, 2.0857), (-0.7068, 0.6371), fastest_radps=7.0),
        robot_from_camera=Pose2D(0.07, 0.0, 0.0),
        camera_height_m=1.12,
    )
    return _naoqi("pepper", body, scan="laser")


def _nao() -> RobotInterface:
    body = Body(
        base=BaseModel(radius_m=0.15, forward_mps=0.1, reverse_mps=0.1, left_mps=0.1, turn_radps=0.8),
        lidar=None,
        laser_frame="base_footprint",
        head=HeadModel((-2.0857, 2.0857), (-0.672, 0.5149), fastest_radps=8.0),
        robot_from_camera=Pose2D(0.06, 0.0, 0.0),
        camera_height_m=0.5,
    )
    return _naoqi("nao", body, scan=None)


_DRESSES: dict[str, dict[int, Callable[[], RobotInterface]]] = {
    DEFAULT: {1: lambda: _generic(Dialect.ROS1), 2: lambda: _generic(Dialect.ROS2)},
    "tiago": {1: _tiago},
    "tiago-base": {1: _tiago_base},
    "turtlebot3": {2: _turtlebot3},
    "turtlebot3-humble": {2: _turtlebot3_humble},
    "turtlebot4": {2: _turtlebot4},
    "pepper": {1: _pepper},
    "nao": {1: _nao},
}
