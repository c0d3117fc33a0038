"""Head on ROS: joint states out, joint commands in, and its moving frames."""

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.ros.joint_messages import (
    decode_joint_angles_with_speed,
    decode_joint_trajectory,
    encode_joint_state,
)
from caris_desktop.ros.message_fields import MessageError
from caris_desktop.simulator.encoding import Placement
from caris_desktop.simulator.robot_interface import HeadTopics
from caris_desktop.simulator.ros_context import Wiring
from caris_desktop.simulator.server import Message
from caris_desktop.simulator.simulated_head import DEFAULT_SPEED_RADPS, Head

_WHEELS = ("wheel_left_joint", "wheel_right_joint")


class HeadOnRos:
    """Executes the model's command topic; without a head only wheel joints are published."""

    def __init__(self, wiring: Wiring) -> None:
        self._wiring = wiring
        self._steps = 0
        dress = wiring.dress
        self._joint_states = (
            wiring.publishes(dress.joint_states, "sensor_msgs", "JointState") if dress.joint_states else None
        )
        if dress.head is None:
            return
        if dress.head.kind == "JointTrajectory":
            wiring.obeys(dress.head.topic, "trajectory_msgs", "JointTrajectory", self._on_trajectory)
        else:
            wiring.obeys(dress.head.topic, "naoqi_bridge_msgs", "JointAnglesWithSpeed", self._on_angles)

    def publish_due(self) -> None:
        """Publish due messages; called after every simulation step."""
        self._steps += 1
        if self._steps % 2 or self._joint_states is None or not self._wiring.wanted(self._joint_states):
            return
        angles = dict.fromkeys(_WHEELS, 0.0)
        if self._wiring.dress.head is not None:
            head, interface = self._wiring.robot.head, self._wiring.dress.head
            angles |= {interface.pan_joint: head.pan_rad, interface.tilt_joint: interface.tilt_sign * head.tilt_rad}
        message = encode_joint_state(self._wiring.dialect, angles, stamp_ns=self._wiring.stamp_ns())
        self._wiring.publish(self._joint_states, message)

    def turning_frames(self) -> list[Placement]:
        """Present frames of the joints."""
        interface, robot = self._wiring.dress.head, self._wiring.robot
        if interface is None:
            return []
        camera = robot.body.robot_from_camera
        pan = Pose2D(camera.x_m, camera.y_m, camera.heading_rad + robot.head.pan_rad)
        pan_frame, tilt_frame = (self._wiring.frame(name) for name in interface.frames)
        return [
            Placement(self._wiring.frame(self._wiring.dress.base_frame), pan_frame, pan, robot.body.camera_height_m),
            Placement(pan_frame, tilt_frame, Pose2D(0.0, 0.0, 0.0), 0.0, robot.head.tilt_rad),
        ]

    def camera_mount(self, camera_frame: str) -> Placement:
        """Mounting of the camera, on the head or on the body."""
        wiring = self._wiring
        frame, body = wiring.frame(camera_frame), wiring.robot.body
        if wiring.dress.head is not None:
            return Placement(wiring.frame(wiring.dress.head.frames[1]), frame, Pose2D(0.0, 0.0, 0.0))
        return Placement(wiring.frame(wiring.dress.base_frame), frame, body.robot_from_camera, body.camera_height_m)

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
        relative = bool(message.get("relative"))
        for name, angle_rad in targets.items():
            target_rad = angle_rad + (self._now_rad(name) if relative else 0.0)
            self._turn(name, target_rad, share * self._wiring.robot.body.head.fastest_radps)

    def _head_interface(self) -> tuple[HeadTopics, Head]:
        interface = self._wiring.dress.head
        if interface is None:
            raise MessageError("the robot has no head")
        return interface, self._wiring.robot.head

    def _now_rad(self, joint: str) -> float:
        interface, head = self._head_interface()
        if joint not in (interface.pan_joint, interface.tilt_joint):
            raise MessageError(
                f"there is no joint '{joint}'; the head has {interface.pan_joint} and {interface.tilt_joint}"
            )
        return head.pan_rad if joint == interface.pan_joint else interface.tilt_sign * head.tilt_rad

    def _turn(self, joint: str, target_rad: float, speed_radps: float) -> None:
        interface, head = self._head_interface()
        if joint == interface.pan_joint:
            head.pan_to(target_rad, speed_radps=speed_radps)
        else:
            head.tilt_to(interface.tilt_sign * target_rad, speed_radps=speed_radps)
