"""What of a robot profile the robot itself has, as its rosapi tells."""

import asyncio
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from caris_desktop.domain.address import without_credentials
from caris_desktop.robot.profile import RobotProfile
from caris_desktop.robot.transport import SafeRos, ServiceCallError
from caris_desktop.ros.dialect import Dialect, same_type, type_name

_GOODBYE_S = 0.3
NO_ROSAPI = (
    "The robot does not tell which topics it has (rosapi does not answer). "
    "Start rosapi beside rosbridge, or expect surprises from a wrong profile."
)


@dataclass(frozen=True, slots=True)
class RobotInventory:
    """Names on the robot. ``topics`` maps each to its type."""

    topics: dict[str, str]
    services: frozenset[str]

    @property
    def dialect(self) -> Dialect | None:
        """As the spelling of its type names tells; None when it tells nothing."""
        kinds = [kind for kind in self.topics.values() if kind]
        if not kinds:
            return None
        return Dialect.ROS2 if any("/msg/" in kind for kind in kinds) else Dialect.ROS1

    def has_service(self, name: str) -> bool:
        return _absolute(name) in self.services


async def take_inventory(ros: SafeRos) -> RobotInventory:
    """Ask rosapi.

    Raises
    ------
    ServiceCallError
        When it does not answer, or not with what it should.
    """
    topics, services = await asyncio.gather(
        ros.ask("/rosapi/topics", "rosapi/Topics"), ros.ask("/rosapi/services", "rosapi/Services")
    )
    names, types = _texts(topics.get("topics")), _texts(topics.get("types"))
    if len(types) != len(names):
        types = [""] * len(names)
    return RobotInventory(
        {_absolute(name): kind for name, kind in zip(names, types, strict=True)},
        frozenset(_absolute(name) for name in _texts(services.get("services"))),
    )


def missing_from(profile: RobotProfile, inventory: RobotInventory) -> list[str]:
    """One sentence for each thing that the profile names and the robot lacks or has with another type."""
    dialect = Dialect(profile.ros)
    sentences = []
    if inventory.dialect not in (None, dialect):
        ros = 3 - profile.ros
        sentences.append(
            f"The robot runs ROS {ros}, but the profile says ROS {profile.ros}. "
            f"Choose a profile with 'ros: {ros}', or add ?ros={ros} to the address."
        )
    for what, topic, package, message in _listened(profile):
        kind = inventory.topics.get(_absolute(topic))
        wanted = type_name(dialect, package, message)
        if kind is None:
            sentences.append(f"{what}: the robot has no topic {topic}.")
        elif kind and not same_type(kind, wanted):
            sentences.append(f"{what}: {topic} carries {kind}, but {wanted} was expected.")
    velocity = profile.velocity
    kind = inventory.topics.get(_absolute(velocity.topic))
    wanted = type_name(dialect, "geometry_msgs", velocity.type)
    if kind is None:
        sentences.append(f"Driving: nothing on the robot listens to {velocity.topic}.")
    elif kind and not same_type(kind, wanted):
        sentences.append(f"Driving: {velocity.topic} carries {kind}, but the profile says {velocity.type}.")
    navigation = profile.navigation
    if navigation is not None and navigation.kind == "move_base":
        goal_topic = _absolute(f"{navigation.name}/goal")
        if goal_topic not in inventory.topics:
            sentences.append(f"Navigation: nothing on the robot listens to {goal_topic}.")
    speech = profile.speech
    if speech is not None and speech.topic is not None and _absolute(speech.topic) not in inventory.topics:
        sentences.append(f"Speech: nothing on the robot listens to {speech.topic}.")
    stop = profile.emergency_stop
    if stop is not None and stop.service is not None and not inventory.has_service(stop.service):
        sentences.append(f"Emergency stop: the robot has no service {stop.service}.")
    return sentences


def _listened(profile: RobotProfile) -> Iterable[tuple[str, str, str, str]]:
    if profile.scan:
        yield "LIDAR", profile.scan.topic, "sensor_msgs", "LaserScan"
    if profile.odometry:
        yield "Odometry", profile.odometry.topic, "nav_msgs", "Odometry"
    if profile.map:
        yield "Map", profile.map.topic, "nav_msgs", "OccupancyGrid"
    if profile.battery:
        yield "Battery", profile.battery.topic, "sensor_msgs", "BatteryState"
    if profile.pose and not profile.tf:
        yield "Pose", profile.pose.topic, "geometry_msgs", "PoseWithCovarianceStamped"
    for camera in profile.cameras:
        yield f"Camera {camera.name}", camera.topic, "sensor_msgs", "CompressedImage"


def _texts(value: Any) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise ServiceCallError("rosapi answered with something that is not a list of names")
    return value


def _absolute(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


class _Probe:
    """Waits for one connection, or for the reason why there is none."""

    def __init__(self) -> None:
        self.outcome: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    def link_connected(self) -> None:
        self._settle("")

    def link_unreachable(self, what: str, advice: str) -> None:
        self._settle(f"{what} {advice}")

    def link_lost(self, reason: str) -> None:
        self._settle(f"The connection was lost at once: {reason}.")

    def link_silent(self) -> None: ...

    def link_heard(self) -> None: ...

    def link_round_trip(self, round_trip_s: float) -> None: ...

    def link_refused(self, detail: str) -> None: ...

    def _settle(self, outcome: str) -> None:
        if not self.outcome.done():
            self.outcome.set_result(outcome)


async def check(profile: RobotProfile, address: str, timeout_s: float) -> list[str]:
    """Connect, compare, disconnect; see ``link.check_robot``."""
    probe = _Probe()
    ros = SafeRos(address, probe, service_timeout_s=timeout_s, security=profile.security)
    ros.connect()
    try:
        async with asyncio.timeout(timeout_s):
            unreachable = await probe.outcome
            if unreachable:
                return [unreachable]
            return missing_from(profile, await take_inventory(ros))
    except (TimeoutError, ServiceCallError):
        if probe.outcome.done():
            return [NO_ROSAPI]
        return [f"Nothing answers at {without_credentials(address)} within {timeout_s:g} s."]
    finally:
        await ros.aclose(_GOODBYE_S)
