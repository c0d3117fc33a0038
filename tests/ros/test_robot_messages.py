"""Round trips of paths, map updates, joints, clocks and map services in both encodings and both ROS versions."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.ros import message_conversion
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ros.message_conversion import decode_pose_with_covariance_stamped
from caris_desktop.ros.message_fields import MessageError
from tests.ros.test_message_conversion import STAMP_NS, both_dialects, both_wires

Wire = Callable[[dict[str, Any]], dict[str, Any]]


@both_dialects
@both_wires
def test_a_path(dialect: Dialect, wire: Wire) -> None:
    points = np.array([[0.5, 1.0], [2.0, -3.0]], np.float32)
    path = message_conversion.decode_path(
        wire(message_conversion.encode_path(dialect, points, stamp_ns=STAMP_NS, frame_id="/odom"))
    )
    assert (path.frame_id, path.robot_stamp_ns) == ("odom", STAMP_NS)
    assert path.points_m.tolist() == points.tolist()
    empty = message_conversion.encode_path(dialect, points[:0], stamp_ns=STAMP_NS)
    assert message_conversion.decode_path(wire(empty)).points_m.shape == (0, 2)


def test_a_long_path_is_thinned_evenly_and_keeps_both_ends() -> None:
    points = np.stack([np.arange(1201), np.zeros(1201)], axis=1).astype(np.float32)
    message = message_conversion.encode_path(Dialect.ROS1, points, stamp_ns=STAMP_NS)
    few = message_conversion.decode_path(message, most_points=500).points_m
    assert (few[0].tolist(), few[-1].tolist(), len(few)) == ([0.0, 0.0], [1200.0, 0.0], 500)
    assert np.diff(few[:, 0]).max() <= 3.0
    assert len(message_conversion.decode_path(message).points_m) == 1201


@both_dialects
@both_wires
def test_a_map_update(dialect: Dialect, wire: Wire) -> None:
    cells = np.array([[-1, 0, 100]], np.int8)
    update = message_conversion.decode_occupancy_grid_update(
        wire(message_conversion.encode_occupancy_grid_update(dialect, cells, x=7, y=9, stamp_ns=STAMP_NS))
    )
    assert (update.x, update.y, update.cells.tolist()) == (7, 9, cells.tolist())


def test_a_map_update_of_another_size_than_it_says_is_refused() -> None:
    message = {"x": 0, "y": 0, "width": 2, "height": 2, "data": [0, 0, 0]}
    with pytest.raises(MessageError, match="3 cells, but its size is 2 x 2"):
        message_conversion.decode_occupancy_grid_update(message)


@both_dialects
@both_wires
def test_an_initial_pose_carries_its_spread(dialect: Dialect, wire: Wire) -> None:
    message = wire(
        message_conversion.encode_pose_with_covariance_stamped(
            dialect, Pose2D(1.0, 2.0, 0.5), spread_m=0.5, spread_rad=0.2, stamp_ns=0, frame_id="world"
        )
    )
    assert message["header"]["frame_id"] == "world"
    assert decode_pose_with_covariance_stamped(message, stamp_ns=0).pose_in_map.heading_rad == pytest.approx(0.5)
    covariance = message["pose"]["covariance"]
    assert (covariance[0], covariance[7], covariance[35]) == pytest.approx((0.25, 0.25, 0.04))
    assert sum(covariance) == pytest.approx(0.54)


@both_dialects
@both_wires
def test_a_clock(dialect: Dialect, wire: Wire) -> None:
    assert message_conversion.decode_clock(wire(message_conversion.encode_clock(dialect, STAMP_NS))) == STAMP_NS
    assert message_conversion.decode_clock(wire(message_conversion.encode_clock(dialect, 0))) == 0


@both_dialects
@both_wires
def test_joints(dialect: Dialect, wire: Wire) -> None:
    state = message_conversion.decode_joint_state(
        wire(message_conversion.encode_joint_state(dialect, {"pan": 0.5, "tilt": float("nan")}, stamp_ns=STAMP_NS))
    )
    assert state.positions == {"pan": 0.5} if wire.__name__ == "over_cbor" else state.positions["pan"] == 0.5
    trajectory = wire(message_conversion.encode_joint_trajectory(dialect, {"pan": 0.5, "tilt": -0.25}, duration_s=1.5))
    assert message_conversion.decode_joint_trajectory(trajectory) == ({"pan": 0.5, "tilt": -0.25}, 1.5)
    angles = wire(message_conversion.encode_joint_angles_with_speed(dialect, {"pan": 0.5}, speed_fraction=0.125))
    assert message_conversion.decode_joint_angles_with_speed(angles) == ({"pan": 0.5}, 0.125)


def test_a_joint_without_a_position_is_left_out() -> None:
    assert message_conversion.decode_joint_state({"name": ["a", "b"], "position": [1.0]}).positions == {"a": 1.0}
    assert message_conversion.decode_joint_state({"name": ["a"]}).positions == {}


def test_a_trajectory_with_too_few_positions_is_refused() -> None:
    with pytest.raises(MessageError, match="2 joints"):
        message_conversion.decode_joint_trajectory({"joint_names": ["a", "b"], "points": [{"positions": [1.0]}]})


@both_wires
def test_map_services(wire: Wire) -> None:
    assert wire(message_conversion.encode_serialize_map("maps/lab")) == {"filename": "maps/lab"}
    request = message_conversion.encode_deserialize_map(
        "lab", match_type=message_conversion.LOCALIZE_AT_POSE, at=Pose2D(1.0, 2.0, 3.0)
    )
    pose = {"x": 1.0, "y": 2.0, "theta": 3.0}
    assert wire(request) == {"filename": "lab", "match_type": 3, "initial_pose": pose}
    assert message_conversion.load_failure({"result": 0}) == ""
    assert message_conversion.load_failure({"result": 1}) == "the robot has no such map"
    assert message_conversion.save_failure({"result": False})
    assert message_conversion.serialize_failure({}) == ""
    assert message_conversion.serialize_failure({"result": 255}) == "the file cannot be written"
