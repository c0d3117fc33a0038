"""Schema of robot profiles.

Settings are declared only here. Validation, messages, reading, writing, the JSON Schema for editors and the guide's
tables derive from these declarations; ``python -m caris_desktop.app.generated_reference`` rewrites the latter two.
Rules across groups are in :mod:`caris_desktop.robot.profile`.
"""

import math
from collections.abc import Mapping
from dataclasses import field, replace
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

from caris_desktop.domain.address import plugin_address
from caris_desktop.domain.camera_projection import CameraModel, CameraModelKeys, Offset, PoseKeys, Radians
from caris_desktop.domain.control_definitions import (
    CONTROL,
    CallService,
    PublishMessage,
    RobotControl,
    RosName,
    RosType,
    SendActionGoal,
)
from caris_desktop.domain.control_effects import RobotInterfaceNames, StopField
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.plugins import PluginError, find
from caris_desktop.domain.schema_fields import Excluded, FieldSpec, StoredAs
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.ros.message_conversion import LEAST_RATE_HZ, MOST_CHANNELS, MOST_RATE_HZ, Coding

DEFAULT_ADDRESS = "ws://127.0.0.1:9090"
PROFILE_VERSION: Literal[1] = 1

RosVersion = Literal[1, 2]
PictureType = Literal["CompressedImage", "Image"]
VelocityType = Literal["Twist", "TwistStamped"]
NavigationKind = Literal["move_base", "navigate_to_pose"]
StopServiceType = Literal["std_srvs/Trigger", "std_srvs/Empty"]

LONGEST_TIMEOUT_S = 1.0
WITHOUT_TIMEOUT_FRACTION = 0.5
MOST_CAMERAS = 4

_Throttle = Annotated[
    int,
    FieldSpec("Minimum interval between messages; 0: every message.", unit="milliseconds", at_least=0, at_most=10_000),
]
_Frame = Annotated[
    str, StoredAs(str, lambda frame: frame.lstrip("/"), str), FieldSpec(shortest=1, longest=200, quiet=True)
]
_Joint = Annotated[str, FieldSpec(shortest=1, longest=100)]
_Sign = Annotated[Literal[1, -1], FieldSpec()]


class ProfileError(ValueError):
    """Unusable robot profile; the text names the file, the line and the allowed values."""


class TopicSource(Value):
    """A topic to listen to."""

    topic: Annotated[RosName, FieldSpec("Name of the panel.")]
    throttle_ms: Annotated[_Throttle, FieldSpec(quiet=True)] = 0
    latched: Annotated[bool, FieldSpec(
        "The last message is stored for later subscribers: latched in ROS 1, transient local in ROS 2.", quiet=True,
    )] = False  # fmt: skip


class _LatchedKeys(TopicSource):
    """A latched topic, unless the file says otherwise."""

    latched: Annotated[bool, FieldSpec("As for other topics, but `true` if not given.", quiet=True)] = True

    @classmethod
    def of(cls, source: TopicSource) -> "_LatchedKeys":
        return cls(source.topic, source.throttle_ms, source.latched)

    def source(self) -> TopicSource:
        return TopicSource(self.topic, self.throttle_ms, self.latched)


_EXAMPLE = "{topic: /scan, throttle_ms: 50}."
_Source = Annotated[TopicSource | None, FieldSpec(noun="topic", allowed=_EXAMPLE)]
_LatchedSource = Annotated[
    TopicSource | None,
    StoredAs(_LatchedKeys, _LatchedKeys.source, _LatchedKeys.of),
    FieldSpec(noun="latched topic", allowed=_EXAMPLE),
]


class VelocityTopic(Value):
    """Where velocity commands go."""

    topic: Annotated[
        RosName, FieldSpec("The base's own topic, or the wizard's input to a velocity multiplexer.", wanted=True)
    ] = "/cmd_vel"
    type: Annotated[
        VelocityType, FieldSpec("The type in geometry_msgs; newer ROS 2 bases require TwistStamped.", quiet=True)
    ] = "Twist"
    frame_id: Annotated[str, FieldSpec("The frame in the header of a TwistStamped.", longest=200, quiet=True)] = (
        "base_link"
    )
    timeout_s: Annotated[float | None, FieldSpec(
        "Time without a command after which the base stops automatically; if not given, or above 1 s, "
            "driving is half as fast.",
        unit="seconds", more_than=0, at_most=60,
    )] = None  # fmt: skip
    timeout_source: Annotated[str, FieldSpec(
        "Source of the timeout: a web page, a file of the driver, or your own test.", shortest=1, longest=300,
        quiet=True, beside=("timeout_s",), needed=("timeout_s",),
        needs="It states where the timeout is documented.",
    )] = ""  # fmt: skip


class TransformFrames(Value):
    """The frames of the robot's transform tree (tf)."""

    map: Annotated[_Frame, FieldSpec("The frame of the map.")] = "map"
    odom: Annotated[_Frame, FieldSpec("The frame of the odometry.")] = "odom"
    base: Annotated[_Frame, FieldSpec("The robot's own frame; many robots have base_footprint.")] = "base_link"


class CameraTopic(Value):
    """One camera."""

    name: Annotated[str, FieldSpec(
        "Name in the window and in the recording.", longest=40, pattern="^[A-Za-z0-9_-]+$",
        allowed="letters, digits, - and _.",
    )]  # fmt: skip
    topic: Annotated[RosName, FieldSpec("Topic with the camera's images.")]
    throttle_ms: Annotated[
        _Throttle, FieldSpec("Minimum interval between images: 33 gives up to 30 images per second.")
    ] = 60
    model: Annotated[CameraModel | None,
                     StoredAs(CameraModelKeys, CameraModelKeys.model, CameraModelKeys.of), FieldSpec(
        "Position on the robot and field of view. With it, a click in the video is mapped to a place on the "
            "floor.",
        some_of=("horizontal_fov_deg", "fx_px"), needs="a camera's model requires either horizontal_fov_deg or fx_px.",
        order=3,
    )] = None  # fmt: skip
    info: Annotated[RosName | None, FieldSpec(
        "A topic with sensor_msgs/CameraInfo messages; their focal lengths replace those of `model`.", order=2,
    )] = None  # fmt: skip
    type: Annotated[PictureType, FieldSpec(
        "The type of the topic, in sensor_msgs; `Image` is not compressed, which is too much for a wireless "
            "link.",
        quiet=True, order=1,
    )] = "CompressedImage"  # fmt: skip


class SpeedLimitInterface(Value):
    """Interface for the navigation's top speed."""

    topic: Annotated[
        RosName | None,
        FieldSpec("In ROS 2: the nav2_msgs/SpeedLimit topic to which Nav2's controller server subscribes."),
    ] = None
    reconfigure: Annotated[RosName | None, FieldSpec(
        "In ROS 1: the node of the local planner, where dynamic_reconfigure sets the speed; requires "
            "`max_mps`.",
        instead_of=("topic",),
    )] = None  # fmt: skip
    parameters: Annotated[
        tuple[Annotated[str, FieldSpec(pattern="^[A-Za-z][A-Za-z0-9_]*$", allowed="letters, digits and _.")], ...],
        FieldSpec(
            "The parameters of that node, in m/s; they are reset to `max_mps` when the console "
                "disconnects.", shortest=1,
            longest=8, quiet=True, beside=("reconfigure",),
    )] = ("max_vel_x", "max_vel_trans")  # fmt: skip


class NavigationServer(Value):
    """What takes navigation goals."""

    kind: Annotated[NavigationKind, FieldSpec("`move_base` in ROS 1 (actionlib), `navigate_to_pose` in ROS 2 (Nav2).")]
    name: Annotated[RosName, FieldSpec("The name of the action.")]
    max_mps: Annotated[float | None, FieldSpec(
        "Speed that the robot's navigation is configured for; the console never sets a "
            "higher limit.", unit="metres per second",
        more_than=0, at_most=5,
    )] = None  # fmt: skip
    speed_limit: Annotated[SpeedLimitInterface | None, FieldSpec(
        "Interface that limits its speed to the speed of Drive.", some_of=("topic", "reconfigure"),
        needs="a speed limit requires a topic (ROS 2) or reconfigure (ROS 1).",
    )] = None  # fmt: skip


class SpeechAction(Value):
    """A speech action (actionlib in ROS 1); its result is the end of the sentence."""

    name: Annotated[RosName, FieldSpec("The name of the action.")]
    type: Annotated[RosType, FieldSpec("Its ROS type.")]
    goal: Annotated[Mapping[str, Any], FieldSpec("The goal; `$value` stands for the text.")]


_AnswersAtEnd = Annotated[bool, FieldSpec(
    "`true` if it answers after speaking; `false` if it answers immediately, so that the console estimates the "
    "duration of a sentence.", quiet=True,
)]  # fmt: skip
_WebAddress = Annotated[str, FieldSpec(
    longest=500, external="address", pattern="^https?://[^/@ ]+(/[^ ]*)?$",
    allowed="http://HOST:PORT/PATH, without a password.",
)]  # fmt: skip


class SpeechService(Value):
    """A ROS service that speaks a text."""

    name: Annotated[RosName, FieldSpec("The name of the service.")]
    type: Annotated[RosType, FieldSpec("Its ROS type.")]
    request: Annotated[Mapping[str, Any], FieldSpec("The request; `$value` stands for the text.")]
    answers_at_end: _AnswersAtEnd = False
    stop: Annotated[RosName | None, FieldSpec("A std_srvs/Trigger service that stops the speech.")] = None


class SpeechWeb(Value):
    """A web interface (HTTP) of the robot that speaks; asked by POST, or by GET where there is no body."""

    url: Annotated[_WebAddress, FieldSpec("Its address; `$value` in it stands for the text.")]
    body: Annotated[Mapping[str, Any] | None, FieldSpec("The JSON to send; `$value` stands for the text.")] = None
    answers_at_end: _AnswersAtEnd = False
    stop: Annotated[_WebAddress | None, FieldSpec("The address that stops the speech, by POST.")] = None


class SpeechInterface(Value):
    """The robot's own voice: a topic, an action, a service or a web interface."""

    topic: Annotated[RosName | None, FieldSpec("std_msgs/String: the text to say.")] = None
    speaking: Annotated[RosName | None, FieldSpec(
        "std_msgs/Bool: true while the robot speaks. Without it, the console estimates the start and end of "
            "a sentence, unless an action reports them.",
    )] = None  # fmt: skip
    stop: Annotated[RosName | None, FieldSpec("std_msgs/Empty: stop the speech.", beside=("topic",))] = None
    action: Annotated[
        SpeechAction | None, FieldSpec("A speech action; its result is the end of the sentence.", instead_of=("topic",))
    ] = None
    service: Annotated[SpeechService | None, FieldSpec("A speech service.", instead_of=("topic", "action"))] = None
    web: Annotated[
        SpeechWeb | None, FieldSpec("A speech web interface (HTTP).", instead_of=("topic", "action", "service"))
    ] = None
    says: Annotated[RosName | None, FieldSpec(
        "std_msgs/String: the text of its speech, reported by the robot. Unprompted speech is recorded as "
            "the robot's own.",
    )] = None  # fmt: skip


class AudioInterface(Value):
    """The robot's microphone, and a loudspeaker that plays sound as it comes (audio_common_msgs)."""

    topic: Annotated[RosName | None, FieldSpec("Audio from the robot's microphone.")] = None
    type: Annotated[Literal["AudioData", "AudioDataStamped"], FieldSpec(
        "The type of that topic, in audio_common_msgs.", quiet=True, beside=("topic",),
    )] = "AudioData"  # fmt: skip
    format: Annotated[Coding, FieldSpec(
        "`wave` is plain samples (S16LE), without a head.", quiet=True, beside=("topic",),
    )] = "wave"  # fmt: skip
    rate_hz: Annotated[int, FieldSpec(
        "Sample rate; for `mp3`, the stream contains it.", unit="hertz", at_least=LEAST_RATE_HZ, at_most=MOST_RATE_HZ,
    )] = 16_000  # fmt: skip
    channels: Annotated[int, FieldSpec(
        "Number of channels of the microphone; for `mp3`, the stream "
            "contains it.", at_least=1, at_most=MOST_CHANNELS, quiet=True,
        beside=("topic",),
    )] = 1  # fmt: skip
    info: Annotated[RosName | None, FieldSpec(
        "A topic with audio_common_msgs/AudioInfo messages, which replace format, rate and channels.", quiet=True,
        beside=("topic",),
    )] = None  # fmt: skip
    speaker: Annotated[RosName | None, FieldSpec(
        "audio_common_msgs/AudioData to publish: plain samples of one channel at `rate_hz`, played on "
            "arrival. With it, the wizard's own voice is played through the robot.",
    )] = None  # fmt: skip


class EmergencyStopInterface(Value):
    """The robot's own emergency stop: the topic that reports its state, and the service that sets it."""

    topic: Annotated[RosName | None, FieldSpec("std_msgs/Bool: true while the robot is stopped.")] = None
    inverted: Annotated[
        bool, FieldSpec("`true` if that topic sends false while the robot is stopped.", quiet=True, beside=("topic",))
    ] = False
    service: Annotated[
        RosName | None, FieldSpec("std_srvs/SetBool, or another service with one bool: true stops, false releases.")
    ] = None
    service_field: Annotated[str, FieldSpec(
        "The name of that bool.", longest=100, pattern="^[a-z][a-z0-9_]*$", allowed="lower-case letters, digits and _.",
        quiet=True, beside=("service",),
    )] = "data"  # fmt: skip
    service_stop_value: Annotated[bool, FieldSpec(
        "`false` if true releases the robot, as for a service that switches the motors.", quiet=True,
        beside=("service",),
    )] = True  # fmt: skip
    set_service: Annotated[
        RosName | None, FieldSpec("The service that stops, if there are two services.", instead_of=("service",))
    ] = None
    clear_service: Annotated[RosName | None, FieldSpec(
        "The service that releases.", beside=("set_service",), needed=("set_service",),
        needs="Without it the robot is never released.",
    )] = None  # fmt: skip
    service_type: Annotated[
        StopServiceType,
        StoredAs(
            Literal["std_srvs/Trigger", "std_srvs/Empty", "std_srvs/srv/Trigger", "std_srvs/srv/Empty"],
            lambda name: name.replace("/srv/", "/"),
            str,
        ),
        FieldSpec("The type of these two services.", quiet=True, beside=("set_service",)),
    ] = "std_srvs/Trigger"
    command_topic: Annotated[RosName | None, FieldSpec(
        "std_msgs/Bool to publish: true stops, false releases.", instead_of=("service", "set_service"),
    )] = None  # fmt: skip

    @property
    def commands_robot(self) -> bool:
        """True if the robot can be commanded to stop, rather than only report a stop."""
        return bool(self.service or self.set_service or self.command_topic)


HEAD_TYPES = {
    "joint_trajectory": "trajectory_msgs/JointTrajectory",
    "joint_angles": "naoqi_bridge_msgs/JointAnglesWithSpeed",
}


class HeadInterface(Value):
    """A head that pans (left positive) and tilts (down positive)."""

    kind: Annotated[Literal["joint_trajectory", "joint_angles"], FieldSpec(
        "trajectory_msgs/JointTrajectory or naoqi_bridge_msgs/JointAnglesWithSpeed.",
    )]  # fmt: skip
    topic: Annotated[RosName, FieldSpec("The topic for head commands.")]
    pan_joint: Annotated[_Joint, FieldSpec("The joint that pans left and right.")]
    tilt_joint: Annotated[_Joint, FieldSpec("The joint that tilts down and up.")]
    joint_states: Annotated[RosName, FieldSpec("sensor_msgs/JointState: the orientation of the head.")] = (
        "/joint_states"
    )
    pan_range_rad: Annotated[tuple[Radians, Radians], FieldSpec("Lowest and highest pan, left positive.")] = (-1.2, 1.2)
    tilt_range_rad: Annotated[tuple[Radians, Radians], FieldSpec("Lowest and highest tilt, down positive.")] = (
        -0.5,
        0.7,
    )
    speed_radps: Annotated[float, FieldSpec("Turning speed.", unit="radians per second", at_least=0.05, at_most=10)] = (
        0.8
    )
    pan_sign: Annotated[_Sign, FieldSpec("-1 if the joint turns right for a positive angle.")] = 1
    tilt_sign: Annotated[_Sign, FieldSpec("-1 if the joint tilts up for a positive angle.")] = 1

    @property
    def command_type(self) -> str:
        """Message type of its topic."""
        return HEAD_TYPES[self.kind]


class MapServices(Value):
    """What saves and loads maps and switches between mapping and localization."""

    slam_toolbox: Annotated[RosName | None, FieldSpec("The node of slam_toolbox, usually `/slam_toolbox`.")] = None
    map_server: Annotated[
        RosName | None, FieldSpec("The node of Nav2's map server (nav2_msgs/LoadMap, ROS 2), usually `/map_server`.")
    ] = None
    map_saver: Annotated[
        RosName | None, FieldSpec("The node of Nav2's map saver (nav2_msgs/SaveMap, ROS 2), usually `/map_saver`.")
    ] = None
    folder: Annotated[str, FieldSpec(
        "Folder for maps on the robot.", longest=300, pattern="^(?!.*(^|/)\\.\\.(/|$))[^\\x00-\\x1f]*$",
        allowed="a folder path without '..' in it.", quiet=True,
    )] = ""  # fmt: skip


_Speed = Annotated[float, FieldSpec(unit="metres per second")]
_Turn = Annotated[float, FieldSpec(unit="radians per second", more_than=0)]
_Acceleration = Annotated[float, FieldSpec(unit="m/s²", more_than=0)]
_TurnAcceleration = Annotated[float, FieldSpec(unit="rad/s²", more_than=0)]


class MotionLimits(Value):
    """How fast and how suddenly the base may move."""

    forward_mps: Annotated[_Speed, FieldSpec("Forward speed.", more_than=0)] = 0.5
    backward_mps: Annotated[_Speed, FieldSpec("Backwards.", at_least=0)] = 0.3
    left_mps: Annotated[_Speed, FieldSpec("Sideways; 0 if the base cannot move sideways.", at_least=0)] = 0.0
    turn_radps: Annotated[_Turn, FieldSpec("Turning speed.")] = 1.0
    acceleration_mps2: Annotated[_Acceleration, FieldSpec("Getting faster.")] = 1.0
    deceleration_mps2: Annotated[_Acceleration, FieldSpec("Getting slower.")] = 2.0
    turn_acceleration_radps2: Annotated[_TurnAcceleration, FieldSpec("Turning faster.")] = 3.0
    turn_deceleration_radps2: Annotated[_TurnAcceleration, FieldSpec("Turning slower.")] = 6.0


class GuardSettings(Value):
    """How the obstacle guard keeps the footprint from touching what the LIDAR sees."""

    on: Annotated[bool, FieldSpec("`false` only if the robot has its own obstacle guard.", quiet=True)] = True
    stop_distance_m: Annotated[
        float, FieldSpec("Distance to the obstacle after stopping.", unit="metres", at_least=0, at_most=1, quiet=True)
    ] = 0.12
    reaction_s: Annotated[float, FieldSpec(
        "Total delay of sensor, network and base; higher for a robot that brakes late.", unit="seconds", at_least=0.05,
        at_most=2, quiet=True,
    )] = 0.35  # fmt: skip


class SecuritySettings(Value):
    """How the link is secured; the secrets themselves are never in a file."""

    ca_file: Annotated[str | None, FieldSpec(
        "File in the folder of the profile with certificates (PEM) to trust for `wss://`, in addition to the "
            "system's.", shortest=1,
        longest=300, external="path",
    )] = None  # fmt: skip
    certificate_sha256: Annotated[str | None, FieldSpec(
        "The fingerprint (SHA-256) of the robot's certificate, read on the robot itself. Only this "
            "certificate is accepted for `wss://`, regardless of its name, dates and issuer.",
        pattern="^([0-9A-Fa-f]{2}:?){31}[0-9A-Fa-f]{2}$",
        allowed="64 hexadecimal digits, with or without colons.", quiet=True,
    )] = None  # fmt: skip
    rosauth_secret_env: Annotated[str | None, FieldSpec(
        "The environment variable with the rosauth secret; the secret itself is never stored in a file.", longest=100,
        external="variable",
        pattern="^[A-Za-z_][A-Za-z0-9_]*$", allowed="the name of an environment variable.",
    )] = None  # fmt: skip


def _counter_clockwise(corners: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    return corners[::-1] if area_m2(corners) < 0.0 else corners


def area_m2(corners: tuple[tuple[float, float], ...]) -> float:
    """Signed area of an outline on the floor; positive for counter-clockwise corners."""
    following = [*corners[1:], corners[0]]
    return sum(ax * by - ay * bx for (ax, ay), (bx, by) in zip(corners, following, strict=True)) / 2.0


_Radius = Annotated[float, FieldSpec(unit="metres", at_least=0.02, at_most=5)]
_Corner = tuple[Offset, Offset]


class FloorOutline(Value):
    """The robot's outline on the floor: a circle, or corners around its centre, counter-clockwise."""

    radius_m: Annotated[_Radius | None, FieldSpec("Radius of a round robot.")] = None
    polygon_m: Annotated[
        tuple[_Corner, ...], StoredAs(tuple[_Corner, ...], _counter_clockwise, lambda corners: corners), FieldSpec(
            "At least three corners `[x, y]` around the point around which the robot turns, x forward, y "
                "left.",
            allowed="three corners or more.", shortest=3, longest=40, quiet=True, instead_of=("radius_m",),
    )] = ()  # fmt: skip


_AT_ORIGIN = Pose2D(0.0, 0.0, 0.0)


class LaserMount(Value):
    """Where the LIDAR is, and which way up."""

    robot_from_laser: Annotated[Pose2D, StoredAs(PoseKeys, PoseKeys.pose, PoseKeys.of), FieldSpec(
        "Its pose in the robot frame, if tf does not provide it.",
    )] = _AT_ORIGIN  # fmt: skip
    mounting: Annotated[Literal["upright", "upside_down"] | None, FieldSpec(
        "Mounting of the LIDAR, if tf does not provide it or is wrong. An `upside_down` LIDAR counts its "
            "angles clockwise, seen from above.",
    )] = None  # fmt: skip


class RobotProfile(Value):
    """Everything the link needs to know of a robot. None means that the robot has no such thing.

    All names are absolute: a ``namespace`` of the file has been put before its relative names already.
    """

    name: Annotated[str, Excluded()] = ""
    title: Annotated[
        str, FieldSpec("Name of the robot in the window; the file name if not given.", shortest=1, longest=80)
    ] = ""
    ros: Annotated[RosVersion, FieldSpec("The ROS version of the robot.", wanted=True)] = 1
    address: Annotated[str, FieldSpec(
        "Address of its rosbridge, or `ros2:DOMAIN` for ROS 2 without rosbridge. `--robot` with an address "
            "overrides it.", longest=500, external="address",
        pattern=r"^(wss?://[^/?#@\s]+(/[^?#\s]*)?|[a-z][a-z0-9._-]+:(?!//)[^?#@\s]*)$",
        allowed="ws://HOST:PORT or wss://HOST:PORT, without a password, or ros2: (without rosbridge).",
    )] = DEFAULT_ADDRESS  # fmt: skip
    security: Annotated[SecuritySettings, FieldSpec(quiet=True)] = field(default_factory=SecuritySettings)
    simulation_time: Annotated[
        bool, FieldSpec("`true` if the robot uses simulation time (`/clock`, `use_sim_time`).", quiet=True)
    ] = False
    velocity: Annotated[VelocityTopic, FieldSpec(wanted=True)] = field(default_factory=VelocityTopic)
    command_rate_hz: Annotated[
        float, FieldSpec("Rate of velocity commands while a key is held.", unit="hertz", at_least=5, at_most=100)
    ] = 20.0
    limits: MotionLimits = field(default_factory=MotionLimits)
    guard: Annotated[GuardSettings, FieldSpec(quiet=True)] = field(default_factory=GuardSettings)
    footprint: Annotated[FloorOutline, FieldSpec(
        "The robot's outline on the floor.", some_of=("radius_m", "polygon_m"),
        needs="a footprint requires either radius_m or polygon_m.",
    )] = field(default_factory=lambda: FloorOutline(0.25))  # fmt: skip
    scan: Annotated[
        _Source,
        FieldSpec("sensor_msgs/LaserScan: the LIDAR, for the map view and the obstacle guard. 50 ms is enough."),
    ] = None
    odometry: Annotated[_Source, FieldSpec("nav_msgs/Odometry: speed and path from the wheels.")] = None
    pose: Annotated[
        _Source,
        FieldSpec("geometry_msgs/PoseWithCovarianceStamped: the pose in the map, used if `tf` does not provide it."),
    ] = None
    tf: Annotated[_Source, FieldSpec("tf2_msgs/TFMessage: transforms between the frames, usually `/tf`.")] = None
    tf_static: Annotated[_LatchedSource, FieldSpec("tf2_msgs/TFMessage: static transforms, usually `/tf_static`.")] = (
        None
    )
    map: Annotated[_LatchedSource, FieldSpec("nav_msgs/OccupancyGrid: the map.")] = None
    map_updates: Annotated[_Source, FieldSpec("map_msgs/OccupancyGridUpdate: changed parts of the map.")] = None
    path: Annotated[_Source, FieldSpec("nav_msgs/Path: the path planned by the navigation.")] = None
    battery: Annotated[_Source, FieldSpec("sensor_msgs/BatteryState: the charge.")] = None
    frames: Annotated[TransformFrames, FieldSpec(quiet=True)] = field(default_factory=TransformFrames)
    cameras: Annotated[
        tuple[CameraTopic, ...], FieldSpec("The first camera is shown first.", longest=MOST_CAMERAS, quiet=True)
    ] = ()
    navigation: NavigationServer | None = None
    initial_pose: Annotated[RosName | None, FieldSpec(
        "geometry_msgs/PoseWithCovarianceStamped: the topic that sets the robot's pose for the localization, "
            "usually `/initialpose`.",
    )] = None  # fmt: skip
    maps: Annotated[MapServices | None, FieldSpec(
        some_of=("slam_toolbox", "map_server", "map_saver", "folder"),
        needs="maps requires slam_toolbox, map_server or map_saver; one of these nodes is enough.",
    )] = None  # fmt: skip
    speech: Annotated[
        SpeechInterface | None,
        FieldSpec(
            some_of=("topic", "action", "service", "web", "says"),
            needs="speech requires a topic, an action, a service or a web interface.",
        ),
    ] = None
    audio: Annotated[
        AudioInterface | None,
        FieldSpec(some_of=("topic", "speaker"), needs="audio requires a topic, a speaker, or both."),
    ] = None
    emergency_stop: Annotated[EmergencyStopInterface | None, FieldSpec(
        some_of=("topic", "service", "set_service", "command_topic"),
        needs="an emergency stop requires a topic, a service, set_service with clear_service, or a command_topic.",
    )] = None  # fmt: skip
    head: HeadInterface | None = None
    controls: Annotated[tuple[CONTROL, ...], FieldSpec(
        "Buttons, toggles, sliders, choices, text fields and readouts of the Robot panel.", longest=100, quiet=True,
    )] = ()  # fmt: skip
    laser: Annotated[
        LaserMount, FieldSpec("Mounting of the LIDAR, for robots that do not provide it in tf.", quiet=True)
    ] = field(default_factory=LaserMount)

    @property
    def holonomic(self) -> bool:
        """True if the base can move sideways."""
        return self.limits.left_mps > 0.0

    @property
    def stops_by_itself(self) -> bool:
        """True if the base is known to stop soon without commands, as when no process is left to send zero."""
        return self.velocity.timeout_s is not None and self.velocity.timeout_s <= LONGEST_TIMEOUT_S

    @property
    def driving_limits(self) -> MotionLimits:
        """Effective limits: a base that is not known to stop on its own is driven slower."""
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
    def footprint_m(self) -> tuple[tuple[float, float], ...]:
        """Corners of its outline on the floor, counter-clockwise; empty for a round robot."""
        return self.footprint.polygon_m

    @property
    def footprint_radius_m(self) -> float:
        """Radius of the circle around its centre that contains the whole robot."""
        if self.footprint.radius_m is not None:
            return self.footprint.radius_m
        return max((math.hypot(x, y) for x, y in self.footprint.polygon_m), default=0.0)

    @property
    def footprint_outline_m(self) -> tuple[tuple[float, float], ...]:
        """Outline on the floor, (x, y) in the robot frame, counter-clockwise; a circle becomes 24 corners."""
        if self.footprint_m:
            return self.footprint_m
        steps = (2.0 * math.pi * step / 24 for step in range(24))
        return tuple((self.footprint_radius_m * math.cos(a), self.footprint_radius_m * math.sin(a)) for a in steps)


class ProfileFile(RobotProfile):
    """Which robot it is, how its topics are called, how fast it may go. The guide of robot profiles explains it."""

    # Only in the file: a loaded profile has absolute names and one footprint.
    version: Annotated[Literal[1], FieldSpec("Version of this file format.", wanted=True, order=-1)] = PROFILE_VERSION
    namespace: Annotated[str, FieldSpec(
        "Prefix of every name that does not start with a slash.", longest=200,
        pattern="^/?[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*$", allowed="a name such as robot1.",
    )] = ""  # fmt: skip
    footprint_radius_m: Annotated[
        _Radius, FieldSpec("The same as `footprint: {radius_m: ...}`.", instead_of=("footprint",))
    ] = 0.25


def interface_names(profile: RobotProfile) -> RobotInterfaceNames:
    """Interface names that move, stop and release this robot."""
    limit = profile.navigation.speed_limit if profile.navigation is not None else None
    motion = (
        profile.velocity.topic,
        profile.initial_pose,
        profile.navigation.name if profile.navigation is not None else None,
        limit.topic if limit is not None else None,
        limit.reconfigure if limit is not None else None,
        profile.head.topic if profile.head is not None else None,
        *(_name_of(one) for one in profile.controls if one.is_motion and one.control_class in ("motion", "unknown")),
    )
    interface = profile.emergency_stop or EmergencyStopInterface()
    fields = (
        (interface.service, interface.service_field, interface.service_stop_value),
        (interface.command_topic, "data", True),
        (interface.topic, "data", not interface.inverted),
        (interface.set_service, "", True),
    )
    return RobotInterfaceNames(
        tuple(name for name in motion if name is not None),
        tuple(StopField(name, field, stops) for name, field, stops in fields if name is not None),
        () if interface.clear_service is None else (interface.clear_service,),
    )


def _name_of(control: RobotControl) -> str | None:
    match control.effect:
        case PublishMessage(topic=name) | CallService(service=name) | SendActionGoal(action=name):
            return name
    return None


def check_address(address: str) -> str:
    """Validate an address ``ws://HOST[:PORT]``, ``wss://...``, or that of a robot plug-in (``ros2:``), and return it.

    Raises
    ------
    ProfileError
        Otherwise.
    """
    of_plugin = plugin_address(address)
    if of_plugin is not None:
        try:
            find("robots", of_plugin[0])
        except PluginError as error:
            words = tr("The robot plug-in {name} cannot be used: {reason}.")
            raise ProfileError(words.format(name=of_plugin[0], reason=tr(error.reason))) from error
        return address
    try:
        parts = urlsplit(address)
        usable = parts.scheme in ("ws", "wss") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        usable = False
    if not usable:
        raise ProfileError(f"{address!r} is not a robot address. Example of an address: ws://192.168.1.20:9090.")
    return address
