"""Map on ROS: whole maps, updates, and the services to save and load."""

import logging

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.ros import message_conversion
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ros.map_services import LOCALIZE_AT_POSE, START_AT_GIVEN_POSE
from caris_desktop.ros.message_fields import count, message_of, number, part, text
from caris_desktop.ros.navigation_messages import encode_occupancy_grid_update
from caris_desktop.simulator.map_files import MapFileError, MapFiles, NoSuchMap
from caris_desktop.simulator.ros_context import RosContext
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

    def __init__(self, ros: RosContext, files: MapFiles) -> None:
        self._ros = ros
        self._files = files
        self._full_s = float("-inf")
        self._full_share = 0.0
        model = ros.model
        self._map = ros.publishes(model.map, "nav_msgs", "OccupancyGrid", latched=True) if model.map else None
        self._updates = (
            ros.publishes(model.map_updates, "map_msgs", "OccupancyGridUpdate") if model.map_updates else None
        )
        ros.every(_LOOK_EVERY_STEPS, self._publish_change)
        if model.slam_toolbox is not None:
            toolbox = model.slam_toolbox
            ros.serves(f"{toolbox}/serialize_map", "slam_toolbox", "SerializePoseGraph", self._serialize)
            ros.serves(f"{toolbox}/deserialize_map", "slam_toolbox", "DeserializePoseGraph", self._deserialize)
            ros.serves(f"{toolbox}/pause_new_measurements", "slam_toolbox", "Pause", self._pause)
            # in ROS 2 a node's parameter follows a colon
            node, between = model.absolute(toolbox), "/" if ros.dialect is Dialect.ROS1 else ":"
            ros.server.params[f"{node}{between}paused_new_measurements"] = lambda: ros.robot.mapping_paused
        if model.map_saver is not None:
            ros.serves(f"{model.map_saver}/save_map", "nav2_msgs", "SaveMap", self._save)
        if model.map_server is not None:
            ros.serves(f"{model.map_server}/load_map", "nav2_msgs", "LoadMap", self._load)

    def _publish_change(self) -> None:
        robot = self._ros.robot
        change = robot.mapper.change() if self._map is not None else None
        if self._map is None or change is None:
            return
        grown = robot.mapper.known_share > self._full_share * (1.0 + _GROWN_BY)
        if self._updates is None or grown or robot.now_s - self._full_s >= _WHOLE_EVERY_S:
            self._publish_whole()
            return
        self._ros.server.set_latched(self._map, self._whole())
        encode, frame = encode_occupancy_grid_update, self._ros.model.map_frame
        self._ros.publish_stamped(self._updates, encode, change.cells, frame=frame, x=change.left, y=change.bottom)

    def _publish_whole(self) -> None:
        if self._map is not None:
            self._full_s = self._ros.robot.now_s
            self._full_share = self._ros.robot.mapper.known_share
            self._ros.publish(self._map, self._whole())

    def _whole(self) -> Message:
        stamp_ns = self._ros.stamp_ns()
        frame = self._ros.frame(self._ros.model.map_frame)
        grid = self._ros.robot.mapper.grid(stamp_ns=stamp_ns)
        return message_conversion.encode_occupancy_grid(self._ros.dialect, grid, stamp_ns=stamp_ns, frame_id=frame)

    def _serialize(self, arguments: Message) -> Message:
        try:
            path = self._files.save_graph(text(arguments, "filename", "args"), *self._ros.robot.mapper.snapshot())
        except MapFileError as error:
            logger.warning("The map was not saved: %s", error)
            return {"result": _NOT_WRITTEN}
        logger.info("The map was saved: %s", path)
        return {"result": _SERIALIZED}

    def _deserialize(self, arguments: Message) -> Message:
        match_type = count(arguments, "match_type", "args", most=LOCALIZE_AT_POSE) if "match_type" in arguments else 0
        try:
            self._ros.robot.mapper.restore(*self._files.load_graph(text(arguments, "filename", "args")))
        except (MapFileError, ValueError) as error:
            # slam_toolbox's answer is the same in any case, and the error is only logged
            logger.warning("The map was not loaded: %s", error)
            return {}
        if match_type in (START_AT_GIVEN_POSE, LOCALIZE_AT_POSE) and "initial_pose" in arguments:
            pose = part(message_of(arguments, "args"), "initial_pose", "args")
            here = Pose2D(*(number(pose, name, "args.initial_pose") for name in ("x", "y", "theta")))
            self._ros.robot.assume_pose(here)
        if match_type == LOCALIZE_AT_POSE:
            self._ros.robot.mapping_paused = True
        self._publish_whole()
        return {}

    def _pause(self, _: Message) -> Message:
        """As in slam_toolbox: each call toggles, and the answer is always the same."""
        robot = self._ros.robot
        robot.mapping_paused = not robot.mapping_paused
        return {"status": True}

    def _save(self, arguments: Message) -> Message:
        try:
            path = self._files.save_picture(text(arguments, "map_url", "args"), self._ros.robot.mapper.cells())
        except MapFileError as error:
            logger.warning("The map was not saved: %s", error)
            return {"result": False}
        logger.info("The map was saved: %s", path)
        return {"result": True}

    def _load(self, arguments: Message) -> Message:
        try:
            self._ros.robot.mapper.replace(self._files.load_picture(text(arguments, "map_url", "args")))
        except (MapFileError, ValueError) as error:
            logger.warning("The map was not loaded: %s", error)
            return {"map": self._whole(), "result": _NO_SUCH_MAP if isinstance(error, NoSuchMap) else _INVALID_MAP}
        self._publish_whole()
        return {"map": self._whole(), "result": _LOADED}
