"""The robot's face on ROS: which topics and services it has, and what is published when."""

import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import BatteryState
from caris_desktop.ros import messages
from caris_desktop.ros.dialect import Dialect, service_type_name, type_name
from caris_desktop.ros.fields import message_of, text, truth
from caris_desktop.simulator import faults as fault_commands
from caris_desktop.simulator.camera_model import sees
from caris_desktop.simulator.faults import Faults
from caris_desktop.simulator.floor_plan import PLACES
from caris_desktop.simulator.lidar import FRAME_ID as LASER_FRAME
from caris_desktop.simulator.lidar import ROBOT_FROM_LASER
from caris_desktop.simulator.robot import ROBOT_FROM_CAMERA, Robot
from caris_desktop.simulator.server import BridgeServer, CallFailed, Message, Service, Topic
from caris_desktop.simulator.speech import Voice

logger = logging.getLogger(__name__)

CAMERA_TOPIC = "/camera/image_raw/compressed"
CAMERA_FRAME = "camera"


@dataclass(frozen=True, slots=True)
class _Periodic:
    """Something published every ``steps`` simulation steps; ``wanted`` says whether it is worth building."""

    steps: int
    topic: str
    publish: Callable[[], None]


class RobotTopics:
    """Publishes the robot's sensors on a :class:`BridgeServer` and obeys its command topics and services."""

    def __init__(self, robot: Robot, server: BridgeServer, dialect: Dialect, *, muted: bool, faults: Faults) -> None:
        self._robot = robot
        self._server = server
        self._dialect = dialect
        self._steps = 0
        self._twists_received = 0
        self._last_twist_s: float | None = None
        self.voice = Voice(self._on_speaking, muted=muted)
        self.faults = faults
        server.latency_s = faults.latency_s
        self._offer_topics()
        self._offer_services()
        self._periodic = (
            _Periodic(2, "/odom", self._publish_odometry),
            _Periodic(2, "/tf", self._publish_transforms),
            _Periodic(5, "", self._publish_scan),
            _Periodic(5, "/amcl_pose", self._publish_pose),
            _Periodic(50, "", self._publish_map),
            _Periodic(50, "/battery_state", self._publish_battery),
        )
        self._server.publish("/emergency_stop", messages.encode_bool(False))
        self._server.publish("/tts/speaking", messages.encode_bool(False))
        self._publish_static_transforms()

    def publish_due(self) -> None:
        """Publish what this step brings. Called once after every step of the robot."""
        self._steps += 1
        for entry in self._periodic:
            if self._steps % entry.steps == 0 and (not entry.topic or self._server.has_subscribers(entry.topic)):
                entry.publish()

    def publish_picture(self, jpeg: bytes, *, stamp_ns: int) -> None:
        """Publish one camera picture."""
        self._server.publish(
            CAMERA_TOPIC,
            messages.encode_compressed_image(self._dialect, jpeg, stamp_ns=stamp_ns, frame_id=CAMERA_FRAME),
        )

    def _offer_topics(self) -> None:
        publishes: tuple[tuple[str, str, str, bool], ...] = (
            ("/scan", "sensor_msgs", "LaserScan", False),
            ("/odom", "nav_msgs", "Odometry", False),
            ("/tf", "tf2_msgs", "TFMessage", False),
            ("/tf_static", "tf2_msgs", "TFMessage", True),
            ("/amcl_pose", "geometry_msgs", "PoseWithCovarianceStamped", True),
            ("/map", "nav_msgs", "OccupancyGrid", True),
            (CAMERA_TOPIC, "sensor_msgs", "CompressedImage", False),
            ("/battery_state", "sensor_msgs", "BatteryState", True),
            ("/emergency_stop", "std_msgs", "Bool", True),
            ("/tts/speaking", "std_msgs", "Bool", True),
        )
        obeys: tuple[tuple[str, str, str, Callable[[Message], None]], ...] = (
            ("/cmd_vel", "geometry_msgs", "Twist", self._on_twist),
            ("/tts", "std_msgs", "String", self._on_say),
            ("/tts/stop", "std_msgs", "Empty", lambda _: self.voice.stop()),
            ("/simulator/fault", "std_msgs", "String", self._on_fault),
        )
        for name, package, kind, latched in publishes:
            self._server.topics[name] = Topic(type_name(self._dialect, package, kind), latched)
        for name, package, kind, on_message in obeys:
            self._server.topics[name] = Topic(type_name(self._dialect, package, kind), on_message=on_message)

    def _offer_services(self) -> None:
        offers: tuple[tuple[str, str, str, Callable[[Message], Message]], ...] = (
            ("/emergency_stop/set", "std_srvs", "SetBool", self._set_emergency_stop),
            ("/simulator/fault", "simulator", "Fault", self._inject_fault),
            ("/simulator/state", "simulator", "State", lambda _: self._state()),
        )
        for name, package, kind, call in offers:
            self._server.services[name] = Service(service_type_name(self._dialect, package, kind), call)

    def _publish_odometry(self) -> None:
        stamp_ns = time.time_ns()
        odometry = self._robot.odometry(stamp_ns=stamp_ns)
        self._server.publish("/odom", messages.encode_odometry(self._dialect, odometry, stamp_ns=stamp_ns))

    def _publish_transforms(self) -> None:
        stamp_ns = time.time_ns()
        transforms = [
            ("map", "odom", self._robot.map_from_odom),
            ("odom", "base_link", self._robot.odometry(stamp_ns=stamp_ns).pose_in_odom),
        ]
        self._server.publish("/tf", messages.encode_tf_message(self._dialect, transforms, stamp_ns=stamp_ns))

    def _publish_static_transforms(self) -> None:
        transforms = [
            ("base_link", LASER_FRAME, ROBOT_FROM_LASER),
            ("base_link", CAMERA_FRAME, ROBOT_FROM_CAMERA),
        ]
        message = messages.encode_tf_message(self._dialect, transforms, stamp_ns=time.time_ns())
        self._server.publish("/tf_static", message)

    def _publish_scan(self) -> None:
        stamp_ns = time.time_ns()
        scan = self._robot.scan(stamp_ns=stamp_ns)
        if not self.faults.lidar_silent and self._server.has_subscribers("/scan"):
            self._server.publish("/scan", messages.encode_laser_scan(self._dialect, scan, stamp_ns=stamp_ns))

    def _publish_pose(self) -> None:
        message = messages.encode_pose_with_covariance_stamped(
            self._dialect, self._robot.pose_in_map, stamp_ns=time.time_ns()
        )
        self._server.publish("/amcl_pose", message)

    def _publish_map(self) -> None:
        stamp_ns = time.time_ns()
        grid = self._robot.mapper.grid_if_changed(stamp_ns=stamp_ns)
        if grid is not None:
            self._server.publish("/map", messages.encode_occupancy_grid(self._dialect, grid, stamp_ns=stamp_ns))

    def _publish_battery(self) -> None:
        stamp_ns = time.time_ns()
        fraction = self._robot.battery_fraction
        message = messages.encode_battery_state(
            self._dialect,
            BatteryState(stamp_ns, fraction),
            stamp_ns=stamp_ns,
            voltage_v=22.0 + 3.2 * fraction,
        )
        self._server.publish("/battery_state", message)

    def _on_twist(self, message: Message) -> None:
        # TwistStamped wraps the same twist; ROS itself fills fields that a client leaves out with zero
        plain = message_of(message["twist"], "TwistStamped.twist") if "twist" in message else message
        axes = {"x": 0.0, "y": 0.0, "z": 0.0}
        whole = {part: axes | message_of(plain.get(part, {}), f"Twist.{part}") for part in ("linear", "angular")}
        twist = messages.decode_twist(whole)
        self._twists_received += 1
        self._last_twist_s = time.monotonic()
        self._robot.drive(twist)

    def _on_say(self, message: Message) -> None:
        if not self.voice.say(messages.decode_string(message)):
            logger.warning("A sentence was not taken: it is empty, or too many wait already")

    def _on_speaking(self, speaking: bool) -> None:
        self._server.publish("/tts/speaking", messages.encode_bool(speaking))

    def _on_fault(self, message: Message) -> None:
        try:
            self._inject(messages.decode_string(message))
        except ValueError as error:
            raise messages.MessageError(str(error)) from error

    def _inject_fault(self, arguments: Message) -> Message:
        try:
            self._inject(text(arguments, "command", "args"))
        except ValueError as error:
            raise CallFailed(str(error)) from error
        return {"success": True, "message": ""}

    def _inject(self, command: str) -> None:
        injection = fault_commands.inject(self.faults, command)
        logger.info("Injected fault: %s", command)
        self.faults = injection.faults
        self._server.latency_s = injection.faults.latency_s
        if injection.battery_fraction is not None:
            self._robot.battery_fraction = injection.battery_fraction
        if injection.drop_link_s is not None:
            self._server.drop_link(injection.drop_link_s)

    def _set_emergency_stop(self, arguments: Message) -> Message:
        stopped = truth(arguments, "data", "args")
        self._robot.set_emergency_stop(stopped)
        self._server.publish("/emergency_stop", messages.encode_bool(stopped))
        return {"success": True, "message": "latched" if stopped else "cleared"}

    def _state(self) -> Message:
        """The truth, for tests and for looking inside: nothing here is on any topic of the robot."""
        truth_ = self._robot.truth
        pose = truth_.pose_in_map
        camera = self._robot.view().map_from_camera
        people = [
            {
                "x_m": person.x_m,
                "y_m": person.y_m,
                "distance_m": math.dist((person.x_m, person.y_m), (camera.x_m, camera.y_m)),
                "walking": person.walking,
                "in_view": sees(camera, person.x_m, person.y_m),
            }
            for person in self._robot.people
        ]
        return {
            "time_s": self._robot.now_s,
            "pose": _pose(pose),
            "believed_pose": _pose(self._robot.pose_in_map),
            "speed_mps": truth_.forward_mps,
            "speed_radps": truth_.turn_radps,
            "touching": truth_.touching,
            "collisions": truth_.collisions,
            "emergency_stopped": self._robot.emergency_stopped,
            "goal_id": self._robot.goal_id or "",
            "speaking": self.voice.speaking or "",
            "twists_received": self._twists_received,
            "last_twist_age_s": None if self._last_twist_s is None else time.monotonic() - self._last_twist_s,
            "people": people,
            "anybody_in_view": any(person["in_view"] for person in people),
            "known_map_share": self._robot.mapper.known_share,
            "places": [{"name": place.name, **_pose(place.pose)} for place in PLACES],
        }


def _pose(pose: Pose2D) -> Message:
    return {"x_m": pose.x_m, "y_m": pose.y_m, "heading_rad": pose.heading_rad}
