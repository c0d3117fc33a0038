"""Field definitions of ROS messages: parsing, checks of outgoing messages, and types of robots and commands."""

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.ros.dialect import plain_name

INTEGER_RANGES: dict[str, tuple[int, int]] = {
    **{f"int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
    # byte is signed in ROS 1 and unsigned in ROS 2, char in one of them vice versa; both are accepted.
    "byte": (-(2**7), 2**8 - 1),
    "char": (-(2**7), 2**8 - 1),
    "octet": (0, 2**8 - 1),
}
FLOATS = frozenset({"float32", "float64", "float", "double"})
TRUTHS = frozenset({"bool", "boolean"})
TEXTS = frozenset({"string", "wstring"})
TIMES = frozenset({"time", "duration", "builtin_interfaces/Time", "builtin_interfaces/Duration"})


LARGEST_FLOAT32 = 3.4028235e38
LONGEST_TEXT = 20_000
LONGEST_LIST = 10_000
_MOST_TYPEDEFS = 500
_MOST_FIELDS = 1_000
_DEEPEST = 20


class MessageMismatchError(ValueError):
    """Message that does not fit its type; the text names the field, its value and the requirement."""


class FieldType(Value):
    """One field. ``length`` is None for a single value, 0 for a list of any length, else the list's fixed length."""

    name: str
    type: str
    length: int | None = None


class Definition(Value):
    """Fields of a type, and of its nested types by plain name (``package/Name``)."""

    fields: tuple[FieldType, ...]
    nested: Mapping[str, tuple[FieldType, ...]]


@lru_cache(maxsize=1)
def shipped_definitions() -> dict[str, tuple[FieldType, ...]]:
    """Known definitions by plain name: a service's request, an action's goal as ``...Goal``."""
    return {name: parse_fields(text) for name, text in DEFINITION_TEXTS.items()}


def shipped_definition(type_: str) -> Definition | None:
    """Known definition of a type, or None."""
    known = shipped_definitions()
    fields = known.get(plain_name(type_))
    return None if fields is None else Definition(fields, known)


def cbor_carries(type_: str) -> bool:
    """True if rosbridge can send this type as CBOR; False for unknown types.

    It silently drops types with fixed-length lists or, in ROS 1, lists of texts or times (its issues 526 and 864; the
    first also in ROS 2). JSON supports everything.
    """
    definition = shipped_definition(type_)
    return definition is not None and all(_cbor_carries(field, definition) for field in definition.fields)


def _cbor_carries(field: FieldType, definition: Definition) -> bool:
    if field.type in TIMES or field.type in TEXTS:
        return field.length is None
    if field.length:
        return False
    if field.type in INTEGER_RANGES or field.type in FLOATS or field.type in TRUTHS:
        return True
    inside = definition.nested.get(plain_name(field.type))
    return inside is not None and all(_cbor_carries(one, definition) for one in inside)


def parse_fields(text: str) -> tuple[FieldType, ...]:
    """Parse the fields of a ``.msg`` definition, separated by line ends or semicolons."""
    fields = []
    for line in text.replace(";", "\n").splitlines():
        if not line.strip():
            continue
        kind, name = line.split()
        base, bracket, length = kind.partition("[")
        fields.append(FieldType(name, base, int(length.rstrip("]") or 0) if bracket else None))
    return tuple(fields)


def definition_from_rosapi(typedefs: Any) -> Definition:
    """Definition from rosapi's message_details and similar; the first typedef is the requested type.

    Raises
    ------
    ValueError, TypeError
        When it is not such an answer, or an empty one.
    """
    if not isinstance(typedefs, list) or not 0 < len(typedefs) <= _MOST_TYPEDEFS:
        raise ValueError("rosapi reports no fields")
    nested: dict[str, tuple[FieldType, ...]] = {}
    first: tuple[FieldType, ...] | None = None
    for typedef in typedefs:
        if not isinstance(typedef, dict) or not isinstance(typedef.get("type"), str):
            raise TypeError("rosapi's response is not a list of types")
        names, types, lengths = (typedef.get(key) for key in ("fieldnames", "fieldtypes", "fieldarraylen"))
        lists = [names, types, lengths]
        if not all(isinstance(items, list) and len(items) <= _MOST_FIELDS for items in lists):
            raise ValueError(localized(QT_TR_NOOP("rosapi does not report the fields of {type}"), type=typedef["type"]))
        fields = tuple(
            FieldType(str(name), str(kind), None if length == -1 else max(0, int(length)))
            for name, kind, length in zip(*lists, strict=True)
        )
        nested[plain_name(typedef["type"])] = fields
        first = fields if first is None else first
    return Definition(first or (), nested)


def coerce_to_definition(
    message: Mapping[str, Any], definition: Definition | None, *, rounds: bool = False
) -> dict[str, Any]:
    """``message`` in a form that can be sent, with integers where required. Fields may be omitted.

    ``definition`` None checks only that it can be encoded. ``rounds`` rounds to integers instead of refusing.

    Raises
    ------
    MessageMismatchError
        For an unknown field, a value of the wrong kind and one out of range.
    """
    if definition is None:
        _check_plain(message, "", 0)
        return dict(message)
    return _message(message, definition.fields, definition, "", rounds)


def _mismatch(template: str, where: str, **values: Any) -> MessageMismatchError:
    field = localized(QT_TR_NOOP("the field {field}"), field=repr(where)) if where else QT_TR_NOOP("the message")
    return MessageMismatchError(localized(template, where=field, **values))


def _message(
    value: Any, fields: tuple[FieldType, ...], definition: Definition, where: str, rounds: bool
) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        template = QT_TR_NOOP("{where} must be a group of fields, but it is {value}")
        raise _mismatch(template, where, value=_described(value))
    if where.count(".") > _DEEPEST:
        raise _mismatch(QT_TR_NOOP("{where} is nested too deeply"), where)
    by_name = {field.name: field for field in fields}
    sent = {}
    for name, item in value.items():
        field = by_name.get(name)
        inside = f"{where}.{name}" if where else str(name)
        if field is None:
            allowed = ", ".join(sorted(by_name)[:12]) or QT_TR_NOOP("none")
            template = QT_TR_NOOP("unknown field {field}; known fields: {known}")
            raise MessageMismatchError(localized(template, field=repr(inside), known=allowed))
        sent[name] = _field(item, field, definition, inside, rounds)
    return sent


def _field(value: Any, field: FieldType, definition: Definition, where: str, rounds: bool) -> Any:
    if field.length is None:
        return _single(value, field.type, definition, where, rounds)
    if field.type in ("uint8", "char", "byte", "octet") and isinstance(value, (str, bytes)):
        return value
    if not isinstance(value, (list, tuple)):
        raise _mismatch(QT_TR_NOOP("{where} must be a list, but it is {value}"), where, value=_described(value))
    if field.length and len(value) != field.length:
        template = QT_TR_NOOP("{where} must have {length} entries, but it has {number}")
        raise _mismatch(template, where, length=field.length, number=len(value))
    if len(value) > LONGEST_LIST:
        raise _mismatch(QT_TR_NOOP("{where} has {number} entries, which is too many"), where, number=len(value))
    return [_single(item, field.type, definition, f"{where}[{index}]", rounds) for index, item in enumerate(value)]


def _single(value: Any, type_: str, definition: Definition, where: str, rounds: bool) -> Any:
    plain = plain_name(type_)
    base = plain.partition("<")[0]
    if base in INTEGER_RANGES:
        return _whole_number(value, INTEGER_RANGES[base], where, rounds)
    if base in FLOATS:
        return _number(value, base, where)
    if base in TRUTHS:
        if not isinstance(value, bool):
            template = QT_TR_NOOP("{where} must be true or false, but it is {value}")
            raise _mismatch(template, where, value=_described(value))
        return value
    if base in TEXTS:
        if not isinstance(value, str):
            raise _mismatch(QT_TR_NOOP("{where} must be text, but it is {value}"), where, value=_described(value))
        if len(value) > LONGEST_TEXT:
            raise _mismatch(QT_TR_NOOP("{where} is longer than {most} characters"), where, most=LONGEST_TEXT)
        return value
    if plain in TIMES:
        names = ({"secs", "nsecs"}, {"sec", "nanosec"})
        parts = value if isinstance(value, Mapping) else {}
        integers = all(isinstance(part, int) and not isinstance(part, bool) for part in parts.values())
        # ROS 1's rosbridge replaces this word by the robot's time.
        if value != "now" and not (parts and integers and any(set(parts) <= allowed for allowed in names)):
            raise _mismatch(QT_TR_NOOP("{where} must be a time in whole seconds and nanoseconds"), where)
        return value
    fields = definition.nested.get(plain) or definition.nested.get("std_msgs/Header" if plain == "Header" else plain)
    if fields is None:
        # Unknown nested type: the robot will refuse it if invalid.
        _check_plain(value, where, 0)
        return value
    return _message(value, fields, definition, where, rounds)


def _whole_number(value: Any, range_: tuple[int, int], where: str, rounds: bool) -> int:
    lowest, highest = range_
    if isinstance(value, float) and math.isfinite(value) and (rounds or value.is_integer()):
        value = round(value)
    if isinstance(value, bool) or not isinstance(value, int) or not lowest <= value <= highest:
        template = QT_TR_NOOP("{where} must be a whole number from {lowest} to {highest}, but it is {value}")
        raise _mismatch(template, where, lowest=lowest, highest=highest, value=_described(value))
    return value


def _number(value: Any, type_: str, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise _mismatch(QT_TR_NOOP("{where} must be a number, but it is {value}"), where, value=_described(value))
    try:
        number = float(value)
    except OverflowError as error:
        raise _mismatch(QT_TR_NOOP("{where} is too large"), where) from error
    if not math.isfinite(number) or (type_ in ("float32", "float") and abs(number) > LARGEST_FLOAT32):
        template = QT_TR_NOOP("{where} must be a finite number, but it is {value}")
        raise _mismatch(template, where, value=_described(value))
    return number


def _check_plain(value: Any, where: str, depth: int) -> None:
    """Check that the value can be encoded as JSON."""
    if depth > _DEEPEST:
        raise _mismatch(QT_TR_NOOP("{where} is nested too deeply"), where)
    if isinstance(value, Mapping):
        for item in value.values():
            _check_plain(item, where, depth + 1)
    elif isinstance(value, (list, tuple)):
        if len(value) > LONGEST_LIST:
            template = QT_TR_NOOP("{where} has a list of {number} entries, which is too many")
            raise _mismatch(template, where, number=len(value))
        for item in value:
            _check_plain(item, where, depth + 1)
    elif isinstance(value, float) and not math.isfinite(value):
        raise _mismatch(QT_TR_NOOP("{where} has a number that is not finite"), where)
    elif value is not None and not isinstance(value, (bool, int, float, str)):
        template = QT_TR_NOOP("{where} has a value that cannot be sent: {value}")
        raise _mismatch(template, where, value=_described(value))


def _described(value: Any) -> str:
    if value is None:
        return QT_TR_NOOP("nothing")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return localized(QT_TR_NOOP("the text {said}"), said=repr(value[:40]))
    if isinstance(value, (int, float)):
        return str(value)[:40]
    a_list = isinstance(value, (list, tuple))
    return QT_TR_NOOP("a list") if a_list else QT_TR_NOOP("a group of fields")


DEFINITION_TEXTS = {
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
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation; geometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header; string child_frame_id; geometry_msgs/Transform transform"
    ),
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose; float64[36] covariance",
    "geometry_msgs/PoseWithCovarianceStamped": "std_msgs/Header header; geometry_msgs/PoseWithCovariance pose",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist; float64[36] covariance",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "tf/tfMessage": "geometry_msgs/TransformStamped[] transforms",
    "rosgraph_msgs/Clock": "time clock",
    "nav_msgs/Path": "std_msgs/Header header; geometry_msgs/PoseStamped[] poses",
    "nav_msgs/Odometry": (
        "std_msgs/Header header; string child_frame_id; geometry_msgs/PoseWithCovariance pose; "
        "geometry_msgs/TwistWithCovariance twist"
    ),
    "nav_msgs/MapMetaData": (
        "time map_load_time; float32 resolution; uint32 width; uint32 height; geometry_msgs/Pose origin"
    ),
    "nav_msgs/OccupancyGrid": "std_msgs/Header header; nav_msgs/MapMetaData info; int8[] data",
    "map_msgs/OccupancyGridUpdate": (
        "std_msgs/Header header; int32 x; int32 y; uint32 width; uint32 height; int8[] data"
    ),
    "sensor_msgs/LaserScan": (
        "std_msgs/Header header; float32 angle_min; float32 angle_max; float32 angle_increment; "
        "float32 time_increment; float32 scan_time; float32 range_min; float32 range_max; float32[] ranges; "
        "float32[] intensities"
    ),
    "sensor_msgs/CompressedImage": "std_msgs/Header header; string format; uint8[] data",
    "sensor_msgs/Image": (
        "std_msgs/Header header; uint32 height; uint32 width; string encoding; uint8 is_bigendian; uint32 step; "
        "uint8[] data"
    ),
    "sensor_msgs/RegionOfInterest": "uint32 x_offset; uint32 y_offset; uint32 height; uint32 width; bool do_rectify",
    "sensor_msgs/CameraInfo": (
        "std_msgs/Header header; uint32 height; uint32 width; string distortion_model; float64[] D; float64[9] K; "
        "float64[9] R; float64[12] P; uint32 binning_x; uint32 binning_y; sensor_msgs/RegionOfInterest roi"
    ),
    "sensor_msgs/BatteryState": (
        "std_msgs/Header header; float32 voltage; float32 current; float32 charge; float32 capacity; "
        "float32 design_capacity; float32 percentage; uint8 power_supply_status; uint8 power_supply_health; "
        "uint8 power_supply_technology; bool present; float32[] cell_voltage; string location; string serial_number"
    ),
    "actionlib_msgs/GoalStatus": "actionlib_msgs/GoalID goal_id; uint8 status; string text",
    "actionlib_msgs/GoalStatusArray": "std_msgs/Header header; actionlib_msgs/GoalStatus[] status_list",
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
    "audio_common_msgs/AudioData": "uint8[] data",
    "audio_common_msgs/AudioDataStamped": "std_msgs/Header header; audio_common_msgs/AudioData audio",
    "audio_common_msgs/AudioInfo": (
        "uint8 channels; uint32 sample_rate; string sample_format; uint32 bitrate; string coding_format"
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
