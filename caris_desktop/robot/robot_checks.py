"""Robot checks: inventory of the robot by rosapi, and the missing parts of a profile."""

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, cast

from caris_desktop.domain.address import plugin_address, without_credentials
from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.control_definitions import CallService, PublishMessage, RobotControl, SendActionGoal
from caris_desktop.domain.events import Problem
from caris_desktop.domain.translation import QT_TR_NOOP, joined, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.robot.bridge_process import start_s
from caris_desktop.robot.profile_model import MapServices, RobotProfile
from caris_desktop.robot.transport import LinkObserver, RosbridgeClient, RosbridgeTopic, ServiceCallError
from caris_desktop.ros.dialect import Dialect, package_and_name, same_type, type_name
from caris_desktop.ros.message_conversion import republish_advice

logger = logging.getLogger(__name__)

_GOODBYE_S = 0.3
_LISTENED_S = 2.0
_SETTLED_S, _SETTLED_TRIES = 0.4, 6
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

    @property
    def key(self) -> tuple[str, str, str]:
        """Field, label and name."""
        return self.field, self.label, self.topic


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


async def settled_inventory(ros: RosbridgeClient) -> RobotInventory:
    """Query rosapi until two answers agree: in ROS 2, a bridge that has just started finds the nodes one by one.

    Raises ServiceCallError like :func:`list_inventory`.
    """
    inventory = await list_inventory(ros)
    for _ in range(_SETTLED_TRIES):
        before = inventory
        await asyncio.sleep(_SETTLED_S)
        inventory = await list_inventory(ros)
        if inventory == before:
            break
    return inventory


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
        expected_types = " or ".join(type_name(dialect, *package_and_name(one)) for one in named.types)
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


_POSE = "geometry_msgs/PoseWithCovarianceStamped"
# As :class:`NamedTopic`, but with the place of the name in the profile, and types with its values.
_FIRST_TOPICS = (
    NamedTopic("velocity", QT_TR_NOOP("Driving"), "velocity.topic", ("geometry_msgs/{0.velocity.type}",), False),
    NamedTopic("scan", QT_TR_NOOP("LIDAR"), "scan.topic", ("sensor_msgs/LaserScan",), expected_hz=5.0),
    NamedTopic("odometry", QT_TR_NOOP("Odometry"), "odometry.topic", ("nav_msgs/Odometry",), expected_hz=5.0),
    NamedTopic("pose", QT_TR_NOOP("Pose"), "pose.topic", (_POSE,)),
    # with the type's name in tf's first version
    NamedTopic(
        "tf", QT_TR_NOOP("Transforms"), "tf.topic", ("tf2_msgs/TFMessage", "tf/tfMessage"), True, 5.0, needed=False
    ),
    NamedTopic("tf_static", QT_TR_NOOP("Static transforms"), "tf_static.topic", ("tf2_msgs/TFMessage",), needed=False),
    NamedTopic("map", QT_TR_NOOP("Map"), "map.topic", ("nav_msgs/OccupancyGrid",)),
    NamedTopic(
        "map_updates", QT_TR_NOOP("Map updates"), "map_updates.topic", ("map_msgs/OccupancyGridUpdate",), needed=False
    ),
    NamedTopic("path", QT_TR_NOOP("Path"), "path.topic", ("nav_msgs/Path",), needed=False),
    NamedTopic("battery", QT_TR_NOOP("Battery"), "battery.topic", ("sensor_msgs/BatteryState",), expected_hz=0.1),
)
_FURTHER_TOPICS = (
    NamedTopic("initial_pose", QT_TR_NOOP("Initial pose"), "initial_pose", (_POSE,), False, needed=False),
    NamedTopic("speech", QT_TR_NOOP("Speech"), "speech.topic", ("std_msgs/String",), False),
    NamedTopic("speech.speaking", QT_TR_NOOP("Speech: speaking"), "speech.speaking", ("std_msgs/Bool",)),
    NamedTopic("speech.stop", QT_TR_NOOP("Speech: stop"), "speech.stop", ("std_msgs/Empty",), False),
    NamedTopic("speech.says", QT_TR_NOOP("Speech: spoken text"), "speech.says", ("std_msgs/String",)),
    NamedTopic("emergency_stop.topic", QT_TR_NOOP("Emergency stop"), "emergency_stop.topic", ("std_msgs/Bool",)),
    NamedTopic(
        "emergency_stop.command_topic",
        QT_TR_NOOP("Emergency stop"),
        "emergency_stop.command_topic",
        ("std_msgs/Bool",),
        False,
    ),
    NamedTopic("audio", QT_TR_NOOP("Microphone"), "audio.topic", ("audio_common_msgs/{0.audio.type}",)),
    NamedTopic(
        "audio.info", QT_TR_NOOP("Microphone: format"), "audio.info", ("audio_common_msgs/AudioInfo",), needed=False
    ),
    NamedTopic("audio.speaker", QT_TR_NOOP("Loudspeaker"), "audio.speaker", ("audio_common_msgs/AudioData",), False),
    NamedTopic("head", QT_TR_NOOP("Head"), "head.topic", ("{0.head.command_type}",), False),
    NamedTopic(
        "head.joint_states", QT_TR_NOOP("Joints"), "head.joint_states", ("sensor_msgs/JointState",), expected_hz=2.0
    ),
)
# Field, label, and place of the name in the profile.
_SERVICES = (
    ("emergency_stop.service", QT_TR_NOOP("Emergency stop"), "emergency_stop.service"),
    ("emergency_stop.set_service", QT_TR_NOOP("Emergency stop"), "emergency_stop.set_service"),
    ("emergency_stop.clear_service", QT_TR_NOOP("Emergency stop"), "emergency_stop.clear_service"),
    ("speech.service", QT_TR_NOOP("Speech"), "speech.service.name"),
    ("speech.service.stop", QT_TR_NOOP("Speech: stop"), "speech.service.stop"),
)
_ACTIONS = (
    ("navigation", QT_TR_NOOP("Navigation"), "navigation.name"),
    ("speech.action", QT_TR_NOOP("Speech"), "speech.action.name"),
)


def named_in(profile: RobotProfile) -> Iterator[NamedTopic]:
    """Every topic named in the profile, with its expected types."""
    yield from _topics_of(profile, _FIRST_TOPICS)
    for index, camera in enumerate(profile.cameras):
        label = localized(QT_TR_NOOP("Camera {name}"), name=camera.name)
        kinds = (f"sensor_msgs/{camera.type}",)
        yield NamedTopic(f"cameras.{index}", label, camera.topic, kinds, expected_hz=_LEAST_PICTURES_HZ)
        if camera.info is not None:
            lens = localized(QT_TR_NOOP("Camera {name}: calibration"), name=camera.name)
            yield NamedTopic(f"cameras.{index}.info", lens, camera.info, ("sensor_msgs/CameraInfo",), needed=False)
    yield from _topics_of(profile, _FURTHER_TOPICS)
    for control in profile.controls:
        key, title = f"controls.{control.id}", _label_of(control)
        if isinstance(control.effect, PublishMessage):
            yield NamedTopic(key, title, control.effect.topic, (control.effect.type,), published=False)
        if control.reading is not None:
            yield NamedTopic(f"{key}.shows", title, control.reading.topic, (control.reading.type,))


def _topics_of(profile: RobotProfile, rows: Iterable[NamedTopic]) -> Iterator[NamedTopic]:
    for row in rows:
        name = _at(profile, row.topic)
        if name is not None:
            needed = row.needed and (row.field != "pose" or profile.tf is None)
            yield replace(row, topic=name, types=tuple(kind.format(profile) for kind in row.types), needed=needed)


def _at(profile: RobotProfile, place: str) -> str | None:
    value: Any = profile
    for name in place.split("."):
        value = getattr(value, name, None)
    return cast("str | None", value)


def services_of(profile: RobotProfile) -> Iterator[tuple[str, str, str]]:
    """(field, label, name) of every service in the profile, except for maps."""
    yield from _names_of(profile, _SERVICES)
    for control in profile.controls:
        if isinstance(control.effect, CallService):
            yield f"controls.{control.id}", _label_of(control), control.effect.service


def actions_of(profile: RobotProfile) -> Iterator[tuple[str, str, str]]:
    """(field, label, name) of every action in the profile."""
    yield from _names_of(profile, _ACTIONS)
    for control in profile.controls:
        if isinstance(control.effect, SendActionGoal):
            yield f"controls.{control.id}", _label_of(control), control.effect.action


def _names_of(profile: RobotProfile, rows: Iterable[tuple[str, str, str]]) -> Iterator[tuple[str, str, str]]:
    for field, label, place in rows:
        name = _at(profile, place)
        if name is not None:
            yield field, label, name


def _label_of(control: RobotControl) -> str:
    return localized(QT_TR_NOOP("Control {title}"), title=control.title)


def _texts(value: Any) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise ServiceCallError("rosapi's response is not a list of names")
    return value


def absolute_name(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


class LinkProbe(LinkObserver):
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

    def _settle(self, what: str, advice: str) -> None:
        if not self.outcome.done():
            self.outcome.set_result((what, advice))


@contextlib.asynccontextmanager
async def probed(address: str, **options: Any) -> AsyncIterator[tuple[RosbridgeClient, LinkProbe]]:
    """Connection of its own, not yet established, and its probe. ``options`` are those of :class:`RosbridgeClient`."""
    probe = LinkProbe()
    ros = RosbridgeClient(address, probe, **options)
    ros.connect()
    try:
        yield ros, probe
    finally:
        await ros.aclose(_GOODBYE_S)


async def check(profile: RobotProfile, address: str, timeout_s: float) -> list[str]:
    """Connect, compare, disconnect; see ``link.check_robot``.

    Without rosapi, continuous streams are checked by listening.
    """
    async with probed(
        address, service_timeout_s=timeout_s, security=profile.security, dialect=Dialect(profile.ros)
    ) as (ros, probe):
        try:
            async with asyncio.timeout(timeout_s + start_s(address)):
                what, advice = await probe.outcome
                if what:
                    return [f"{what} {advice}".strip()]
        except TimeoutError:
            return [f"No response from {without_credentials(address)} within {timeout_s:g} s."]
        try:
            async with asyncio.timeout(timeout_s):
                return missing_from(profile, await settled_inventory(ros))
        except (TimeoutError, ServiceCallError) as error:
            silent = await _silent_streams(ros, profile)
            if silent:
                silent.append(
                    f"Other missing parts are unknown: {rosapi_reply(error)} Start rosapi in addition to rosbridge."
                )
            return silent


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
        topic = RosbridgeTopic(ros, named.topic, named.types[0])
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
    async with probed(address, security=profile.security) as (ros, probe):
        try:
            async with asyncio.timeout(timeout_s):
                await probe.outcome
                request = {"names": list(_QUEUE_PARAMETERS)}
                answer = await ros.ask(_GET_PARAMETERS, "rcl_interfaces/srv/GetParameters", request)
        except (TimeoutError, ServiceCallError) as error:
            # Renamed node, or another server.
            logger.info("Whether rosbridge has one queue is not known: %s", error)
            return ""
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
