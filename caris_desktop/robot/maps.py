"""Map management on the robot: save, load, switch between mapping and localization, set the initial pose."""

import logging
import math
import re
from collections.abc import Callable
from typing import Any

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import InitialPoseSet, MappingChanged, MapRequestChanged, RequestState
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.link_commands import RequestMap, SetInitialPose
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.robot.link_context import LinkContext
from caris_desktop.robot.profile_model import MapServices
from caris_desktop.robot.robot_checks import RobotInventory
from caris_desktop.robot.transport import AnswerTooLargeError, RosbridgeTopic, ServiceCallError
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ros.message_conversion import (
    LOCALIZE_AT_POSE,
    START_AT_FIRST_NODE,
    encode_deserialize_map,
    encode_load_map,
    encode_pose_with_covariance_stamped,
    encode_save_map,
    encode_serialize_map,
    load_failure,
    save_failure,
    serialize_failure,
)
from caris_desktop.ros.message_fields import MessageError

logger = logging.getLogger(__name__)

# Large maps take time to write and read.
MAP_WAIT_S = 60.0
LONGEST_NAME = 100
UNSURE = QT_TR_NOOP("The robot does not report whether it found the map: check that it shows the right one")
_NAME = re.compile(r"[\w][\w .-]*", re.UNICODE)
_RESULT = re.compile(rb'"result"\s*:\s*([0-9]{1,3})\b')
_PAUSED = "paused_new_measurements"


def map_name_refusal(name: str) -> str:
    """Reason why ``name`` is invalid for a map, or an empty text. It becomes part of a file name on the robot."""
    if not name.strip():
        return QT_TR_NOOP("a map needs a name")
    if len(name) > LONGEST_NAME:
        return localized(QT_TR_NOOP("the name is longer than {most} characters"), most=LONGEST_NAME)
    if not _NAME.fullmatch(name) or ".." in name or name != name.strip():
        return QT_TR_NOOP("a map name can only contain letters, digits, spaces, '-', '_' and single dots")
    return ""


class RobotMaps:
    """Executes RequestMap and SetInitialPose with slam_toolbox's services, or else the map server's.

    It sends a MapRequestChanged for each step of a request, InitialPoseSet, and a MappingChanged with each
    connection and each switch. ``pose`` returns the robot's present pose.
    """

    def __init__(self, link: LinkContext, *, pose: Callable[[], Pose2D | None]) -> None:
        self._ros, profile = link.ros, link.profile
        self._frame = profile.frames.map
        self._map_topic = profile.map.topic if profile.map is not None else "map"
        self._services = profile.maps or MapServices()
        self._emit = link.put
        self._pose = pose
        self._in_background = link.in_background
        self._offer = _offer(self._services, self._ros.dialect)
        self._mapping: bool | None = None
        self._reported = False
        self._busy = ""
        self._initial_pose: RosbridgeTopic | None = None
        if profile.initial_pose is not None:
            kind = "geometry_msgs/PoseWithCovarianceStamped"
            self._initial_pose = RosbridgeTopic(self._ros, profile.initial_pose, kind, queue_size=1)
            self._initial_pose.advertise()

    def on_inventory(self, inventory: RobotInventory | None) -> None:
        """Find available operations on connection; by the profile alone if the robot has no inventory."""
        offer = _offer(self._services, self._ros.dialect)
        if inventory is not None:
            offer = {operation: service for operation, service in offer.items() if inventory.has_service(service)}
        self._offer = offer
        self._in_background(self._find_out_mapping())

    def link_recovered(self) -> None:
        """Repeat the state after link trouble, since displays have cleared it."""
        if self._reported:
            self._set_mapping(self._mapping)

    def link_lost(self) -> None:
        self._mapping = None
        self._reported = False

    def set_initial_pose(self, command: SetInitialPose) -> str:
        """Set the initial pose; return the reason for a refusal, or an empty text."""
        pose = command.pose_in_map
        if self._initial_pose is None:
            return QT_TR_NOOP("this robot's profile does not define a topic for it")
        if not all(math.isfinite(value) for value in (pose.x_m, pose.y_m, pose.heading_rad)):
            return QT_TR_NOOP("the position on the map is invalid")
        message = encode_pose_with_covariance_stamped(
            self._ros.dialect,
            pose,
            spread_m=command.spread_m,
            spread_rad=command.spread_rad,
            stamp_ns=0,
            frame_id=self._frame,
        )
        if not self._initial_pose.publish(message):
            return QT_TR_NOOP("the robot is not connected")
        self._emit(InitialPoseSet(now_ns(), pose, command.actor))
        return ""

    def request(self, command: RequestMap) -> None:
        """Start a map operation; one at a time."""
        refusal = self._refusal(command)
        if refusal:
            self._notify(command, "failed", refusal)
            return
        self._notify(command, "requested")
        self._busy = command.request_id
        self._in_background(self._carry_out(command))

    def _refusal(self, command: RequestMap) -> str:
        offer = self._offer
        if command.operation in ("save", "load") and (refusal := map_name_refusal(command.name)):
            return refusal
        if not self._ros.is_connected:
            return QT_TR_NOOP("the robot is not connected")
        if self._busy:
            return QT_TR_NOOP("the previous map operation is still running")
        able = {
            "save": offer.get("serialize") or offer.get("save"),
            "load": offer.get("deserialize") or offer.get("load"),
            "start_mapping": offer.get("pause"),
            "start_localization": offer.get("pause"),
        }
        return "" if able[command.operation] else QT_TR_NOOP("the robot offers no service for it")

    async def _carry_out(self, command: RequestMap) -> None:
        detail = ""
        try:
            failure = await self._done(command)
            if command.operation == "load" and "deserialize" in self._offer:
                # slam_toolbox's answer is the same for a missing map.
                detail = UNSURE
        except (ServiceCallError, MessageError) as error:
            logger.warning("Map operation %s: %s", command.operation, error)
            failure = str(error)
        finally:
            self._busy = ""
        self._notify(command, "failed" if failure else "succeeded", failure or detail)

    async def _done(self, command: RequestMap) -> str:
        offer = self._offer
        folder = self._services.folder.rstrip("/")
        path = f"{folder}/{command.name}" if folder else command.name
        match command.operation:
            case "save":
                return await self._save(path, offer)
            case "load":
                return await self._load(path, offer)
            case "start_mapping" | "start_localization":
                starts = command.operation == "start_mapping"
                paused = await self._ask_paused()
                mapping = not paused if paused is not None else self._mapping
                # The service toggles; slam_toolbox starts in mapping mode.
                if (mapping is not False) != starts and "pause" in offer:
                    await self._call(offer["pause"], "slam_toolbox/Pause", {})
                self._set_mapping(starts)
                return ""

    async def _save(self, path: str, offer: dict[str, str]) -> str:
        failures = []
        if "serialize" in offer:
            answer = await self._call(offer["serialize"], "slam_toolbox/SerializePoseGraph", encode_serialize_map(path))
            failures.append(serialize_failure(answer))
        if "save" in offer:
            # Next to the pose graph, for programs that only read map images.
            request = encode_save_map(path, map_topic=self._map_topic)
            failures.append(save_failure(await self._call(offer["save"], "nav2_msgs/SaveMap", request)))
        return "; ".join(filter(None, failures))

    async def _load(self, path: str, offer: dict[str, str]) -> str:
        if "deserialize" in offer:
            here = self._pose()
            localizing = self._mapping is False
            request = encode_deserialize_map(
                path, match_type=LOCALIZE_AT_POSE if localizing and here is not None else START_AT_FIRST_NODE, at=here
            )
            await self._call(offer["deserialize"], "slam_toolbox/DeserializePoseGraph", request)
            return ""
        if "load" not in offer:
            return QT_TR_NOOP("the robot offers no service for it")
        kind = "nav_msgs/LoadMap" if self._ros.dialect is Dialect.ROS1 else "nav2_msgs/LoadMap"
        try:
            answer = await self._call(offer["load"], kind, encode_load_map(f"{path}.yaml"))
        except AnswerTooLargeError as large:
            # The answer contains the whole map, with the result at its end. The map itself arrives on its topic, over
            # the other link.
            answer = {"result": int(found[1])} if (found := _RESULT.search(large.tail)) else {"result": 255}
        return load_failure(answer)

    async def _call(self, service: str, kind: str, request: dict[str, Any]) -> dict[str, Any]:
        return await self._ros.ask(service, kind, request, timeout_s=MAP_WAIT_S)

    async def _find_out_mapping(self) -> None:
        paused = await self._ask_paused() if "pause" in self._offer else None
        self._set_mapping(None if paused is None else not paused)

    async def _ask_paused(self) -> bool | None:
        """State of slam_toolbox's toggle from its parameter; None if unreadable."""
        node = self._services.slam_toolbox
        separator = "/" if self._ros.dialect is Dialect.ROS1 else ":"
        try:
            answer = await self._ros.ask(
                "/rosapi/get_param", "rosapi/GetParam", {"name": f"{node}{separator}{_PAUSED}"}
            )
            paused = parse_json(answer.get("value") or "null")
        except (ServiceCallError, TypeError, ValueError) as error:
            logger.debug("Whether the robot maps is not known: %s", error)
            return None
        return paused if isinstance(paused, bool) else None

    def _set_mapping(self, mapping: bool | None) -> None:
        self._mapping = mapping
        self._reported = True
        offer = self._offer
        self._emit(
            MappingChanged(
                now_ns(),
                mapping,
                can_save=bool(offer.get("serialize") or offer.get("save")),
                can_load=bool(offer.get("deserialize") or offer.get("load")),
                can_switch=bool(offer.get("pause")),
            )
        )

    def _notify(self, command: RequestMap, state: RequestState, detail: str = "") -> None:
        self._emit(
            MapRequestChanged(
                now_ns(), command.request_id, command.operation, command.name, state, detail, command.actor
            )
        )


def _offer(services: MapServices, dialect: Dialect) -> dict[str, str]:
    """Map services of the robot by operation: serialize, deserialize, pause, load and save."""
    slam, server, saver = services.slam_toolbox, services.map_server, services.map_saver
    offer = {}
    if slam:
        offer = {"serialize": "serialize_map", "deserialize": "deserialize_map", "pause": "pause_new_measurements"}
        offer = {operation: f"{slam}/{service}" for operation, service in offer.items()}
    if server is not None:
        # ROS 1's map server (from Noetic on) has its service in its namespace rather than under its own name.
        ros2 = dialect is Dialect.ROS2
        offer["load"] = f"{server}/load_map" if ros2 else f"{server.rpartition('/')[0]}/change_map"
    if saver and dialect is Dialect.ROS2:
        offer["save"] = f"{saver}/save_map"
    return offer
