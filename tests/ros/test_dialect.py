"""Differences between ROS 1 and ROS 2."""

import pytest

from caris_desktop.ros.dialect import (
    Dialect,
    action_type_name,
    decode_time,
    encode_time,
    same_type,
    service_type_name,
    type_name,
)


def test_type_names() -> None:
    assert type_name(Dialect.ROS1, "geometry_msgs", "Twist") == "geometry_msgs/Twist"
    assert type_name(Dialect.ROS2, "geometry_msgs", "Twist") == "geometry_msgs/msg/Twist"
    assert service_type_name(Dialect.ROS1, "std_srvs", "SetBool") == "std_srvs/SetBool"
    assert service_type_name(Dialect.ROS2, "std_srvs", "SetBool") == "std_srvs/srv/SetBool"
    assert action_type_name(Dialect.ROS1, "move_base_msgs", "MoveBase") == "move_base_msgs/MoveBaseAction"
    assert action_type_name(Dialect.ROS2, "nav2_msgs", "NavigateToPose") == "nav2_msgs/action/NavigateToPose"


def test_the_same_type_in_both_dialects() -> None:
    assert same_type("geometry_msgs/Twist", "geometry_msgs/msg/Twist")
    assert not same_type("geometry_msgs/Twist", "geometry_msgs/msg/TwistStamped")


@pytest.mark.parametrize("dialect", list(Dialect))
@pytest.mark.parametrize("time_ns", [1, 1_700_000_000_123_456_789])
def test_times_come_back(dialect: Dialect, time_ns: int) -> None:
    assert decode_time(encode_time(dialect, time_ns)) == time_ns


def test_each_dialect_spells_time_its_own_way() -> None:
    assert encode_time(Dialect.ROS1, 2_000_000_003) == {"secs": 2, "nsecs": 3}
    assert encode_time(Dialect.ROS2, 2_000_000_003) == {"sec": 2, "nanosec": 3}


def test_the_zero_time_means_not_stamped() -> None:
    assert decode_time({"secs": 0, "nsecs": 0}) is None


@pytest.mark.parametrize("value", [None, 3, {}, {"secs": 1.5}, {"sec": "1"}, {"secs": True}, {"secs": 2**70}])
def test_an_invalid_time_is_refused(value: object) -> None:
    with pytest.raises(ValueError, match="a time must be an object"):
        decode_time(value)
