"""Camera direction at the time of a frame."""

import math

import pytest

from caris_desktop.domain.geometry import ZERO_TWIST, Pose2D
from caris_desktop.domain.sensing import HeadState, Odometry
from caris_desktop.perception.camera_schedule import CameraRotation

MS = 1_000_000


def odometry(stamp_ms: int, heading_rad: float) -> Odometry:
    return Odometry(stamp_ms * MS, None, Pose2D(0.0, 0.0, heading_rad), ZERO_TWIST)


def test_between_two_values_and_never_across_the_full_turn() -> None:
    turning = CameraRotation()
    for step in range(10):
        turning.add(odometry(100 * step, math.remainder(3.0 + 0.1 * step, math.tau)))
    assert turning.direction(250 * MS, on_head=False) == (pytest.approx(3.25), 0.0)
    assert turning.direction(850 * MS, on_head=False) == (pytest.approx(3.85), 0.0)
    assert turning.direction(1100 * MS, on_head=False) == (pytest.approx(3.9), 0.0), "the newest, for a while"
    assert turning.direction(2100 * MS, on_head=False) is None


def test_a_head_turns_its_camera_and_no_other() -> None:
    turning = CameraRotation()
    turning.add(odometry(0, 1.0))
    turning.add(HeadState(0, None, 0.5, 0.2))
    assert turning.direction(0, on_head=True) == (pytest.approx(1.5), pytest.approx(0.2))
    assert turning.direction(0, on_head=False) == (pytest.approx(1.0), 0.0)


def test_nothing_is_known_of_a_robot_that_reports_nothing() -> None:
    turning = CameraRotation()
    assert turning.direction(0, on_head=True) is None
    turning.add(odometry(0, 1.0))
    turning.forget()
    assert turning.direction(0, on_head=False) is None
