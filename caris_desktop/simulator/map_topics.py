"""Map on ROS: whole maps, updates, and the services to save and load."""

import logging

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.ros import message_conversion
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ros.map_services import LOCALIZE_AT_POSE, START_AT_GIVEN_POSE
from caris_desktop.ros.message_fields import count, message_of, number, part, text
from caris_desktop.ros.navigation_messages import encode_occupancy_grid_update
from caris_desktop.simulator.map_files import MapFileError, MapFiles, NoSuchMap
from caris_desktop.simulator.ros_context import Wiring
from caris_desktop.simulator.server import Message

logger = logging.getLogger(__name__)

_LOOK_EVERY_STEPS = 50
_WHOLE_EVERY_S = 5.0
_GROWN_BY = 0.1
_LOADED, _NO_SUCH_MAP, _INVALID_MAP = 0, 1, 2
_SERIALIZED, _NOT_WRITTEN = 0, 255


class MapOnRos:
    """Publishes the growing map, and executes slam_toolbox's and the map server's services if the model has them.

    The whole map is published when it has grown by a tenth, and every five seconds while it changes, with updates in
    between. Late subscribers get the present map.
    """

    def __init__(self, wiring: Wiring, files: MapFiles) -> None:
        self._wiring = wiring
        self._files = files
        self._full_s = float("-inf")
        self._full_share = 0.0
        dress = wiring.dress
        self._map = wiring.publishes(dress.map, "nav_msgs", "OccupancyGrid", latched=True) if dress.map else None
        self._updates = (
            wiring.publishes(dress.map_updates, "map_msgs", "OccupancyGridUpdate") if dress.map_updates else None
        )
        wiring.every(_LOOK_EVERY_STEPS, self._publish_change)
        if dress.slam_toolbox is not None:
            toolbox = dress.slam_toolbox
            wiring.serves(f"{toolbox}/serialize_map", "slam_toolbox", "SerializePoseGraph", self._serialize)
            wiring.serves(f"{toolbox}/deserialize_map", "slam_toolbox", "DeserializePoseGraph", self._deserialize)
            wiring.serves(f"{toolbox}/pause_new_measurements", "slam_toolbox", "Pause", self._pause)
            # in ROS 2 a node's parameter follows a colon
            node, between = dress.absolute(toolbox), "/" if wiring.dialect is Dialect.ROS1 else ":"
            wiring.server.params[f"{node}{between}paused_new_measurements"] = lambda: wiring.robot.mapping_paused
        if dress.map_saver is not None:
            wiring.serves(f"{dress.map_saver}/save_map", "nav2_msgs", "SaveMap", self._save)
        if dress.map_server is not None:
            wiring.serves(f"{dress.map_server}/load_map", "nav2_msgs", "LoadMap", self._load)

    def _publish_change(self) -> None:
        change = self._wiring.robot.mapper.change() if self._map is not None else None
        if self._map is None or change is None:
            return
        share = self._wiring.robot.mapper.known_share
        now_s = self._wiring.robot.now_s
        if (
            self._updates is None
            or share > self._full_share * (1.0 + _GROWN_BY)
            or now_s - self._full_s >= _WHOLE_EVERY_S
        ):
            self._publish_whole()
            return
        self._wiring.server.set_latched(self._map, self._whole())
        update = encode_occupancy_grid_update(
            self._wiring.dialect,
            change.cells,
            x=change.left,
            y=change.bottom,
            stamp_ns=self._wiring.stamp_ns(),
            frame_id=self._wiring.frame(self._wiring.dress.map_frame),
        )
        self._wiring.publish(self._updates, update)

    def _publish_whole(self) -> None:
        if self._map is not None:
            self._full_s = self._wiring.robot.now_s
            self._full_share = self._wiring.robot.mapper.known_share
            self._wiring.publish(self._map, self._whole())

    def _whole(self) -> Message:
        stamp_ns = self._wiring.stamp_ns()
        frame = self._wiring.frame(self._wiring.dress.map_frame)
        grid = self._wiring.robot.mapper.grid(stamp_ns=stamp_ns)
        return message_conversion.encode_occupancy_grid(self._wiring.dialect, grid, stamp_ns=stamp_ns, frame_id=frame)

    def _serialize(self, arguments: Message) -> Message:
        try:
            path = self._files.save_graph(text(arguments, "filename", "args"), *self._wiring.robot.mapper.snapshot())
        except MapFileError as error:
            logger.warning("The map was not saved: %s", error)
            return {"result": _NOT_WRITTEN}
        logger.info("The map was saved: %s", path)
        return {"result": _SERIALIZED}

    def _deserialize(self, arguments: Message) -> Message:
        match_type = count(arguments, "match_type", "args", most=LOCALIZE_AT_POSE) if "match_type" in arguments else 0
        try:
            self._wiring.robot.mapper.restore(*self._files.load_graph(text(arguments, "filename", "args")))
        except (MapFileError, ValueError) as error:
            # slam_toolbox's answer is the same in any case, and the error is only logged
            logger.warning("The map was not loaded: %s", error)
            return {}
        if match_type in (START_AT_GIVEN_POSE, LOCALIZE_AT_POSE) and "initial_pose" in arguments:
            pose = part(message_of(arguments, "args"), "initial_pose", "args")
            here = Pose2D(*(number(pose, name, "args.initial_pose") for name in ("x", "y", "theta")))
            self._wiring.robot.assume_pose(here)
        if match_type == LOCALIZE_AT_POSE:
            self._wiring.robot.mapping_paused = True
        self._publish_whole()
        return {}

    def _pause(self, _: Message) -> Message:
        """As in slam_toolbox: each call toggles, and the answer is always the same."""
        robot = self._wiring.robot
        robot.mapping_paused = not robot.mapping_paused
        return {"status": True}

    def _save(self, arguments: Message) -> Message:
        try:
            path = self._files.save_picture(text(arguments, "map_url", "args"), self._wiring.robot.mapper.cells())
        except MapFileError as error:
            logger.warning("The map was not saved: %s", error)
            return {"result": False}
        logger.info("The map was saved: %s", path)
        return {"result": True}

    def _load(self, arguments: Message) -> Message:
        try:
            self._wiring.robot.mapper.replace(self._files.load_picture(text(arguments, "map_url", "args")))
        except (MapFileError, ValueError) as error:
            logger.warning("The map was not loaded: %s", error)
            return {"map": self._whole(), "result": _NO_SUCH_MAP if isinstance(error, NoSuchMap) else _INVALID_MAP}
        self._publish_whole()
        return {"map": self._whole(), "result": _LOADED}
