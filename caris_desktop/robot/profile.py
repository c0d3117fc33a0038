"""Robot profiles: which robot it is, how its topics are called, how fast it may go. Plain YAML, never code."""

import math
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal
from urllib.parse import parse_qs, urlsplit

import platformdirs

from caris_desktop.domain.address import without_credentials
from caris_desktop.domain.camera import CameraModel
from caris_desktop.domain.controls import (
    VALUE,
    RobotControl,
    control_data,
    control_from_data,
    control_problems,
    mentions_value,
)
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.shipped import resources_dir
from caris_desktop.robot import profile_file
from caris_desktop.robot.profile_file import (
    PROFILE_VERSION,
    KeyPath,
    ProfileText,
    did_you_mean,
    profile_yaml,
    write_atomically,
)

ProfileError = profile_file.ProfileError
DEFAULT_ADDRESS = "ws://127.0.0.1:9090"

RosVersion = Literal[1, 2]
VelocityType = Literal["Twist", "TwistStamped"]
NavigationKind = Literal["move_base", "navigate_to_pose"]


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
    def footprint_outline_m(self) -> tuple[tuple[float, float], ...]:
        """The outline on the floor, (x, y) in the robot frame, counter-clockwise; a circle becomes 24 corners."""
        if self.footprint_m:
            return self.footprint_m
        steps = (2.0 * math.pi * step / 24 for step in range(24))
        return tuple((self.footprint_radius_m * math.cos(a), self.footprint_radius_m * math.sin(a)) for a in steps)


@dataclass(frozen=True, slots=True)
class ListedProfile:
    """One line of the robot list. ``error`` says why the file cannot be used; ``title`` is then the file's name."""

    name: str
    title: str
    address: str
    path: Path
    shipped: bool
    error: str = ""


def shipped_profiles() -> tuple[str, ...]:
    """Names of the profiles that come with the program."""
    return tuple(sorted(path.stem for path in _robots_dir().glob("*.yaml")))


def user_robots_dir() -> Path:
    """Where the user's own profiles are; it need not exist."""
    return Path(platformdirs.user_config_dir("caris-desktop", appauthor=False)) / "robots"


def list_profiles(user_dir: Path | None = None) -> tuple[ListedProfile, ...]:
    """The user's own profiles, then the shipped ones. An own profile hides the shipped one of its name."""
    own = [_listed(path, shipped=False) for path in _own_files(user_dir or user_robots_dir())]
    names = {profile.name for profile in own}
    shipped = [_listed(_robots_dir() / f"{name}.yaml", shipped=True) for name in shipped_profiles()]
    return (*own, *(profile for profile in shipped if profile.name not in names))


def load_profile(name_or_path_or_url: str, *, user_dir: Path | None = None) -> RobotProfile:
    """Find a robot.

    The name of an own or shipped profile (``simulated``), a YAML file, or an address ``ws://HOST:PORT``, which means a
    robot with the usual ROS names there. An address that does not end in ``?ros=1`` or ``?ros=2`` leaves open which ROS
    it is: :func:`leaves_ros_open` says so, ``explore.detect_dialect`` asks the robot, and until then it is ROS 1.

    Raises
    ------
    ProfileError
        If there is no such profile or it has a mistake in it.
    """
    wanted = name_or_path_or_url.strip()
    if "://" in wanted:
        return _profile_at_address(wanted)
    if re.fullmatch(_NAME, wanted) and not Path(wanted).exists():
        return read_profile(_file_of(wanted, user_dir or user_robots_dir()))
    return read_profile(Path(wanted))


def leaves_ros_open(name_or_path_or_url: str) -> bool:
    """Whether this is an address that does not say which ROS the robot runs."""
    wanted = name_or_path_or_url.strip()
    return "://" in wanted and "ros" not in parse_qs(urlsplit(wanted).query)


def with_ros(url: str, ros: RosVersion) -> str:
    """The address ``url`` as :func:`load_profile` takes it for a robot with this ROS."""
    return urlsplit(url.strip())._replace(query=f"ros={ros}", fragment="").geturl()


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
    """Build a profile from YAML text; ``file_name`` is used in messages and to find the certificates beside it.

    Raises
    ------
    ProfileError
        As :func:`read_profile`.
    """
    source = ProfileText(text, file_name)
    source.check()
    return _Builder(source).profile(name)


def save_profile(profile: RobotProfile, path: Path) -> None:
    """Write a profile so that it reads back equal, in one step; ``path`` ends in .yaml and names the profile.

    Raises
    ------
    ProfileError
        If it cannot be written or would not read back; a file that was there is as before.
    """
    if path.suffix != ".yaml" or not re.fullmatch(_NAME, path.stem):
        raise ProfileError(f"{path.name!r} cannot be the name of a profile. Use letters, digits, - and _, then .yaml.")
    text = profile_yaml(profile_data(profile, path.parent))
    read_back = parse_profile(text, file_name=str(path), name=path.stem)
    if read_back != replace(profile, name=path.stem):
        raise ProfileError(f"The profile {profile.title!r} holds something that a file cannot say; it was not saved.")
    try:
        write_atomically(path, text)
    except OSError as error:
        raise ProfileError(f"The profile was not written to {path}: {error.strerror or error}.") from error


def profile_file_name(title: str) -> str:
    """A file name for a robot of this title: ``My Robot 2`` becomes ``my-robot-2.yaml``."""
    plain = unicodedata.normalize("NFKD", title).encode("ascii", "ignore").decode().lower()
    return (re.sub(r"[^a-z0-9]+", "-", plain).strip("-")[:60] or "robot") + ".yaml"


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


def profile_data(profile: RobotProfile, folder: Path) -> dict[str, Any]:
    """What a file in ``folder`` says of this profile, in the order in which it is written, without defaults.

    Raises
    ------
    ProfileError
        Where a certificate file is not in ``folder``.
    """
    data: dict[str, Any] = {
        "version": PROFILE_VERSION,
        "title": profile.title,
        "ros": profile.ros,
        "address": profile.address,
    }
    security = _given(profile.security, SecuritySettings())
    if profile.security.ca_file is not None:
        ca_file = Path(profile.security.ca_file)
        if not ca_file.is_relative_to(folder.resolve()):
            raise ProfileError(
                f"Copy the certificate file {ca_file} into {folder} first: a profile names it from there."
            )
        security["ca_file"] = ca_file.relative_to(folder.resolve()).as_posix()
    sections: dict[str, Any] = {
        "security": security,
        "simulation_time": profile.simulation_time,
        "velocity": {"topic": profile.velocity.topic} | _given(profile.velocity, VelocityTopic()),
        "command_rate_hz": profile.command_rate_hz,
        "limits": asdict(profile.limits),
        "guard": _given(profile.guard, GuardSettings()),
        "footprint": (
            {"polygon_m": [list(corner) for corner in profile.footprint_m]}
            if profile.footprint_m
            else {"radius_m": profile.footprint_radius_m}
        ),
        **{key: _source_data(key, getattr(profile, key)) for key in _SOURCES},
        "frames": _given(profile.frames, TransformFrames()),
        "cameras": [_camera_data(camera) for camera in profile.cameras],
        "navigation": profile.navigation and asdict(profile.navigation),
        "initial_pose": profile.initial_pose,
        "maps": profile.maps and _given(profile.maps, MapServices()),
        "speech": profile.speech and {**_given(profile.speech, SpeechInterface()), **_speech_action(profile.speech)},
        "emergency_stop": profile.emergency_stop and _given(profile.emergency_stop, EmergencyStopInterface()),
        "head": profile.head and _head_data(profile.head),
        "controls": [control_data(control) for control in profile.controls],
    }
    if profile.robot_from_laser != _AT_ORIGIN:
        laser = profile.robot_from_laser
        sections["laser"] = {
            "robot_from_laser": {"x_m": laser.x_m, "y_m": laser.y_m} | _angle("heading", laser.heading_rad)
        }
    return data | {key: value for key, value in sections.items() if value not in (None, {}, [], False)}


_NAME = r"[A-Za-z0-9_-]+"
_SOURCES = ("scan", "odometry", "pose", "tf", "tf_static", "map", "map_updates", "path", "battery")
_ALWAYS_LATCHED = ("map", "tf_static")
_AT_ORIGIN = Pose2D(0.0, 0.0, 0.0)


class _Builder:
    """Makes a profile of data that the schema has accepted, and checks what the schema cannot say."""

    def __init__(self, source: ProfileText) -> None:
        self._source = source
        self._data = source.data
        namespace = source.data.get("namespace", "").strip("/")
        self._prefix = f"/{namespace}/" if namespace else "/"
        self._digits_are_refused = source.data["ros"] == 2

    def profile(self, name: str) -> RobotProfile:
        data = self._data
        footprint_m, radius_m = self._footprint()
        velocity = data["velocity"]
        return RobotProfile(
            name=name,
            title=data.get("title", name),
            ros=data["ros"],
            address=self._address(),
            security=self._security(),
            simulation_time=data.get("simulation_time", False),
            velocity=VelocityTopic(**{**velocity, "topic": self._name(velocity["topic"], ("velocity", "topic"))}),
            command_rate_hz=float(data.get("command_rate_hz", 20.0)),
            limits=MotionLimits(**_floats(data.get("limits", {}))),
            guard=GuardSettings(**_floats(data.get("guard", {}))),
            **{key: self._topic_source(key) for key in _SOURCES},
            frames=TransformFrames(**{key: frame.lstrip("/") for key, frame in data.get("frames", {}).items()}),
            cameras=self._cameras(),
            navigation=self._navigation(),
            initial_pose=self._name_at(("initial_pose",)),
            maps=self._maps(),
            speech=self._speech(),
            emergency_stop=self._emergency_stop(),
            head=self._head(),
            controls=self._controls(),
            robot_from_laser=self._laser(),
            footprint_radius_m=radius_m,
            footprint_m=footprint_m,
        )

    def _name(self, name: str, path: KeyPath) -> str:
        """The absolute name: one that does not begin with a slash lies in the namespace."""
        absolute = name if name.startswith("/") else self._prefix + name
        if self._digits_are_refused and (re.search(r"/[0-9]", absolute) or "__" in absolute):
            raise self._source.mistake(
                path, f"{name!r} is no name in ROS 2, where no part begins with a digit or holds two _ in a row."
            )
        return absolute

    def _name_at(self, path: KeyPath) -> str | None:
        found: Any = self._data
        for step in path:
            found = found.get(step) if isinstance(found, Mapping) else found[step]
            if found is None:
                return None
        return self._name(found, path)

    def _names(self, section: str, keys: Iterable[str]) -> dict[str, str | None]:
        return {key: self._name_at((section, key)) for key in keys}

    def _address(self) -> str:
        try:
            return check_address(self._data.get("address", DEFAULT_ADDRESS))
        except ProfileError as error:
            raise self._source.mistake(("address",), str(error)) from error

    def _security(self) -> SecuritySettings:
        security = self._data.get("security", {})
        given = security.get("ca_file")
        if given is None:
            return SecuritySettings(rosauth_secret_env=security.get("rosauth_secret_env"))
        folder = Path(self._source.file_name).parent.resolve()
        ca_file = (folder / given).resolve()
        if Path(given).is_absolute() or not ca_file.is_relative_to(folder):
            raise self._source.mistake(
                ("security", "ca_file"), "the certificates must lie in the folder of the profile."
            )
        if not ca_file.is_file():
            raise self._source.mistake(("security", "ca_file"), f"there is no file {ca_file}.")
        return SecuritySettings(str(ca_file), security.get("rosauth_secret_env"))

    def _topic_source(self, key: str) -> TopicSource | None:
        data = self._data.get(key)
        if data is None:
            return None
        latched = data.get("latched", key in _ALWAYS_LATCHED)
        return TopicSource(self._name(data["topic"], (key, "topic")), data.get("throttle_ms", 0), latched)

    def _footprint(self) -> tuple[tuple[tuple[float, float], ...], float]:
        data = self._data
        if "footprint" in data and "footprint_radius_m" in data:
            raise self._source.mistake(("footprint_radius_m",), "is not needed beside footprint; keep one of the two.")
        footprint = data.get("footprint", {"radius_m": data.get("footprint_radius_m", 0.25)})
        if "radius_m" in footprint:
            return (), float(footprint["radius_m"])
        corners = [(float(x), float(y)) for x, y in footprint["polygon_m"]]
        wrong = polygon_mistake(corners)
        if wrong:
            raise self._source.mistake(("footprint", "polygon_m"), wrong)
        if _area(corners) < 0.0:
            corners.reverse()
        return tuple(corners), max(math.hypot(x, y) for x, y in corners)

    def _cameras(self) -> tuple[CameraTopic, ...]:
        cameras: list[CameraTopic] = []
        for index, camera in enumerate(self._data.get("cameras", ())):
            path: KeyPath = ("cameras", index)
            if any(camera["name"] == other.name for other in cameras):
                raise self._source.mistake((*path, "name"), f"two cameras are named {camera['name']!r}.")
            cameras.append(
                CameraTopic(
                    camera["name"],
                    self._name(camera["topic"], (*path, "topic")),
                    camera.get("throttle_ms", 60),
                    self._camera_model(camera["model"], (*path, "model")) if "model" in camera else None,
                    self._name(camera["info"], (*path, "info")) if "info" in camera else None,
                )
            )
        return tuple(cameras)

    def _camera_model(self, data: Mapping[str, Any], path: KeyPath) -> CameraModel:
        width_px, height_px = data["width_px"], data["height_px"]
        if "horizontal_fov_deg" in data:
            model = CameraModel.from_field_of_view(
                width_px=width_px, height_px=height_px, horizontal_rad=math.radians(data["horizontal_fov_deg"])
            )
            for key in ("fy_px", "cx_px", "cy_px"):
                if key in data:
                    raise self._source.mistake((*path, key), "belongs to fx_px, not to horizontal_fov_deg.")
        else:
            fx_px = float(data["fx_px"])
            model = CameraModel(
                width_px,
                height_px,
                fx_px,
                float(data.get("fy_px", fx_px)),
                float(data.get("cx_px", width_px / 2.0)),
                float(data.get("cy_px", height_px / 2.0)),
            )
        on_head = data.get("on_head", False)
        if on_head and "head" not in self._data:
            raise self._source.mistake((*path, "on_head"), "the profile names no head that the camera could turn with.")
        return replace(
            model,
            x_m=float(data.get("x_m", 0.0)),
            y_m=float(data.get("y_m", 0.0)),
            z_m=float(data.get("z_m", 1.0)),
            heading_rad=self._angle(data, "heading", path),
            tilt_rad=self._angle(data, "tilt", path),
            on_head=on_head,
        )

    def _angle(self, data: Mapping[str, Any], what: str, path: KeyPath) -> float:
        degrees, radians = data.get(f"{what}_deg"), data.get(f"{what}_rad")
        if degrees is not None and radians is not None:
            raise self._source.mistake((*path, f"{what}_rad"), f"is not needed beside {what}_deg; keep one of the two.")
        return math.radians(degrees) if degrees is not None else float(radians or 0.0)

    def _navigation(self) -> NavigationServer | None:
        data = self._data.get("navigation")
        if data is None:
            return None
        wanted = "move_base" if self._data["ros"] == 1 else "navigate_to_pose"
        if data["kind"] != wanted:
            raise self._source.mistake(
                ("navigation", "kind"), f"is {data['kind']!r}; with ros: {self._data['ros']} it is {wanted!r}."
            )
        return NavigationServer(data["kind"], self._name(data["name"], ("navigation", "name")))

    def _maps(self) -> MapServices | None:
        data = self._data.get("maps")
        if data is None:
            return None
        names = self._names("maps", ("slam_toolbox", "map_server", "map_saver"))
        return MapServices(**names, folder=data.get("folder", ""))

    def _speech(self) -> SpeechInterface | None:
        data = self._data.get("speech")
        if data is None:
            return None
        action = None
        if "action" in data:
            for key in ("speaking", "stop"):
                if key in data:
                    raise self._source.mistake(("speech", key), "belongs to a topic; an action tells and stops itself.")
            goal = data["action"]["goal"]
            if not mentions_value(goal):
                raise self._source.mistake(("speech", "action", "goal"), f"nowhere holds {VALUE}, the text to say.")
            name = self._name(data["action"]["name"], ("speech", "action", "name"))
            action = SpeechAction(name, data["action"]["type"], goal)
        return SpeechInterface(**self._names("speech", ("topic", "speaking", "stop")), action=action)

    def _emergency_stop(self) -> EmergencyStopInterface | None:
        data = self._data.get("emergency_stop")
        if data is None:
            return None
        ways = [key for key in ("service", "set_service", "command_topic") if key in data]
        if len(ways) > 1:
            raise self._source.mistake(
                ("emergency_stop", ways[1]), f"the robot is stopped in one way; keep either {' or '.join(ways)}."
            )
        for key, other in (("set_service", "clear_service"), ("clear_service", "set_service")):
            if key in data and other not in data:
                raise self._source.mistake(
                    ("emergency_stop", key), f"needs {other} beside it, or it is never released."
                )
        for key, owner in (
            ("service_field", "service"),
            ("service_stop_value", "service"),
            ("service_type", "set_service"),
            ("inverted", "topic"),
        ):
            if key in data and owner not in data:
                raise self._source.mistake(("emergency_stop", key), f"belongs to {owner}, which is not there.")
        if not ways and "topic" not in data:
            raise self._source.mistake(
                ("emergency_stop",), "name a topic, a service, set_service with clear_service, or a command_topic."
            )
        keys = ("topic", "service", "set_service", "clear_service", "command_topic")
        return EmergencyStopInterface(
            **self._names("emergency_stop", keys),
            inverted=data.get("inverted", False),
            service_field=data.get("service_field", "data"),
            service_stop_value=data.get("service_stop_value", True),
            service_type=data.get("service_type", "std_srvs/Trigger").replace("/srv/", "/"),
        )

    def _head(self) -> HeadInterface | None:
        data = self._data.get("head")
        if data is None:
            return None
        given = dict(data)
        for key in ("pan_range_rad", "tilt_range_rad"):
            if key in given:
                lowest, highest = given[key]
                if not lowest < highest:
                    raise self._source.mistake(
                        ("head", key), f"is [{lowest}, {highest}]; the lower number comes first."
                    )
                given[key] = (float(lowest), float(highest))
        if "speed_radps" in given:
            given["speed_radps"] = float(given["speed_radps"])
        if given["pan_joint"] == given["tilt_joint"]:
            raise self._source.mistake(("head", "tilt_joint"), "is the pan joint too; they are two joints.")
        given["topic"] = self._name(given["topic"], ("head", "topic"))
        given["joint_states"] = self._name(given.get("joint_states", "joint_states"), ("head", "joint_states"))
        return HeadInterface(**given)

    def _controls(self) -> tuple[RobotControl, ...]:
        controls: list[Mapping[str, Any]] = self._data.get("controls", [])
        for index, problem in control_problems(controls):
            raise self._source.mistake(("controls", index), problem)
        return tuple(
            control_from_data(self._with_absolute_names(control, ("controls", index)))
            for index, control in enumerate(controls)
        )

    def _with_absolute_names(self, control: Mapping[str, Any], path: KeyPath) -> dict[str, Any]:
        absolute = dict(control)
        for part, key in (("publish", "topic"), ("call", "service"), ("action", "name"), ("shows", "topic")):
            if part in control:
                absolute[part] = {**control[part], key: self._name(control[part][key], (*path, part, key))}
        return absolute

    def _laser(self) -> Pose2D:
        laser = self._data.get("laser", {}).get("robot_from_laser", {})
        heading_rad = self._angle(laser, "heading", ("laser", "robot_from_laser"))
        return Pose2D(float(laser.get("x_m", 0.0)), float(laser.get("y_m", 0.0)), heading_rad)


def polygon_mistake(corners: Sequence[tuple[float, float]]) -> str:
    """What is wrong with a footprint; empty when it is a simple polygon with the robot's centre inside."""
    if len(set(corners)) != len(corners):
        return "the same corner is listed twice; the outline closes by itself."
    sides = list(zip(corners, [*corners[1:], corners[0]], strict=True))
    for first, (a, b) in enumerate(sides):
        for second in range(first + 1, len(sides)):
            c, d = sides[second]
            if second - first not in (1, len(sides) - 1) and _cross(a, b, c, d):
                return "two sides of the outline cross; list the corners in their order around the robot."
    if abs(_area(corners)) < 1e-6:
        return "the corners lie on one line."
    turns = sum(math.atan2(ax * by - ay * bx, ax * bx + ay * by) for (ax, ay), (bx, by) in sides)
    if abs(turns) < math.pi:
        return "the outline must lie around the robot's centre [0, 0], around which it turns."
    return ""


def _area(corners: Sequence[tuple[float, float]]) -> float:
    """Positive when the corners go counter-clockwise."""
    following = [*corners[1:], corners[0]]
    return sum(ax * by - ay * bx for (ax, ay), (bx, by) in zip(corners, following, strict=True)) / 2.0


def _cross(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float], d: tuple[float, float]) -> bool:
    """Whether the two segments meet."""

    def side(p: tuple[float, float], q: tuple[float, float], r: tuple[float, float]) -> float:
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    return side(a, b, c) * side(a, b, d) <= 0.0 and side(c, d, a) * side(c, d, b) <= 0.0


def _profile_at_address(url: str) -> RobotProfile:
    parts = urlsplit(check_address(url))
    asked = parse_qs(parts.query)
    ros = asked.pop("ros", ["1"])[-1]
    if asked or ros not in ("1", "2"):
        raise ProfileError(f"{url!r}: after the '?' of an address only ros=1 or ros=2 is understood.")
    address = parts._replace(query="", fragment="").geturl()
    # The fullest set of usual names; the link finds out which of them the robot really has.
    profile = read_profile(_robots_dir() / ("simulated.yaml" if ros == "1" else "simulated-ros2.yaml"))
    return replace(
        profile,
        name="address",
        address=address,
        title=f"Robot at {without_credentials(address)}",
        # Nobody has told of these: where its camera is, whether it has a head, and what it can besides.
        cameras=tuple(replace(camera, model=None) for camera in profile.cameras),
        head=None,
        maps=None,
        controls=(),
    )


def _robots_dir() -> Path:
    return resources_dir() / "robots"


def _own_files(user_dir: Path) -> list[Path]:
    return sorted(path for path in user_dir.glob("*.yaml") if path.is_file() and not path.name.startswith("."))


def _file_of(name: str, user_dir: Path) -> Path:
    own, shipped = user_dir / f"{name}.yaml", _robots_dir() / f"{name}.yaml"
    if own.is_file():
        return own
    if shipped.is_file():
        return shipped
    names = sorted({path.stem for path in _own_files(user_dir)} | set(shipped_profiles()))
    raise ProfileError(
        f"There is no robot profile named {name!r}.{did_you_mean(name, names)} Profiles: {', '.join(names)}. "
        "A YAML file or an address such as ws://192.168.1.20:9090 works too."
    )


def _listed(path: Path, *, shipped: bool) -> ListedProfile:
    name = path.stem if re.fullmatch(_NAME, path.stem) else str(path)
    try:
        profile = read_profile(path)
    except ProfileError as error:
        return ListedProfile(name, path.name, "", path, shipped, str(error))
    return ListedProfile(name, profile.title, without_credentials(profile.address), path, shipped)


def _floats(data: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value if isinstance(value, bool) else float(value) for key, value in data.items()}


def _given(value: Any, default: Any) -> dict[str, Any]:
    """The fields of a dataclass that differ from ``default``."""
    pairs = ((each.name, getattr(value, each.name), getattr(default, each.name)) for each in fields(value))
    return {name: found for name, found, usual in pairs if found != usual and not is_dataclass(found)}


def _source_data(key: str, source: TopicSource | None) -> dict[str, Any] | None:
    if source is None:
        return None
    data: dict[str, Any] = {"topic": source.topic}
    if source.throttle_ms:
        data["throttle_ms"] = source.throttle_ms
    if source.latched != (key in _ALWAYS_LATCHED):
        data["latched"] = source.latched
    return data


def _camera_data(camera: CameraTopic) -> dict[str, Any]:
    data: dict[str, Any] = {"name": camera.name, "topic": camera.topic, "throttle_ms": camera.throttle_ms}
    if camera.info is not None:
        data["info"] = camera.info
    if camera.model is not None:
        data["model"] = _model_data(camera.model)
    return data


def _model_data(model: CameraModel) -> dict[str, Any]:
    data: dict[str, Any] = {"width_px": model.width_px, "height_px": model.height_px}
    horizontal_deg = _degrees(2.0 * math.atan2(model.width_px / 2.0, model.fx_px))
    from_angle = None
    if horizontal_deg is not None:
        from_angle = CameraModel.from_field_of_view(
            width_px=model.width_px, height_px=model.height_px, horizontal_rad=math.radians(horizontal_deg)
        )
    lens = ("fx_px", "fy_px", "cx_px", "cy_px")
    if from_angle is not None and all(getattr(model, key) == getattr(from_angle, key) for key in lens):
        data["horizontal_fov_deg"] = horizontal_deg
    else:
        data |= {key: getattr(model, key) for key in lens}
    data |= {"x_m": model.x_m, "y_m": model.y_m, "z_m": model.z_m}
    data |= _angle("heading", model.heading_rad) | _angle("tilt", model.tilt_rad)
    return data | ({"on_head": True} if model.on_head else {})


def _angle(what: str, angle_rad: float) -> dict[str, float]:
    """An angle in degrees where that says it exactly."""
    degrees = _degrees(angle_rad)
    return (
        {f"{what}_rad": angle_rad}
        if degrees is None or math.radians(degrees) != angle_rad
        else {f"{what}_deg": degrees}
    )


def _degrees(angle_rad: float) -> float | None:
    """The shortest number of degrees that is nearly this angle."""
    exact = math.degrees(angle_rad)
    rounded = (round(exact, digits) for digits in range(16))
    return next((degrees for degrees in rounded if math.isclose(math.radians(degrees), angle_rad, rel_tol=1e-15)), None)


def _speech_action(speech: SpeechInterface) -> dict[str, Any]:
    if speech.action is None:
        return {}
    return {"action": {"name": speech.action.name, "type": speech.action.type, "goal": dict(speech.action.goal)}}


def _head_data(head: HeadInterface) -> dict[str, Any]:
    data = {each.name: getattr(head, each.name) for each in fields(head)}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in data.items()}
