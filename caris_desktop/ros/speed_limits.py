"""Speed limit messages for navigation: nav2_msgs/SpeedLimit (ROS 2) and dynamic_reconfigure/Reconfigure (ROS 1)."""

from collections.abc import Sequence
from typing import Any

from caris_desktop.ros.dialect import Dialect, encode_time
from caris_desktop.ros.message_fields import Message, MessageError, message_of, number

NO_LIMIT = 0.0
"""``speed_limit`` of nav2_msgs/SpeedLimit that lifts an earlier one."""


def encode_speed_limit(limit_mps: float) -> Message:
    """Encode nav2_msgs/SpeedLimit, absolute in m/s; :data:`NO_LIMIT` lifts it. Nav2's controllers never exceed their
    own.
    """
    header = {"stamp": encode_time(Dialect.ROS2, 0), "frame_id": ""}
    return {"header": header, "percentage": False, "speed_limit": limit_mps}


def decode_speed_limit(message: Message) -> tuple[float, bool]:
    """Limit, and whether it is a percentage."""
    percentage = message.get("percentage", False)
    if not isinstance(percentage, bool):
        raise MessageError("SpeedLimit.percentage must be true or false")
    return number(message, "speed_limit", "SpeedLimit"), percentage


def encode_reconfigure(doubles: dict[str, float]) -> Message:
    """Request of dynamic_reconfigure/Reconfigure that sets only these parameters."""
    values = [{"name": name, "value": value} for name, value in doubles.items()]
    return {"config": {"bools": [], "ints": [], "strs": [], "doubles": values, "groups": []}}


def decode_reconfigured(answer: Any, names: Sequence[str]) -> dict[str, float]:
    """Present values of the named parameters in the answer of dynamic_reconfigure/Reconfigure."""
    config = message_of(message_of(answer, "Reconfigure").get("config", {}), "Reconfigure.config")
    doubles = config.get("doubles", [])
    if not isinstance(doubles, list):
        raise MessageError("Reconfigure.config.doubles must be a list")
    parameters = [message_of(double, "DoubleParameter") for double in doubles]
    return {str(one["name"]): number(one, "value", "DoubleParameter") for one in parameters if one.get("name") in names}
