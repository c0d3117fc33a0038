"""Robot profiles: which robot it is, how its topics are called, how fast it may go. Plain YAML, never code."""

import json
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal
from urllib.parse import parse_qs, urlsplit

import jsonschema
import yaml

from caris_desktop.domain.address import without_credentials
from caris_desktop.domain.camera import CameraModel
from caris_desktop.domain.controls import RobotControl
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.shipped import resources_dir

PROFILE_VERSION = 1
DEFAULT_ADDRESS = "ws://127.0.0.1:9090"

RosVersion = Literal[1, 2]
VelocityType = Literal["Twist", "TwistStamped"]
NavigationKind = Literal["move_base", "navigate_to_pose"]


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

    ``frame_id`` is used in the header of a TwistStamped.
    """

    topic: str = "/cmd_vel"
    type: VelocityType = "Twist"
    frame_id: str = "base_link"


@dataclass(frozen=True, slots=True)
class TransformFrames:
    """The frames of the robot's transform tree (tf)."""

    map: str = "map"
    odom: str = "odom"
    base: str = "base_link"


@dataclass(frozen=True, slots=True)
class CameraTopic:
    """One camera: a topic of sensor_msgs/CompressedImage. ``model`` tells where it looks; ``info`` is a topic of
    sensor_msgs/CameraInfo whose focal lengths replace those of the model.
    """

    name: str
    topic: str
    throttle_ms: int = 60
    model: CameraModel | None = None
    info: str | None = None


@dataclass(frozen=True, slots=True)
class NavigationServer:
    """What takes navigation goals: actionlib's move_base (ROS 1) or the NavigateToPose action (ROS 2)."""

    kind: NavigationKind
    name: str


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
    ``service`` (std_srvs/SetBool), or by ``set_service`` and ``clear_service`` (std_srvs/Trigger or Empty as
    ``service_type`` says), or by publishing std_msgs/Bool on ``command_topic``.
    """

    topic: str | None = None
    inverted: bool = False
    service: str | None = None
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
    def footprint_outline_m(self) -> tuple[tuple[float, float], ...]:
        """The outline on the floor, (x, y) in the robot frame, counter-clockwise; a circle becomes 24 corners."""
        if self.footprint_m:
            return self.footprint_m
        steps = (2.0 * math.pi * step / 24 for step in range(24))
        return tuple((self.footprint_radius_m * math.cos(a), self.footprint_radius_m * math.sin(a)) for a in steps)


def shipped_profiles() -> tuple[str, ...]:
    """Names of the profiles that come with the program."""
    return tuple(sorted(path.stem for path in _robots_dir().glob("*.yaml")))


def load_profile(name_or_path_or_url: str) -> RobotProfile:
    """Find a robot.

    A shipped name (``simulated``), a YAML file, or an address ``ws://HOST:PORT``, which means a robot with the
    usual ROS names there: ROS 1 unless the address ends in ``?ros=2``.

    Raises
    ------
    ProfileError
        If there is no such profile or it has a mistake in it.
    """
    wanted = name_or_path_or_url.strip()
    if "://" in wanted:
        return _profile_at_address(wanted)
    if re.fullmatch(r"[A-Za-z0-9_-]+", wanted) and not Path(wanted).exists():
        path = _robots_dir() / f"{wanted}.yaml"
        if not path.is_file():
            raise ProfileError(
                f"There is no robot profile named {wanted!r}. Shipped profiles: {', '.join(shipped_profiles())}. "
                "A YAML file or an address such as ws://192.168.1.20:9090 works too."
            )
        return read_profile(path)
    return read_profile(Path(wanted))


def read_profile(path: Path) -> RobotProfile:
    """Read and check one profile file.

    Raises
    ------
    ProfileError
        Naming the file, the line, what is wrong and what is allowed.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ProfileError(f"The robot profile {path} cannot be read: {error}.") from error
    return parse_profile(text, file_name=str(path), name=path.stem)


def parse_profile(text: str, *, file_name: str, name: str) -> RobotProfile:
    """Build a profile from YAML text; ``file_name`` is used in messages only.

    Raises
    ------
    ProfileError
        As :func:`read_profile`.
    """
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
        data = yaml.safe_load(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise ProfileError(f"{_place(file_name, mark)}: this is not YAML: {error.problem or error.context}.") from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ProfileError(f"{file_name}: this is not YAML: {error}.") from error
    if not isinstance(data, dict) or not isinstance(node, yaml.MappingNode):
        raise ProfileError(f"{file_name}: a robot profile is a list of 'name: value' lines; this file is not.")
    _refuse_repeated_keys(node, file_name)
    _refuse_other_versions(data, node, file_name)
    problem = jsonschema.exceptions.best_match(_validator().iter_errors(data))
    if problem is not None:
        raise ProfileError(_explain(problem, node, file_name))
    return _build(data, name)


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


def _profile_at_address(url: str) -> RobotProfile:
    parts = urlsplit(check_address(url))
    asked = parse_qs(parts.query)
    ros = asked.pop("ros", ["1"])[-1]
    if asked or ros not in ("1", "2"):
        raise ProfileError(f"{url!r}: after the '?' of an address only ros=1 or ros=2 is understood.")
    address = parts._replace(query="", fragment="").geturl()
    # The fullest set of usual names; the link finds out which of them the robot really has.
    profile = load_profile("simulated" if ros == "1" else "simulated-ros2")
    return replace(profile, name="address", address=address, title=f"Robot at {without_credentials(address)}")


def _robots_dir() -> Path:
    return resources_dir() / "robots"


@lru_cache(maxsize=1)
def _validator() -> jsonschema.protocols.Validator:
    schema = json.loads((resources_dir() / "schemas" / "robot-profile.schema.json").read_text(encoding="utf-8"))
    return jsonschema.Draft202012Validator(schema)


def _build(data: dict[str, Any], name: str) -> RobotProfile:
    def source(key: str) -> TopicSource | None:
        return TopicSource(**data[key]) if data.get(key) else None

    laser = data.get("laser", {}).get("robot_from_laser", {})
    return RobotProfile(
        name=name,
        title=data.get("title", name),
        ros=data["ros"],
        address=check_address(data.get("address", DEFAULT_ADDRESS)),
        velocity=VelocityTopic(**data["velocity"]),
        command_rate_hz=float(data.get("command_rate_hz", 20.0)),
        limits=MotionLimits(**{key: float(value) for key, value in data.get("limits", {}).items()}),
        scan=source("scan"),
        odometry=source("odometry"),
        pose=source("pose"),
        tf=source("tf"),
        tf_static=source("tf_static"),
        frames=TransformFrames(**data.get("frames", {})),
        map=source("map"),
        battery=source("battery"),
        cameras=tuple(CameraTopic(**camera) for camera in data.get("cameras", ())),
        navigation=NavigationServer(**data["navigation"]) if data.get("navigation") else None,
        speech=SpeechInterface(**data["speech"]) if data.get("speech") else None,
        emergency_stop=EmergencyStopInterface(**data["emergency_stop"]) if data.get("emergency_stop") else None,
        robot_from_laser=Pose2D(
            float(laser.get("x_m", 0.0)), float(laser.get("y_m", 0.0)), float(laser.get("heading_rad", 0.0))
        ),
        footprint_radius_m=float(data.get("footprint_radius_m", 0.25)),
    )


def _place(file_name: str, mark: Any) -> str:
    return file_name if mark is None else f"{file_name}, line {mark.line + 1}"


def _refuse_repeated_keys(node: yaml.Node, file_name: str) -> None:
    if isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, value in node.value:
            if key.value in seen:
                raise ProfileError(f"{_place(file_name, key.start_mark)}: {key.value!r} is given twice.")
            seen.add(key.value)
            _refuse_repeated_keys(value, file_name)
    elif isinstance(node, yaml.SequenceNode):
        for item in node.value:
            _refuse_repeated_keys(item, file_name)


def _refuse_other_versions(data: dict[str, Any], node: yaml.Node, file_name: str) -> None:
    version = data.get("version")
    place = _place(file_name, _node_at(node, ["version"]).start_mark)
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        raise ProfileError(f"{place}: 'version' is missing or not a whole number; write 'version: {PROFILE_VERSION}'.")
    if version > PROFILE_VERSION:
        raise ProfileError(
            f"{place}: this profile has version {version}, made for a newer CARIS Desktop; "
            f"this one reads version {PROFILE_VERSION}. Update the program or use an older profile."
        )


def _node_at(node: yaml.Node, path: Iterable[str | int]) -> yaml.Node:
    """The node that ``path`` leads to, or the nearest one above it."""
    for step in path:
        if isinstance(node, yaml.MappingNode):
            below = next((value for key, value in node.value if key.value == step), None)
        elif isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
            below = node.value[step]
        else:
            below = None
        if below is None:
            break
        node = below
    return node


def _explain(problem: jsonschema.ValidationError, node: yaml.Node, file_name: str) -> str:
    where = ".".join(str(step) for step in problem.absolute_path) or "the profile"
    at = _node_at(node, problem.absolute_path)
    place = _place(file_name, at.start_mark)
    found: Any = problem.instance
    rule: Any = problem.validator_value
    schema: dict[str, Any] = problem.schema if isinstance(problem.schema, dict) else {}
    if problem.validator == "additionalProperties":
        allowed = sorted(schema.get("properties", {}))
        unknown = next(str(key) for key in found if key not in allowed)
        key_node = next((key for key, _ in at.value if key.value == unknown), at)
        return (
            f"{_place(file_name, key_node.start_mark)}: {unknown!r} is not known in {where}. "
            f"Allowed are: {', '.join(allowed)}."
        )
    if problem.validator == "required":
        return f"{place}: {where} lacks {next(key for key in rule if key not in found)!r}."
    if problem.validator == "enum":
        return f"{place}: {where} is {found!r}; allowed are: {', '.join(str(value) for value in rule)}."
    hint = schema.get("description")
    return f"{place}: {where}: {problem.message}." + (f" Expected: {hint}." if hint else "")
