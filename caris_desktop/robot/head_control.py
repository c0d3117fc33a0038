"""Robot head: joint state, and commands to turn it."""

import asyncio
import math
from dataclasses import replace
from typing import Any

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import HeadMoved
from caris_desktop.domain.link_commands import MoveHead
from caris_desktop.domain.sensing import HeadState
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.robot.link_context import LinkContext
from caris_desktop.robot.profile_model import TopicSource
from caris_desktop.robot.transport import RosbridgeTopic
from caris_desktop.ros.message_conversion import (
    decode_joint_state,
    encode_joint_angles_with_speed,
    encode_joint_trajectory,
)

# A controller that gets a new goal before starting the last one never moves smoothly.
SEND_EVERY_S = 0.05
SHORTEST_MOVE_S = 0.1
# Joints may come from several nodes, so each message is processed, but not all are passed on.
REPORT_EVERY_NS = 90_000_000
# HeadYaw and HeadPitch of NAO and Pepper turn at about 8 rad/s; naoqi expects a fraction of that.
NAOQI_FASTEST_RADPS = 8.0


class RobotHead:
    """Turns the head within its range and speed limit; newer targets replace older ones.

    It sends a HeadState from the robot's joint states, and a HeadMoved for each command sent.
    """

    def __init__(self, link: LinkContext) -> None:
        self._loop = asyncio.get_running_loop()
        self._ros = link.ros
        self._head = head = link.profile.head
        self._emit = link.put
        self._at: tuple[float, float] | None = None
        self._target: tuple[float, float] | None = None
        self._reported_ns = 0
        self._sent_s = -math.inf
        self._next: MoveHead | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._held = False
        if head is None:
            return
        self._command = RosbridgeTopic(self._ros, head.topic, head.command_type, queue_size=1)
        self._command.advertise()
        link.listen(TopicSource(head.joint_states), "sensor_msgs/JointState", self._on_joints, queue_length=5)

    def move(self, command: MoveHead) -> str:
        """Turn the head; return the reason for a refusal, or an empty text."""
        if self._head is None:
            return QT_TR_NOOP("this robot's profile does not define a head")
        if not self._ros.is_connected:
            return QT_TR_NOOP("the robot is not connected")
        if self._held:
            return QT_TR_NOOP("the emergency stop is active")
        if not (math.isfinite(command.pan_rad) and math.isfinite(command.tilt_rad)):
            return QT_TR_NOOP("the direction is invalid")
        self._next = replace(
            command,
            pan_rad=_clamped(command.pan_rad, self._head.pan_range_rad),
            tilt_rad=_clamped(command.tilt_rad, self._head.tilt_range_rad),
        )
        if self._timer is None:
            due_s = self._sent_s + SEND_EVERY_S
            if due_s <= self._loop.time():
                self._send_next()
            else:
                self._timer = self._loop.call_at(due_s, self._send_next)
        return ""

    def set_emergency_stop(self, held: bool) -> None:
        """Emergency stop: the head stays as it is and refuses commands until cleared."""
        began = held and not self._held
        self._held = held
        if not began:
            return
        self._drop_next()
        here = self._at or self._target
        if self._head is not None and here is not None and self._ros.is_connected:
            # Only a new goal makes a trajectory controller abandon the present one.
            self._publish(here, SHORTEST_MOVE_S)

    def link_lost(self) -> None:
        """Drop pending commands, which must not be sent later."""
        self._drop_next()
        self._at = self._target = None

    def _drop_next(self) -> None:
        self._next = None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _send_next(self) -> None:
        command, head = self._next, self._head
        self._drop_next()
        if command is None or head is None or self._held:
            return
        target = command.pan_rad, command.tilt_rad
        begin = self._at or self._target or (0.0, 0.0)
        way_rad = max(abs(target[0] - begin[0]), abs(target[1] - begin[1]))
        if self._publish(target, max(SHORTEST_MOVE_S, way_rad / head.speed_radps)):
            self._emit(HeadMoved(now_ns(), *target, command.actor))

    def _publish(self, target: tuple[float, float], duration_s: float) -> bool:
        head = self._head
        if head is None:
            return False
        self._sent_s = self._loop.time()
        self._target = target
        joints = {head.pan_joint: head.pan_sign * target[0], head.tilt_joint: head.tilt_sign * target[1]}
        if head.kind == "joint_trajectory":
            return self._command.publish(encode_joint_trajectory(self._ros.dialect, joints, duration_s=duration_s))
        fraction = min(1.0, max(0.01, head.speed_radps / NAOQI_FASTEST_RADPS))
        return self._command.publish(encode_joint_angles_with_speed(self._ros.dialect, joints, speed_fraction=fraction))

    def _on_joints(self, message: Any) -> None:
        head = self._head
        joints = decode_joint_state(message)
        if head is None or not ({head.pan_joint, head.tilt_joint} & joints.positions.keys()):
            return
        before = self._at or (0.0, 0.0)
        self._at = (
            head.pan_sign * joints.positions.get(head.pan_joint, head.pan_sign * before[0]),
            head.tilt_sign * joints.positions.get(head.tilt_joint, head.tilt_sign * before[1]),
        )
        if self._ros.arrival_ns - self._reported_ns >= REPORT_EVERY_NS:
            self._reported_ns = self._ros.arrival_ns
            self._emit(HeadState(self._ros.arrival_ns, joints.robot_stamp_ns, *self._at))


def _clamped(angle_rad: float, range_rad: tuple[float, float]) -> float:
    return min(max(angle_rad, range_rad[0]), range_rad[1])
