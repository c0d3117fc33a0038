"""Robot discovery: what an unknown robot offers, which profile fits, and whether a profile's streams arrive.

Everything is asyncio with its own connections; ``*_blocking`` functions are for callers without a loop.

Long because inventory and stream checks share their connections.
"""

import asyncio
import contextlib
import logging
import math
import re
import time
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, Literal

from caris_desktop.domain.address import without_credentials
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.media_checks import picture_size
from caris_desktop.domain.sensing import lidar_mounting
from caris_desktop.domain.translation import QT_TR_NOOP, joined, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.robot.bridge_process import start_s
from caris_desktop.robot.bridge_wire import MEDIA_TIMINGS
from caris_desktop.robot.localization import TransformTree
from caris_desktop.robot.profile import leaves_ros_open, list_profiles, load_profile, with_ros
from caris_desktop.robot.profile_model import RobotProfile, SecuritySettings
from caris_desktop.robot.profile_proposal import Proposal, RobotOffer, may_stop, propose
from caris_desktop.robot.robot_checks import (
    NamedTopic,
    RobotInventory,
    actions_of,
    list_inventory,
    map_services_of,
    named_in,
    picture_advice,
    probed,
    rosapi_reply,
    services_of,
    settled_inventory,
)
from caris_desktop.robot.transport import MEDIA_SIZES, RosbridgeClient, RosbridgeTopic, ServiceCallError
from caris_desktop.ros import message_conversion
from caris_desktop.ros.dialect import Dialect, decode_time, package_and_name, same_type, type_name
from caris_desktop.ros.message_conversion import decode_image, republish_advice
from caris_desktop.ros.message_fields import MessageError, stamp_or_none

logger = logging.getLogger(__name__)

_LISTEN_S = 1.0
_MAX_REQUESTS = 60
_INVENTORY_WITHIN_S = 8.0
_OLD_S = 1.0
_UNRELATED_S = 3600.0
_BRIDGE = "rosbridge"  # default prefix of its node name
# In ROS 2 a new publisher becomes visible with a delay.
_ADVERTISED_WITHIN, _ADVERTISED_AGAIN_S = 8, 0.25
_RESEMBLES = 0.7
_OF_INTEREST = (
    "geometry_msgs/Twist", "geometry_msgs/TwistStamped", "geometry_msgs/PoseWithCovarianceStamped",
    "sensor_msgs/LaserScan", "sensor_msgs/CompressedImage", "sensor_msgs/Image", "sensor_msgs/BatteryState",
    "nav_msgs/Odometry", "nav_msgs/OccupancyGrid", "nav_msgs/Path", "rosgraph_msgs/Clock", "std_msgs/Bool",
)  # fmt: skip

StreamState = Literal["good", "slow", "quiet", "nothing", "wrong"]


class ExploreError(UserFacingError):
    """The robot cannot be queried."""


class Resemblance(Value):
    """Similar profile of the list: ``share`` of its names exist with the right type."""

    name: str
    title: str
    share: float


class Exploration(Value):
    """Result for an address. ``resembles`` is sorted best first and may be empty."""

    address: str
    offer: RobotOffer
    proposal: Proposal
    resembles: tuple[Resemblance, ...]


class StreamCheck(Value):
    """Check of one stream of a profile.

    ``state``: good; slow (rate below the console's need); quiet (no message, but it is only occasional); nothing (no
    message, though expected); wrong (contradicts the profile). ``rate_hz`` is None for fewer than two messages,
    ``age_s`` (since the last one) for none. ``detail`` is a sentence.
    """

    field: str
    label: str
    topic: str
    state: StreamState
    rate_hz: float | None
    age_s: float | None
    detail: str


async def detect_dialect(
    address: str, *, security: SecuritySettings | None = None, timeout_s: float = 3.0
) -> Dialect | None:
    """ROS version of the robot; None if unknown (no rosapi, no topics).

    Raises
    ------
    ExploreError
        When nothing answers at the address.
    """
    async with _connected(address, security, timeout_s) as ros:
        dialect, _ = await _ros_version(ros)
        with contextlib.suppress(ServiceCallError):
            dialect = dialect or (await list_inventory(ros)).dialect
        return dialect


def load_profile_blocking(name_or_path_or_url: str, *, timeout_s: float = 2.0) -> RobotProfile:
    """``load_profile``, asking the robot first if the address leaves the ROS version open.

    A robot that does not answer in time counts as ROS 1; the link's check reports a mismatch later. Must not be called
    from a running asyncio loop. Raises ProfileError.
    """
    profile = load_profile(name_or_path_or_url)
    if not leaves_ros_open(name_or_path_or_url):
        return profile
    try:
        dialect = asyncio.run(detect_dialect(profile.address, security=profile.security, timeout_s=timeout_s))
    except ExploreError as error:
        logger.info("Which ROS runs at %s is not known: %s", without_credentials(profile.address), error)
        return profile
    return load_profile(with_ros(name_or_path_or_url, 2)) if dialect is Dialect.ROS2 else profile


async def explore_robot(
    address: str,
    *,
    security: SecuritySettings | None = None,
    timeout_s: float = 10.0,
    on_progress: Callable[[str], None] = lambda _words: None,
) -> Exploration:
    """Query the robot's inventory and propose a mapping. ``on_progress`` gets a short text for each step.

    Raises
    ------
    ExploreError
        When nothing answers at the address, or it does not tell what it has.
    """
    on_progress(QT_TR_NOOP("Connecting"))
    async with _connected(address, security, timeout_s) as ros:
        try:
            async with asyncio.timeout(timeout_s):
                on_progress(QT_TR_NOOP("Querying the robot"))
                offer = await list_offer(ros)
                on_progress(QT_TR_NOOP("Listening for frames and joints"))
                offer = await _with_received_streams(ros, offer)
        except (TimeoutError, ServiceCallError) as error:
            logger.info("The robot at %s does not tell what it has: %s", without_credentials(address), error)
            raise ExploreError(
                localized(
                    QT_TR_NOOP("The robot does not report its topics and services: {why}"), why=rosapi_reply(error)
                ),
                QT_TR_NOOP("No mapping can be proposed."),
                QT_TR_NOOP(
                    "Start the node 'rosapi' in addition to rosbridge (rosbridge_websocket.launch starts both), or "
                    "write the profile by hand."
                ),
            ) from error
    return Exploration(address, offer, propose(offer), _resemblances(offer))


async def list_offer(ros: RosbridgeClient) -> RobotOffer:
    """Query rosapi for the input of a proposal. Raises ServiceCallError."""
    inventory, (dialect, distribution) = await asyncio.gather(settled_inventory(ros), _ros_version(ros))
    dialect = dialect or inventory.dialect
    services = dict.fromkeys(sorted(inventory.services), "")
    # In ROS 1 each query of a service type connects to its node, so they are limited.
    for name in [name for name in services if may_stop(name)][:_MAX_REQUESTS]:
        services[name] = await _type_of(ros, "service", name)
    actions = _actionlib_servers(inventory.topics)
    for name in sorted(inventory.actions or ())[:_MAX_REQUESTS]:
        if name not in actions:
            actions[name] = await _type_of(ros, "action", name)
    # Most informative types first: a large robot has hundreds of topics, with two queries each.
    ranked = sorted((_interest(kind), topic) for topic, kind in inventory.topics.items() if _interest(kind) is not None)
    topics = [topic for _rank, topic in ranked[:_MAX_REQUESTS]]
    publishers = await asyncio.gather(*(_nodes(ros, "publishers", topic) for topic in topics))
    subscribers = await asyncio.gather(*(_nodes(ros, "subscribers", topic) for topic in topics))
    # A topic with neither has nodes unknown to rosapi.
    used = [found for found in zip(topics, publishers, subscribers, strict=True) if found[1] or found[2]]
    return RobotOffer(
        inventory.topics,
        services,
        actions,
        dialect,
        distribution,
        publishers={topic: len(names) for topic, names, _ in used},
        subscribers={topic: len(names) for topic, _, names in used},
    )


async def check_streams(
    profile: RobotProfile,
    address: str | None = None,
    *,
    seconds: float = 3.0,
    on_check: Callable[[StreamCheck], None] = lambda _check: None,
) -> tuple[StreamCheck, ...]:
    """Listen to all streams of the profile at once for ``seconds``, and rate them.

    Topics that the robot subscribes to are advertised without sending; services and actions are looked up and never
    used. Without rosapi only the streams are checked. ``on_check`` gets each result at once.

    Raises
    ------
    ExploreError
        When nothing answers at the address, or it runs another ROS than the profile says.
    """
    done: list[StreamCheck] = []

    def report_check(check: StreamCheck) -> None:
        done.append(check)
        on_check(check)

    async with _connected(address or profile.address, profile.security, _INVENTORY_WITHIN_S) as ros:
        inventory: RobotInventory | None = None
        try:
            async with asyncio.timeout(_INVENTORY_WITHIN_S):
                inventory = await settled_inventory(ros)
        except (TimeoutError, ServiceCallError) as error:
            logger.info("The robot does not tell what it has: %s", error)
            reason = localized(
                QT_TR_NOOP(
                    "{why} Only the streams in the profile are checked; everything else on the robot is unknown."
                ),
                why=rosapi_reply(error),
            )
            report_check(StreamCheck("rosapi", "rosapi", "/rosapi", "quiet", None, None, reason))
        if inventory is not None and inventory.dialect not in (None, Dialect(profile.ros)):
            raise ExploreError(
                localized(
                    QT_TR_NOOP("The robot runs ROS {found}, but the profile says ROS {said}."),
                    found=3 - profile.ros,
                    said=profile.ros,
                ),
                QT_TR_NOOP("Its streams cannot be checked."),
                localized(QT_TR_NOOP("Write 'ros: {found}' instead."), found=3 - profile.ros),
            )
        offset_ns = await _clock_offset_ns(ros)
        listeners: list[_StreamListener] = []
        inputs: list[tuple[NamedTopic, str]] = []
        tree = TransformTree()
        for named in named_in(profile):
            usual = type_name(Dialect(profile.ros), *package_and_name(named.types[0]))
            kind = usual if inventory is None else inventory.topics.get(named.topic)
            otherwise = "" if inventory is None else picture_advice(named, inventory)
            if inventory is None and not named.published:
                report_check(_unknown(*named.key))
            elif otherwise:
                report_check(_rated(named, "wrong", otherwise))
            elif kind is None:
                nobody = QT_TR_NOOP("Nothing on the robot subscribes to it.")
                detail = QT_TR_NOOP("The robot has no topic with this name.") if named.published else nobody
                report_check(_rated(named, "nothing" if named.needed else "quiet", detail))
            elif kind and not any(same_type(kind, expected) for expected in named.types):
                carries = QT_TR_NOOP("Its type is {kind}; {expected} was expected.")
                other = localized(carries, kind=kind, expected=" / ".join(named.types))
                report_check(_rated(named, "wrong", other))
            elif named.published:
                listeners.append(_StreamListener(ros, profile, named, kind or usual, tree))
            else:
                inputs.append((named, kind or usual))
        for check in _offered_checks(profile, inventory):
            report_check(check)
        await asyncio.sleep(seconds)
        bridge_reports = inventory is not None and await _bridge_subscribes(ros, listeners)
        for named, kind in inputs:
            report_check(await _listened_to(ros, named, kind, bridge_reports=bridge_reports))
        for listener in listeners:
            report_check(listener.verdict(offset_ns))
            listener.close()
    order = {named.field: number for number, named in enumerate(named_in(profile))}
    return tuple(sorted(done, key=lambda check: order.get(check.field, len(order))))


@contextlib.asynccontextmanager
async def _connected(
    address: str, security: SecuritySettings | None, timeout_s: float
) -> AsyncIterator[RosbridgeClient]:
    """Separate connection. Raises ExploreError."""
    async with probed(address, timings=MEDIA_TIMINGS, sizes=MEDIA_SIZES, security=security) as (ros, probe):
        try:
            async with asyncio.timeout(timeout_s + start_s(address)):
                what, advice = await probe.outcome
        except TimeoutError:
            nothing = QT_TR_NOOP("No response from {address} within {seconds} s.")
            what, advice = localized(nothing, address=without_credentials(address), seconds=f"{timeout_s:g}"), ""
        if what:
            advice = advice or QT_TR_NOOP("Check the address, and that rosbridge is running on the robot.")
            raise ExploreError(what, QT_TR_NOOP("The robot was not queried."), advice)
        try:
            yield ros
        except ExploreError as error:
            if probe.broke_off:  # then nothing was answered, whatever the query
                raise _broken_off(security) from error
            raise


def _broken_off(security: SecuritySettings | None) -> ExploreError:
    if security is None or security.rosauth_secret_env is None:
        # A rosbridge with rosauth accepts every connection, and closes it at the first query.
        advice = QT_TR_NOOP(
            "If the robot requires a secret (rosauth), enter the name of its environment variable under "
            "Security. Otherwise, check that rosbridge is still running on the robot, and try again."
        )
    else:
        advice = QT_TR_NOOP(
            "Check that rosbridge is still running on the robot, and try again; see its log on the robot for details."
        )
    return ExploreError(
        QT_TR_NOOP("The robot closed the connection during the query."),
        QT_TR_NOOP("No mapping can be proposed."),
        advice,
    )


async def _ros_version(ros: RosbridgeClient) -> tuple[Dialect | None, str]:
    """ROS version and distribution as reported; (None, "") from old robots."""
    try:
        answer = await ros.ask("/rosapi/get_ros_version", "rosapi/GetROSVersion")
    except ServiceCallError:
        return None, ""
    version, distribution = answer.get("version"), answer.get("distro")
    dialect = Dialect(version) if version in (1, 2) else None
    return dialect, distribution if isinstance(distribution, str) else ""


async def _nodes(ros: RosbridgeClient, kind: Literal["publishers", "subscribers"], topic: str) -> list[str]:
    """Nodes at a topic; empty if unknown."""
    with contextlib.suppress(ServiceCallError):
        return await ros.nodes(kind, topic)
    return []


def _actionlib_servers(topics: Mapping[str, str]) -> dict[str, str]:
    """Actions of ROS 1, by their goal topics."""
    return {
        topic.removesuffix("/goal"): kind.removesuffix("Goal")
        for topic, kind in topics.items()
        if topic.endswith("/goal") and kind.endswith("ActionGoal")
    }


async def _type_of(ros: RosbridgeClient, kind: Literal["service", "action"], name: str) -> str:
    """Type of a service or action from rosapi; empty if unknown."""
    try:
        found = (await ros.ask(f"/rosapi/{kind}_type", f"rosapi/{kind.capitalize()}Type", {kind: name})).get("type")
    except ServiceCallError as error:
        logger.debug("rosapi: %s", error)
        return ""
    return found if isinstance(found, str) else ""


def _interest(kind: str) -> int | None:
    """Rank of a type whose publishers and subscribers matter; None for others."""
    return next((rank for rank, expected in enumerate(_OF_INTEREST) if same_type(kind, expected)), None)


async def _with_received_streams(ros: RosbridgeClient, offer: RobotOffer) -> RobotOffer:
    frames: set[str] = set()
    joints: dict[str, None] = {}

    def on_transforms(message: Any) -> None:
        for transform in message_conversion.decode_tf_message(message, unusable=lambda *_reason: None):
            frames.update((transform.parent_frame.lstrip("/"), transform.child_frame.lstrip("/")))

    def on_joints(message: Any) -> None:
        joints.update(dict.fromkeys(message_conversion.decode_joint_state(message).positions))

    readers: tuple[tuple[str, Callable[[Any], None]], ...] = (
        ("tf2_msgs/TFMessage", on_transforms),
        ("tf/tfMessage", on_transforms),
        ("sensor_msgs/JointState", on_joints),
    )
    listeners: list[RosbridgeTopic] = []
    for topic, kind in offer.topics.items():
        for known, take in readers:
            if same_type(kind, known) and len(listeners) < _MAX_REQUESTS:
                listener = RosbridgeTopic(ros, topic, kind, every_message=True, queue_length=20)
                listener.subscribe(take)
                listeners.append(listener)
    if listeners:
        await asyncio.sleep(_LISTEN_S)
    for listener in listeners:
        listener.unsubscribe()
    return replace(offer, frames=tuple(sorted(frames)), joints=tuple(joints))


def _resemblances(offer: RobotOffer) -> tuple[Resemblance, ...]:
    found = []
    for listed in list_profiles():
        if listed.error or listed.name.startswith("generic-"):
            continue
        profile = load_profile(listed.name)
        hits = _hits(profile, offer)
        share = round(sum(hits) / len(hits), 3)
        if share >= _RESEMBLES and offer.dialect in (None, Dialect(profile.ros)):
            found.append((share, len(hits), Resemblance(listed.name, profile.title, share)))
    # Of two equal fits, the one with more names.
    return tuple(each for _share, _names, each in sorted(found, key=lambda one: (-one[0], -one[1], one[2].name)))


def _hits(profile: RobotProfile, offer: RobotOffer) -> list[bool]:
    """For each name in the profile, whether the robot has it with the right type. Controls do not
    count, as they vary.
    """
    hits = [
        any(same_type(offer.topics.get(named.topic, "-"), kind) for kind in named.types)
        for named in named_in(profile)
        if not named.field.startswith("controls.")
    ]
    hits += [name in offer.services for name in map_services_of(profile)]
    for offered, rows in ((offer.services, services_of(profile)), (offer.actions, actions_of(profile))):
        hits += [name in offered for key, _, name in rows if not key.startswith("controls.")]
    return hits


class _StreamListener:
    """Listener to one stream of a profile. Received transforms fill ``tree``."""

    def __init__(
        self, ros: RosbridgeClient, profile: RobotProfile, named: NamedTopic, kind: str, tree: TransformTree
    ) -> None:
        self.named = named
        self._describe = _description_of(named, profile, tree)
        self._tree = tree if named.field in ("tf", "tf_static") else None
        self._loop = asyncio.get_running_loop()
        self.count = 0
        self._first_s = self._last_s = 0.0
        self._message: Any = None
        self._received_ns = 0
        every = self._tree is not None
        self._topic = RosbridgeTopic(ros, named.topic, kind, queue_length=20 if every else 1, every_message=every)
        self._topic.subscribe(self._on_message)

    def close(self) -> None:
        self._topic.unsubscribe()

    def _on_message(self, message: Any) -> None:
        self._last_s = self._loop.time()
        self._first_s = self._first_s or self._last_s
        self.count += 1
        self._message = message
        self._received_ns = time.time_ns()
        if self._tree is not None:
            transforms = message_conversion.decode_tf_message(message, unusable=lambda *_reason: None)
            self._tree.add(transforms, static=self.named.field == "tf_static")

    def verdict(self, offset_ns: int | None) -> StreamCheck:
        named = self.named
        if self.count == 0:
            if named.expected_hz is None:
                return _rated(named, "quiet", QT_TR_NOOP("No message received; this topic is only sent occasionally."))
            return _rated(named, "nothing", QT_TR_NOOP("No message received."))
        took_s = self._last_s - self._first_s
        rate_hz = (self.count - 1) / took_s if self.count > 1 and took_s > 0.0 else None
        age_s = self._loop.time() - self._last_s
        try:
            detail = self._describe(self._message)
        except (MessageError, ValueError) as error:
            wrong = localized(QT_TR_NOOP("The messages cannot be used: {error}."), error=error)
            return _rated(named, "wrong", wrong, rate_hz, age_s)
        state: StreamState = "good"
        if named.expected_hz is not None and (rate_hz or 0.0) < named.expected_hz and age_s > 0.5 / named.expected_hz:
            state = "slow"
        # Age of the last message on arrival, by the robot's clock.
        stamp_ns = stamp_or_none(self._message)
        late_s = None if offset_ns is None or stamp_ns is None else (self._received_ns + offset_ns - stamp_ns) / 1e9
        if late_s is not None and _OLD_S < late_s < _UNRELATED_S and named.expected_hz is not None:
            state = "slow"
            detail = joined((detail, localized(QT_TR_NOOP("The latency is {late} s."), late=f"{late_s:.1f}")))
        return _rated(named, state, detail, rate_hz, age_s)


async def _clock_offset_ns(ros: RosbridgeClient) -> int | None:
    """Robot clock minus this computer's clock, accurate to half a round trip."""
    sent_ns = time.time_ns()
    try:
        robot_ns = decode_time((await ros.ask("/rosapi/get_time", "rosapi/GetTime")).get("time"))
    except (ServiceCallError, ValueError):
        return None
    return None if robot_ns is None else robot_ns - (sent_ns + time.time_ns()) // 2


def _offered_checks(profile: RobotProfile, inventory: RobotInventory | None) -> Iterator[StreamCheck]:
    """Checks of the profile's services and actions."""
    if inventory is None:
        for row in (*services_of(profile), *actions_of(profile)):
            yield _unknown(*row)
        return
    has_service = QT_TR_NOOP("The robot has this service.")
    rows: list[tuple[tuple[str, str, str], bool | None, str, str, StreamState]] = []
    for row in services_of(profile):
        no_service = QT_TR_NOOP("The robot has no service with this name.")
        rows.append((row, inventory.has_service(row[2]), has_service, no_service, "nothing"))
    for service in map_services_of(profile):
        not_now = QT_TR_NOOP("Not available now; only in one mode of the robot.")
        rows.append((("maps", "Maps", service), inventory.has_service(service), has_service, not_now, "quiet"))
    for row in actions_of(profile):
        has_action = QT_TR_NOOP("The robot has this action.")
        no_action = QT_TR_NOOP("The robot has no action with this name.")
        rows.append((row, inventory.has_action(row[2]), has_action, no_action, "nothing"))
    for row, there, present, absent, state in rows:
        if there is None:
            yield StreamCheck(*row, "quiet", None, None, QT_TR_NOOP("The robot does not report its actions."))
        else:
            yield StreamCheck(*row, "good" if there else state, None, None, present if there else absent)


def _unknown(field: str, label: str, name: str) -> StreamCheck:
    words = QT_TR_NOOP("This cannot be checked without rosapi.")
    return StreamCheck(field, label, name, "quiet", None, None, words)


def _rated(
    named: NamedTopic, state: StreamState, detail: str, rate_hz: float | None = None, age_s: float | None = None
) -> StreamCheck:
    return StreamCheck(*named.key, state, rate_hz, age_s, detail)


async def _bridge_subscribes(ros: RosbridgeClient, listeners: list[_StreamListener]) -> bool:
    """True if the robot lists rosbridge among the subscribers of received topics."""
    for listener in listeners:
        if listener.count:
            names = await _nodes(ros, "subscribers", listener.named.topic)
            return any(_BRIDGE in name for name in names)
    return False


async def _listened_to(ros: RosbridgeClient, named: NamedTopic, kind: str, *, bridge_reports: bool) -> StreamCheck:
    try:
        listeners = await ros.nodes("subscribers", named.topic)
    except ServiceCallError:  # not answered, or not permitted
        return _rated(named, "good", QT_TR_NOOP("The robot has this topic."))
    speakers = await _nodes(ros, "publishers", named.topic)
    if speakers and not listeners:
        alone = QT_TR_NOOP("Publishers: {who}. There are no subscribers.")
        return _rated(named, "nothing", localized(alone, who=_short(speakers)))
    if not listeners:
        # A topic with neither has nodes unknown to rosapi.
        return _rated(named, "good", QT_TR_NOOP("The robot has this topic."))
    if bridge_reports and not await _lets_through(ros, named.topic, kind, set(speakers)):
        refused = QT_TR_NOOP(
            "Subscribers: {who}. But rosbridge does not publish it: its topics_glob does not allow this topic."
        )
        return _rated(named, "wrong", localized(refused, who=_short(listeners)))
    return _rated(named, "good", localized(QT_TR_NOOP("Subscribers: {who}."), who=_short(listeners)))


async def _lets_through(ros: RosbridgeClient, topic: str, kind: str, before: set[str]) -> bool:
    """True if rosbridge becomes a publisher of the topic on request, as ROS reports. Nothing is sent.

    rosbridge silently ignores topics outside of its ``topics_glob``.
    """
    publisher = RosbridgeTopic(ros, topic, kind)
    publisher.advertise()
    try:
        for _ in range(_ADVERTISED_WITHIN):
            names = await _nodes(ros, "publishers", topic)
            # Another client of the same bridge may have made it a publisher before.
            if set(names) - before or any(_BRIDGE in name for name in names):
                return True
            await asyncio.sleep(_ADVERTISED_AGAIN_S)
        return False
    finally:
        publisher.unadvertise()


def _short(names: Iterable[str]) -> str:
    listed = sorted(names)
    few = ", ".join(listed[:2])
    if len(listed) <= 2:
        return few
    return localized(QT_TR_NOOP("{names} and {number} more"), names=few, number=len(listed) - 2)


def _description_of(named: NamedTopic, profile: RobotProfile, tree: TransformTree) -> Callable[[Any], str]:
    """Description of a message; raises MessageError or ValueError if the console could not use it."""
    if named.field == "head.joint_states" and profile.head is not None:
        joints = (profile.head.pan_joint, profile.head.tilt_joint)
        return lambda message: _joints(message, joints)
    if named.field == "scan":
        return lambda message: joined((_scan(message), _mounting(message, profile, tree)))
    if named.types == ("sensor_msgs/Image",):
        advice = localized(QT_TR_NOOP("Not compressed: {advice}."), advice=republish_advice(named.topic))
        return lambda message: joined((_raw_picture(message), advice))
    for control in profile.controls:
        if control.reading is not None and named.field == f"controls.{control.id}.shows":
            path = control.reading.field
            return lambda message: localized(QT_TR_NOOP("Now {value}."), value=value_at(message, path))
    return _DESCRIPTIONS.get(named.types[0], lambda _message: QT_TR_NOOP("Messages received."))


def _joints(message: Any, names: tuple[str, str]) -> str:
    known = message_conversion.decode_joint_state(message).positions
    lacking = [joint for joint in names if joint not in known]
    # Joints may be spread over several messages, so one without them proves nothing.
    if not lacking:
        return QT_TR_NOOP("Both head joints are reported.")
    return localized(QT_TR_NOOP("Not in the last message: {joints}."), joints=", ".join(lacking))


def _scan(message: Any) -> str:
    scan = message_conversion.decode_laser_scan(message, stamp_ns=0)
    span_deg = abs(math.degrees(scan.angle_increment_rad * (len(scan.ranges_m) - 1)))
    return localized(
        QT_TR_NOOP("{beams} beams over {angle} degrees, up to {range} m."),
        beams=len(scan.ranges_m), angle=f"{span_deg:.0f}", range=f"{scan.range_max_m:g}",
    )  # fmt: skip


def _mounting(message: Any, profile: RobotProfile, tree: TransformTree) -> str:
    """Mounting of the LIDAR. Raises MessageError if it is tilted."""
    frame = message_conversion.decode_laser_scan(message, stamp_ns=0).frame_id.lstrip("/")
    pose = tree.lookup_in_space(profile.frames.base.lstrip("/"), frame)
    if profile.laser.mounting is not None:
        upside_down = profile.laser.mounting == "upside_down"
        return (
            QT_TR_NOOP("Mounted upside down, as set in the profile: its beams are reversed.")
            if upside_down
            else QT_TR_NOOP("Mounted upright, as set in the profile.")
        )
    if pose is None:
        return localized(
            QT_TR_NOOP(
                "There is no transform from {base} to {frame}: the LIDAR is assumed to be upright at the "
                "position set in the profile."
            ),
            base=profile.frames.base,
            frame=repr(frame),
        )
    match lidar_mounting(pose):
        case "upright":
            return QT_TR_NOOP("Mounted upright.")
        case "upside_down":
            return QT_TR_NOOP("Mounted upside down: its beams are reversed.")
        case "tilted":
            tilted = QT_TR_NOOP("the LIDAR is tilted by {degrees} degrees, so it measures the floor and the ceiling")
            raise MessageError(localized(tilted, degrees=f"{math.degrees(pose.tilt_rad):.0f}"))


def _picture(message: Any) -> str:
    image = message_conversion.decode_compressed_image(message)
    size = picture_size(image.content)
    kilobytes = f"{len(image.content) / 1000:.0f}"
    if not size:
        return localized(QT_TR_NOOP("{encoding}, {size} kB."), encoding=image.encoding, size=kilobytes)
    return _pixels(image.encoding, size[0], size[1], kilobytes)


def _raw_picture(message: Any) -> str:
    height_px, width_px = decode_image(message).image_bgr.shape[:2]
    size_kb = message["step"] * height_px / 1000
    return _pixels(message["encoding"], width_px, height_px, f"{size_kb:.0f}")


def _pixels(encoding: str, width_px: int, height_px: int, kilobytes: str) -> str:
    return localized(
        QT_TR_NOOP("{encoding} of {width}x{height} pixels, {size} kB."),
        encoding=encoding, width=width_px, height=height_px, size=kilobytes,
    )  # fmt: skip


def _grid(message: Any) -> str:
    grid = message_conversion.decode_occupancy_grid(message, stamp_ns=0)
    height, width = grid.cells.shape
    cell_m = grid.resolution_m
    return localized(
        QT_TR_NOOP("{width} x {height} m in cells of {cell} m."),
        width=f"{width * cell_m:.0f}", height=f"{height * cell_m:.0f}", cell=f"{cell_m:g}",
    )  # fmt: skip


def _battery(message: Any) -> str:
    fraction = message_conversion.decode_battery_state(message, stamp_ns=0).charge_fraction
    return QT_TR_NOOP("Its charge is not reported.") if fraction is None else f"{100 * fraction:.0f} %."


def _odometry(message: Any) -> str:
    poseless: list[str] = []

    def reckoned(_twist: Twist2D) -> Pose2D:
        poseless.append(QT_TR_NOOP("It reports no orientation (a zero quaternion): only its speed is used."))
        return Pose2D(0.0, 0.0, 0.0)

    twist = message_conversion.decode_odometry(message, stamp_ns=0, pose_of=reckoned).twist
    return joined((f"{twist.forward_mps:.2f} m/s, {twist.turn_radps:.2f} rad/s.", *poseless))


def _pose(message: Any) -> str:
    pose = message_conversion.decode_pose_with_covariance_stamped(message, stamp_ns=0).pose_in_map
    return localized(
        QT_TR_NOOP("At {x}, {y} m, heading {heading} degrees."),
        x=f"{pose.x_m:.1f}", y=f"{pose.y_m:.1f}", heading=f"{math.degrees(pose.heading_rad):.0f}",
    )  # fmt: skip


def _transforms(message: Any) -> str:
    frames = sorted({each.child_frame for each in message_conversion.decode_tf_message(message)})
    if not frames:
        return QT_TR_NOOP("It contains no frames.")
    return localized(QT_TR_NOOP("Frames {frames}."), frames=_short(frames))


def _path(message: Any) -> str:
    return localized(QT_TR_NOOP("{number} points."), number=len(message_conversion.decode_path(message).points_m))


_DESCRIPTIONS: dict[str, Callable[[Any], str]] = {
    "sensor_msgs/LaserScan": _scan,
    "sensor_msgs/CompressedImage": _picture,
    "nav_msgs/OccupancyGrid": _grid,
    "sensor_msgs/BatteryState": _battery,
    "nav_msgs/Odometry": _odometry,
    "geometry_msgs/PoseWithCovarianceStamped": _pose,
    "tf2_msgs/TFMessage": _transforms,
    "nav_msgs/Path": _path,
    "std_msgs/Bool": lambda message: localized(
        QT_TR_NOOP("Now {value}."), value=str(message_conversion.decode_bool(message)).lower()
    ),
}


def value_at(message: Any, path: str) -> bool | float | str:
    """Value at a path such as ``status[0].level``. Raises ValueError if there is none."""
    found = message
    for step in re.findall(r"[A-Za-z_][A-Za-z0-9_]*|\[[0-9]+\]", path):
        try:
            found = found[int(step[1:-1])] if step.startswith("[") else found[step]
        except (LookupError, TypeError) as error:
            raise ValueError(localized(QT_TR_NOOP("the message has no {path}"), path=path)) from error
    if not isinstance(found, (bool, int, float, str)):
        raise ValueError(localized(QT_TR_NOOP("{path} is not a single value"), path=path))  # noqa: TRY004 - one kind of error for display
    return found
