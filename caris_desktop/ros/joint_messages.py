"""Joint messages: states, trajectories and angles with speed.

Encoders and decoders keep the rules of :mod:`caris_desktop.ros.message_conversion`.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from caris_desktop.domain.value_class import Value
from caris_desktop.ros.dialect import Dialect, decode_time, encode_time
from caris_desktop.ros.message_fields import (
    Message,
    MessageError,
    encode_header,
    field,
    floats,
    message_of,
    number,
    objects,
    stamp_of,
)

MAX_JOINTS = 1_000
_MAX_POINTS = 10_000


class JointPositions(Value):
    """Position of each named joint, in radians or metres."""

    robot_stamp_ns: int | None
    positions: dict[str, float]


def encode_joint_state(dialect: Dialect, positions: Mapping[str, float], *, stamp_ns: int) -> Message:
    """Encode sensor_msgs/JointState."""
    return {
        "header": encode_header(dialect, stamp_ns=stamp_ns, frame_id=""),
        "name": list(positions),
        "position": np.array(list(positions.values()), dtype=np.float64),
        "velocity": [],
        "effort": [],
    }


def decode_joint_state(message: Any) -> JointPositions:
    """Decode sensor_msgs/JointState. Joints without a finite position are omitted."""
    state = message_of(message, "JointState")
    names = _names(state, "name", "JointState")
    positions = floats(state, "position", "JointState", most=MAX_JOINTS) if "position" in state else ()
    known = {name: float(position) for name, position in zip(names, positions, strict=False) if np.isfinite(position)}
    return JointPositions(stamp_of(state, "JointState"), known)


def encode_joint_trajectory(dialect: Dialect, positions: Mapping[str, float], *, duration_s: float) -> Message:
    """Encode trajectory_msgs/JointTrajectory with one point, starting at once."""
    return {
        "header": encode_header(dialect, stamp_ns=0, frame_id=""),
        "joint_names": list(positions),
        "points": [
            {
                "positions": list(positions.values()),
                "velocities": [],
                "accelerations": [],
                "effort": [],
                "time_from_start": encode_time(dialect, int(duration_s * 1e9)),
            }
        ],
    }


def decode_joint_trajectory(message: Any) -> tuple[dict[str, float], float]:
    """Last point of a trajectory_msgs/JointTrajectory, and its time in seconds."""
    what = "JointTrajectory"
    trajectory = message_of(message, what)
    names = _names(trajectory, "joint_names", what)
    points = objects(trajectory, "points", what, most=_MAX_POINTS)
    if not points:
        return {}, 0.0
    last = f"{what}.points[{len(points) - 1}]"
    positions = floats(points[-1], "positions", last, most=MAX_JOINTS)
    if len(positions) != len(names) or not np.isfinite(positions).all():
        raise MessageError(f"{last}.positions must contain one number for each of the {len(names)} joints")
    try:
        duration_ns = decode_time(points[-1].get("time_from_start", encode_time(Dialect.ROS1, 0))) or 0
    except ValueError as error:
        raise MessageError(f"{last}.time_from_start: {error}") from error
    return dict(zip(names, positions.tolist(), strict=True)), duration_ns / 1e9


def encode_joint_angles_with_speed(
    dialect: Dialect, positions: Mapping[str, float], *, speed_fraction: float
) -> Message:
    """Encode naoqi_bridge_msgs/JointAnglesWithSpeed; ``speed_fraction`` of the motors' maximum, 0..1."""
    return {
        "header": encode_header(dialect, stamp_ns=0, frame_id=""),
        "joint_names": list(positions),
        "joint_angles": list(positions.values()),
        "speed": speed_fraction,
        "relative": 0,
    }


def decode_joint_angles_with_speed(message: Any) -> tuple[dict[str, float], float]:
    """Angles and speed fraction of a naoqi_bridge_msgs/JointAnglesWithSpeed."""
    what = "JointAnglesWithSpeed"
    angles = message_of(message, what)
    names = _names(angles, "joint_names", what)
    positions = floats(angles, "joint_angles", what, most=MAX_JOINTS)
    if len(positions) != len(names) or not np.isfinite(positions).all():
        raise MessageError(f"{what}.joint_angles must contain one number for each of the {len(names)} joints")
    return dict(zip(names, positions.tolist(), strict=True)), number(angles, "speed", what)


def _names(message: Message, name: str, what: str) -> list[str]:
    value = field(message, name, what)
    if not isinstance(value, list) or len(value) > MAX_JOINTS or not all(isinstance(item, str) for item in value):
        raise MessageError(f"{what}.{name} must be a list of at most {MAX_JOINTS} names")
    return value
