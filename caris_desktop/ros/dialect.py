"""Differences between ROS 1 and ROS 2 in rosbridge's protocol: type names and time."""

from enum import Enum
from typing import Any

_NS_PER_S = 1_000_000_000
_KINDS_IN_TYPE_NAMES = frozenset({"msg", "srv", "action"})


class Dialect(Enum):
    """ROS version of the other side."""

    ROS1 = 1
    ROS2 = 2


def type_name(dialect: Dialect, package: str, name: str) -> str:
    """Message type name: ``geometry_msgs/Twist`` or ``geometry_msgs/msg/Twist``."""
    return f"{package}/{name}" if dialect is Dialect.ROS1 else f"{package}/msg/{name}"


def service_type_name(dialect: Dialect, package: str, name: str) -> str:
    """Service type name: ``std_srvs/SetBool`` or ``std_srvs/srv/SetBool``."""
    return f"{package}/{name}" if dialect is Dialect.ROS1 else f"{package}/srv/{name}"


def action_type_name(dialect: Dialect, package: str, name: str) -> str:
    """Action type name: ``move_base_msgs/MoveBaseAction`` or ``nav2_msgs/action/NavigateToPose``."""
    return f"{package}/{name}Action" if dialect is Dialect.ROS1 else f"{package}/action/{name}"


def same_type(one: str, other: str) -> bool:
    """True if two type names mean the same type, in either dialect."""
    return plain_name(one) == plain_name(other)


def plain_name(type_: str) -> str:
    """Type name in ROS 1 spelling, from either dialect."""
    return "/".join(part for part in type_.split("/") if part not in _KINDS_IN_TYPE_NAMES)


def package_and_name(type_: str) -> tuple[str, str]:
    """Package and name of a message or service type, from either dialect."""
    package, _, name = plain_name(type_).partition("/")
    return package, name


def encode_time(dialect: Dialect, time_ns: int) -> dict[str, int]:
    """Encode a ROS time: ``{secs, nsecs}`` or ``{sec, nanosec}``."""
    seconds, nanoseconds = divmod(time_ns, _NS_PER_S)
    if dialect is Dialect.ROS1:
        return {"secs": seconds, "nsecs": nanoseconds}
    return {"sec": seconds, "nanosec": nanoseconds}


def decode_time(value: Any) -> int | None:
    """Nanoseconds of a ROS time in either spelling; None for zero, which means unstamped.

    Raises
    ------
    ValueError
        When ``value`` is not a ROS time.
    """
    if isinstance(value, dict):
        for seconds_key, nanoseconds_key in (("secs", "nsecs"), ("sec", "nanosec")):
            if seconds_key in value:
                seconds, nanoseconds = value[seconds_key], value.get(nanoseconds_key, 0)
                if _is_count(seconds) and _is_count(nanoseconds):
                    return int(seconds) * _NS_PER_S + int(nanoseconds) or None
    raise ValueError("a time must be an object with secs and nsecs, or sec and nanosec, as integers")


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**63
