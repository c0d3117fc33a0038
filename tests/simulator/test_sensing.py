"""LIDAR, map and odometry compared with ground truth."""

import math

import numpy as np
import pytest

from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.simulator import lidar
from caris_desktop.simulator.robot_simulation import Robot
from caris_desktop.simulator.simulated_mapping import RESOLUTION_M, Mapper

NOBODY = np.zeros((0, 3))
IN_THE_CORRIDOR = Pose2D(9.0, 5.0, 0.3)


def test_the_scan_measures_the_building() -> None:
    scan = lidar.scan_from(IN_THE_CORRIDOR, NOBODY, np.random.default_rng(1), stamp_ns=0)
    assert scan.ranges_m.shape == (720,)
    laser = IN_THE_CORRIDOR @ scan.robot_from_laser

    def distance_towards(angle_rad: float) -> float:
        beam = (angle_rad - laser.heading_rad - scan.angle_min_rad) / scan.angle_increment_rad
        return float(scan.ranges_m[round(beam) % 720])

    assert distance_towards(0.0) == pytest.approx(16.0 - 0.06 - laser.x_m, abs=0.06)
    assert distance_towards(math.pi / 2) == pytest.approx(5.8 - 0.06 - laser.y_m, abs=0.06)


def test_it_has_noise_and_nothing_comes_back_from_afar() -> None:
    noise = np.random.default_rng(1)
    scans = [lidar.scan_from(Pose2D(1.0, 5.0, 0.0), NOBODY, noise, stamp_ns=0).ranges_m for _ in range(30)]
    stacked = np.array(scans)
    assert np.isinf(stacked).any()
    returned = np.isfinite(stacked).all(axis=0)
    assert 0.007 < stacked[:, returned].std(axis=0).mean() < 0.013


def test_legs_are_seen() -> None:
    legs = np.array([[10.5, 5.0, 0.06]])
    scan = lidar.scan_from(Pose2D(9.0, 5.0, 0.0), legs, np.random.default_rng(1), stamp_ns=0)
    assert scan.ranges_m[360] == pytest.approx(1.5 - 0.12 - 0.06, abs=0.05)


def test_the_map_grows_and_reports_free_from_occupied() -> None:
    mapper = Mapper()
    noise = np.random.default_rng(1)
    for _ in range(3):
        mapper.add(lidar.scan_from(IN_THE_CORRIDOR, NOBODY, noise, stamp_ns=0), IN_THE_CORRIDOR)
    first = mapper.known_share
    grid = mapper.grid(stamp_ns=5)
    assert mapper.change() is not None

    def cell(x_m: float, y_m: float) -> int:
        return int(
            grid.cells[
                int((y_m - grid.origin_in_map.y_m) / RESOLUTION_M), int((x_m - grid.origin_in_map.x_m) / RESOLUTION_M)
            ]
        )

    assert cell(10.0, 5.0) == 0
    assert cell(2.0, 8.0) == -1
    wall = [cell(9.2, y) for y in np.arange(5.65, 5.85, 0.05)]
    assert 100 in wall
    assert mapper.change() is None
    elsewhere = Pose2D(2.4, 7.2, 0.0)
    mapper.add(lidar.scan_from(elsewhere, NOBODY, noise, stamp_ns=0), elsewhere)
    assert mapper.known_share > first


@pytest.mark.long
def test_odometry_drifts_and_localisation_corrects_it() -> None:
    robot = Robot(seed=3)
    start = robot.truth.pose_in_map
    for step in range(1500):
        robot.drive(Twist2D(0.3, 0.0, 0.6))
        robot.step()
        if step % 5 == 0:
            robot.scan(stamp_ns=0)
    robot.scan(stamp_ns=0)
    truth = robot.truth.pose_in_map
    dead_reckoned = start @ robot.odometry(stamp_ns=0).pose_in_odom
    corrected = robot.map_from_odom @ robot.odometry(stamp_ns=0).pose_in_odom
    assert abs(math.remainder(dead_reckoned.heading_rad - truth.heading_rad, 2 * math.pi)) > 0.02
    assert math.dist((corrected.x_m, corrected.y_m), (truth.x_m, truth.y_m)) < 0.05
