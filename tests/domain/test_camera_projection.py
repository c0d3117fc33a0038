"""Pinhole camera on the robot: from pixels to the floor and back."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from caris_desktop.domain.camera_projection import CameraModel

CAMERA = CameraModel.from_field_of_view(width_px=640, height_px=480, horizontal_rad=math.radians(60))


def test_the_centre_of_a_level_camera_is_on_the_horizon() -> None:
    assert CAMERA.floor_point(320, 240) is None
    assert CAMERA.floor_point(320, 100) is None


def test_a_camera_one_metre_up_and_45_degrees_down_sees_the_floor_one_metre_ahead() -> None:
    tilted = replace(CAMERA, tilt_rad=math.pi / 4, x_m=0.2)
    assert tilted.floor_point(320, 240) == pytest.approx((1.2, 0.0))


def test_left_in_the_picture_is_left_of_the_robot() -> None:
    point = CAMERA.floor_point(100, 400)
    assert point is not None and point[1] > 0
    assert CAMERA.bearing_rad(0) == pytest.approx(math.radians(30))


@given(
    u_px=st.floats(0, 640), v_px=st.floats(260, 480), heading=st.floats(-3, 3), tilt=st.floats(0, 0.6),
    z_m=st.floats(0.3, 2),
)  # fmt: skip
def test_the_floor_point_of_a_pixel_is_seen_in_that_pixel(
    u_px: float, v_px: float, heading: float, tilt: float, z_m: float
) -> None:
    camera = replace(CAMERA, heading_rad=heading, tilt_rad=tilt, z_m=z_m, x_m=0.1, y_m=-0.05)
    point = camera.floor_point(u_px, v_px)
    assert point is not None
    assert camera.pixel_of(*point, 0.0) == pytest.approx((u_px, v_px), abs=1e-4)


def test_a_point_behind_the_camera_has_no_pixel() -> None:
    assert CAMERA.pixel_of(-1.0, 0.0, 1.0) is None


def test_a_smaller_picture_sees_the_same() -> None:
    assert CAMERA.scaled_to(320, 240).floor_point(50, 200) == pytest.approx(CAMERA.floor_point(100, 400))


def test_only_a_camera_on_the_head_turns_with_it() -> None:
    assert CAMERA.with_head_at(pan_rad=1.0, tilt_rad=0.1) == CAMERA
    turned = replace(CAMERA, on_head=True).with_head_at(pan_rad=1.0, tilt_rad=0.1)
    assert turned.bearing_rad(320) == pytest.approx(1.0)
