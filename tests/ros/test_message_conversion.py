"""Round trips of messages in both encodings, and a single error type for malformed ones."""

import copy
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import BatteryState, LaserScan, OccupancyGrid, Odometry
from caris_desktop.ros import action_messages, message_conversion, rosbridge
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ros.message_fields import MessageError, decode_heading, encode_heading
from tests.support.examples import examples

STAMP_NS = 1_700_000_000_000_000_005
NOW_NS = 77
POSE = Pose2D(1.25, -3.5, 2.0)

Wire = Callable[[dict[str, Any]], dict[str, Any]]


def over_json(message: dict[str, Any]) -> dict[str, Any]:
    text = rosbridge.encode_json({"op": "publish", "topic": "/t", "msg": message})
    decoded: dict[str, Any] = rosbridge.decode_json(text)["msg"]
    return decoded


def over_cbor(message: dict[str, Any]) -> dict[str, Any]:
    content = rosbridge.encode_cbor({"op": "publish", "topic": "/t", "msg": message})
    decoded: dict[str, Any] = rosbridge.decode_cbor(content)["msg"]
    return decoded


both_wires = pytest.mark.parametrize("wire", [over_json, over_cbor])
both_dialects = pytest.mark.parametrize("dialect", list(Dialect))


def scan(ranges_m: list[float]) -> LaserScan:
    return LaserScan(
        stamp_ns=0,
        robot_stamp_ns=None,
        frame_id="laser",
        angle_min_rad=-1.0,
        angle_increment_rad=0.5,
        range_min_m=0.1,
        range_max_m=12.0,
        ranges_m=np.array(ranges_m, dtype=np.float32),
        robot_from_laser=POSE,
    )


def grid() -> OccupancyGrid:
    cells = np.array([[-1, 0, 100], [0, 0, 50]], dtype=np.int8)
    return OccupancyGrid(0, None, 0.05, POSE, cells)


def move_base_feedback(status: action_messages.GoalStatus) -> dict[str, Any]:
    at = message_conversion.encode_pose_stamped(Dialect.ROS1, POSE, stamp_ns=STAMP_NS)
    return action_messages.encode_action_feedback(status, {"base_position": at}, stamp_ns=STAMP_NS)


def close(one: Pose2D, other: Pose2D) -> bool:
    return (one.x_m, one.y_m, one.heading_rad) == pytest.approx((other.x_m, other.y_m, other.heading_rad))


@both_wires
def test_twist(wire: Wire) -> None:
    twist = Twist2D(0.25, -0.1, 1.5)
    assert message_conversion.decode_twist(wire(message_conversion.encode_twist(twist))) == twist


@both_wires
@both_dialects
def test_twist_stamped(wire: Wire, dialect: Dialect) -> None:
    message = message_conversion.encode_twist_stamped(dialect, Twist2D(0.5), stamp_ns=STAMP_NS)
    assert message_conversion.decode_twist_stamped(wire(message)) == (Twist2D(0.5), STAMP_NS)


@both_dialects
def test_a_scan_keeps_what_each_form_can_hold(dialect: Dialect) -> None:
    message = message_conversion.encode_laser_scan(dialect, scan([1.5, math.inf, math.nan]), stamp_ns=STAMP_NS)
    from_json = message_conversion.decode_laser_scan(over_json(message), stamp_ns=NOW_NS)
    from_cbor = message_conversion.decode_laser_scan(over_cbor(message), stamp_ns=NOW_NS)
    assert from_json.ranges_m.tolist() == [1.5, math.inf, math.inf]
    assert from_cbor.ranges_m[:2].tolist() == [1.5, math.inf]
    assert math.isnan(from_cbor.ranges_m[2])
    assert from_json.ranges_m.dtype == from_cbor.ranges_m.dtype == np.float32
    assert (from_json.stamp_ns, from_json.robot_stamp_ns, from_json.frame_id) == (NOW_NS, STAMP_NS, "laser")


@both_wires
@both_dialects
def test_a_scan_keeps_its_intensities(wire: Wire, dialect: Dialect) -> None:
    bright = replace(scan([1.5, 2.5]), intensities=np.array([47.0, 1023.5], np.float32))
    message = message_conversion.encode_laser_scan(dialect, bright, stamp_ns=STAMP_NS)
    decoded = message_conversion.decode_laser_scan(wire(message), stamp_ns=NOW_NS)
    assert decoded.intensities.dtype == np.float32
    assert decoded.intensities.tolist() == [47.0, 1023.5]
    del message["intensities"]
    assert message_conversion.decode_laser_scan(wire(message), stamp_ns=NOW_NS).intensities.tolist() == []


@both_wires
@both_dialects
def test_odometry(wire: Wire, dialect: Dialect) -> None:
    message = message_conversion.encode_odometry(
        dialect, Odometry(0, None, POSE, Twist2D(0.1, 0.0, 0.2)), stamp_ns=STAMP_NS
    )
    decoded = message_conversion.decode_odometry(wire(message), stamp_ns=NOW_NS)
    assert close(decoded.pose_in_odom, POSE)
    assert decoded.twist == Twist2D(0.1, 0.0, 0.2)
    assert decoded.robot_stamp_ns == STAMP_NS


@both_wires
@both_dialects
def test_poses(wire: Wire, dialect: Dialect) -> None:
    plain = message_conversion.decode_pose_stamped(
        wire(message_conversion.encode_pose_stamped(dialect, POSE, stamp_ns=STAMP_NS)), stamp_ns=NOW_NS
    )
    with_covariance = message_conversion.decode_pose_with_covariance_stamped(
        wire(message_conversion.encode_pose_with_covariance_stamped(dialect, POSE, stamp_ns=STAMP_NS)), stamp_ns=NOW_NS
    )
    assert close(plain.pose_in_map, POSE)
    assert close(with_covariance.pose_in_map, POSE)
    assert plain.robot_stamp_ns == with_covariance.robot_stamp_ns == STAMP_NS


@both_wires
@both_dialects
def test_a_map(wire: Wire, dialect: Dialect) -> None:
    decoded = message_conversion.decode_occupancy_grid(
        wire(message_conversion.encode_occupancy_grid(dialect, grid(), stamp_ns=STAMP_NS)), stamp_ns=NOW_NS
    )
    assert decoded.cells.tolist() == grid().cells.tolist()
    assert decoded.cells.dtype == np.int8
    assert close(decoded.origin_in_map, POSE)


@both_wires
@both_dialects
def test_transforms(wire: Wire, dialect: Dialect) -> None:
    message = message_conversion.encode_tf_message(dialect, [("map", "odom", POSE)], stamp_ns=STAMP_NS)
    (transform,) = message_conversion.decode_tf_message(wire(message))
    assert (transform.parent_frame, transform.child_frame) == ("map", "odom")
    assert close(transform.parent_from_child, POSE)
    assert transform.robot_stamp_ns == STAMP_NS


@both_wires
@pytest.mark.parametrize("fraction", [None, 0.0, 0.5, 1.0])
def test_battery(wire: Wire, fraction: float | None) -> None:
    message = message_conversion.encode_battery_state(Dialect.ROS1, BatteryState(0, fraction), stamp_ns=STAMP_NS)
    assert message_conversion.decode_battery_state(wire(message), stamp_ns=NOW_NS) == BatteryState(NOW_NS, fraction)


def test_a_battery_in_percent_is_understood() -> None:
    assert message_conversion.decode_battery_state({"percentage": 80.0}, stamp_ns=0).charge_fraction == pytest.approx(
        0.8
    )


@both_wires
def test_an_image(wire: Wire) -> None:
    content = bytes(range(256))
    message = message_conversion.encode_compressed_image(Dialect.ROS1, content, stamp_ns=STAMP_NS)
    image = message_conversion.decode_compressed_image(wire(message))
    assert (image.encoding, image.content, image.robot_stamp_ns) == ("jpeg", content, STAMP_NS)


@both_wires
def test_small_ones(wire: Wire) -> None:
    assert message_conversion.decode_string(wire(message_conversion.encode_string("Grüße"))) == "Grüße"
    assert message_conversion.decode_bool(wire(message_conversion.encode_bool(True))) is True


@given(st.floats(-math.pi + 1e-6, math.pi))
def test_headings_come_back(heading_rad: float) -> None:
    assert decode_heading(encode_heading(heading_rad), "q") == pytest.approx(heading_rad, abs=1e-9)


def test_a_scaled_quaternion_is_the_same_heading() -> None:
    assert decode_heading({"x": 0, "y": 0, "z": 1e200, "w": 1e200}, "q") == pytest.approx(math.pi / 2)


@both_wires
def test_a_goal_of_ros1(wire: Wire) -> None:
    target = action_messages.encode_move_base_target(POSE, stamp_ns=0)
    goal = wire(action_messages.encode_action_goal("g1", target, stamp_ns=STAMP_NS))
    assert goal["goal_id"]["id"] == "g1"
    assert close(message_conversion.decode_pose_stamped(goal["goal"]["target_pose"], stamp_ns=0).pose_in_map, POSE)
    status = action_messages.GoalStatus("g1", action_messages.SUCCEEDED, "there")
    told, result = action_messages.decode_action_result(
        wire(action_messages.encode_action_result(status, {}, stamp_ns=STAMP_NS)), "MoveBaseActionResult"
    )
    assert (told, told.ending, result) == (status, "reached", {})
    active = action_messages.GoalStatus("g1", action_messages.ACTIVE)
    told, values = action_messages.decode_action_feedback(wire(move_base_feedback(active)), "MoveBaseActionFeedback")
    assert told.goal_id == "g1"
    feedback = action_messages.decode_move_base_feedback(values)
    assert feedback.pose_in_map is not None
    assert close(feedback.pose_in_map, POSE)
    array = wire(action_messages.encode_goal_status_array([active, status], stamp_ns=STAMP_NS))
    assert action_messages.decode_goal_status_array(array) == (active, status)


@both_wires
def test_a_goal_of_ros2(wire: Wire) -> None:
    target = action_messages.decode_navigate_to_pose_goal(
        wire(action_messages.encode_navigate_to_pose_goal(POSE, stamp_ns=STAMP_NS))
    )
    assert close(target, POSE)
    values = action_messages.encode_navigate_to_pose_feedback(
        POSE, distance_left_m=2.5, time_left_s=4.0, elapsed_s=1.0, stamp_ns=STAMP_NS
    )
    assert action_messages.decode_navigate_to_pose_feedback(wire(values)).distance_left_m == 2.5


@both_wires
@pytest.mark.parametrize("uuid", [list(range(16)), bytes(range(16))])
def test_goals_of_ros2_are_known_by_their_uuid(wire: Wire, uuid: Any) -> None:
    entry = {"goal_info": {"goal_id": {"uuid": uuid}, "stamp": {"sec": 1, "nanosec": 0}}, "status": 2}
    [(uuid_hex, status)] = action_messages.decode_ros2_goal_status_array(wire({"status_list": [entry]}))
    assert (bytes.fromhex(uuid_hex), status) == (bytes(range(16)), action_messages.ROS2_EXECUTING)
    cancel = wire(action_messages.encode_cancel_goal(uuid_hex))
    assert cancel["goal_info"]["goal_id"]["uuid"] == list(range(16))
    assert not action_messages.means_every_goal(cancel)


@pytest.mark.parametrize(
    "spelled", ["pal_interaction_msgs/TtsAction", "pal_interaction_msgs/Tts", "pal_interaction_msgs/action/Tts"]
)
def test_an_action_type_may_be_spelled_in_either_dialect(spelled: str) -> None:
    assert action_messages.action_package_and_name(spelled) == ("pal_interaction_msgs", "Tts")


@both_wires
def test_only_a_zero_id_with_the_zero_time_cancels_every_goal(wire: Wire) -> None:
    assert action_messages.means_every_goal(wire(action_messages.encode_cancel_every_goal()))
    assert action_messages.means_every_goal(wire({}))
    assert action_messages.means_every_goal(wire({"goal_info": {"goal_id": {"uuid": bytes(16)}}}))
    for info in (
        {"goal_id": {"uuid": [200, *range(15)]}},
        {"goal_id": {"uuid": bytes(range(16))}},
        {"stamp": {"sec": 3, "nanosec": 0}},
    ):
        assert not action_messages.means_every_goal(wire({"goal_info": info}))


@pytest.mark.parametrize(
    ("operation", "ending"),
    [
        ({"status": 4, "result": True, "values": {}}, "reached"),
        ({"status": 5, "result": True, "values": {}}, "cancelled"),
        ({"status": 6, "result": True, "values": {"error_msg": "no way"}}, "failed"),
        ({"status": 0, "result": False, "values": "no such action"}, "failed"),
        ({"result": False, "values": "no such action"}, "failed"),
        ({"result": True, "values": {}}, "reached"),
    ],
)
def test_the_end_of_a_goal_of_ros2(operation: dict[str, Any], ending: str) -> None:
    assert action_messages.decode_ros2_result({"id": "g", **operation}).ending == ending


DECODERS: dict[str, tuple[Callable[[Any], Any], dict[str, Any]]] = {
    "twist": (message_conversion.decode_twist, message_conversion.encode_twist(Twist2D(1.0))),
    "twist_stamped": (
        message_conversion.decode_twist_stamped,
        message_conversion.encode_twist_stamped(Dialect.ROS2, Twist2D(1.0), stamp_ns=STAMP_NS),
    ),
    "scan": (
        lambda message: message_conversion.decode_laser_scan(message, stamp_ns=0),
        over_json(message_conversion.encode_laser_scan(Dialect.ROS1, scan([1.0, 2.0]), stamp_ns=STAMP_NS)),
    ),
    "odometry": (
        lambda message: message_conversion.decode_odometry(message, stamp_ns=0),
        message_conversion.encode_odometry(Dialect.ROS1, Odometry(0, None, POSE, Twist2D()), stamp_ns=STAMP_NS),
    ),
    "amcl_pose": (
        lambda message: message_conversion.decode_pose_with_covariance_stamped(message, stamp_ns=0),
        message_conversion.encode_pose_with_covariance_stamped(Dialect.ROS1, POSE, stamp_ns=STAMP_NS),
    ),
    "map": (
        lambda message: message_conversion.decode_occupancy_grid(message, stamp_ns=0),
        over_json(message_conversion.encode_occupancy_grid(Dialect.ROS1, grid(), stamp_ns=STAMP_NS)),
    ),
    "tf": (
        message_conversion.decode_tf_message,
        message_conversion.encode_tf_message(Dialect.ROS1, [("map", "odom", POSE)], stamp_ns=STAMP_NS),
    ),
    "battery": (
        lambda message: message_conversion.decode_battery_state(message, stamp_ns=0),
        over_json(message_conversion.encode_battery_state(Dialect.ROS1, BatteryState(0, 0.5), stamp_ns=STAMP_NS)),
    ),
    "image": (
        message_conversion.decode_compressed_image,
        over_json(message_conversion.encode_compressed_image(Dialect.ROS1, b"abc", stamp_ns=STAMP_NS)),
    ),
    "camera_info": (
        message_conversion.decode_camera_info,
        over_json(
            message_conversion.encode_camera_info(
                Dialect.ROS1, CameraModel(2, 2, 1.0, 1.0, 1.0, 1.0), stamp_ns=STAMP_NS
            )
        ),
    ),
    "string": (message_conversion.decode_string, message_conversion.encode_string("hello")),
    "bool": (message_conversion.decode_bool, message_conversion.encode_bool(True)),
    "result": (
        lambda message: action_messages.decode_action_result(message, "result"),
        action_messages.encode_action_result(action_messages.GoalStatus("g", 3), {}, stamp_ns=STAMP_NS),
    ),
    "feedback": (
        lambda message: action_messages.decode_move_base_feedback(
            action_messages.decode_action_feedback(message, "feedback")[1]
        ),
        move_base_feedback(action_messages.GoalStatus("g", 1)),
    ),
    "status2": (
        action_messages.decode_ros2_goal_status_array,
        {"status_list": [{"goal_info": {"goal_id": {"uuid": [0] * 16}}, "status": 2}]},
    ),
    "path": (
        message_conversion.decode_path,
        over_json(message_conversion.encode_path(Dialect.ROS1, np.ones((2, 2), np.float32), stamp_ns=STAMP_NS)),
    ),
    "map_update": (
        message_conversion.decode_occupancy_grid_update,
        over_json(
            message_conversion.encode_occupancy_grid_update(Dialect.ROS1, grid().cells, x=1, y=2, stamp_ns=STAMP_NS)
        ),
    ),
    "clock": (message_conversion.decode_clock, message_conversion.encode_clock(Dialect.ROS2, STAMP_NS)),
    "joint_state": (
        message_conversion.decode_joint_state,
        over_json(message_conversion.encode_joint_state(Dialect.ROS1, {"a": 1.0}, stamp_ns=STAMP_NS)),
    ),
    "joint_trajectory": (
        message_conversion.decode_joint_trajectory,
        message_conversion.encode_joint_trajectory(Dialect.ROS2, {"a": 1.0}, duration_s=0.5),
    ),
    "joint_angles": (
        message_conversion.decode_joint_angles_with_speed,
        message_conversion.encode_joint_angles_with_speed(Dialect.ROS1, {"a": 1.0}, speed_fraction=0.1),
    ),
    "load_map": (message_conversion.load_failure, {"result": 0}),
    "save_map": (message_conversion.save_failure, {"result": True}),
    "serialize_map": (message_conversion.serialize_failure, {"result": 0}),
    "status": (
        action_messages.decode_goal_status_array,
        action_messages.encode_goal_status_array([action_messages.GoalStatus("g", 1)], stamp_ns=STAMP_NS),
    ),
    "goal2": (
        action_messages.decode_navigate_to_pose_goal,
        action_messages.encode_navigate_to_pose_goal(POSE, stamp_ns=STAMP_NS),
    ),
    "feedback2": (
        action_messages.decode_navigate_to_pose_feedback,
        action_messages.encode_navigate_to_pose_feedback(
            POSE, distance_left_m=1.0, time_left_s=1.0, elapsed_s=1.0, stamp_ns=STAMP_NS
        ),
    ),
    "cancel2": (action_messages.means_every_goal, action_messages.encode_cancel_every_goal()),
    "result2": (action_messages.decode_ros2_result, {"id": "g", "status": 4, "values": {}, "result": True}),
}

anything = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.binary(max_size=5)
    | st.sampled_from(
        [
            np.zeros((2, 2)),
            np.array(3.0),
            np.array(["a"]),
            np.array([1e300]),
            np.array([300, 2]),
            np.float64("nan"),
            10**400,
            1e308,
        ]
    ),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


def paths_in(message: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    inner = message.items() if isinstance(message, dict) else enumerate(message) if isinstance(message, list) else ()
    return [path, *(deeper for key, value in inner for deeper in paths_in(value, (*path, key)))]


@pytest.mark.parametrize("name", list(DECODERS))
@settings(max_examples=examples(40), deadline=None)
@given(data=st.data())
def test_one_field_turned_into_anything_is_decoded_or_refused(name: str, data: st.DataObject) -> None:
    decode, good = DECODERS[name]
    message = copy.deepcopy(good)
    path = data.draw(st.sampled_from(paths_in(message)))
    strange = data.draw(anything)
    if not path:
        message = strange
    else:
        place: Any = message
        for key in path[:-1]:
            place = place[key]
        if data.draw(st.booleans()):
            place[path[-1]] = strange
        else:
            del place[path[-1]]
    try:
        decode(message)
    except MessageError as error:
        assert str(error)


@pytest.mark.parametrize("name", list(DECODERS))
def test_the_good_one_is_decoded(name: str) -> None:
    decode, good = DECODERS[name]
    decode(good)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"data": [0] * 5}, "OccupancyGrid.data has 5 cells, but its size is 3 x 2"),
        ({"data": [0] * 5 + [300]}, "between -128 and 127"),
        ({"data": [0] * 5 + [0.5]}, "only integers"),
        ({"data": "AAAA"}, "must be a list, but it is a text"),
        ({"info": {"width": 2**31, "height": 2**31, "resolution": 0.05}}, "must be between 0 and"),
        ({"info": {"width": 60000, "height": 60000, "resolution": 0.05}}, "at most 64000000 are accepted"),
        ({"info": {"width": 3, "height": 2, "resolution": 0.0}}, "resolution must be above zero"),
    ],
)
def test_a_broken_map_gets_a_sentence(change: dict[str, Any], sentence: str) -> None:
    decode, good = DECODERS["map"]
    with pytest.raises(MessageError, match=sentence):
        decode({**good, **change})


@pytest.mark.parametrize(
    ("linear", "sentence"),
    [
        ({"x": math.nan}, "Twist.linear.x must be a finite number"),
        ({"x": None}, "Twist.linear.x must be a number, but it is null"),
        ({"x": "1"}, "Twist.linear.x must be a number, but it is a text"),
        ({"x": True}, "Twist.linear.x must be a number, but it is a Boolean"),
        ({"x": 10**400}, "Twist.linear.x is too large"),
        ({}, "Twist.linear has no field 'x'"),
    ],
)
def test_a_broken_twist_gets_a_sentence(linear: dict[str, Any], sentence: str) -> None:
    with pytest.raises(MessageError, match=sentence):
        message_conversion.decode_twist({"linear": linear, "angular": {"z": 0.0}})


def test_a_scan_with_too_many_beams_is_refused() -> None:
    _, good = DECODERS["scan"]
    with pytest.raises(MessageError, match="at most 100000 are accepted"):
        message_conversion.decode_laser_scan({**good, "ranges": np.zeros(100_001, dtype=np.float32)}, stamp_ns=0)


@pytest.mark.parametrize(
    "encoding", ["16UC1; compressedDepth", "32FC1; compressedDepth png", "16UC1; compressedDepth rvl"]
)
def test_a_depth_image_is_reported_as_one(encoding: str) -> None:
    message = {"header": {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": "d"}, "format": encoding, "data": "AAAA"}
    with pytest.raises(MessageError, match="depth image"):
        message_conversion.decode_compressed_image(message)
