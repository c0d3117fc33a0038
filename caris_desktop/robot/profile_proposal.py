"""Profile proposal for an unknown robot: candidates for each interface by type and name, with reasons as text.

Long because it holds the recognition rules of each interface.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import field, replace
from typing import Any

from caris_desktop.domain.translation import QT_TR_NOOP, joined, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.robot.profile_model import (
    HEAD_TYPES,
    MOST_CAMERAS,
    AudioInterface,
    CameraTopic,
    EmergencyStopInterface,
    HeadInterface,
    MapServices,
    MotionLimits,
    NavigationServer,
    RobotProfile,
    SecuritySettings,
    SpeechAction,
    SpeechInterface,
    SpeedLimitInterface,
    TopicSource,
    TransformFrames,
    VelocityTopic,
)
from caris_desktop.ros.dialect import Dialect, same_type
from caris_desktop.ros.message_conversion import republish_advice

_RAW_THROTTLE_MS = 100
# Unknown dynamics: slow enough for a first try.
CAUTIOUS = MotionLimits(
    forward_mps=0.3, backward_mps=0.2, turn_radps=0.6, acceleration_mps2=0.5, deceleration_mps2=1.0,
    turn_acceleration_radps2=1.5, turn_deceleration_radps2=3.0,
)  # fmt: skip


class RobotOffer(Value):
    """Inventory of a robot. Types are spelled as on the robot; an empty one is unknown.

    ``actions`` are the action servers. ``frames`` (of tf) and ``joints`` (of joint states) were received while
    listening briefly. ``publishers`` and ``subscribers`` count the nodes at a topic, if rosapi reports them.
    """

    topics: Mapping[str, str]
    services: Mapping[str, str] = field(default_factory=dict)
    actions: Mapping[str, str] = field(default_factory=dict)
    dialect: Dialect | None = None
    distribution: str = ""
    frames: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    publishers: Mapping[str, int] = field(default_factory=dict)
    subscribers: Mapping[str, int] = field(default_factory=dict)


class Candidate(Value):
    """Candidate value of a profile field. ``confidence`` is 0..1; ``why`` is the reason."""

    value: str
    type: str
    confidence: float
    why: str


class FieldProposal(Value):
    """Line of the proposed mapping: the profile's ``field`` gets ``value`` ("" for none), one of ``candidates``.

    Candidates are sorted best first. ``field`` is a key of the profile (``scan``, ``cameras.0``, ``speech.stop``).
    """

    field: str
    label: str
    value: str
    candidates: tuple[Candidate, ...]
    why: str


class Proposal(Value):
    """Mapping for the whole robot. ``notes`` are for the person who saves it."""

    namespace: str
    namespaces: tuple[str, ...]
    fields: tuple[FieldProposal, ...]
    notes: tuple[str, ...] = ()

    @property
    def chosen(self) -> dict[str, str]:
        """Proposed value of each field; input of :func:`profile_of`, possibly changed."""
        return {proposal.field: proposal.value for proposal in self.fields}


def propose(offer: RobotOffer, *, namespace: str | None = None) -> Proposal:
    """Most likely mapping. ``namespace`` selects one of several robots on one server ("" for none)."""
    namespaces = _namespaces(offer)
    chosen_namespace = namespace if namespace is not None else namespaces[0] if namespaces else ""
    ranked = _Ranking(offer, chosen_namespace)
    fields: list[FieldProposal] = []

    def add(key: str, label: str, candidates: list[Candidate], least: float = 0.4) -> None:
        best = candidates[0] if candidates and candidates[0].confidence >= least else None
        if best is not None:
            reason = best.why
        elif candidates:
            reason = localized(QT_TR_NOOP("{count} of this type, none with a matching name."), count=len(candidates))
        else:
            reason = QT_TR_NOOP("The robot offers nothing of this kind.")
        fields.append(FieldProposal(key, label, best.value if best else "", tuple(candidates), reason))

    def add_topics(kinds: Iterable[_Kind]) -> None:
        for kind in kinds:
            add(kind.field, kind.label, ranked.topics(kind), kind.least)

    add_topics(_TOPICS)
    cameras = ranked.cameras()
    for index, best in enumerate(_distinct_cameras(cameras)[:MOST_CAMERAS]):
        # Only the first is proposed with low confidence: each further camera costs bandwidth.
        value = best.value if index == 0 or best.confidence >= 0.7 else ""
        label = localized(QT_TR_NOOP("Camera {number}"), number=index + 1)
        fields.append(FieldProposal(f"cameras.{index}", label, value, tuple(cameras), best.why))
    add("navigation", QT_TR_NOOP("Navigation"), ranked.navigation())
    add_topics([_INITIAL_POSE])
    add("speech", QT_TR_NOOP("Voice"), ranked.voices())
    add_topics(_FURTHER_TOPICS)
    add("emergency_stop.service", QT_TR_NOOP("Emergency stop"), ranked.emergency_stops(), 0.6)
    add("head", QT_TR_NOOP("Head"), ranked.heads())
    for node, service in (("slam_toolbox", "serialize_map"), ("map_server", "load_map"), ("map_saver", "save_map")):
        add(f"maps.{node}", localized(QT_TR_NOOP("Maps: {node}"), node=node), ranked.map_nodes(service))
    return Proposal(chosen_namespace, namespaces, tuple(fields), tuple(_notes(offer, fields)))


def profile_of(
    offer: RobotOffer,
    chosen: Mapping[str, str],
    *,
    name: str,
    title: str,
    address: str,
    security: SecuritySettings | None = None,
) -> RobotProfile:
    """Profile with this mapping: ``chosen`` is ``Proposal.chosen``, possibly changed; "" omits a field.

    Speeds are cautious; what the robot cannot report (footprint, camera pose) has defaults.
    """

    def given(key: str) -> str | None:
        return chosen.get(key) or None

    def source(key: str, throttle_ms: int = 0, *, latched: bool = False) -> TopicSource | None:
        topic = given(key)
        return TopicSource(topic, throttle_ms, latched) if topic else None

    velocity = given("velocity") or "/cmd_vel"
    stamped = same_type(offer.topics.get(velocity, ""), "geometry_msgs/TwistStamped")
    frames = _frames(offer)
    maps = MapServices(given("maps.slam_toolbox"), given("maps.map_server"), given("maps.map_saver"))
    ros2 = offer.dialect is Dialect.ROS2
    navigation = given("navigation")
    return RobotProfile(
        name=name,
        title=title,
        ros=2 if ros2 else 1,
        address=address,
        security=security or SecuritySettings(),
        simulation_time=_runs_on_simulation_time(offer),
        velocity=VelocityTopic(velocity, "TwistStamped" if stamped else "Twist", frames.base),
        limits=CAUTIOUS,
        scan=source("scan", 50),
        odometry=source("odometry", 50),
        pose=source("pose", latched=not ros2),
        tf=source("tf"),
        tf_static=source("tf_static", latched=True),
        frames=frames,
        map=source("map", 500, latched=True),
        map_updates=source("map_updates"),
        path=source("path"),
        battery=source("battery", 1000),
        cameras=tuple(_cameras(offer, chosen)),
        navigation=_navigation(offer, navigation) if navigation else None,
        initial_pose=given("initial_pose"),
        maps=maps if maps != MapServices() else None,
        speech=_speech(offer, chosen),
        audio=_audio(offer, chosen),
        emergency_stop=_emergency_stop(offer, given("emergency_stop.topic"), given("emergency_stop.service")),
        head=_head(offer, given("head")),
    )


def _navigation(offer: RobotOffer, action: str) -> NavigationServer:
    if offer.dialect is not Dialect.ROS2:
        # The speed of a ROS 1 planner cannot be queried, so no limit is configured.
        return NavigationServer("move_base", action)
    limits = sorted(topic for topic, kind in offer.topics.items() if same_type(kind, "nav2_msgs/SpeedLimit"))
    speed_limit = SpeedLimitInterface(topic=limits[0]) if limits else None
    return NavigationServer("navigate_to_pose", action, speed_limit=speed_limit)


def may_stop(service: str) -> bool:
    """True if a service of this name may be an emergency stop, so that its type is of interest."""
    return bool(_STOP_WORDS.search(service) or _SWITCH_WORDS.search(service))


class _Kind(Value):
    """Recognition rule of a topic: types, last words of the name (best first), and words that count against it.

    Below ``least`` confidence it is listed but not proposed. ``published``: the robot publishes it. ``about`` must
    occur in the name.
    """

    field: str
    label: str
    types: tuple[str, ...]
    names: tuple[str, ...]
    against: tuple[str, ...] = ()
    least: float = 0.4
    published: bool = True
    about: re.Pattern[str] | None = None


_SPEECH_WORDS = re.compile(r"(^|[/_])(tts|speech|say|speak|speaking|talk|voice)([/_]|$)", re.IGNORECASE)
_TOPICS = (
    _Kind(
        "velocity", QT_TR_NOOP("Driving"), ("geometry_msgs/Twist", "geometry_msgs/TwistStamped"),
        ("cmd_vel", "key_vel", "cmd_vel_teleop", "teleop", "cmd_vel_key", "joy_vel", "cmd_vel_joy", "tab_vel",
         "cmd_vel_unstamped", "velocity"),
        ("nav", "smooth", "safe", "out", "raw", "assisted", "turtle", "odom", "command_velocity", "measured",
         "controller"),
        published=False,
    ),
    _Kind(
        "scan", QT_TR_NOOP("LIDAR"), ("sensor_msgs/LaserScan",),
        ("scan", "scan_raw", "base_scan", "scan_filtered", "front_scan", "scan_front", "laser", "laser_scan"),
        ("rear", "back", "depth", "cliff", "sonar", "camera", "virtual", "ground", "shovel"),
    ),
    _Kind(
        "odometry", QT_TR_NOOP("Odometry"), ("nav_msgs/Odometry",), ("odom", "odometry", "filtered"),
        ("ground_truth", "visual", "vo", "gps", "rf2o", "camera", "t265"),
    ),
    _Kind(
        "pose", QT_TR_NOOP("Pose in the map"), ("geometry_msgs/PoseWithCovarianceStamped",),
        ("amcl_pose", "pose", "robot_pose", "localization_pose"), ("initialpose", "initial", "set_pose", "gps"),
    ),
    _Kind("tf", QT_TR_NOOP("Transforms"), ("tf2_msgs/TFMessage", "tf/tfMessage"), ("tf",), ("tf_static",)),
    _Kind("tf_static", QT_TR_NOOP("Static transforms"), ("tf2_msgs/TFMessage",), ("tf_static",), least=0.7),
    _Kind(
        "map", QT_TR_NOOP("Map"), ("nav_msgs/OccupancyGrid",), ("map",),
        ("costmap", "local", "global", "visibility", "keepout", "mask", "filter"), least=0.6,
    ),
    _Kind(
        "map_updates", QT_TR_NOOP("Map updates"), ("map_msgs/OccupancyGridUpdate",), ("map_updates",),
        ("costmap", "local"), least=0.6,
    ),
    _Kind(
        "path", QT_TR_NOOP("Planned path"), ("nav_msgs/Path",), ("plan", "global_plan", "received_global_plan", "path"),
        ("local", "transformed", "trajectory", "odom", "history", "smoothed"),
    ),
    _Kind(
        "battery", QT_TR_NOOP("Battery"), ("sensor_msgs/BatteryState",), ("battery_state", "battery", "state"),
        ("dock", "arm"),
    ),
)  # fmt: skip
_INITIAL_POSE = _Kind(
    "initial_pose", QT_TR_NOOP("Initial pose"), ("geometry_msgs/PoseWithCovarianceStamped",),
    ("initialpose", "initial_pose"), least=0.7, published=False,
)  # fmt: skip
_CAMERA = _Kind(
    "cameras.0", QT_TR_NOOP("Camera"), ("sensor_msgs/CompressedImage",), ("compressed",),
    ("depth", "infra", "ir", "left", "right", "stereo", "theora", "debug", "overlay", "mask", "bottom", "rear", "back"),
)  # fmt: skip
_RAW_CAMERA = replace(
    _CAMERA,
    types=("sensor_msgs/Image",),
    names=("image_raw", "image_color", "image", "image_rect_color", "color", "rgb", "image_rect"),
)
_SOUND_TYPES = ("audio_common_msgs/AudioData", "audio_common_msgs/AudioDataStamped")
_FURTHER_TOPICS = (
    _Kind(
        "speech.speaking", QT_TR_NOOP("Voice: speaking"), ("std_msgs/Bool",),
        ("speaking", "is_speaking", "tts_active"), least=0.7,
    ),
    _Kind(
        "speech.stop", QT_TR_NOOP("Voice: stop"), ("std_msgs/Empty",),
        ("stop", "tts_stop", "stop_speaking", "shut_up"), least=0.7, published=False, about=_SPEECH_WORDS,
    ),
    _Kind(
        "audio.topic", QT_TR_NOOP("Microphone"), _SOUND_TYPES,
        ("audio", "audio_stamped", "audio_raw", "mic", "microphone"), ("speaker", "play", "tts", "out"),
    ),
    _Kind(
        "audio.info", QT_TR_NOOP("Microphone: format"), ("audio_common_msgs/AudioInfo",), ("audio_info", "info"),
        least=0.6,
    ),
    _Kind(
        "audio.speaker", QT_TR_NOOP("Loudspeaker"), _SOUND_TYPES[:1], ("audio", "speaker", "play", "audio_play"),
        least=0.6, published=False, about=re.compile(r"speaker|play", re.IGNORECASE),
    ),
    _Kind(
        "emergency_stop.topic", QT_TR_NOOP("Emergency stop state"), ("std_msgs/Bool",),
        ("emergency_stop", "e_stop", "estop", "emergency_stop_state", "emergency_button", "is_emergency", "is_stopped"),
        least=0.6,
    ),
)  # fmt: skip
_STOP_WORDS = re.compile(r"e_?stop|emergency|runstop", re.IGNORECASE)
_HEARING_WORDS = re.compile(
    r"recogni|asr|stt|heard|result|status|feedback|event|viseme|speaking|grammar", re.IGNORECASE
)
# Speech actions with published goals: (type, goal). $value is the text.
_SPEECH_ACTIONS: tuple[tuple[str, Mapping[str, Any]], ...] = (
    ("pal_interaction_msgs/TtsAction", {"rawtext": {"text": "$value", "lang_id": "en_GB"}}),
    ("tts_msgs/action/TTS", {"input": "$value", "locale": "en_US"}),
    ("communication_skills/action/Say", {"input": "$value"}),
    (
        "sound_play/SoundRequestAction",
        {"sound_request": {"sound": -3, "command": 1, "volume": 1.0, "arg": "$value", "arg2": ""}},
    ),
    ("naoqi_bridge_msgs/SpeechWithFeedbackAction", {"say": "$value"}),
)
_NAVIGATION = ("move_base_msgs/MoveBaseAction", "nav2_msgs/action/NavigateToPose")
# Services with a bool that stops: (type, field).
_STOP_SERVICES = (("std_srvs/SetBool", "data"), ("irobot_create_msgs/EStop", "e_stop_on"))
# Switching off the motors stops the robot.
_SWITCH_WORDS = re.compile(r"motors?_?(power|enabled?)|enable_motors?", re.IGNORECASE)
_PAIRED_SERVICES = ("std_srvs/Trigger", "std_srvs/Empty")
_PAN_JOINTS = ("head_1_joint", "headyaw", "head_pan_joint", "head_pan", "head_yaw", "pan_joint", "neck_pan")
_TILT_JOINTS = ("head_2_joint", "headpitch", "head_tilt_joint", "head_tilt", "head_pitch", "tilt_joint", "neck_tilt")


class _Ranking:
    """Candidates from one inventory, best first, those in ``namespace`` first."""

    def __init__(self, offer: RobotOffer, namespace: str) -> None:
        self._offer = offer
        self._namespace = namespace

    def topics(self, kind: _Kind) -> list[Candidate]:
        found = [
            self._rated(kind, topic, found_type)
            for topic, found_type in self._offer.topics.items()
            if any(same_type(found_type, expected) for expected in kind.types)
            and (kind.about is None or kind.about.search(topic))
        ]
        return _best_first(found)

    def cameras(self) -> list[Candidate]:
        """Cameras, compressed images first."""
        raw = [
            replace(
                candidate,
                confidence=_clipped(candidate.confidence - 0.3),
                why=joined((candidate.why, QT_TR_NOOP("But it is not compressed and needs much bandwidth."))),
            )
            for candidate in self.topics(_RAW_CAMERA)
        ]
        return _best_first([*self.topics(_CAMERA), *raw])

    def navigation(self) -> list[Candidate]:
        found = []
        for action, found_type in self._offer.actions.items():
            if any(same_type(found_type, expected) for expected in _NAVIGATION):
                reason = localized(QT_TR_NOOP("It is an action server of type {type}."), type=found_type)
                found.append(Candidate(action, found_type, 0.95, reason))
            elif not found_type and action.rsplit("/", 1)[-1] in ("move_base", "navigate_to_pose"):
                usual = QT_TR_NOOP("It is an action server with the usual name.")
                found.append(Candidate(action, found_type, 0.75, usual))
        return _best_first(self._in_namespace(candidate) for candidate in found)

    def voices(self) -> list[Candidate]:
        found = []
        for action, found_type in self._offer.actions.items():
            if any(same_type(found_type, known) for known, _ in _SPEECH_ACTIONS):
                reason = QT_TR_NOOP("It is a speech action, which reports when it has finished.")
                found.append(Candidate(action, found_type, 0.95, reason))
        for topic, found_type in self._offer.topics.items():
            spoken = same_type(found_type, "std_msgs/String") and _SPEECH_WORDS.search(topic)
            if spoken and not _HEARING_WORDS.search(topic):
                last = topic.rsplit("/", 1)[-1]
                certainty = 0.8 if last in ("tts", "speech", "say") else 0.55
                reason = localized(QT_TR_NOOP("It accepts text and is named “{name}”."), name=last)
                found.append(Candidate(topic, found_type, certainty, reason))
        return _best_first(self._in_namespace(candidate) for candidate in found)

    def emergency_stops(self) -> list[Candidate]:
        """Services and command topics; a pair of services is written ``SET | CLEAR``."""
        found = []
        services = self._offer.services
        for service, found_type in services.items():
            if not may_stop(service):
                continue
            switch = _SWITCH_WORDS.search(service)
            if any(same_type(found_type, known) for known, _field in _STOP_SERVICES):
                reason = QT_TR_NOOP("It is a service of type {type} with a matching name.")
                if switch:
                    reason = QT_TR_NOOP("It is a service of type {type} that switches the motors: false stops.")
                found.append(Candidate(service, found_type, 0.7 if switch else 0.9, localized(reason, type=found_type)))
            elif any(same_type(found_type, known) for known in _PAIRED_SERVICES):
                release = _release_of(service, services)
                if release is not None:
                    reason = QT_TR_NOOP("They are two services of type {type}: one stops, the other releases.")
                    found.append(
                        Candidate(f"{service} | {release}", found_type, 0.7, localized(reason, type=found_type))
                    )
        return _best_first(self._in_namespace(candidate) for candidate in found)

    def heads(self) -> list[Candidate]:
        joints = _head_joints(self._offer)
        found = []
        for topic, found_type in self._offer.topics.items():
            kind = next((kind for kind, known in HEAD_TYPES.items() if same_type(found_type, known)), None)
            if kind is None or (kind == "joint_trajectory" and "head" not in topic.lower() and "neck" not in topic):
                continue
            if joints is None:
                reason = QT_TR_NOOP("Its type matches, but the joint states contain no head joints.")
                found.append(Candidate(topic, found_type, 0.3, reason))
            else:
                reason = QT_TR_NOOP("It moves joints, and {pan} and {tilt} exist.")
                found.append(Candidate(topic, found_type, 0.85, localized(reason, pan=joints[0], tilt=joints[1])))
        return _best_first(self._in_namespace(candidate) for candidate in found)

    def map_nodes(self, service: str) -> list[Candidate]:
        found = []
        for name, found_type in self._offer.services.items():
            node, _, last = name.rpartition("/")
            if last == service and node:
                reason = localized(QT_TR_NOOP("It has the service {name}."), name=name)
                found.append(Candidate(node, found_type, 0.9, reason))
        return _best_first(self._in_namespace(candidate) for candidate in found)

    def _rated(self, kind: _Kind, topic: str, found_type: str) -> Candidate:
        words = [word for word in topic.lower().split("/") if word]
        last = words[-1] if words else ""
        reasons: list[str] = [localized(QT_TR_NOOP("Its type is {type}."), type=found_type)]
        if last in kind.names:
            certainty = 0.95 - 0.03 * kind.names.index(last)
            reasons.append(localized(QT_TR_NOOP("It is named “{name}”."), name=last))
        elif any(name in last for name in kind.names):
            certainty = 0.65
            held = next(name for name in kind.names if name in last)
            reasons.append(localized(QT_TR_NOOP("Its name contains “{word}”."), word=held))
        else:
            certainty = 0.45
        doubts = [word for word in kind.against if _has_word(words, word)]
        if doubts:
            certainty -= 0.4
            reasons.append(localized(QT_TR_NOOP("But “{word}” in its name makes it unlikely."), word=doubts[0]))
        # A short name is the robot's own; long ones belong to components.
        certainty -= 0.02 * max(0, len(words) - 1)
        count = (self._offer.publishers if kind.published else self._offer.subscribers).get(topic)
        if count == 0 and kind.published:
            certainty -= 0.25
            reasons.append(QT_TR_NOOP("But nothing currently publishes it."))
        elif count:
            certainty += 0.03
        return self._in_namespace(Candidate(topic, found_type, _clipped(certainty), joined(reasons)))

    def _in_namespace(self, candidate: Candidate) -> Candidate:
        # tf is shared by all robots of a server unless one has its own.
        shared = candidate.value in ("/tf", "/tf_static", "/map")
        if shared or not self._namespace:
            return candidate
        if f"{candidate.value}/".startswith(f"/{self._namespace}/"):
            return replace(candidate, confidence=_clipped(candidate.confidence + 0.1))
        elsewhere = QT_TR_NOOP("But it is not in the namespace {namespace}.")
        return replace(
            candidate,
            confidence=_clipped(candidate.confidence - 0.5),
            why=joined((candidate.why, localized(elsewhere, namespace=self._namespace))),
        )


def _distinct_cameras(candidates: Iterable[Candidate]) -> list[Candidate]:
    """Best topic of each camera, which may have raw and rectified images."""
    cameras: dict[str, Candidate] = {}
    for candidate in candidates:
        cameras.setdefault(candidate.value.removesuffix("/compressed").rpartition("/")[0], candidate)
    return list(cameras.values())


def _namespaces(offer: RobotOffer) -> tuple[str, ...]:
    """Common prefixes of the velocity topics of several robots, or of a single one."""
    holds: dict[str, set[str]] = {}
    for topic, found_type in offer.topics.items():
        prefix, _, last = topic.strip("/").rpartition("/")
        if prefix and "/" not in prefix:
            kinds = holds.setdefault(prefix, set())
            for kind in _TOPICS[:3]:
                # Many topics carry a Twist; those that drive a robot have telling names.
                if any(same_type(found_type, expected) for expected in kind.types) and last in kind.names:
                    kinds.add(kind.field)
    # A controller has its own velocity and odometry, but no LIDAR.
    found = sorted(prefix for prefix, kinds in holds.items() if kinds >= {"velocity", "odometry", "scan"})
    return tuple(["", *found] if "/cmd_vel" in offer.topics and found else found)


def _notes(offer: RobotOffer, fields: Iterable[FieldProposal]) -> Iterator[str]:
    values = {proposal.field: proposal.value for proposal in fields}
    slow = QT_TR_NOOP(
        "The speed limit starts low, at {speed} m/s. Set “limits” and “footprint” in the file to the robot's values."
    )
    yield localized(slow, speed=CAUTIOUS.forward_mps)
    if not values.get("velocity"):
        yield QT_TR_NOOP("No topic for driving was found; choose it manually if the robot subscribes to one.")
    if _runs_on_simulation_time(offer):
        yield QT_TR_NOOP("The robot publishes /clock, so its time is that of a simulator.")
    if values.get("cameras.0"):
        yield QT_TR_NOOP(
            "The position of the camera cannot be queried: add “model” to the camera so that clicks in the "
            "video find the floor."
        )
    for index in range(MOST_CAMERAS):
        topic = values.get(f"cameras.{index}", "")
        if same_type(offer.topics.get(topic, ""), "sensor_msgs/Image"):
            heavy = QT_TR_NOOP("{topic} is not compressed, which is too much for a wireless link. Better: {advice}.")
            yield localized(heavy, topic=topic, advice=republish_advice(topic))
    multiplexer = re.compile(r"twist_mux|vel_mux|joy_priority$")
    if values.get("velocity") and any(multiplexer.search(topic) for topic in offer.topics):
        yield QT_TR_NOOP(
            "There is a velocity multiplexer: drive through an input for manual control, so that driving "
            "overrides navigation."
        )


def _runs_on_simulation_time(offer: RobotOffer) -> bool:
    return same_type(offer.topics.get("/clock", ""), "rosgraph_msgs/Clock") and offer.publishers.get("/clock", 1) > 0


def _frames(offer: RobotOffer) -> TransformFrames:
    def first(*names: str) -> str:
        """The received frame name, with any namespace."""
        for name in names:
            found = [frame for frame in offer.frames if frame == name or frame.endswith(f"/{name}")]
            if found:
                return min(found, key=len)
        return names[0]

    return TransformFrames(first("map"), first("odom"), first("base_link", "base_footprint"))


def _cameras(offer: RobotOffer, chosen: Mapping[str, str]) -> Iterator[CameraTopic]:
    names: set[str] = set()
    for index in range(MOST_CAMERAS):
        topic = chosen.get(f"cameras.{index}")
        if not topic:
            continue
        base = topic.removesuffix("/compressed").rpartition("/")[0]
        info = f"{base}/camera_info"
        known = same_type(offer.topics.get(info, ""), "sensor_msgs/CameraInfo")
        words = [word for word in base.split("/") if word not in ("", "rgb", "color", "image", "camera")]
        name = re.sub(r"[^A-Za-z0-9_-]", "", words[-1] if words else "front") or "front"
        if name in names:
            name = f"{name}-{index + 1}"
        names.add(name)
        camera = CameraTopic(name, topic, info=info if known else None)
        if same_type(offer.topics.get(topic, ""), "sensor_msgs/Image"):
            camera = replace(camera, type="Image", throttle_ms=_RAW_THROTTLE_MS)
        yield camera


def _speech(offer: RobotOffer, chosen: Mapping[str, str]) -> SpeechInterface | None:
    name = chosen.get("speech")
    if not name:
        return None
    found_type = offer.actions.get(name, "")
    for known, goal in _SPEECH_ACTIONS:
        if same_type(found_type, known):
            return SpeechInterface(action=SpeechAction(name, found_type, goal))
    return SpeechInterface(name, chosen.get("speech.speaking") or None, chosen.get("speech.stop") or None)


def _audio(offer: RobotOffer, chosen: Mapping[str, str]) -> AudioInterface | None:
    """Coding and rate have default values unless the robot reports them."""
    topic, speaker = chosen.get("audio.topic") or None, chosen.get("audio.speaker") or None
    if topic is None:
        return None if speaker is None else AudioInterface(speaker=speaker)
    stamped = same_type(offer.topics.get(topic, ""), "audio_common_msgs/AudioDataStamped")
    info = chosen.get("audio.info") or None
    return AudioInterface(topic, "AudioDataStamped" if stamped else "AudioData", info=info, speaker=speaker)


def _emergency_stop(offer: RobotOffer, topic: str | None, service: str | None) -> EmergencyStopInterface | None:
    if service is None:
        return EmergencyStopInterface(topic) if topic else None
    stops, _, releases = service.partition(" | ")
    found_type = offer.services.get(stops, "")
    if not releases:
        field_name = next((name for known, name in _STOP_SERVICES if same_type(found_type, known)), "data")
        return EmergencyStopInterface(
            topic, service=stops, service_field=field_name, service_stop_value=not _SWITCH_WORDS.search(stops)
        )
    empty = same_type(found_type, "std_srvs/Empty")
    return EmergencyStopInterface(
        topic, set_service=stops, clear_service=releases, service_type="std_srvs/Empty" if empty else "std_srvs/Trigger"
    )


def _head(offer: RobotOffer, topic: str | None) -> HeadInterface | None:
    joints = _head_joints(offer)
    if topic is None or joints is None:
        return None
    found_type = offer.topics.get(topic, "")
    angles = same_type(found_type, "naoqi_bridge_msgs/JointAnglesWithSpeed")
    states = [name for name, kind in offer.topics.items() if same_type(kind, "sensor_msgs/JointState")]
    named = [name for name in states if name.endswith("/joint_states")] or states or ["/joint_states"]
    # The narrow default ranges suit most heads; joint directions cannot be queried.
    return HeadInterface(
        "joint_angles" if angles else "joint_trajectory", topic, joints[0], joints[1], min(named, key=len)
    )


def _head_joints(offer: RobotOffer) -> tuple[str, str] | None:
    """(pan, tilt) among the received joints."""

    def find(known: tuple[str, ...]) -> str | None:
        lower = {joint.lower().rsplit("/", 1)[-1]: joint for joint in offer.joints}
        return next((lower[name] for name in known if name in lower), None)

    pan, tilt = find(_PAN_JOINTS), find(_TILT_JOINTS)
    return (pan, tilt) if pan and tilt else None


def _release_of(service: str, services: Mapping[str, str]) -> str | None:
    """Service of the same type that releases what ``service`` stops."""
    folder, _, last = service.rpartition("/")
    pairs: tuple[tuple[str, str], ...] = (
        ("set", "clear"), ("set", "reset"), ("set", "release"), ("stop", "release"), ("stop", "reset"),
        ("trigger", "reset"), ("trigger", "clear"), ("engage", "release"), ("on", "off"), ("enable", "disable"),
    )  # fmt: skip
    for stops, releases in pairs:
        if stops in last:
            release = f"{folder}/{last.replace(stops, releases)}"
            if release != service and release in services and same_type(services[release], services[service]):
                return release
    return None


def _has_word(words: Iterable[str], keyword: str) -> bool:
    """True if ``keyword`` is a word, or a part between underscores of one."""
    return any(
        keyword == word or keyword in word.split("_") or (len(keyword) > 5 and keyword in word) for word in words
    )


def _best_first(candidates: Iterable[Candidate]) -> list[Candidate]:
    return sorted(candidates, key=lambda candidate: (-candidate.confidence, len(candidate.value), candidate.value))


def _clipped(confidence: float) -> float:
    return round(min(max(confidence, 0.0), 1.0), 3)
