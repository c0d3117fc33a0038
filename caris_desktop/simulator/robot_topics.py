"""Simulated robot on ROS: topics and services of its model, and periodic publishing."""

import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import BatteryState
from caris_desktop.domain.value_class import dataclass
from caris_desktop.ros import message_conversion
from caris_desktop.ros.message_fields import MessageError, message_of, number, text, truth
from caris_desktop.ros.navigation_messages import encode_clock
from caris_desktop.simulator import encoding
from caris_desktop.simulator import faults as fault_commands
from caris_desktop.simulator.camera_model import FOCAL_PX, HEIGHT_PX, WIDTH_PX, sees
from caris_desktop.simulator.demo_controls import DemoControls
from caris_desktop.simulator.encoding import Placement
from caris_desktop.simulator.faults import Faults
from caris_desktop.simulator.floor_plan import PLACES
from caris_desktop.simulator.goal_topics import MoveBaseTopics, NavigateToPoseAction
from caris_desktop.simulator.head_topics import HeadOnRos
from caris_desktop.simulator.map_files import MapFiles
from caris_desktop.simulator.map_topics import MapOnRos
from caris_desktop.simulator.robot_interface import BatteryTopic, SpeechAction, SpeechTopics, StopService, VelocityInput
from caris_desktop.simulator.ros_context import Wiring
from caris_desktop.simulator.server import CallFailed, Message
from caris_desktop.simulator.simulated_speech import Voice
from caris_desktop.simulator.sound_topics import SoundOnRos
from caris_desktop.simulator.speech_topics import SpeechOnAction, SpeechOnTopics
from caris_desktop.simulator.stub_capabilities import OrdersOnRos

logger = logging.getLogger(__name__)

CLOCK_TOPIC = "/clock"
_AT_BASE = Pose2D(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class _Periodic:
    """Message published every ``steps`` simulation steps; without a ``topic``, regardless of subscribers."""

    steps: int
    topic: str
    publish: Callable[[], None]


class RobotTopics:
    """Publishes the robot's sensors on a :class:`BridgeServer` and executes its commands and services."""

    def __init__(
        self,
        wiring: Wiring,
        *,
        muted: bool,
        simulation_time: bool = False,
        maps: MapFiles | None = None,
        lines: Sequence[str] = (),
    ) -> None:
        """``lines`` are a participant's sentences, one after each utterance of the robot."""
        self._wiring = wiring
        self._robot = wiring.robot
        self._steps = 0
        self._twists_received = 0
        self._last_twist_s: float | None = None
        self._stop_state: str | None = None
        self._camera: str | None = None
        self._periodic: list[_Periodic] = []
        self._head = HeadOnRos(wiring)
        self._map = MapOnRos(wiring, maps or MapFiles())
        self._goals = self._navigation()
        self._speech = self._speech_of_robot_model(muted=muted)
        self.sound = SoundOnRos(wiring, wiring.dress.audio, lines) if wiring.dress.audio is not None else None
        if self.voice is not None and self.sound is not None:
            self.voice.on_sound = self.sound.on_voice
            self.voice.on_said = self.sound.participant.on_robot_finished
        self._gadgets = DemoControls(wiring) if wiring.dress.gadgets else None
        self._orders = OrdersOnRos(wiring)
        self._offer_sensors()
        self._offer_commands()
        self._offer_simulator()
        wiring.server.params["/use_sim_time"] = lambda: simulation_time
        if simulation_time:
            wiring.publishes(CLOCK_TOPIC, "rosgraph_msgs", "Clock")
            self._every(1, CLOCK_TOPIC, self._publish_clock)
        self._apply_faults(wiring.faults)

    @property
    def faults(self) -> Faults:
        """Present faults."""
        return self._wiring.faults

    @property
    def voice(self) -> Voice | None:
        return self._speech.voice if self._speech is not None else None

    @property
    def camera_topic(self) -> str | None:
        """Topic of the images; None without a camera."""
        return self._camera

    def publish_due(self) -> None:
        """Publish this step's messages; called after every simulation step."""
        self._steps += 1
        for entry in self._periodic:
            if self._steps % entry.steps == 0 and (not entry.topic or self._wiring.wanted(entry.topic)):
                entry.publish()
        self._map.publish_due()
        self._head.publish_due()
        for part in (self._goals, self._speech, self.sound, self._gadgets, self._orders):
            if part is not None:
                part.publish_due()

    def skip_time(self, skipped_s: float) -> None:
        """Continue after skipped simulation time."""
        if self.sound is not None:
            self.sound.skip_time(skipped_s)

    def publish_picture(self, jpeg: bytes, *, stamp_ns: int) -> None:
        """Publish one camera image and, if subscribed, the camera info."""
        wiring, camera = self._wiring, self._wiring.dress.camera
        if camera is None or self._camera is None:
            return
        frame = wiring.frame(camera.frame)
        picture = message_conversion.encode_compressed_image(wiring.dialect, jpeg, stamp_ns=stamp_ns, frame_id=frame)
        wiring.publish(self._camera, picture)
        info = wiring.dress.absolute(camera.info)
        if wiring.wanted(info):
            self._publish_camera_info(info, frame)

    def stop(self) -> None:
        """Stop publishing and cancel pending work."""
        if self.voice is not None:
            self.voice.stop()
        if self.sound is not None:
            self.sound.stop()
        if self._gadgets is not None:
            self._gadgets.stop()
        self._orders.stop()

    def _every(self, steps: int, topic: str, publish: Callable[[], None]) -> None:
        self._periodic.append(_Periodic(steps, topic, publish))

    def _navigation(self) -> MoveBaseTopics | NavigateToPoseAction | None:
        navigation = self._wiring.dress.navigation
        if navigation is None:
            return None
        kind = MoveBaseTopics if self._wiring.dialect.value == 1 else NavigateToPoseAction
        return kind(self._wiring, navigation)

    def _speech_of_robot_model(self, *, muted: bool) -> SpeechOnTopics | SpeechOnAction | None:
        match self._wiring.dress.speech:
            case SpeechTopics() as interface:
                return SpeechOnTopics(self._wiring, interface, muted=muted)
            case SpeechAction() as interface:
                return SpeechOnAction(self._wiring, interface, muted=muted)
        return None

    def _offer_sensors(self) -> None:
        wiring, dress = self._wiring, self._wiring.dress
        self._odometry = wiring.publishes(dress.odometry, "nav_msgs", "Odometry")
        self._tf = wiring.publishes(dress.tf, "tf2_msgs", "TFMessage")
        self._tf_static = wiring.publishes(dress.tf_static, "tf2_msgs", "TFMessage", latched=True)
        if dress.camera is not None:
            self._camera = wiring.publishes(dress.camera.image, "sensor_msgs", "CompressedImage")
            wiring.publishes(dress.camera.info, "sensor_msgs", "CameraInfo")
        self._scan = wiring.publishes(dress.scan, "sensor_msgs", "LaserScan") if dress.scan else None
        self._every(2, self._odometry, self._publish_odometry)
        self._every(2, self._tf, self._publish_transforms)
        self._every(5, "", self._publish_scan)
        if dress.pose:
            pose = wiring.publishes(dress.pose, "geometry_msgs", "PoseWithCovarianceStamped", latched=True)
            # latched, so that it is published without subscribers, too
            self._every(5, "", lambda: self._publish_pose(pose))
        if dress.battery:
            battery = dress.battery
            package, kind = (
                ("std_msgs", "Float32") if battery.kind == "Float32 percent" else ("sensor_msgs", "BatteryState")
            )
            name = wiring.publishes(battery.topic, package, kind, latched=True)
            self._every(50, "", lambda: self._publish_battery(name, battery))
        self._publish_static_transforms()

    def _offer_commands(self) -> None:
        wiring, dress = self._wiring, self._wiring.dress
        for velocity in dress.velocity:
            self._offer_velocity(velocity)
        if dress.initial_pose:
            wiring.obeys(dress.initial_pose, "geometry_msgs", "PoseWithCovarianceStamped", self._on_initial_pose)
        if dress.stop_state:
            self._stop_state = wiring.publishes(dress.stop_state, "std_msgs", "Bool", latched=True)
            wiring.publish(self._stop_state, message_conversion.encode_bool(False))
        if dress.stop_service:
            service = dress.stop_service
            wiring.serves(
                service.name, service.package, service.type, lambda arguments: self._set_stop(service, arguments)
            )

    def _offer_velocity(self, velocity: VelocityInput) -> None:
        kind = "TwistStamped" if velocity.type == "TwistStamped" else "Twist"
        others = ("geometry_msgs/TwistStamped", "geometry_msgs/msg/TwistStamped") if velocity.type == "either" else ()
        self._wiring.obeys(
            velocity.topic, "geometry_msgs", kind, lambda message: self._on_twist(velocity, message), other_types=others
        )

    def _offer_simulator(self) -> None:
        wiring = self._wiring
        wiring.obeys("/simulator/fault", "std_msgs", "String", self._on_fault)
        wiring.serves("/simulator/fault", "simulator", "Fault", self._inject_fault)
        wiring.serves("/simulator/state", "simulator", "State", lambda _: self._state())
        wiring.serves("/simulator/reset_pose", "simulator", "ResetPose", self._reset_pose)

    def _publish_clock(self) -> None:
        self._wiring.publish(CLOCK_TOPIC, encode_clock(self._wiring.dialect, self._wiring.stamp_ns()))

    def _publish_odometry(self) -> None:
        wiring, stamp_ns = self._wiring, self._wiring.stamp_ns()
        message = message_conversion.encode_odometry(
            wiring.dialect,
            self._robot.odometry(stamp_ns=stamp_ns),
            stamp_ns=stamp_ns,
            frame_id=wiring.frame(wiring.dress.odom_frame),
            child_frame_id=wiring.frame(wiring.dress.odometry_frame),
        )
        wiring.publish(self._odometry, message)

    def _publish_transforms(self) -> None:
        wiring, stamp_ns = self._wiring, self._wiring.stamp_ns()
        dress = wiring.dress
        odom = wiring.frame(dress.odom_frame)
        odom_from_base = self._robot.odometry(stamp_ns=stamp_ns).pose_in_odom
        placements = [Placement(odom, wiring.frame(dress.base_frame), odom_from_base), *self._head.turning_frames()]
        if dress.pose is not None:
            # only a robot with localization knows its pose in a map
            placements.insert(0, Placement(wiring.frame(dress.map_frame), odom, self._robot.map_from_odom))
        wiring.publish(self._tf, encoding.transforms(wiring.dialect, placements, stamp_ns=stamp_ns))

    def _publish_static_transforms(self) -> None:
        wiring, dress = self._wiring, self._wiring.dress
        base, lidar = wiring.frame(dress.base_frame), self._robot.body.lidar
        placements = [Placement(base, wiring.frame(name), _AT_BASE) for name in dress.same_as_base]
        if lidar is not None and self._robot.body.laser_frame not in (dress.base_frame, *dress.same_as_base):
            placements.append(Placement(base, wiring.frame(self._robot.body.laser_frame), lidar.mount))
        if dress.camera is not None:
            placements.append(self._head.camera_mount(dress.camera.frame))
        message = encoding.transforms(wiring.dialect, placements, stamp_ns=wiring.stamp_ns())
        wiring.publish(self._tf_static, message)

    def _publish_scan(self) -> None:
        wiring, stamp_ns = self._wiring, self._wiring.stamp_ns()
        scan = self._robot.scan(stamp_ns=stamp_ns)
        if self._scan is not None and not self.faults.lidar_silent and wiring.wanted(self._scan):
            scan = replace(scan, frame_id=wiring.frame(scan.frame_id))
            wiring.publish(self._scan, message_conversion.encode_laser_scan(wiring.dialect, scan, stamp_ns=stamp_ns))

    def _publish_pose(self, topic: str) -> None:
        wiring = self._wiring
        message = message_conversion.encode_pose_with_covariance_stamped(
            wiring.dialect,
            self._robot.pose_in_map,
            stamp_ns=wiring.stamp_ns(),
            frame_id=wiring.frame(wiring.dress.map_frame),
        )
        wiring.publish(topic, message)

    def _publish_battery(self, topic: str, interface: BatteryTopic) -> None:
        wiring, stamp_ns, fraction = self._wiring, self._wiring.stamp_ns(), self._robot.battery_fraction
        if interface.kind == "Float32 percent":
            wiring.publish(topic, {"data": 100.0 * fraction})
            return
        message = message_conversion.encode_battery_state(
            wiring.dialect, BatteryState(stamp_ns, fraction), stamp_ns=stamp_ns, voltage_v=22.0 + 3.2 * fraction
        )
        if interface.kind == "BatteryState percent":
            message["percentage"] = 100.0 * fraction
        wiring.publish(topic, message)

    def _publish_camera_info(self, topic: str, frame: str) -> None:
        wiring = self._wiring
        message = encoding.camera_info(
            wiring.dialect,
            width_px=WIDTH_PX,
            height_px=HEIGHT_PX,
            focal_px=FOCAL_PX,
            stamp_ns=wiring.stamp_ns(),
            frame_id=frame,
        )
        wiring.publish(topic, message)

    def _on_twist(self, velocity: VelocityInput, message: Message) -> None:
        stamped = velocity.type == "TwistStamped" or (velocity.type == "either" and "twist" in message)
        unknown = set(message) - ({"header", "twist"} if stamped else {"linear", "angular"})
        if unknown:
            # as rosbridge does for a message of another type
            raise MessageError(f"{velocity.topic}: the message has a field '{min(unknown)}' that is not in its type")
        # TwistStamped wraps the same twist; ROS fills omitted fields with zero
        plain = message_of(message.get("twist", {}), "TwistStamped.twist") if stamped else message
        axes = {"x": 0.0, "y": 0.0, "z": 0.0}
        whole = {part: axes | message_of(plain.get(part, {}), f"Twist.{part}") for part in ("linear", "angular")}
        twist = message_conversion.decode_twist(whole)
        self._twists_received += 1
        self._last_twist_s = time.monotonic()
        self._robot.drive(twist)

    def _on_initial_pose(self, message: Message) -> None:
        self._robot.assume_pose(message_conversion.decode_pose_with_covariance_stamped(message, stamp_ns=0).pose_in_map)

    def _on_fault(self, message: Message) -> None:
        try:
            self._inject(message_conversion.decode_string(message))
        except (ValueError, CallFailed) as error:
            raise MessageError(str(error)) from error

    def _inject_fault(self, arguments: Message) -> Message:
        try:
            self._inject(text(arguments, "command", "args"))
        except ValueError as error:
            raise CallFailed(str(error)) from error
        return {"success": True, "message": ""}

    def _inject(self, command: str) -> None:
        injection = fault_commands.inject(self.faults, command)
        logger.info("Injected fault: %s", command)
        self._apply_faults(injection.faults)
        if injection.battery_fraction is not None:
            self._robot.battery_fraction = injection.battery_fraction
        if injection.drop_link_s is not None:
            self._wiring.server.drop_link(injection.drop_link_s)
        if injection.malformed:
            scan = self._scan or self._odometry
            self._wiring.server.send_raw(fault_commands.malformed_messages(injection.malformed, scan))
        if injection.stop_button is not None:
            self._stop_robot(injection.stop_button)
        if injection.pose_in_map is not None:
            self._place(injection.pose_in_map)

    def _apply_faults(self, faults: Faults) -> None:
        before, self._wiring.faults = self._wiring.faults, faults
        self._wiring.server.latency_s = faults.latency_s
        self._wiring.server.service_s = faults.service_s
        self._wiring.server.rate_bytes_s = None if faults.rate_kbps is None else faults.rate_kbps * 125.0
        clock_before = (before.clock_offset_s, before.clock_drift_ppm)
        if (faults.clock_offset_s, faults.clock_drift_ppm) != clock_before:
            self._wiring.clock.disagree(offset_s=faults.clock_offset_s, drift_ppm=faults.clock_drift_ppm)
        if faults.frames_wrong != before.frames_wrong:
            self._publish_static_transforms()

    def _reset_pose(self, arguments: Message) -> Message:
        heading_rad = math.radians(number(arguments, "heading_deg", "args")) if "heading_deg" in arguments else 0.0
        self._place(Pose2D(number(arguments, "x", "args"), number(arguments, "y", "args"), heading_rad))
        return {"success": True, "message": ""}

    def _place(self, pose: Pose2D) -> None:
        if not self._robot.place(pose):
            raise CallFailed(f"the robot does not fit at x {pose.x_m:.2f} m, y {pose.y_m:.2f} m")

    def _set_stop(self, service: StopService, arguments: Message) -> Message:
        stopped = truth(arguments, service.field, "args") is service.stopping
        self._stop_robot(stopped)
        return {"success": True, "message": "latched" if stopped else "cleared"}

    def _stop_robot(self, stopped: bool) -> None:
        self._robot.set_emergency_stop(stopped)
        if self._stop_state is not None:
            self._wiring.publish(self._stop_state, message_conversion.encode_bool(stopped))

    def _state(self) -> Message:
        """True state, for tests and debugging: none of it is on a topic."""
        robot, truth_ = self._robot, self._robot.truth
        view = robot.view()
        camera = view.map_from_camera
        people = [
            {
                "x_m": person.x_m,
                "y_m": person.y_m,
                "distance_m": math.dist((person.x_m, person.y_m), (camera.x_m, camera.y_m)),
                "walking": person.walking,
                "in_view": sees(camera, person.x_m, person.y_m),
            }
            for person in robot.people
        ]
        return {
            "dress": self._wiring.dress.name,
            "time_s": robot.now_s,
            "pose": _pose(truth_.pose_in_map),
            "believed_pose": _pose(robot.pose_in_map),
            "localised": robot.localised,
            "speed_mps": truth_.forward_mps,
            "speed_left_mps": truth_.left_mps,
            "speed_radps": truth_.turn_radps,
            "touching": truth_.touching,
            "collisions": truth_.collisions,
            "touches": robot.touches,
            "gap_m": robot.gap_m,
            "min_gap_m": robot.min_gap_m if math.isfinite(robot.min_gap_m) else None,
            "emergency_stopped": robot.emergency_stopped,
            "goal_id": robot.goal_id or "",
            "head": {"pan_rad": robot.head.pan_rad, "tilt_rad": robot.head.tilt_rad},
            "mapping_paused": robot.mapping_paused,
            "speaking": (self.voice.speaking if self.voice is not None else None) or "",
            "sound": self.sound.state if self.sound is not None else {},
            "twists_received": self._twists_received,
            "last_twist_age_s": None if self._last_twist_s is None else time.monotonic() - self._last_twist_s,
            "people": people,
            "anybody_in_view": any(person["in_view"] for person in people),
            "known_map_share": robot.mapper.known_share,
            "places": [{"name": place.name, **_pose(place.pose)} for place in PLACES],
            "panel": self._gadgets.state if self._gadgets is not None else {},
            "orders": self._orders.taken,
            "refusals": list(self._wiring.server.refusals),
        }


def _pose(pose: Pose2D) -> Message:
    return {"x_m": pose.x_m, "y_m": pose.y_m, "heading_rad": pose.heading_rad}
