"""What a robot profile holds: the parts of which :mod:`caris_desktop.robot.profile` reads and writes files."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal
from urllib.parse import urlsplit

from caris_desktop.domain.camera import CameraModel
from caris_desktop.domain.controls import RobotControl
from caris_desktop.domain.geometry import Pose2D

DEFAULT_ADDRESS = "ws://127.0.0.1:9090"

RosVersion = Literal[1, 2]
PictureType = Literal["CompressedImage", "Image"]
VelocityType = Literal["Twist", "TwistStamped"]
NavigationKind = Literal["move_base", "navigate_to_pose"]

LONGEST_TIMEOUT_S = 1.0
WITHOUT_TIMEOUT_FRACTION = 0.5


class ProfileError(ValueError):
    """A robot profile that cannot be used; the text names the file, the line and what is allowed."""


@dataclass(frozen=True, slots=True)
class TopicSource:
    """A topic to listen to, at most once every ``throttle_ms`` (0: as often as it comes).

    ``latched``: its last message is kept for late listeners (latch in ROS 1, transient local in ROS 2).
    """

    topic: str
    throttle_ms: int = 0
    latched: bool = False


@dataclass(frozen=True, slots=True)
class VelocityTopic:
    """Where velocity commands go: the base itself, or the wizard's input of a velocity multiplexer.

    ``frame_id`` is used in the header of a TwistStamped. ``timeout_s`` is after how long without a command the base
    stops by itself, and ``timeout_source`` where that is documented; None where nobody has said so.
    """

    topic: str = "/cmd_vel"
    type: VelocityType = "Twist"
    frame_id: str = "base_link"
    timeout_s: float | None = None
    timeout_source: str = ""


@dataclass(frozen=True, slots=True)
class TransformFrames:
    """The frames of the robot's transform tree (tf)."""

    map: str = "map"
    odom: str = "odom"
    base: str = "base_link"


@dataclass(frozen=True, slots=True)
class CameraTopic:
    """One camera. ``type`` is of sensor_msgs: Image is not compressed and a heavy load. ``model`` tells where it looks;
    ``info`` is a topic of sensor_msgs/CameraInfo whose focal lengths replace those of the model.
    """

    name: str
    topic: str
    throttle_ms: int = 60
    model: CameraModel | None = None
    info: str | None = None
    type: PictureType = "CompressedImage"


@dataclass(frozen=True, slots=True)
class SpeedLimitInterface:
    """How the navigation is told its top speed: a ``topic`` of nav2_msgs/SpeedLimit (ROS 2), or the ``parameters`` of
    the local planner's node ``reconfigure`` (dynamic_reconfigure, ROS 1).
    """

    topic: str | None = None
    reconfigure: str | None = None
    parameters: tuple[str, ...] = ("max_vel_x", "max_vel_trans")


@dataclass(frozen=True, slots=True)
class NavigationServer:
    """What takes navigation goals: actionlib's move_base (ROS 1) or the NavigateToPose action (ROS 2).

    ``max_mps`` is how fast the robot's navigation is set up to drive, where that is known; it is never told more.
    """

    kind: NavigationKind
    name: str
    max_mps: float | None = None
    speed_limit: SpeedLimitInterface | None = None


@dataclass(frozen=True, slots=True)
class SpeechAction:
    """A speech action (actionlib in ROS 1). ``$value`` in ``goal`` stands for the text; its result is the end."""

    name: str
    type: str
    goal: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class SpeechInterface:
    """The robot's own voice: an action, or a topic of std_msgs/String.

    With a topic: ``speaking`` is std_msgs/Bool while it speaks, ``stop`` std_msgs/Empty to stop it.
    """

    topic: str | None = None
    speaking: str | None = None
    stop: str | None = None
    action: SpeechAction | None = None


@dataclass(frozen=True, slots=True)
class EmergencyStopInterface:
    """The robot's own emergency stop.

    ``topic`` tells its state (std_msgs/Bool, True while stopped; the other way round with ``inverted``). It is set by
    ``service`` (std_srvs/SetBool, or another whose ``service_field`` is a bool, which ``service_stop_value`` stops), or
    by ``set_service`` and ``clear_service`` (std_srvs/Trigger or Empty as ``service_type`` says), or by publishing
    std_msgs/Bool on ``command_topic``.
    """

    topic: str | None = None
    inverted: bool = False
    service: str | None = None
    service_field: str = "data"
    service_stop_value: bool = True
    set_service: str | None = None
    clear_service: str | None = None
    service_type: Literal["std_srvs/Trigger", "std_srvs/Empty"] = "std_srvs/Trigger"
    command_topic: str | None = None

    @property
    def commands_robot(self) -> bool:
        """Whether the robot can be told to stop, rather than only telling that it has."""
        return bool(self.service or self.set_service or self.command_topic)


@dataclass(frozen=True, slots=True)
class HeadInterface:
    """A head that pans (left positive) and tilts (down positive).

    ``joint_trajectory`` publishes trajectory_msgs/JointTrajectory, ``joint_angles`` naoqi_bridge_msgs'
    JointAnglesWithSpeed. ``joint_states`` tells how the head is turned. A sign of -1 turns a joint's direction.
    """

    kind: Literal["joint_trajectory", "joint_angles"]
    topic: str
    pan_joint: str
    tilt_joint: str
    joint_states: str = "/joint_states"
    pan_range_rad: tuple[float, float] = (-1.2, 1.2)
    tilt_range_rad: tuple[float, float] = (-0.5, 0.7)
    speed_radps: float = 0.8
    pan_sign: Literal[1, -1] = 1
    tilt_sign: Literal[1, -1] = 1


@dataclass(frozen=True, slots=True)
class MapServices:
    """What saves and loads maps and switches between mapping and localization; None where the robot has no such node.

    ``slam_toolbox`` is the node's name (serialize_map, deserialize_map, pause_new_measurements);
    ``map_server`` (nav2_msgs/LoadMap, ROS 2) and ``map_saver`` (nav2_msgs/SaveMap) likewise. Saved maps lie in
    ``folder`` on the robot.
    """

    slam_toolbox: str | None = None
    map_server: str | None = None
    map_saver: str | None = None
    folder: str = ""


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """How fast and how suddenly the base may move. All of them are positive; ``left_mps`` is 0 without side motion."""

    forward_mps: float = 0.5
    backward_mps: float = 0.3
    left_mps: float = 0.0
    turn_radps: float = 1.0
    acceleration_mps2: float = 1.0
    deceleration_mps2: float = 2.0
    turn_acceleration_radps2: float = 3.0
    turn_deceleration_radps2: float = 6.0


@dataclass(frozen=True, slots=True)
class GuardSettings:
    """How the obstacle guard keeps the footprint from touching what the LIDAR sees.

    The robot stops with ``stop_distance_m`` left in the direction of motion and never drives faster than it can stop
    from after ``reaction_s`` (sensor period, network, base).
    """

    on: bool = True
    stop_distance_m: float = 0.12
    reaction_s: float = 0.35


@dataclass(frozen=True, slots=True)
class SecuritySettings:
    """How the link is secured: a file with certificates to trust besides the system's (``wss://``), and the name of the
    environment variable that holds the rosauth secret. The secret itself is never in a file.
    """

    ca_file: str | None = None
    rosauth_secret_env: str | None = None


@dataclass(frozen=True, slots=True)
class RobotProfile:
    """Everything the link needs to know of a robot. None means that the robot has no such thing.

    All names are absolute: a ``namespace`` of the file has been put before its relative names already.
    """

    name: str
    title: str
    ros: RosVersion = 1
    address: str = DEFAULT_ADDRESS
    security: SecuritySettings = field(default_factory=SecuritySettings)
    simulation_time: bool = False
    velocity: VelocityTopic = field(default_factory=VelocityTopic)
    command_rate_hz: float = 20.0
    limits: MotionLimits = field(default_factory=MotionLimits)
    guard: GuardSettings = field(default_factory=GuardSettings)
    scan: TopicSource | None = None
    odometry: TopicSource | None = None
    pose: TopicSource | None = None
    tf: TopicSource | None = None
    tf_static: TopicSource | None = None
    frames: TransformFrames = field(default_factory=TransformFrames)
    map: TopicSource | None = None
    map_updates: TopicSource | None = None
    path: TopicSource | None = None
    battery: TopicSource | None = None
    cameras: tuple[CameraTopic, ...] = ()
    navigation: NavigationServer | None = None
    initial_pose: str | None = None
    maps: MapServices | None = None
    speech: SpeechInterface | None = None
    emergency_stop: EmergencyStopInterface | None = None
    head: HeadInterface | None = None
    controls: tuple[RobotControl, ...] = ()
    robot_from_laser: Pose2D = field(default_factory=lambda: Pose2D(0.0, 0.0, 0.0))
    footprint_radius_m: float = 0.25
    footprint_m: tuple[tuple[float, float], ...] = ()

    @property
    def holonomic(self) -> bool:
        """Whether the base can move sideways."""
        return self.limits.left_mps > 0.0

    @property
    def stops_by_itself(self) -> bool:
        """Whether the base is known to stop soon when commands no longer come, because nobody is left to send zero."""
        return self.velocity.timeout_s is not None and self.velocity.timeout_s <= LONGEST_TIMEOUT_S

    @property
    def driving_limits(self) -> MotionLimits:
        """The limits that hold: a base that is not known to stop by itself is driven slower."""
        if self.stops_by_itself:
            return self.limits
        return replace(
            self.limits,
            forward_mps=self.limits.forward_mps * WITHOUT_TIMEOUT_FRACTION,
            backward_mps=self.limits.backward_mps * WITHOUT_TIMEOUT_FRACTION,
            left_mps=self.limits.left_mps * WITHOUT_TIMEOUT_FRACTION,
            turn_radps=self.limits.turn_radps * WITHOUT_TIMEOUT_FRACTION,
        )

    @property
    def footprint_outline_m(self) -> tuple[tuple[float, float], ...]:
        """The outline on the floor, (x, y) in the robot frame, counter-clockwise; a circle becomes 24 corners."""
        if self.footprint_m:
            return self.footprint_m
        steps = (2.0 * math.pi * step / 24 for step in range(24))
        return tuple((self.footprint_radius_m * math.cos(a), self.footprint_radius_m * math.sin(a)) for a in steps)


def check_address(address: str) -> str:
    """The address itself when it is ``ws://HOST[:PORT]`` or ``wss://...``.

    Raises
    ------
    ProfileError
        Otherwise.
    """
    try:
        parts = urlsplit(address)
        usable = parts.scheme in ("ws", "wss") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        usable = False
    if not usable:
        raise ProfileError(f"{address!r} is not a robot's address. An address looks like ws://192.168.1.20:9090.")
    return address
