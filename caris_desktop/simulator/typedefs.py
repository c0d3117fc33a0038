"""Definitions of the simulated robot's ROS types, as reported by rosapi.

Written as in .msg, .srv and .action files; parts of a service are separated by ``---``. Types that differ between ROS 1
and ROS 2 have both. ``rosbags``' type store knows 65 of these 117, no service and no action, uses the ROS 2 name for
ROS 1's time, and takes 0.2 s to load.
"""

import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from caris_desktop.domain.value_class import dataclass
from caris_desktop.ros.definitions import DEFINITION_TEXTS
from caris_desktop.ros.dialect import Dialect, plain_name

_PRIMITIVES = frozenset(("bool", "byte", "char", "string", "float32", "float64", "time", "duration")) | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}
_LINE = re.compile(r"(?P<type>[A-Za-z][\w/]*)(?P<array>\[(?:<=)?\d*\])?\s+(?P<name>\w+)(?:\s*=\s*(?P<value>.*))?")

_BOTH = {
    **DEFINITION_TEXTS,
    "dynamic_reconfigure/BoolParameter": "string name; bool value",
    "dynamic_reconfigure/IntParameter": "string name; int32 value",
    "dynamic_reconfigure/StrParameter": "string name; string value",
    "dynamic_reconfigure/DoubleParameter": "string name; float64 value",
    "dynamic_reconfigure/GroupState": "string name; bool state; int32 id; int32 parent",
    "dynamic_reconfigure/Config": (
        "dynamic_reconfigure/BoolParameter[] bools; dynamic_reconfigure/IntParameter[] ints; "
        "dynamic_reconfigure/StrParameter[] strs; dynamic_reconfigure/DoubleParameter[] doubles; "
        "dynamic_reconfigure/GroupState[] groups"
    ),
    "dynamic_reconfigure/Reconfigure": "dynamic_reconfigure/Config config --- dynamic_reconfigure/Config config",
    "nav2_msgs/SpeedLimit": "std_msgs/Header header; bool percentage; float64 speed_limit",
    "std_srvs/SetBool": "bool data --- bool success; string message",
    "std_srvs/Trigger": " --- bool success; string message",
    "std_srvs/Empty": " --- ",
    "turtlebot3_msgs/Sound": (
        "uint8 OFF=0; uint8 ON=1; uint8 LOW_BATTERY=2; uint8 ERROR=3; uint8 BUTTON1=4; uint8 BUTTON2=5; uint8 value "
        "--- bool success; string message"
    ),
    "irobot_create_msgs/LedColor": "uint8 red; uint8 green; uint8 blue",
    "irobot_create_msgs/LightringLeds": (
        "std_msgs/Header header; irobot_create_msgs/LedColor[6] leds; bool override_system"
    ),
    "irobot_create_msgs/Dock": " --- bool is_docked --- bool sees_dock",
    "irobot_create_msgs/Undock": " --- bool is_docked --- ",
    "irobot_create_msgs/EStop": "bool e_stop_on --- bool success; string message",
    "slam_toolbox/Pause": " --- bool status",
    "nav2_msgs/SaveMap": (
        "string map_topic; string map_url; string image_format; string map_mode; float32 free_thresh; "
        "float32 occupied_thresh --- bool result"
    ),
    "nav2_msgs/LoadMap": (
        "string map_url --- uint8 RESULT_SUCCESS=0; uint8 RESULT_MAP_DOES_NOT_EXIST=1; "
        "uint8 RESULT_INVALID_MAP_DATA=2; uint8 RESULT_INVALID_MAP_METADATA=3; "
        "uint8 RESULT_UNDEFINED_FAILURE=255; nav_msgs/OccupancyGrid map; uint8 result"
    ),
    "slam_toolbox/SerializePoseGraph": (
        "string filename --- uint8 RESULT_SUCCESS=0; uint8 RESULT_NO_MAP_RECEIEVD=1; "
        "uint8 RESULT_UNDEFINED_FAILURE=255; uint8 result"
    ),
    "slam_toolbox/DeserializePoseGraph": (
        "int8 UNSET=0; int8 START_AT_FIRST_NODE=1; int8 START_AT_GIVEN_POSE=2; int8 LOCALIZE_AT_POSE=3; "
        "string filename; int8 match_type; geometry_msgs/Pose2D initial_pose --- "
    ),
    "simulator/Fault": "string command --- bool success; string message",
    "simulator/ResetPose": "float64 x; float64 y; float64 heading_deg --- bool success; string message",
    "simulator/Say": "string text --- bool success; string message",
    "simulator/State": " --- ",
}

_ROS1 = {
    "actionlib_msgs/GoalStatus": (
        "uint8 PENDING=0; uint8 ACTIVE=1; uint8 PREEMPTED=2; uint8 SUCCEEDED=3; uint8 ABORTED=4; uint8 REJECTED=5; "
        "uint8 PREEMPTING=6; uint8 RECALLING=7; uint8 RECALLED=8; uint8 LOST=9; actionlib_msgs/GoalID goal_id; "
        "uint8 status; string text"
    ),
    "move_base_msgs/MoveBaseGoal": "geometry_msgs/PoseStamped target_pose",
    "move_base_msgs/MoveBaseFeedback": "geometry_msgs/PoseStamped base_position",
    "move_base_msgs/MoveBaseResult": "",
    "pal_interaction_msgs/I18nText": (
        "string section; string key; string lang_id; pal_interaction_msgs/I18nArgument[] arguments"
    ),
    "pal_interaction_msgs/I18nArgument": "string section; string key; string expanded",
    "pal_interaction_msgs/TtsMark": "string type; string name",
    "pal_interaction_msgs/TtsFeedback": (
        "uint16 TTS_EVENT_INITIALIZED_ENGINE=1; uint16 event_type; time timestamp; string text_said; string next_word; "
        "string viseme_id; pal_interaction_msgs/TtsMark marks"
    ),
    "pal_interaction_msgs/TtsResult": "string text; string msg",
    "play_motion_msgs/PlayMotionFeedback": "",
    "play_motion_msgs/PlayMotionResult": "int32 error_code; string error_string",
    "naoqi_bridge_msgs/BodyPoseWithSpeedGoal": "string posture_name; float32 speed",
    "naoqi_bridge_msgs/BodyPoseWithSpeedFeedback": "",
    "naoqi_bridge_msgs/BodyPoseWithSpeedResult": "",
}
for _package, _name in (
    ("move_base_msgs", "MoveBase"),
    ("pal_interaction_msgs", "Tts"),
    ("play_motion_msgs", "PlayMotion"),
    ("naoqi_bridge_msgs", "BodyPoseWithSpeed"),
):
    _ROS1[f"{_package}/{_name}ActionGoal"] = (
        f"std_msgs/Header header; actionlib_msgs/GoalID goal_id; {_package}/{_name}Goal goal"
    )
    for _part in ("Feedback", "Result"):
        _ROS1[f"{_package}/{_name}Action{_part}"] = (
            f"std_msgs/Header header; actionlib_msgs/GoalStatus status; {_package}/{_name}{_part} {_part.lower()}"
        )

_ROS2 = {
    "std_msgs/Header": "builtin_interfaces/Time stamp; string frame_id",
    "builtin_interfaces/Time": "int32 sec; uint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec; uint32 nanosec",
    "unique_identifier_msgs/UUID": "uint8[16] uuid",
    "rosgraph_msgs/Clock": "builtin_interfaces/Time clock",
    "nav_msgs/MapMetaData": (
        "builtin_interfaces/Time map_load_time; float32 resolution; uint32 width; uint32 height; "
        "geometry_msgs/Pose origin"
    ),
    "sensor_msgs/CameraInfo": DEFINITION_TEXTS["sensor_msgs/CameraInfo"]
    .replace("[] D", "[] d")
    .replace("[9] K", "[9] k")
    .replace("[9] R", "[9] r")
    .replace("[12] P", "[12] p"),
    "sensor_msgs/BatteryState": DEFINITION_TEXTS["sensor_msgs/BatteryState"].replace(
        "float32 current", "float32 temperature; float32 current"
    ),
    "trajectory_msgs/JointTrajectoryPoint": (
        "float64[] positions; float64[] velocities; float64[] accelerations; float64[] effort; "
        "builtin_interfaces/Duration time_from_start"
    ),
    "action_msgs/GoalInfo": "unique_identifier_msgs/UUID goal_id; builtin_interfaces/Time stamp",
    "action_msgs/GoalStatus": "action_msgs/GoalInfo goal_info; int8 status",
    "action_msgs/GoalStatusArray": "action_msgs/GoalStatus[] status_list",
    "action_msgs/CancelGoal": (
        "action_msgs/GoalInfo goal_info --- int8 return_code; action_msgs/GoalInfo[] goals_canceling"
    ),
    "nav2_msgs/NavigateToPose": (
        "geometry_msgs/PoseStamped pose; string behavior_tree --- uint16 error_code; string error_msg --- "
        "geometry_msgs/PoseStamped current_pose; builtin_interfaces/Duration navigation_time; "
        "builtin_interfaces/Duration estimated_time_remaining; int16 number_of_recoveries; float32 distance_remaining"
    ),
}


@dataclass(frozen=True, slots=True)
class _Field:
    type: str
    name: str
    length: int
    value: str | None


def message_typedefs(dialect: Dialect, type_: str) -> list[dict[str, Any]]:
    """rosapi's TypeDefs of a message type and its nested types; empty if unknown."""
    return _typedefs(dialect, plain_name(type_), 0)


def service_typedefs(dialect: Dialect, type_: str, part: int) -> list[dict[str, Any]]:
    """The same of a service's request (0) or response (1), or of an action's goal, result and feedback."""
    return _typedefs(dialect, plain_name(type_), part)


def misfit(dialect: Dialect, type_: str, message: Any) -> str | None:
    """Mismatch of ``message`` with its type, for which rosbridge would refuse it; None if there is none.

    ROS fills omitted fields with zero. A type without a definition permits everything.
    """
    definition = _part_of(dialect, type_)
    return None if definition is None else _misfit(dialect, plain_name(type_), definition, message, "")


def cbor_refusal(dialect: Dialect, type_: str, message: dict[str, Any]) -> str | None:
    """Reason why rosbridge cannot encode ``message`` as CBOR; None if it can.

    Its encoder recognises number lists by names such as ``float64[]``. Other names count as messages or lists of
    messages: fixed-length lists, and in ROS 1 also non-empty lists of texts and times.
    """
    for entry in _values(_part_of(dialect, type_)):
        values = message.get(entry.name)
        if entry.length < 0:
            items: Sequence[Any] = [values if isinstance(values, dict) else {}]
        else:
            items = values if isinstance(values, (list, tuple)) else []
        if entry.type not in _PRIMITIVES:
            found = (cbor_refusal(dialect, entry.type, item) for item in items if isinstance(item, dict))
            problem = next((refusal for refusal in found if refusal is not None), None)
            if problem is not None:
                return problem
        elif entry.length > 0 or (entry.length == 0 and len(items) > 0 and _is_no_list_of_cbor(dialect, entry.type)):
            return f"{type_}: {entry.name} is a {entry.type}[{entry.length or ''}], and an item of it has no __slots__"
    return None


def _is_no_list_of_cbor(dialect: Dialect, type_: str) -> bool:
    return dialect is Dialect.ROS1 and type_ in ("string", "time", "duration")


def is_known(dialect: Dialect, type_: str) -> bool:
    """True if the robot has this type installed."""
    return _part_of(dialect, type_) is not None


def field_names(dialect: Dialect, type_: str) -> list[str]:
    """Field names in order; empty if the type is unknown."""
    return [entry.name for entry in _values(_part_of(dialect, type_))]


def with_defaults(dialect: Dialect, type_: str, message: dict[str, Any]) -> dict[str, Any]:
    """``message`` as ROS passes it on: with zeros in omitted fields."""
    values = blank(dialect, type_)
    for name, value in message.items():
        inside = values.get(name)
        entry = next((one for one in _values(_part_of(dialect, type_)) if one.name == name), None)
        nested = isinstance(inside, dict) and isinstance(value, dict) and entry is not None
        values[name] = (
            with_defaults(dialect, entry.type, value)
            if nested and entry is not None and entry.type not in _PRIMITIVES
            else value
        )
    return values


def blank(dialect: Dialect, type_: str, *, part: int = 0) -> dict[str, Any]:
    """Message with every field zero, false or empty."""
    return {entry.name: _blank(dialect, entry) for entry in _values(_part_of(dialect, type_, part))}


def _blank(dialect: Dialect, entry: _Field) -> Any:
    if entry.length >= 0:
        return []
    if entry.type in ("time", "duration"):
        return {"secs": 0, "nsecs": 0}
    if entry.type not in _PRIMITIVES:
        return blank(dialect, entry.type)
    return {"string": "", "bool": False}.get(entry.type, 0)


def _misfit(dialect: Dialect, name: str, definition: str, message: Any, where: str) -> str | None:
    if not isinstance(message, dict):
        return f"{where or name} must be a {name}"
    fields = {entry.name: entry for entry in _values(definition)}
    for key, value in message.items():
        path = f"{where}.{key}" if where else key
        if key not in fields:
            return f"Message type {name} does not have a field {key}"
        entry = fields[key]
        if entry.length < 0:
            problem = _misfit_of_one(dialect, entry.type, value, path)
        elif isinstance(value, (bytes, np.ndarray)) or (isinstance(value, str) and entry.type in ("uint8", "char")):
            problem = None  # blobs and typed arrays have their type on the wire
        elif not isinstance(value, (list, tuple)):
            problem = f"{path} must be a list of {entry.type}"
        else:
            problems = (_misfit_of_one(dialect, entry.type, item, f"{path}[{i}]") for i, item in enumerate(value))
            problem = next((found for found in problems if found is not None), None)
        if problem is not None:
            return problem
    return None


def _misfit_of_one(dialect: Dialect, type_: str, value: Any, where: str) -> str | None:
    if type_ in ("time", "duration"):
        fits = isinstance(value, dict) and set(value) <= {"secs", "nsecs"}
    elif type_ == "bool":
        fits = isinstance(value, (bool, np.bool_))
    elif type_ == "string":
        fits = isinstance(value, str)
    elif type_.startswith("float"):
        # rosbridge writes infinity as null, and does not accept null
        fits = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
    elif type_ in _PRIMITIVES:
        fits = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    else:
        definition = _part_of(dialect, type_)
        return None if definition is None else _misfit(dialect, type_, definition, value, where)
    return None if fits else f"{where} must be a {type_}"


def _part_of(dialect: Dialect, type_: str, part: int = 0) -> str | None:
    """One part of a definition; None if there is none of that type or number."""
    name, special = plain_name(type_), _ROS1 if dialect is Dialect.ROS1 else _ROS2
    parts = special.get(name, _BOTH.get(name, "")).split("---")
    return parts[part] if part < len(parts) and (name in special or name in _BOTH) else None


def _typedefs(dialect: Dialect, type_: str, part: int) -> list[dict[str, Any]]:
    typedefs: list[dict[str, Any]] = []
    waiting, seen = [(type_, part)], {type_}
    while waiting:
        name, which = waiting.pop(0)
        definition = _part_of(dialect, name, which)
        if definition is None:
            continue
        entries = list(_fields(definition))
        typedefs.append(_typedef(name, entries))
        for entry in entries:
            if entry.type not in _PRIMITIVES and entry.type not in seen:
                seen.add(entry.type)
                waiting.append((entry.type, 0))
    return typedefs


def _typedef(name: str, entries: list[_Field]) -> dict[str, Any]:
    fields = [entry for entry in entries if entry.value is None]
    constants = [entry for entry in entries if entry.value is not None]
    return {
        "type": name,
        "fieldnames": [entry.name for entry in fields],
        "fieldtypes": [entry.type for entry in fields],
        "fieldarraylen": [entry.length for entry in fields],
        "examples": [_example(entry) for entry in fields],
        "constnames": [entry.name for entry in constants],
        "constvalues": [entry.value for entry in constants],
    }


def _values(definition: str | None) -> Iterator[_Field]:
    """Fields without constants."""
    return (entry for entry in _fields(definition or "") if entry.value is None)


def _fields(definition: str) -> Iterator[_Field]:
    for line in definition.split(";"):
        found = _LINE.fullmatch(line.strip())
        if found is None:
            continue
        array = found["array"]
        # as in rosapi: -1 is no array, 0 one of any length
        length = -1 if array is None else int(array.strip("[]").removeprefix("<=") or 0)
        yield _Field(found["type"], found["name"], length, found["value"])


def _example(entry: _Field) -> str:
    if entry.length >= 0:
        return "[]"
    if entry.type in ("string",):
        return ""
    if entry.type == "bool":
        return "False"
    if entry.type.startswith("float"):
        return "0.0"
    return "0" if entry.type in _PRIMITIVES else "{}"
