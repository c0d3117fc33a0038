"""Map service messages: slam_toolbox, and Nav2's map server and map saver."""

from typing import Any

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.ros.message_fields import Message, count, message_of, truth

START_AT_FIRST_NODE = 1
START_AT_GIVEN_POSE = 2
LOCALIZE_AT_POSE = 3
"""match_type of slam_toolbox/DeserializePoseGraph."""

_LOADING_FAILED = {
    1: "the robot has no such map",
    2: "the map's data cannot be read",
    3: "the map's description cannot be read",
    255: "the robot gave no reason",
}
_SERIALIZING_FAILED = {1: "the robot has no map yet", 255: "the file cannot be written"}


def encode_serialize_map(file_name: str) -> Message:
    """Request of slam_toolbox/SerializePoseGraph; ``file_name`` is without a suffix."""
    return {"filename": file_name}


def encode_deserialize_map(file_name: str, *, match_type: int, at: Pose2D | None = None) -> Message:
    """Request of slam_toolbox/DeserializePoseGraph. ``at`` is the robot's pose, for match types that need it."""
    pose = at or Pose2D(0.0, 0.0, 0.0)
    return {
        "filename": file_name,
        "match_type": match_type,
        "initial_pose": {"x": pose.x_m, "y": pose.y_m, "theta": pose.heading_rad},
    }


def encode_load_map(map_url: str) -> Message:
    """Request of nav2_msgs/LoadMap, and of nav_msgs/LoadMap of ROS 1."""
    return {"map_url": map_url}


def encode_save_map(map_url: str, *, map_topic: str) -> Message:
    """Request of nav2_msgs/SaveMap, with the usual thresholds."""
    return {
        "map_topic": map_topic,
        "map_url": map_url,
        "image_format": "pgm",
        "map_mode": "trinary",
        "free_thresh": 0.25,
        "occupied_thresh": 0.65,
    }


def serialize_failure(answer: Any) -> str:
    """Reason of a failed slam_toolbox/SerializePoseGraph; empty on success. Old versions return nothing."""
    result = message_of(answer, "SerializePoseGraph").get("result", 0)
    code = count({"result": result}, "result", "SerializePoseGraph", most=255)
    return "" if code == 0 else _SERIALIZING_FAILED.get(code, f"the robot responded with error {code}")


def load_failure(answer: Any) -> str:
    """Reason of a failed LoadMap; empty on success."""
    code = count(message_of(answer, "LoadMap"), "result", "LoadMap", most=255)
    return "" if code == 0 else _LOADING_FAILED.get(code, f"the robot responded with error {code}")


def save_failure(answer: Any) -> str:
    """Reason of a failed nav2_msgs/SaveMap; empty on success."""
    return "" if truth(message_of(answer, "SaveMap"), "result", "SaveMap") else "the robot gave no reason"
