"""Obstacle in the direction of the base, within the LIDAR's field of view, independent of the camera."""

import dataclasses
import math

import numpy as np
import pytest

from caris_desktop.domain import clock
from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import FrameRef, HeadState, LaserScan
from caris_desktop.live.status import DriveStatus
from caris_desktop.robot.profile_model import CameraTopic, RobotProfile
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.video_panel import VideoPanel, guard_chip
from caris_desktop.ui.robot_motion import Ahead, ahead_of, ahead_words, gaze_is_away
from tests.ui import samples
from tests.ui.conftest import freshen
from tests.ui.fake_console import FakeConsole

SCAN = samples.scan_at(Pose2D(2.0, 4.0, math.pi))
FRAME = FrameRef(1, None, "front", "ring", 0, 1, 640, 480)
MODEL = CameraModel.from_field_of_view(width_px=320, height_px=240, horizontal_rad=1.2)


def scan_from(first_deg: float, last_deg: float, range_m: float, *, mounted_deg: float = 0.0) -> LaserScan:
    """Scan with one beam per degree, all of the same length."""
    beams = round(last_deg - first_deg) + 1
    return LaserScan(
        1, None, "laser", math.radians(first_deg), math.radians(1.0), 0.1, 10.0,
        np.full(beams, range_m, np.float32), Pose2D(0.0, 0.0, math.radians(mounted_deg)),
    )  # fmt: skip


def robot_with(model: CameraModel | None) -> RobotProfile:
    return RobotProfile("lab", "Lab", cameras=(CameraTopic("front", "/camera", model=model),))


def test_the_distance_comes_from_the_beams_in_front() -> None:
    assert ahead_of(SCAN).distance_m == pytest.approx(2.0, abs=0.1)
    nothing = dataclasses.replace(SCAN, ranges_m=np.full_like(SCAN.ranges_m, np.inf))
    assert ahead_of(nothing) == Ahead(None, 1.0)
    assert ahead_of(dataclasses.replace(SCAN, robot_from_laser=None)) == Ahead(None, 0.0)


@pytest.mark.parametrize(
    ("scan", "covered"),
    [
        (scan_from(-90, 90, math.inf), 1.0),
        (scan_from(-90, 90, math.inf, mounted_deg=180), 0.0),
        (scan_from(90, 270, math.inf), 0.0),
        (scan_from(0, 90, math.inf), 0.5),
        (scan_from(-180, 180, math.nan), 0.0),
        (scan_from(-180, 180, -1.0), 0.0),
        (scan_from(-180, 180, 0.0), 1.0),
    ],
)
def test_beyond_the_lidar_nothing_is_called_free(scan: LaserScan, covered: float) -> None:
    ahead = ahead_of(scan)
    assert ahead.distance_m is None
    assert ahead.covered == pytest.approx(covered, abs=0.06)
    text, _warns = ahead_words(ahead)
    assert text.startswith(
        {1.0: "Nothing within range ahead", 0.0: "No LIDAR coverage ahead"}.get(covered, "Nothing detected ahead; LI")
    )


def test_the_words_describe_the_base_while_the_picture_points_elsewhere() -> None:
    head = HeadState(1, None, pan_rad=0.6, tilt_rad=0.0)
    on_head = robot_with(dataclasses.replace(MODEL, on_head=True))
    assert gaze_is_away(on_head, FRAME, head) == "the camera faces left"
    assert gaze_is_away(on_head, FRAME, dataclasses.replace(head, pan_rad=-0.6)) == "the camera faces right"
    assert gaze_is_away(on_head, FRAME, dataclasses.replace(head, pan_rad=0.1)) == ""
    assert gaze_is_away(on_head, FRAME, None) == "the head may be turned"
    assert gaze_is_away(robot_with(MODEL), FRAME, head) == "", "this camera is not on the head"
    assert gaze_is_away(robot_with(dataclasses.replace(MODEL, heading_rad=math.pi)), FRAME, None) == (
        "the camera faces backward"
    )
    assert gaze_is_away(robot_with(None), FRAME, None) == gaze_is_away(None, None, None) == ""
    assert ahead_words(Ahead(0.4, 1.0), "the camera faces left") == (
        "Close! Obstacle 0.4 m ahead of the base · the camera faces left",
        True,
    )


def test_the_video_says_so(window: MainWindow, console: FakeConsole) -> None:
    panel = window.panels["video"]
    assert isinstance(panel, VideoPanel)
    console.state.robot.set(robot_with(dataclasses.replace(MODEL, on_head=True)))
    console.state.add(HeadState(clock.now_ns(), None, 0.6, 0.0))
    freshen(console)
    panel._refresh()
    chip_text = next(text for text, _role in panel.view.chips if "ahead" in text)
    assert chip_text.endswith("ahead of the base · the camera faces left")
    console.state.add(dataclasses.replace(scan_from(90, 270, 2.0), stamp_ns=clock.now_ns()))
    panel._refresh()
    assert any(text.startswith("No LIDAR coverage ahead of the base") for text, _role in panel.view.chips)


def test_a_guard_that_does_not_see_says_why() -> None:
    blind = DriveStatus(True, "", guard="blind", guard_detail="the LIDAR does not cover this direction")
    assert guard_chip(blind) == ("The guard allows crawling only: the LIDAR does not cover this direction", "warning")


@pytest.mark.parametrize("nothing_m", [0.0, -0.0, 1e-45])
def test_a_beam_without_an_answer_is_no_obstacle_where_the_driver_writes_zero(nothing_m: float) -> None:
    """Data of ``cases/messages``: range_min is 0, and two of three beams read 0."""
    ranges_m = np.full(SCAN.ranges_m.size, 2.0, np.float32)
    ranges_m[::3] = ranges_m[1::3] = nothing_m
    scan = dataclasses.replace(SCAN, range_min_m=0.0, ranges_m=ranges_m)
    assert scan.robot_from_laser is not None
    assert ahead_of(scan).distance_m == pytest.approx(2.0 + scan.robot_from_laser.x_m)
    assert len(scan.points(scan.robot_from_laser)) == np.count_nonzero(ranges_m > 1.0)
