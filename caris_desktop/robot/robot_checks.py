"""Robot checks: inventory of the robot by rosapi, and the missing parts of a profile."""

import asyncio
import contextlib
import logging
from collections.abc import Iterator, Sequence
from typing import Any

from caris_desktop.domain.address import plugin_address, without_credentials
from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.control_definitions import CallService, PublishMessage, RobotControl, SendActionGoal
from caris_desktop.domain.events import Problem
from caris_desktop.domain.translation import QT_TR_NOOP, joined, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.robot.bridge_process import start_s
from caris_desktop.robot.profile_model import MapServices, RobotProfile, TopicSource
from caris_desktop.robot.transport import RosbridgeClient, RosbridgeTopic, ServiceCallError
from caris_desktop.ros.dialect import Dialect, same_type, type_name
from caris_desktop.ros.message_conversion import republish_advice

logger = logging.getLogger(__name__)

_GOODBYE_S = 0.3
_LISTENED_S = 2.0
_GET_PARAMETERS = "/rosbridge_websocket/get_parameters"
_QUEUE_PARAMETERS = ("send_action_goals_in_new_thread", "call_services_in_new_thread")
_LEAST_PICTURES_HZ = 3.0
_MAX_ERROR_CHARS = 300


class RobotInventory(Value):
    """Names on the robot. ``topics`` maps each to its type; ``actions`` is None if unknown."""

    topics: dict[str, str]
    services: frozenset[str]
    actions: frozenset[str] | None = None

    @property
    def dialect(self) -> Dialect | None:
        """Dialect by the spelling of type names; None without any."""
        kinds = [kind for kind in self.topics.values() if kind]
        if not kinds:
            return None
        return Dialect.ROS2 if any("/msg/" in kind for kind in kinds) else Dialect.ROS1

    def has_service(self, name: str) -> bool:
        return absolute_name(name) in self.services

    def has_action(self, name: str) -> bool | None:
        """True if the action exists; None if unknown. An action of ROS 1 is recognised by its goal topic."""
        if absolute_name(f"{name}/goal") in self.topics:
            return True
        if self.dialect is Dialect.ROS1:
            return False
        return None if self.actions is None else absolute_name(name) in self.actions


class NamedTopic(Value):
    """Topic named in a profile: ``field`` is its location, ``types`` (of ROS 1) are the acceptable ones.

    ``published``: the robot publishes it; otherwise it subscribes. ``expected_hz`` is None for occasional messages.
    ``needed``: without it, something that the wizard sees stays empty.
    """

    field: str
    label: str
    topic: str
    types: tuple[str, ...]
    published: bool = True
    expected_hz: float | None = None
    needed: bool = True


async def list_inventory(ros: RosbridgeClient) -> RobotInventory:
    """Query rosapi.

    Raises
    ------
    ServiceCallError
        When it does not answer, or not with what it should.
    """
    topics, services, actions = await asyncio.gather(
        ros.ask("/rosapi/topics", "rosapi/Topics"), ros.ask("/rosapi/services", "rosapi/Services"), _action_servers(ros)
    )
    names, types = _texts(topics.get("topics")), _texts(topics.get("types"))
    if len(types) != len(names):
        types = [""] * len(names)
    return RobotInventory(
        {absolute_name(name): kind for name, kind in zip(names, types, strict=True)},
        frozenset(absolute_name(name) for name in _texts(services.get("services"))),
        actions,
    )


def rosapi_reply(error: Exception) -> str:
    """Sentence on a failed query: no answer, or rosbridge's own text."""
    reason = error.answer.strip() if isinstance(error, ServiceCallError) else ""
    if not reason:
        return QT_TR_NOOP("rosapi does not respond.")
    words = reason if len(reason) <= _MAX_ERROR_CHARS else f"{reason[:_MAX_ERROR_CHARS]}…"
    return localized(QT_TR_NOOP("rosbridge says “{words}”."), words=words)


async def _action_servers(ros: RosbridgeClient) -> frozenset[str] | None:
    try:
        answer = await ros.ask("/rosapi/action_servers", "rosapi/GetActionServers")
        return frozenset(absolute_name(name) for name in _texts(answer.get("action_servers")))
    except ServiceCallError:
        # Older servers lack it.
        return None


def missing_from(profile: RobotProfile, inventory: RobotInventory) -> list[str]:
    """One sentence for each name in the profile that the robot lacks or has with another type."""
    dialect = Dialect(profile.ros)
    sentences: list[str] = []
    if inventory.dialect not in (None, dialect):
        ros = 3 - profile.ros
        sentences.append(
            localized(
                QT_TR_NOOP(
                    "The robot runs ROS {ros}, but the profile says ROS {said}. Choose a profile with 'ros: {ros}', or"
                    " add ?ros={ros} to the address."
                ),
                ros=ros,
                said=profile.ros,
            )
        )
    useless: dict[str, None] = {}
    control_titles = {f"controls.{control.id}": control.title for control in profile.controls}

    def lacks(field: str, label: str, sentence: str) -> None:
        # With many controls, the wizard needs to know which have no effect rather than the reason for each.
        if field.startswith("controls."):
            useless[control_titles[field.removesuffix(".shows")]] = None
        else:
            sentences.append(localized("{label}: {sentence}", label=localized(label), sentence=sentence))

    for named in named_in(profile):
        kind = inventory.topics.get(absolute_name(named.topic))
        otherwise = picture_advice(named, inventory)
        if otherwise:
            sentences.append(localized("{label}: {sentence}", label=localized(named.label), sentence=otherwise))
            continue
        expected_types = " or ".join(in_dialect(dialect, one) for one in named.types)
        if kind is None:
            if named.needed:
                words = (
                    QT_TR_NOOP("the robot has no topic {topic}.")
                    if named.published
                    else QT_TR_NOOP("nothing on the robot subscribes to {topic}.")
                )
                lacks(named.field, named.label, localized(words, topic=named.topic))
        elif kind and not any(same_type(kind, one) for one in named.types):
            carries = QT_TR_NOOP("{topic} has the type {kind}, but {wanted} was expected.")
            lacks(named.field, named.label, localized(carries, topic=named.topic, kind=kind, wanted=expected_types))
    for field, label, action in actions_of(profile):
        if inventory.has_action(action) is False:
            lacks(field, label, localized(QT_TR_NOOP("the robot has no action {action}."), action=action))
    for field, label, service in services_of(profile):
        if not inventory.has_service(service):
            lacks(field, label, localized(QT_TR_NOOP("the robot has no service {service}."), service=service))
    if useless:
        sentences.append(
            localized(
                QT_TR_NOOP(
                    "Controls in the Robot panel without effect, because the robot lacks the interfaces that "
                    "they use: {useless}."
                ),
                useless=", ".join(useless),
            )
        )
    nodes = map_services_of(profile)
    # Which one runs depends on mapping or localization.
    if nodes and not any(inventory.has_service(service) for service in nodes):
        sentences.append(localized(QT_TR_NOOP("Maps: the robot has none of {nodes}."), nodes=", ".join(nodes)))
    return sentences


def problem_of_missing(missing: Sequence[str]) -> Problem:
    """Problem for the result of :func:`missing_from`."""
    return Problem(
        now_ns(),
        "warning",
        localized(QT_TR_NOOP("The robot does not match its profile: {missing}"), missing=joined(missing)),
        QT_TR_NOOP("The missing parts stay empty or have no effect."),
        QT_TR_NOOP("Start the missing parts on the robot, or correct the names in the robot profile."),
        cause="robot_lacks",
    )


def nothing_is_missing() -> Problem:
    """End of the Problem of :func:`problem_of_missing`."""
    return Problem(now_ns(), "info", QT_TR_NOOP("The robot now matches its profile."), "", "", cause="robot_lacks")


def picture_advice(named: NamedTopic, inventory: RobotInventory) -> str:
    """Advice if a camera's images exist in another form than the profile says; else empty."""
    if not named.field.startswith("cameras.") or named.field.endswith(".info"):
        return ""
    kind = inventory.topics.get(named.topic)
    if named.types == ("sensor_msgs/Image",):
        compressed = same_type(kind or "", "sensor_msgs/CompressedImage")
        advice = localized(QT_TR_NOOP("{topic} is compressed: remove 'type: Image'."), topic=named.topic)
        return advice if compressed else ""
    raw = named.topic if kind is not None else named.topic.removesuffix("/compressed")
    if not same_type(inventory.topics.get(raw, ""), "sensor_msgs/Image"):
        return ""
    return localized(
        QT_TR_NOOP("{topic} is only available uncompressed. Add 'type: Image' or, better, {advice}."),
        topic=raw,
        advice=republish_advice(raw),
    )


def map_services_of(profile: RobotProfile) -> tuple[str, ...]:
    """One service of each map node."""
    maps = profile.maps or MapServices()
    nodes = ((maps.slam_toolbox, "serialize_map"), (maps.map_server, "load_map"), (maps.map_saver, "save_map"))
    return tuple(f"{node}/{service}" for node, service in nodes if node is not None)


def named_in(profile: RobotProfile) -> Iterator[NamedTopic]:
    """Every topic named in the profile, with its expected types."""
    bare = profile.velocity.type
    yield NamedTopic(
        "velocity", QT_TR_NOOP("Driving"), profile.velocity.topic, (f"geometry_msgs/{bare}",), published=False
    )
    streams: tuple[tuple[str, str, TopicSource | None, str, float | None, bool], ...] = (
        ("scan", QT_TR_NOOP("LIDAR"), profile.scan, "sensor_msgs/LaserScan", 5.0, True),
        ("odometry", QT_TR_NOOP("Odometry"), profile.odometry, "nav_msgs/Odometry", 5.0, True),
        ("pose", QT_TR_NOOP("Pose"), profile.pose, "geometry_msgs/PoseWithCovarianceStamped", None, profile.tf is None),
        ("tf", QT_TR_NOOP("Transforms"), profile.tf, "tf2_msgs/TFMessage", 5.0, False),
        ("tf_static", QT_TR_NOOP("Static transforms"), profile.tf_static, "tf2_msgs/TFMessage", None, False),
        ("map", QT_TR_NOOP("Map"), profile.map, "nav_msgs/OccupancyGrid", None, True),
        ("map_updates", QT_TR_NOOP("Map updates"), profile.map_updates, "map_msgs/OccupancyGridUpdate", None, False),
        ("path", QT_TR_NOOP("Path"), profile.path, "nav_msgs/Path", None, False),
        ("battery", QT_TR_NOOP("Battery"), profile.battery, "sensor_msgs/BatteryState", 0.1, True),
    )
    for key, label, source, kind, expected_hz, needed in streams:
        if source is not None:
            # the type's name in tf's first version
            kinds = (kind, "tf/tfMessage") if key == "tf" else (kind,)
            yield NamedTopic(key, label, source.topic, kinds, expected_hz=expected_hz, needed=needed)
    for index, camera in enumerate(profile.cameras):
        label = localized(QT_TR_NOOP("Camera {name}"), name=camera.name)
        yield NamedTopic(
            f"cameras.{index}", label, camera.topic, (f"sensor_msgs/{camera.type}",), expected_hz=_LEAST_PICTURES_HZ
        )
        if camera.info is not None:
            lens = localized(QT_TR_NOOP("Camera {name}: calibration"), name=camera.name)
            yield NamedTopic(f"cameras.{index}.info", lens, camera.info, ("sensor_msgs/CameraInfo",), needed=False)
    if profile.initial_pose is not None:
        kinds = ("geometry_msgs/PoseWithCovarianceStamped",)
        yield NamedTopic(
            "initial_pose", QT_TR_NOOP("Initial pose"), profile.initial_pose, kinds, published=False, needed=False
        )
    yield from _voice_and_stop(profile)
    yield from _sound(profile)
    head = profile.head
    if head is not None:
        kind = "trajectory_msgs/JointTrajectory"
        if head.kind == "joint_angles":
            kind = "naoqi_bridge_msgs/JointAnglesWithSpeed"
        yield NamedTopic("head", QT_TR_NOOP("Head"), head.topic, (kind,), published=False)
        yield NamedTopic(
            "head.joint_states", QT_TR_NOOP("Joints"), head.joint_states, ("sensor_msgs/JointState",), expected_hz=2.0
        )
    for control in profile.controls:
        key, label = f"controls.{control.id}", _label_of(control)
        if isinstance(control.effect, PublishMessage):
            yield NamedTopic(key, label, control.effect.topic, (control.effect.type,), published=False)
        if control.reading is not None:
            yield NamedTopic(f"{key}.shows", label, control.reading.topic, (control.reading.type,))


def _voice_and_stop(profile: RobotProfile) -> Iterator[NamedTopic]:
    speech, stop = profile.speech, profile.emergency_stop
    if speech is not None and speech.topic is not None:
        yield NamedTopic("speech", QT_TR_NOOP("Speech"), speech.topic, ("std_msgs/String",), published=False)
    if speech is not None and speech.speaking is not None:
        yield NamedTopic("speech.speaking", QT_TR_NOOP("Speech: speaking"), speech.speaking, ("std_msgs/Bool",))
    if speech is not None and speech.stop is not None:
        yield NamedTopic("speech.stop", QT_TR_NOOP("Speech: stop"), speech.stop, ("std_msgs/Empty",), published=False)
    if speech is not None and speech.says is not None:
        yield NamedTopic("speech.says", QT_TR_NOOP("Speech: spoken text"), speech.says, ("std_msgs/String",))
    if stop is not None and stop.topic is not None:
        yield NamedTopic("emergency_stop.topic", QT_TR_NOOP("Emergency stop"), stop.topic, ("std_msgs/Bool",))
    if stop is not None and stop.command_topic is not None:
        kinds = ("std_msgs/Bool",)
        yield NamedTopic(
            "emergency_stop.command_topic", QT_TR_NOOP("Emergency stop"), stop.command_topic, kinds, published=False
        )


def _sound(profile: RobotProfile) -> Iterator[NamedTopic]:
    audio = profile.audio
    if audio is None:
        return
    if audio.topic is not None:
        yield NamedTopic("audio", QT_TR_NOOP("Microphone"), audio.topic, (f"audio_common_msgs/{audio.type}",))
    if audio.info is not None:
        yield NamedTopic(
            "audio.info", QT_TR_NOOP("Microphone: format"), audio.info, ("audio_common_msgs/AudioInfo",), needed=False
        )
    if audio.speaker is not None:
        yield NamedTopic(
            "audio.speaker", QT_TR_NOOP("Loudspeaker"), audio.speaker, ("audio_common_msgs/AudioData",), published=False
        )


def services_of(profile: RobotProfile) -> Iterator[tuple[str, str, str]]:
    """(field, label, name) of every service in the profile, except for maps."""
    stop = profile.emergency_stop
    if stop is not None:
        for key in ("service", "set_service", "clear_service"):
            service = getattr(stop, key)
            if service is not None:
                yield f"emergency_stop.{key}", QT_TR_NOOP("Emergency stop"), service
    if profile.speech is not None and profile.speech.service is not None:
        yield "speech.service", QT_TR_NOOP("Speech"), profile.speech.service.name
        if profile.speech.service.stop is not None:
            yield "speech.service.stop", QT_TR_NOOP("Speech: stop"), profile.speech.service.stop
    for control in profile.controls:
        if isinstance(control.effect, CallService):
            yield f"controls.{control.id}", _label_of(control), control.effect.service


def actions_of(profile: RobotProfile) -> Iterator[tuple[str, str, str]]:
    """(field, label, name) of every action in the profile."""
    if profile.navigation is not None:
        yield "navigation", QT_TR_NOOP("Navigation"), profile.navigation.name
    if profile.speech is not None and profile.speech.action is not None:
        yield "speech.action", QT_TR_NOOP("Speech"), profile.speech.action.name
    for control in profile.controls:
        if isinstance(control.effect, SendActionGoal):
            yield f"controls.{control.id}", _label_of(control), control.effect.action


def _label_of(control: RobotControl) -> str:
    return localized(QT_TR_NOOP("Control {title}"), title=control.title)


def in_dialect(dialect: Dialect, kind: str) -> str:
    """Message type as spelled in this ROS version."""
    package, _, name = kind.partition("/")
    return type_name(dialect, package, name.removeprefix("msg/"))


def _texts(value: Any) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise ServiceCallError("rosapi's response is not a list of names")
    return value


def absolute_name(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


class LinkProbe:
    """Awaits one connection: two empty texts, or problem and advice."""

    def __init__(self) -> None:
        self.outcome: asyncio.Future[tuple[str, str]] = asyncio.get_running_loop().create_future()
        self.broke_off = False

    def link_connected(self) -> None:
        self._settle("", "")

    def link_unreachable(self, what: str, advice: str) -> None:
        self._settle(what, advice)

    def link_lost(self, reason: str) -> None:
        self.broke_off = True
        self._settle(f"The connection was lost immediately: {reason}.", "")

    def link_silent(self) -> None: ...

    def link_recovered(self) -> None: ...

    def link_round_trip(self, round_trip_s: float) -> None: ...

    def link_refused(self, detail: str) -> None: ...

    def _settle(self, what: str, advice: str) -> None:
        if not self.outcome.done():
            self.outcome.set_result((what, advice))


async def check(profile: RobotProfile, address: str, timeout_s: float) -> list[str]:
    """Connect, compare, disconnect; see ``link.check_robot``.

    Without rosapi, continuous streams are checked by listening.
    """
    probe = LinkProbe()
    ros = RosbridgeClient(address, probe, service_timeout_s=timeout_s, security=profile.security)
    ros.connect()
    try:
        async with asyncio.timeout(timeout_s + start_s(address)):
            what, advice = await probe.outcome
            if what:
                return [f"{what} {advice}".strip()]
        try:
            async with asyncio.timeout(timeout_s):
                return missing_from(profile, await list_inventory(ros))
        except (TimeoutError, ServiceCallError) as error:
            silent = await _silent_streams(ros, profile)
            if silent:
                silent.append(
                    f"Other missing parts are unknown: {rosapi_reply(error)} Start rosapi in addition to rosbridge."
                )
            return silent
    except TimeoutError:
        return [f"No response from {without_credentials(address)} within {timeout_s:g} s."]
    finally:
        await ros.aclose(_GOODBYE_S)


async def _silent_streams(ros: RosbridgeClient, profile: RobotProfile) -> list[str]:
    """One sentence for each continuous stream of the profile that is silent."""
    all_received = asyncio.Event()
    streams = [named for named in named_in(profile) if named.published and named.needed]
    streams = [named for named in streams if named.expected_hz is not None and named.expected_hz > 1.0 / _LISTENED_S]
    silent = {named.topic for named in streams}

    def on_message(topic: str) -> None:
        silent.discard(topic)
        if not silent:
            all_received.set()

    for named in streams:
        topic = RosbridgeTopic(ros, named.topic, in_dialect(Dialect(profile.ros), named.types[0]))
        topic.subscribe(lambda _message, name=named.topic: on_message(name))
    if silent:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_LISTENED_S):
                await all_received.wait()
    nothing = QT_TR_NOOP("{label}: no messages on {topic}.")
    return [
        localized(nothing, label=localized(named.label), topic=named.topic)
        for named in streams
        if named.topic in silent
    ]


async def queue_advice(profile: RobotProfile, address: str, timeout_s: float) -> str:
    """Advice on a ROS 2 rosbridge that executes goals and calls sequentially; else empty."""
    if profile.ros != Dialect.ROS2.value or plugin_address(address):
        return ""
    probe = LinkProbe()
    ros = RosbridgeClient(address, probe, security=profile.security)
    ros.connect()
    try:
        async with asyncio.timeout(timeout_s):
            await probe.outcome
            request = {"names": list(_QUEUE_PARAMETERS)}
            answer = await ros.ask(_GET_PARAMETERS, "rcl_interfaces/srv/GetParameters", request)
    except (TimeoutError, ServiceCallError) as error:
        # Renamed node, or another server.
        logger.info("Whether rosbridge has one queue is not known: %s", error)
        return ""
    finally:
        await ros.aclose(_GOODBYE_S)
    values = answer.get("values")
    off = [
        name
        for name, value in zip(_QUEUE_PARAMETERS, values if isinstance(values, list) else (), strict=False)
        if isinstance(value, dict) and value.get("bool_value") is False
    ]
    advice = QT_TR_NOOP(
        "Its rosbridge handles the requests of one connection one at a time (false: {parameters}). This "
        "console uses additional connections for goals and calls. Other programs that drive the robot need "
        "true."
    )
    return localized(advice, parameters=", ".join(off)) if off else ""
