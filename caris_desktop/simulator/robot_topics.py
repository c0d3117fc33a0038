"""Simulated robot on ROS: topics and services of its model, and periodic publishing."""

import asyncio
import itertools
import logging
import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.geometry import Pose2D, Pose3D
from caris_desktop.domain.sensing import BatteryState
from caris_desktop.ros import action_messages, message_conversion
from caris_desktop.ros.action_messages import GoalStatus
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ros.message_conversion import (
    LOCALIZE_AT_POSE,
    NO_LIMIT,
    START_AT_GIVEN_POSE,
    decode_audio_data,
    decode_joint_angles_with_speed,
    decode_joint_trajectory,
    decode_reconfigured,
    decode_speed_limit,
    encode_audio_data,
    encode_clock,
    encode_joint_state,
    encode_occupancy_grid_update,
    encode_path,
    encode_reconfigure,
    samples_of,
)
from caris_desktop.ros.message_fields import MessageError, count, message_of, number, part, text, text_or_empty, truth
from caris_desktop.simulator import faults as fault_commands
from caris_desktop.simulator import typedefs
from caris_desktop.simulator.faults import Faults
from caris_desktop.simulator.floor_plan import PLACES
from caris_desktop.simulator.robot_models import (
    AudioTopics,
    BatteryTopic,
    Navigation,
    SpeechAction,
    SpeechTopics,
    StopService,
    StubCapability,
    VelocityInput,
)
from caris_desktop.simulator.robot_simulation import DEFAULT_SPEED_RADPS, FOCAL_PX, HEIGHT_PX, WIDTH_PX, sees
from caris_desktop.simulator.ros_context import ActionlibServer, ActionServer, Ros2ActionServer, RosContext
from caris_desktop.simulator.server import CallFailed, Message
from caris_desktop.simulator.simulated_mapping import MapFileError, MapFiles, NoSuchMap
from caris_desktop.simulator.simulated_navigation import CRUISE_MPS, Progress
from caris_desktop.simulator.simulated_speech import (
    RATE_HZ,
    Microphone,
    Participant,
    Spoken,
    Voice,
    at_rate,
    cache_folder,
)

logger = logging.getLogger(__name__)

CLOCK_TOPIC = "/clock"
_AT_BASE = Pose2D(0.0, 0.0, 0.0)

FramePose = tuple[str, str, Pose2D | Pose3D]
"""Parent frame, child frame, and pose of the child in the parent."""


class SpeechOnTopics:
    """std_msgs/String in; Bool while it speaks, and Empty to stop it, if the model has them."""

    def __init__(self, ros: RosContext, interface: SpeechTopics, *, muted: bool) -> None:
        self._ros = ros
        self.voice = Voice(self._on_speaking, muted=muted)
        ros.obeys(interface.topic, "std_msgs", "String", self._on_say)
        if interface.stop is not None:
            ros.obeys(interface.stop, "std_msgs", "Empty", lambda _: self.voice.stop())
        self._speaking = interface.speaking and ros.publishes(interface.speaking, "std_msgs", "Bool", latched=True)
        self._on_speaking(False)

    def _on_say(self, message: Message) -> None:
        if not self.voice.say(message_conversion.decode_string(message)):
            logger.warning("A sentence was not taken: it is empty, or too many wait already")

    def _on_speaking(self, speaking: bool) -> None:
        if self._speaking is not None:
            self._ros.publish(self._speaking, message_conversion.encode_bool(speaking))


class SpeechOnAction:
    """pal_interaction_msgs/TtsAction: one sentence at a time; a newer goal preempts the present one."""

    def __init__(self, ros: RosContext, interface: SpeechAction, *, muted: bool) -> None:
        self.voice = Voice(self._on_speaking, muted=muted)
        self._goal_id: str | None = None
        self._text = ""
        self._begun = False
        self._server = ActionlibServer(
            ros, interface.name, "pal_interaction_msgs", "Tts", on_goal=self._on_goal, on_cancel=self._on_cancel
        )

    def _on_goal(self, goal_id: str, goal: Message) -> None:
        raw = message_of(goal.get("rawtext", {}), "TtsGoal.rawtext")
        sentence = text_or_empty(raw, "text", "TtsGoal.rawtext").strip()
        # PAL's server requires both; the language selects the voice
        missing = "text" if not sentence else "" if text_or_empty(raw, "lang_id", "TtsGoal.rawtext") else "lang_id"
        if missing:
            status = GoalStatus(goal_id, action_messages.ABORTED, f"rawtext.{missing} is empty")
            self._server.finish(status, {"text": "", "msg": "aborted"})
            return
        self._end("replaced by a newer sentence")
        self._goal_id, self._text, self._begun = goal_id, sentence, False
        self._server.accept(goal_id)
        self.voice.say(sentence)

    def _on_cancel(self, goal_id: str) -> None:
        if goal_id in ("", self._goal_id):
            self._end("cancelled")

    def _on_speaking(self, speaking: bool) -> None:
        if self._goal_id is None:
            return
        if speaking:
            self._begun = True
            feedback = {
                "event_type": 1,  # TTS_EVENT_STARTED_PLAYING_UTTERANCE
                "timestamp": {"secs": 0, "nsecs": 0},
                "text_said": "",
                "next_word": self._text.split()[0],
                "viseme_id": "",
                "marks": {"type": "", "name": ""},
            }
            self._server.progress(GoalStatus(self._goal_id, action_messages.ACTIVE), feedback)
        elif self._begun:
            self._finish(action_messages.SUCCEEDED, "")

    def _end(self, detail: str) -> None:
        if self._goal_id is not None:
            self._finish(action_messages.PREEMPTED, detail)
            self.voice.stop()

    def _finish(self, status: int, detail: str) -> None:
        if self._goal_id is not None:
            goal_id, self._goal_id = self._goal_id, None
            result = {"text": self._text, "msg": detail or "succeeded"}
            self._server.finish(GoalStatus(goal_id, status, detail), result)


class RobotTopics:
    """Publishes the robot's sensors on a :class:`BridgeServer` and executes its commands and services.

    ``camera_topic`` is that of the images; None without a camera.
    """

    def __init__(
        self,
        ros: RosContext,
        *,
        muted: bool,
        simulation_time: bool,
        maps: MapFiles,
        lines: Sequence[str],
    ) -> None:
        """``lines`` are a participant's sentences, one after each utterance of the robot."""
        self._ros = ros
        self._robot = ros.robot
        self._twists_received = 0
        self._last_twist_s: float | None = None
        self._stop_state: str | None = None
        self.camera_topic: str | None = None
        self._head = HeadOnRos(ros)
        self._offer_sensors()  # before the map, which a scan changes
        MapOnRos(ros, maps)
        if ros.model.navigation is not None:
            NavigationTopics(ros, ros.model.navigation)
        self.voice: Voice | None = None
        match ros.model.speech:
            case SpeechTopics() as interface:
                self.voice = SpeechOnTopics(ros, interface, muted=muted).voice
            case SpeechAction() as action:
                self.voice = SpeechOnAction(ros, action, muted=muted).voice
        self.sound = SoundOnRos(ros, ros.model.audio, lines) if ros.model.audio is not None else None
        if self.voice is not None and self.sound is not None:
            self.voice.on_sound = self.sound.on_voice
            self.voice.on_spoken = self.sound.participant.on_robot_finished
        self._demo_controls = DemoControls(ros) if ros.model.demo_controls else None
        self._stub_capabilities = StubCapabilities(ros)
        self._offer_commands()
        ros.server.params["/use_sim_time"] = lambda: simulation_time
        if simulation_time:
            ros.publishes(CLOCK_TOPIC, "rosgraph_msgs", "Clock")
            ros.every(1, lambda: ros.publish(CLOCK_TOPIC, encode_clock(ros.dialect, ros.stamp_ns())), CLOCK_TOPIC)
        self._apply_faults(ros.faults)

    def publish_picture(self, jpeg: bytes, *, stamp_ns: int) -> None:
        """Publish one camera image and, if subscribed, the camera info."""
        ros, camera = self._ros, self._ros.model.camera
        if camera is None or self.camera_topic is None:
            return
        frame = ros.frame(camera.frame)
        picture = message_conversion.encode_compressed_image(ros.dialect, jpeg, stamp_ns=stamp_ns, frame_id=frame)
        ros.publish(self.camera_topic, picture)
        info = ros.model.absolute(camera.info)
        if ros.wanted(info):
            lens = CameraModel(WIDTH_PX, HEIGHT_PX, FOCAL_PX, FOCAL_PX, WIDTH_PX / 2.0, HEIGHT_PX / 2.0)
            ros.publish_stamped(info, message_conversion.encode_camera_info, lens, frame=camera.frame)

    def stop(self) -> None:
        """Stop publishing and cancel pending work."""
        if self.voice is not None:
            self.voice.stop()
        if self.sound is not None:
            self.sound.stop()
        if self._demo_controls is not None:
            self._demo_controls.stop()
        self._stub_capabilities.stop()

    def _offer_sensors(self) -> None:
        ros, model, robot = self._ros, self._ros.model, self._robot
        self._odometry = ros.publishes(model.odometry, "nav_msgs", "Odometry")
        self._tf = ros.publishes(model.tf, "tf2_msgs", "TFMessage")
        self._tf_static = ros.publishes(model.tf_static, "tf2_msgs", "TFMessage", latched=True)
        if model.camera is not None:
            self.camera_topic = ros.publishes(model.camera.image, "sensor_msgs", "CompressedImage")
            ros.publishes(model.camera.info, "sensor_msgs", "CameraInfo")
        self._scan = ros.publishes(model.scan, "sensor_msgs", "LaserScan") if model.scan else None
        ros.every(2, self._publish_odometry, self._odometry)
        ros.every(2, self._publish_transforms, self._tf)
        ros.every(5, self._publish_scan)
        if model.pose:
            pose = ros.publishes(model.pose, "geometry_msgs", "PoseWithCovarianceStamped", latched=True)
            encode_pose = message_conversion.encode_pose_with_covariance_stamped
            # latched, so that it is published without subscribers, too
            ros.every(5, lambda: ros.publish_stamped(pose, encode_pose, robot.pose_in_map, frame=model.map_frame))
        if model.battery:
            battery = model.battery
            is_float = battery.kind == "Float32 percent"
            type_ = ("std_msgs", "Float32") if is_float else ("sensor_msgs", "BatteryState")
            name = ros.publishes(battery.topic, *type_, latched=True)
            ros.every(50, lambda: self._publish_battery(name, battery))
        self._publish_static_transforms()

    def _offer_commands(self) -> None:
        ros, model = self._ros, self._ros.model
        stamped = ("geometry_msgs/TwistStamped", "geometry_msgs/msg/TwistStamped")
        for velocity in model.velocity:
            kind = "TwistStamped" if velocity.type == "TwistStamped" else "Twist"
            others = stamped if velocity.type == "either" else ()
            on_twist = partial(self._on_twist, velocity)
            ros.obeys(velocity.topic, "geometry_msgs", kind, on_twist, other_types=others)
        if model.initial_pose:
            ros.obeys(
                model.initial_pose,
                "geometry_msgs",
                "PoseWithCovarianceStamped",
                lambda message: self._robot.assume_pose(
                    message_conversion.decode_pose_with_covariance_stamped(message, stamp_ns=0).pose_in_map
                ),
            )
        if model.stop_state:
            self._stop_state = ros.publishes(model.stop_state, "std_msgs", "Bool", latched=True)
            ros.publish(self._stop_state, message_conversion.encode_bool(False))
        if model.stop_service:
            service = model.stop_service
            ros.serves(service.name, service.package, service.type, partial(self._set_stop, service))
        ros.obeys(
            "/simulator/fault", "std_msgs", "String", lambda msg: self._inject(message_conversion.decode_string(msg))
        )
        ros.serves("/simulator/fault", "simulator", "Fault", self._inject_fault)
        ros.serves("/simulator/state", "simulator", "State", lambda _: self._state())
        ros.serves("/simulator/reset_pose", "simulator", "ResetPose", self._reset_pose)

    def _publish_odometry(self) -> None:
        ros, encode = self._ros, message_conversion.encode_odometry
        child, odometry = ros.frame(ros.model.odometry_frame), self._robot.odometry(stamp_ns=ros.stamp_ns())
        ros.publish_stamped(self._odometry, encode, odometry, frame=ros.model.odom_frame, child_frame_id=child)

    def _publish_transforms(self) -> None:
        ros, model, stamp_ns = self._ros, self._ros.model, self._ros.stamp_ns()
        odom = ros.frame(model.odom_frame)
        odom_from_base = self._robot.odometry(stamp_ns=stamp_ns).pose_in_odom
        frames: list[FramePose] = [(odom, ros.frame(model.base_frame), odom_from_base), *self._head.moving_frames()]
        if model.pose is not None:
            # only a robot with localization knows its pose in a map
            frames.insert(0, (ros.frame(model.map_frame), odom, self._robot.map_from_odom))
        ros.publish(self._tf, message_conversion.encode_tf_message(ros.dialect, frames, stamp_ns=stamp_ns))

    def _publish_static_transforms(self) -> None:
        ros, model, body = self._ros, self._ros.model, self._robot.body
        base = ros.frame(model.base_frame)
        frames: list[FramePose] = [(base, ros.frame(name), _AT_BASE) for name in model.same_as_base]
        if body.lidar is not None and body.laser_frame not in (model.base_frame, *model.same_as_base):
            frames.append((base, ros.frame(body.laser_frame), body.lidar.mount))
        if model.camera is not None:
            frames.append(self._head.camera_mount(model.camera.frame))
        message = message_conversion.encode_tf_message(ros.dialect, frames, stamp_ns=ros.stamp_ns())
        ros.publish(self._tf_static, message)

    def _publish_scan(self) -> None:
        ros, stamp_ns = self._ros, self._ros.stamp_ns()
        scan = self._robot.scan(stamp_ns=stamp_ns)
        if self._scan is not None and not ros.faults.lidar_silent and ros.wanted(self._scan):
            scan = replace(scan, frame_id=ros.frame(scan.frame_id))
            ros.publish(self._scan, message_conversion.encode_laser_scan(ros.dialect, scan, stamp_ns=stamp_ns))

    def _publish_battery(self, topic: str, interface: BatteryTopic) -> None:
        ros, stamp_ns, fraction = self._ros, self._ros.stamp_ns(), self._robot.battery_fraction
        if interface.kind == "Float32 percent":
            ros.publish(topic, {"data": 100.0 * fraction})
            return
        message = message_conversion.encode_battery_state(
            ros.dialect, BatteryState(stamp_ns, fraction), stamp_ns=stamp_ns, voltage_v=22.0 + 3.2 * fraction
        )
        if interface.kind == "BatteryState percent":
            message["percentage"] = 100.0 * fraction
        ros.publish(topic, message)

    def _on_twist(self, velocity: VelocityInput, message: Message) -> None:
        stamped = velocity.type == "TwistStamped" or (velocity.type == "either" and "twist" in message)
        unknown = set(message) - ({"header", "twist"} if stamped else {"linear", "angular"})
        if unknown:
            # as rosbridge does for a message of another type
            raise MessageError(f"{velocity.topic}: the message has a field '{min(unknown)}' that is not in its type")
        # TwistStamped wraps the same twist; ROS fills omitted fields with zero
        plain = message_of(message.get("twist", {}), "TwistStamped.twist") if stamped else message
        axes = {"x": 0.0, "y": 0.0, "z": 0.0}
        complete = {part: axes | message_of(plain.get(part, {}), f"Twist.{part}") for part in ("linear", "angular")}
        twist = message_conversion.decode_twist(complete)
        self._twists_received += 1
        self._last_twist_s = time.monotonic()
        self._robot.drive(twist)

    def _inject_fault(self, arguments: Message) -> Message:
        self._inject(text(arguments, "command", "args"))
        return {"success": True, "message": ""}

    def _inject(self, command: str) -> None:
        try:
            injection = fault_commands.inject(self._ros.faults, command)
        except ValueError as error:
            raise CallFailed(str(error)) from error
        logger.info("Injected fault: %s", command)
        self._apply_faults(injection.faults)
        if injection.battery_fraction is not None:
            self._robot.battery_fraction = injection.battery_fraction
        if injection.drop_link_s is not None:
            self._ros.server.drop_link(injection.drop_link_s)
        if injection.malformed:
            scan = self._scan or self._odometry
            self._ros.server.send_raw(fault_commands.malformed_messages(injection.malformed, scan))
        if injection.stop_button is not None:
            self._stop_robot(injection.stop_button)
        if injection.pose_in_map is not None:
            self._place(injection.pose_in_map)

    def _apply_faults(self, faults: Faults) -> None:
        before, self._ros.faults = self._ros.faults, faults
        self._ros.server.latency_s = faults.latency_s
        self._ros.server.service_s = faults.service_s
        self._ros.server.rate_bytes_s = None if faults.rate_kbps is None else faults.rate_kbps * 125.0
        clock_before = (before.clock_offset_s, before.clock_drift_ppm)
        if (faults.clock_offset_s, faults.clock_drift_ppm) != clock_before:
            self._ros.clock.disagree(offset_s=faults.clock_offset_s, drift_ppm=faults.clock_drift_ppm)
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
            self._ros.publish(self._stop_state, message_conversion.encode_bool(stopped))

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
            "dress": self._ros.model.name,
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
            "goal_id": robot.navigation.goal_id or "",
            "head": {"pan_rad": robot.head.pan.angle_rad, "tilt_rad": robot.head.tilt.angle_rad},
            "mapping_paused": robot.mapping_paused,
            "speaking": (self.voice.speaking if self.voice is not None else None) or "",
            "sound": self.sound.state if self.sound is not None else {},
            "twists_received": self._twists_received,
            "last_twist_age_s": None if self._last_twist_s is None else time.monotonic() - self._last_twist_s,
            "people": people,
            "anybody_in_view": any(person["in_view"] for person in people),
            "known_map_share": robot.mapper.known_share,
            "places": [{"name": place.name, **_pose(place.pose)} for place in PLACES],
            "panel": self._demo_controls.state if self._demo_controls is not None else {},
            "orders": list(self._stub_capabilities.taken),
            "refusals": list(self._ros.server.refusals),
        }


def _pose(pose: Pose2D) -> Message:
    return {"x_m": pose.x_m, "y_m": pose.y_m, "heading_rad": pose.heading_rad}


WAVE_S = 2.0
_MOST_SCREEN_CHARS = 500


class DemoControls:
    """Demo controls of the default robot model for the Robot panel: lights, volume, gesture, screen, eyes.

    Holds the present values, publishes them on latched topics, and lists them in :attr:`state`.
    """

    def __init__(self, ros: RosContext) -> None:
        self._ros = ros
        self._values: dict[str, Any] = {
            "leds": dict.fromkeys("rgba", 0.0),
            "volume": 60.0,
            "screen": "",
            "eyes_open": True,
            "waving": False,
            "waves_begun": 0,
        }
        self._waving_task: asyncio.TimerHandle | None = None
        ros.obeys("/leds/color", "std_msgs", "ColorRGBA", self._on_color)
        ros.obeys("/volume", "std_msgs", "Float32", self._on_volume)
        ros.obeys("/screen/text", "std_msgs", "String", self._on_screen)
        ros.serves("/gestures/wave", "std_srvs", "Trigger", self._wave)
        ros.serves("/eyes/set", "std_srvs", "SetBool", self._set_eyes)
        self._volume_state = ros.publishes("/volume/state", "std_msgs", "Float32", latched=True)
        self._eyes_state = ros.publishes("/eyes/state", "std_msgs", "Bool", latched=True)
        temperature = ros.publishes("/diagnostics/temperature", "std_msgs", "Float32")
        ros.every(50, lambda: ros.publish(temperature, {"data": self.temperature_c}), temperature)
        ros.publish(self._volume_state, {"data": self._values["volume"]})
        ros.publish(self._eyes_state, message_conversion.encode_bool(True))

    @property
    def state(self) -> dict[str, Any]:
        return {**self._values, "temperature_c": self.temperature_c}

    @property
    def temperature_c(self) -> float:
        """Motor temperature: rises with speed, with a slow oscillation, so that a plot shows something."""
        truth_ = self._ros.robot.truth
        effort = abs(truth_.forward_mps) + abs(truth_.left_mps) + 0.3 * abs(truth_.turn_radps)
        return 36.0 + 4.0 * effort + 0.5 * math.sin(self._ros.robot.now_s / 7.0)

    def stop(self) -> None:
        """Cancel pending work."""
        if self._waving_task is not None:
            self._waving_task.cancel()

    def _on_color(self, message: Message) -> None:
        color = message_of(message, "ColorRGBA")
        # ROS fills omitted fields with zero
        self._values["leds"] = {
            channel: min(max(number(color, channel, "ColorRGBA"), 0.0), 1.0) if channel in color else 0.0
            for channel in "rgba"
        }

    def _on_volume(self, message: Message) -> None:
        self._values["volume"] = min(max(number(message_of(message, "Float32"), "data", "Float32"), 0.0), 100.0)
        self._ros.publish(self._volume_state, {"data": self._values["volume"]})

    def _on_screen(self, message: Message) -> None:
        self._values["screen"] = message_conversion.decode_string(message)[:_MOST_SCREEN_CHARS]

    def _wave(self, _: Message) -> Message:
        if self._values["waving"]:
            return {"success": False, "message": "the arm is already waving"}
        self._values.update(waving=True, waves_begun=self._values["waves_begun"] + 1)
        end_wave = partial(self._values.update, waving=False)
        self._waving_task = asyncio.get_running_loop().call_later(WAVE_S, end_wave)
        return {"success": True, "message": f"waving for {WAVE_S:g} s"}

    def _set_eyes(self, arguments: Message) -> Message:
        is_open = self._values["eyes_open"] = truth(arguments, "data", "args")
        self._ros.publish(self._eyes_state, message_conversion.encode_bool(is_open))
        return {"success": True, "message": "open" if is_open else "closed"}


_WHEELS = ("wheel_left_joint", "wheel_right_joint")


class HeadOnRos:
    """Head on ROS: joint states out, joint commands in, and its moving frames.

    Executes the model's command topic; without a head only wheel joints are published.
    """

    def __init__(self, ros: RosContext) -> None:
        self._ros = ros
        self._head = ros.robot.head
        self._interface = interface = ros.model.head
        if ros.model.joint_states:
            topic = ros.publishes(ros.model.joint_states, "sensor_msgs", "JointState")
            ros.every(2, lambda: self._publish_joint_states(topic), topic)
        if interface is None:
            return
        if interface.kind == "JointTrajectory":
            ros.obeys(interface.topic, "trajectory_msgs", "JointTrajectory", self._on_trajectory)
        else:
            ros.obeys(interface.topic, "naoqi_bridge_msgs", "JointAnglesWithSpeed", self._on_angles)

    def _publish_joint_states(self, topic: str) -> None:
        angles_rad = dict.fromkeys(_WHEELS, 0.0) | self._angles_rad()
        self._ros.publish(topic, encode_joint_state(self._ros.dialect, angles_rad, stamp_ns=self._ros.stamp_ns()))

    def _angles_rad(self) -> dict[str, float]:
        """Present angles by joint, in the joints' own directions."""
        if self._interface is None:
            return {}
        tilt_rad = self._interface.tilt_sign * self._head.tilt.angle_rad
        return {self._interface.pan_joint: self._head.pan.angle_rad, self._interface.tilt_joint: tilt_rad}

    def moving_frames(self) -> list[FramePose]:
        """Present frames of the joints."""
        if self._interface is None:
            return []
        body, base = self._ros.robot.body, self._ros.frame(self._ros.model.base_frame)
        camera, half_tilt_rad = body.robot_from_camera, self._head.tilt.angle_rad / 2.0
        pan = Pose2D(camera.x_m, camera.y_m, camera.heading_rad + self._head.pan.angle_rad)
        pan_frame, tilt_frame = map(self._ros.frame, self._interface.frames)
        tilt = Pose3D(0.0, 0.0, 0.0, 0.0, math.sin(half_tilt_rad), 0.0, math.cos(half_tilt_rad))
        return [(base, pan_frame, _raised(pan, body.camera_height_m)), (pan_frame, tilt_frame, tilt)]

    def camera_mount(self, camera_frame: str) -> FramePose:
        """Mounting of the camera, on the head or on the body."""
        ros, body = self._ros, self._ros.robot.body
        if self._interface is not None:
            return ros.frame(self._interface.frames[1]), ros.frame(camera_frame), _AT_BASE
        mounted = _raised(body.robot_from_camera, body.camera_height_m)
        return ros.frame(ros.model.base_frame), ros.frame(camera_frame), mounted

    def _on_trajectory(self, message: Message) -> None:
        # the head moves uniformly, so the last point gives target and speed
        targets, duration_s = decode_joint_trajectory(message)
        if not targets:
            raise MessageError("JointTrajectory.points is empty")
        for name, target_rad in targets.items():
            left_rad = abs(target_rad - self._now_rad(name))
            self._turn(name, target_rad, left_rad / duration_s if duration_s else DEFAULT_SPEED_RADPS)

    def _on_angles(self, message: Message) -> None:
        targets, share = decode_joint_angles_with_speed(message)
        if not 0.0 < share <= 1.0:
            raise MessageError(
                "JointAnglesWithSpeed.speed must be a fraction of the maximum speed, above 0 and at most 1"
            )
        for name, angle_rad in targets.items():
            target_rad = angle_rad + (self._now_rad(name) if message.get("relative") else 0.0)
            self._turn(name, target_rad, share * self._ros.robot.body.head.fastest_radps)

    def _now_rad(self, joint: str) -> float:
        angles_rad = self._angles_rad()
        if joint not in angles_rad:
            raise MessageError(f"there is no joint '{joint}'; the head has {' and '.join(angles_rad)}")
        return angles_rad[joint]

    def _turn(self, joint: str, target_rad: float, speed_radps: float) -> None:
        if self._interface is not None and joint == self._interface.pan_joint:
            self._head.pan.turn_to(target_rad, speed_radps)
        elif self._interface is not None:
            self._head.tilt.turn_to(self._interface.tilt_sign * target_rad, speed_radps)


def _raised(pose: Pose2D, height_m: float) -> Pose3D:
    return replace(Pose3D.on_floor(pose), z_m=height_m)


_STEP_SAMPLES = RATE_HZ // 50
_STEPS = 2
SAY_TOPIC = "/simulator/participant/say"
SPEAKING_TOPIC = "/simulator/participant/speaking"


class SoundOnRos:
    """Microphone and loudspeaker on ROS, and the simulated participant's speech.

    audio_common_msgs/AudioData out and in, plain samples of one channel at 16 kHz.

    The participant speaks with or without subscribers: by std_msgs/String on ``SAY_TOPIC``, or the service
    ``/simulator/say``; ``/simulator/prepare`` only synthesises. std_msgs/Bool on ``SPEAKING_TOPIC`` is true meanwhile.
    """

    def __init__(self, ros: RosContext, interface: AudioTopics, lines: Sequence[str] = ()) -> None:
        self._ros = ros
        self._random = np.random.default_rng(5)
        self._played_s = 0.0
        self.microphone = Microphone()
        self._topic = ros.publishes(interface.microphone, "audio_common_msgs", "AudioData")
        ros.every(_STEPS, self._publish_sound)
        ros.obeys(interface.speaker, "audio_common_msgs", "AudioData", self._on_sound)
        ros.obeys(SAY_TOPIC, "std_msgs", "String", self._on_say)
        ros.serves("/simulator/prepare", "simulator", "Say", self._prepare)
        ros.serves("/simulator/say", "simulator", "Say", self._say)
        self._speaking = ros.publishes(SPEAKING_TOPIC, "std_msgs", "Bool", latched=True)
        self.participant = Participant(self.microphone, lines, on_speaking=self._on_speaking, cache=cache_folder())
        self._on_speaking(False)

    @property
    def state(self) -> Message:
        """Participant's sentences, in seconds from now (negative: past), and audio received by the loudspeaker."""
        now_ns = time.monotonic_ns()
        return {
            "speaking": self.participant.speaking or "",
            "said": [
                {
                    "text": utterance.text,
                    "began_s": (utterance.began_ns - now_ns) / 1e9,
                    "ended_s": None if utterance.ended_ns is None else (utterance.ended_ns - now_ns) / 1e9,
                }
                for utterance in self.participant.utterances
            ],
            "own_voice_s": self._played_s,
        }

    def skip_time(self, skipped_s: float) -> None:
        """Publish the audio of skipped simulation time at once, as a driver with a buffer would."""
        for _ in range(round(skipped_s * RATE_HZ / (_STEPS * _STEP_SAMPLES))):
            self._publish_sound()

    def _publish_sound(self) -> None:
        faults = self._ros.faults
        self.microphone.leak, self.microphone.noise = faults.voice_leak, faults.sound_noise
        samples = self.microphone.take(_STEPS * _STEP_SAMPLES)
        lost = faults.microphone_silent or self._random.random() < faults.sound_dropouts
        if not lost and self._ros.wanted(self._topic):
            self._ros.publish(self._topic, encode_audio_data(samples))

    def on_voice(self, spoken: Spoken | None) -> None:
        """The robot's voice starts playing this, or stops."""
        if spoken is not None:
            self.microphone.leak_voice(at_rate(spoken.samples, spoken.rate_hz))
        else:
            self.microphone.silence_voice()

    def stop(self) -> None:
        self.participant.stop()

    def _on_sound(self, message: Message) -> None:
        samples = samples_of(decode_audio_data(message).content, 1)
        self._played_s += len(samples) / RATE_HZ
        self.microphone.leak_voice(samples[:, 0].astype(np.float32) / 32768.0)

    def _say(self, arguments: Message) -> Message:
        if not self.participant.say(text(arguments, "text", "args")):
            raise CallFailed("the sentence is empty, or too many sentences are already queued")
        return {"success": True, "message": ""}

    def _on_say(self, sentence: Message) -> None:
        self.participant.say(message_conversion.decode_string(sentence))

    def _prepare(self, arguments: Message) -> Message:
        self.participant.prepare(text(arguments, "text", "args"))
        return {"success": True, "message": ""}

    def _on_speaking(self, speaking: bool) -> None:
        self._ros.publish(self._speaking, message_conversion.encode_bool(speaking))


ACTION_TAKES_S = 1.0
_REMEMBERED = 50


class StubCapabilities:
    """Stub capabilities of a robot model (gestures, docks, displays): recorded and answered, without effect.

    Actions take one second, can be cancelled, and then succeed. ``taken`` has the newest commands, oldest first: name
    and content.
    """

    def __init__(self, ros: RosContext) -> None:
        self._ros = ros
        self.taken: deque[dict[str, Any]] = deque(maxlen=_REMEMBERED)
        self._under_way: dict[str, asyncio.TimerHandle] = {}
        for order in ros.model.stub_capabilities:
            match order.kind:
                case "topic":
                    ros.obeys(order.name, order.package, order.type, partial(self._note, order))
                case "service":
                    ros.serves(order.name, order.package, order.type, partial(self._answer, order))
                case "action":
                    self._offer_action(order)

    def stop(self) -> None:
        """Cancel pending work."""
        for timer in self._under_way.values():
            timer.cancel()

    def _note(self, order: StubCapability, content: Message) -> None:
        self.taken.append({"name": self._ros.model.absolute(order.name), "content": content})

    def _answer(self, order: StubCapability, arguments: Message) -> Message:
        self._note(order, arguments)
        answer = typedefs.blank(self._ros.dialect, f"{order.package}/{order.type}", part=1)
        return answer | ({"success": True} if "success" in answer else {})

    def _offer_action(self, order: StubCapability) -> None:
        ros, ros1 = self._ros, self._ros.dialect is Dialect.ROS1
        name = f"{order.package}/{order.type}"
        goal_type = f"{name}Goal" if ros1 else name
        result = typedefs.blank(ros.dialect, f"{name}Result") if ros1 else typedefs.blank(ros.dialect, name, part=1)

        def on_goal(goal_id: str, goal: Message) -> None:
            problem = typedefs.misfit(ros.dialect, goal_type, goal)
            if problem is not None:
                raise MessageError(problem)
            self._note(order, goal)
            server.accept(goal_id)
            if goal_id in self._under_way:
                raise MessageError(f"a goal with the id '{goal_id}' is already active")
            loop = asyncio.get_running_loop()
            self._under_way[goal_id] = loop.call_later(ACTION_TAKES_S, end, goal_id, action_messages.SUCCEEDED)

        def end(goal_id: str, status: int) -> None:
            if timer := self._under_way.pop(goal_id, None):
                timer.cancel()
                server.finish(GoalStatus(goal_id, status), result)

        def on_cancel(wanted: str) -> None:
            for goal_id in [wanted] if wanted else list(self._under_way):
                end(goal_id, action_messages.PREEMPTED)

        kind = ActionlibServer if ros1 else Ros2ActionServer
        server: ActionServer = kind(ros, order.name, order.package, order.type, on_goal=on_goal, on_cancel=on_cancel)


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
        if self._map is None or (change := robot.mapper.change()) is None:
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
        filename, graph = text(arguments, "filename", "args"), self._ros.robot.mapper.snapshot()
        return {"result": _SERIALIZED if _is_saved(lambda: self._files.save_graph(filename, *graph)) else _NOT_WRITTEN}

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
        url, cells = text(arguments, "map_url", "args"), self._ros.robot.mapper.cells()
        return {"result": _is_saved(lambda: self._files.save_picture(url, cells))}

    def _load(self, arguments: Message) -> Message:
        try:
            self._ros.robot.mapper.replace(self._files.load_picture(text(arguments, "map_url", "args")))
        except (MapFileError, ValueError) as error:
            logger.warning("The map was not loaded: %s", error)
            return {"map": self._whole(), "result": _NO_SUCH_MAP if isinstance(error, NoSuchMap) else _INVALID_MAP}
        self._publish_whole()
        return {"map": self._whole(), "result": _LOADED}


def _is_saved(save: Callable[[], Path]) -> bool:
    """False, with a line in the log, if the map cannot be saved."""
    try:
        logger.info("The map was saved: %s", save())
    except MapFileError as error:
        logger.warning("The map was not saved: %s", error)
        return False
    return True


_PROGRESS_EVERY_STEPS = 10
_STATUS = {
    "reached": action_messages.SUCCEEDED,
    "cancelled": action_messages.PREEMPTED,
    "preempted": action_messages.PREEMPTED,
    "aborted": action_messages.ABORTED,
}
_PLANNER_SPEEDS = ("max_vel_x", "max_vel_trans")


class NavigationTopics:
    """Navigation interfaces of the model."""

    def __init__(self, ros: RosContext, navigation: Navigation) -> None:
        self._ros = ros
        self._robot = ros.robot
        self._is_ros1 = ros.dialect is Dialect.ROS1
        self._numbers = itertools.count(1)
        self._server: ActionServer | None = None
        ros.every(1, self._finish_ended)
        if navigation.path:
            self._path = ros.publishes(navigation.path, "nav_msgs", "Path")
            self._path_of: tuple[int, str | None] = (0, None)
            ros.every(1, self._publish_new_path)
        if navigation.name is not None:
            ros.every(_PROGRESS_EVERY_STEPS, self._publish_progress)
            serve: Callable[..., ActionServer] = partial(ActionlibServer, package="move_base_msgs", kind="MoveBase")
            if not self._is_ros1:
                serve = partial(Ros2ActionServer, package="nav2_msgs", kind="NavigateToPose", lists_goals=True)
            self._server = serve(ros, navigation.name, on_goal=self._on_goal, on_cancel=self._on_cancel)
        ros.obeys(navigation.simple_goal, "geometry_msgs", "PoseStamped", self._on_simple_goal)
        if navigation.planner is not None:
            ros.serves(f"{navigation.planner}/set_parameters", "dynamic_reconfigure", "Reconfigure", self._reconfigure)
        if navigation.speed_limit is not None:
            ros.obeys(navigation.speed_limit, "nav2_msgs", "SpeedLimit", self._on_speed_limit)

    def _reconfigure(self, request: Message) -> Message:
        """Speed parameters of a DWAPlannerROS, of which the lower applies."""
        speeds = decode_reconfigured(request, _PLANNER_SPEEDS)
        if speeds:
            self._robot.navigation.limit(min(speeds.values()))
        return encode_reconfigure(dict.fromkeys(_PLANNER_SPEEDS, self._robot.navigation.top_mps))

    def _on_speed_limit(self, message: Message) -> None:
        limit, percentage = decode_speed_limit(message)
        top_mps = limit / 100.0 * CRUISE_MPS if percentage else limit
        self._robot.navigation.limit(CRUISE_MPS if limit == NO_LIMIT else top_mps)

    def _publish_new_path(self) -> None:
        """Publish the path on each new plan, and an empty one at its end."""
        now = (self._robot.navigation.plans_made, self._robot.navigation.goal_id)
        if now != self._path_of:
            self._path_of = now
            points = np.array(self._robot.path_in_map, dtype=np.float32).reshape(-1, 2)
            self._ros.publish_stamped(self._path, encode_path, points, frame=self._ros.model.map_frame)

    def _publish_progress(self) -> None:
        progress = self._robot.navigation.progress(self._robot.now_s)
        if self._server is not None and progress is not None:
            status = GoalStatus(progress.goal_id, action_messages.ACTIVE, f"{progress.distance_left_m:.2f} m left")
            self._server.progress(status, self._feedback(progress))

    def _feedback(self, progress: Progress) -> Message:
        pose, stamp_ns = self._robot.pose_in_map, self._ros.stamp_ns()
        if self._is_ros1:
            return {"base_position": message_conversion.encode_pose_stamped(Dialect.ROS1, pose, stamp_ns=stamp_ns)}
        return action_messages.encode_navigate_to_pose_feedback(
            pose,
            distance_left_m=progress.distance_left_m,
            time_left_s=progress.distance_left_m / CRUISE_MPS,
            elapsed_s=progress.elapsed_s,
            stamp_ns=stamp_ns,
        )

    def _finish_ended(self) -> None:
        for ended in self._robot.take_ended_goals():
            status = _STATUS[ended.ending]
            if ended.ending == "preempted" and not self._is_ros1:
                status = action_messages.ABORTED
            self._finish(GoalStatus(ended.goal_id, status, ended.detail))

    def _finish(self, status: GoalStatus) -> None:
        if self._server is not None:
            code = 0 if status.status == action_messages.SUCCEEDED else 100
            self._server.finish(status, {} if self._is_ros1 else {"error_code": code, "error_msg": status.detail})

    def _on_goal(self, goal_id: str, goal: Message) -> None:
        if self._is_ros1:
            pose = part(goal, "target_pose", "MoveBaseGoal")
            target = message_conversion.decode_pose_stamped(pose, stamp_ns=0).pose_in_map
        else:
            target = action_messages.decode_navigate_to_pose_goal(goal)
        self._start(goal_id, target)

    def _on_simple_goal(self, message: Message) -> None:
        goal_id = f"{'simple' if self._is_ros1 else 'goal_pose'}-{next(self._numbers)}"
        self._start(goal_id, message_conversion.decode_pose_stamped(message, stamp_ns=0).pose_in_map)

    def _start(self, goal_id: str, target: Pose2D) -> None:
        logger.info("Goal %s: %s", goal_id, target)
        if not self._robot.go(goal_id, target):
            self._finish(GoalStatus(goal_id, action_messages.REJECTED, "the emergency stop is active"))
        elif self._server is not None and self._robot.navigation.goal_id == goal_id:
            self._server.accept(goal_id)

    def _on_cancel(self, goal_id: str) -> None:
        if goal_id in ("", self._robot.navigation.goal_id):
            self._robot.cancel_goal()
