"""Field definitions of ROS messages: parsing, and the types used by robots and commands."""

from collections.abc import Mapping
from functools import lru_cache

from caris_desktop.domain.value_class import Value
from caris_desktop.ros.dialect import plain_name

INTEGER_RANGES: dict[str, tuple[int, int]] = {
    "int8": (-(2**7), 2**7 - 1),
    "uint8": (0, 2**8 - 1),
    "int16": (-(2**15), 2**15 - 1),
    "uint16": (0, 2**16 - 1),
    "int32": (-(2**31), 2**31 - 1),
    "uint32": (0, 2**32 - 1),
    "int64": (-(2**63), 2**63 - 1),
    "uint64": (0, 2**64 - 1),
    # byte is signed in ROS 1 and unsigned in ROS 2, char in one of them vice versa; both are accepted.
    "byte": (-(2**7), 2**8 - 1),
    "char": (-(2**7), 2**8 - 1),
    "octet": (0, 2**8 - 1),
}
FLOATS = frozenset({"float32", "float64", "float", "double"})
TRUTHS = frozenset({"bool", "boolean"})
TEXTS = frozenset({"string", "wstring"})
TIMES = frozenset({"time", "duration", "builtin_interfaces/Time", "builtin_interfaces/Duration"})


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
