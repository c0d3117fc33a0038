"""The fields of ROS messages: as types tell them, and those of the types that robots are commanded with."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

INTEGER_RANGES: dict[str, tuple[int, int]] = {
    "int8": (-(2**7), 2**7 - 1),
    "uint8": (0, 2**8 - 1),
    "int16": (-(2**15), 2**15 - 1),
    "uint16": (0, 2**16 - 1),
    "int32": (-(2**31), 2**31 - 1),
    "uint32": (0, 2**32 - 1),
    "int64": (-(2**63), 2**63 - 1),
    "uint64": (0, 2**64 - 1),
    # byte is signed in ROS 1 and not in ROS 2, and char the other way round in one of them; either is let through.
    "byte": (-(2**7), 2**8 - 1),
    "char": (-(2**7), 2**8 - 1),
    "octet": (0, 2**8 - 1),
}
FLOATS = frozenset({"float32", "float64", "float", "double"})
TRUTHS = frozenset({"bool", "boolean"})
TEXTS = frozenset({"string", "wstring"})
TIMES = frozenset({"time", "duration", "builtin_interfaces/Time", "builtin_interfaces/Duration"})


@dataclass(frozen=True, slots=True)
class FieldType:
    """One field. ``length`` is None for a single value, 0 for a list of any length, else the list's fixed length."""

    name: str
    type: str
    length: int | None = None


@dataclass(frozen=True, slots=True)
class Definition:
    """The fields of a type, and of the types within it by their plain names (``package/Name``)."""

    fields: tuple[FieldType, ...]
    nested: Mapping[str, tuple[FieldType, ...]]


def plain_name(type_: str) -> str:
    """A type's name as ROS 1 spells it, whichever dialect it is written in."""
    return "/".join(part for part in type_.split("/") if part not in ("msg", "srv", "action"))


@lru_cache(maxsize=1)
def shipped_definitions() -> dict[str, tuple[FieldType, ...]]:
    """Those that this program knows by itself, by plain name: a service's request, an action's goal as ``...Goal``."""
    return {name: parse_fields(text) for name, text in _TEXTS.items()}


def shipped_definition(type_: str) -> Definition | None:
    """The definition of one of them; None where it is not known."""
    known = shipped_definitions()
    fields = known.get(plain_name(type_))
    return None if fields is None else Definition(fields, known)


def parse_fields(text: str) -> tuple[FieldType, ...]:
    """The fields of a message definition as ``.msg`` files write them, separated by line ends or semicolons."""
    fields = []
    for line in text.replace(";", "\n").splitlines():
        if not line.strip():
            continue
        kind, name = line.split()
        base, bracket, length = kind.partition("[")
        fields.append(FieldType(name, base, int(length.rstrip("]") or 0) if bracket else None))
    return tuple(fields)


_TEXTS = {
    "std_msgs/Empty": "",
    "std_msgs/Bool": "bool data",
    "std_msgs/Byte": "byte data",
    "std_msgs/Char": "char data",
    "std_msgs/Int8": "int8 data",
    "std_msgs/UInt8": "uint8 data",
    "std_msgs/Int16": "int16 data",
    "std_msgs/UInt16": "uint16 data",
    "std_msgs/Int32": "int32 data",
    "std_msgs/UInt32": "uint32 data",
    "std_msgs/Int64": "int64 data",
    "std_msgs/UInt64": "uint64 data",
    "std_msgs/Float32": "float32 data",
    "std_msgs/Float64": "float64 data",
    "std_msgs/String": "string data",
    "std_msgs/ColorRGBA": "float32 r; float32 g; float32 b; float32 a",
    "std_msgs/Header": "uint32 seq; time stamp; string frame_id",
    "std_msgs/MultiArrayDimension": "string label; uint32 size; uint32 stride",
    "std_msgs/MultiArrayLayout": "std_msgs/MultiArrayDimension[] dim; uint32 data_offset",
    "std_msgs/Float32MultiArray": "std_msgs/MultiArrayLayout layout; float32[] data",
    "std_msgs/Float64MultiArray": "std_msgs/MultiArrayLayout layout; float64[] data",
    "std_srvs/Empty": "",
    "std_srvs/Trigger": "",
    "std_srvs/SetBool": "bool data",
    "geometry_msgs/Vector3": "float64 x; float64 y; float64 z",
    "geometry_msgs/Point": "float64 x; float64 y; float64 z",
    "geometry_msgs/Quaternion": "float64 x; float64 y; float64 z; float64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position; geometry_msgs/Quaternion orientation",
    "geometry_msgs/Pose2D": "float64 x; float64 y; float64 theta",
    "geometry_msgs/PoseStamped": "std_msgs/Header header; geometry_msgs/Pose pose",
    "geometry_msgs/PointStamped": "std_msgs/Header header; geometry_msgs/Point point",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear; geometry_msgs/Vector3 angular",
    "geometry_msgs/TwistStamped": "std_msgs/Header header; geometry_msgs/Twist twist",
    "sensor_msgs/JointState": (
        "std_msgs/Header header; string[] name; float64[] position; float64[] velocity; float64[] effort"
    ),
    "trajectory_msgs/JointTrajectoryPoint": (
        "float64[] positions; float64[] velocities; float64[] accelerations; float64[] effort; duration time_from_start"
    ),
    "trajectory_msgs/JointTrajectory": (
        "std_msgs/Header header; string[] joint_names; trajectory_msgs/JointTrajectoryPoint[] points"
    ),
    "naoqi_bridge_msgs/JointAnglesWithSpeed": (
        "std_msgs/Header header; string[] joint_names; float32[] joint_angles; float32 speed; uint8 relative"
    ),
    "actionlib_msgs/GoalID": "time stamp; string id",
    "pal_interaction_msgs/I18nArgument": "string key; pal_interaction_msgs/I18nText[] expanded",
    "pal_interaction_msgs/I18nText": "string section; string key; string lang_id; string[] arguments",
    "pal_interaction_msgs/TtsText": "string text; string lang_id",
    "pal_interaction_msgs/TtsGoal": (
        "pal_interaction_msgs/I18nText text; pal_interaction_msgs/TtsText rawtext; string speakerName; "
        "float64 wait_before_speaking"
    ),
    "play_motion_msgs/PlayMotionGoal": "string motion_name; bool skip_planning; int32 priority",
}
