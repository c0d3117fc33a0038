"""A real laser recording, served over rosbridge, passes unchanged through the control link."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from caris_desktop.domain.sensing import LaserScan
from tests.robot.link_bench import LinkProcess
from tests.support.polling import wait_for
from tests.support.recorded_robot import RecordedRobot

BAG = Path(__file__).parents[3] / "shared" / "data" / "legs_demo_stationary.bag"
FROM_S = 60.0

pytest.importorskip("rosbags", reason="needs the package rosbags, which reads recordings")
pytestmark = pytest.mark.skipif(not BAG.is_file(), reason=f"needs the recording {BAG.name} in shared/data")


def test_each_scan_of_a_recording_arrives_as_it_was_recorded() -> None:
    from tests.support.bag_server import messages

    recorded = {
        message.header.stamp.sec * 10**9 + message.header.stamp.nanosec: message
        for _, _, _, message in messages(BAG, from_s=FROM_S)
    }
    with RecordedRobot(BAG, from_s=FROM_S) as robot:
        link = LinkProcess(robot.address, "generic-ros1")
        try:
            wait_for(lambda: len(link.of(LaserScan)) >= 15, "fifteen scans")
        finally:
            link.close()
    scans = link.of(LaserScan)
    for scan in scans:
        assert scan.robot_stamp_ns is not None
        original = recorded[scan.robot_stamp_ns]
        assert scan.ranges_m.shape == (512,)
        assert np.array_equal(scan.ranges_m, original.ranges, equal_nan=True)
        assert scan.frame_id == original.header.frame_id == "laser"
        assert scan.angle_min_rad == pytest.approx(original.angle_min, abs=1e-9)
        assert scan.angle_increment_rad == pytest.approx(original.angle_increment, abs=1e-9)
        last_rad = scan.angle_min_rad + scan.angle_increment_rad * 511
        assert last_rad == pytest.approx(original.angle_max, abs=1e-4)
        assert scan.range_max_m == pytest.approx(original.range_max)
    assert any(np.isinf(scan.ranges_m).any() for scan in scans)
    assert any(math.isfinite(distance) and distance < 5.0 for distance in scans[0].ranges_m)
    # at the rate of the recording: ten a second, no duplicates, in order
    stamps = [scan.robot_stamp_ns or 0 for scan in scans]
    assert stamps == sorted(set(stamps))
    between_s = [(b.stamp_ns - a.stamp_ns) * 1e-9 for a, b in pairwise(scans)]
    assert np.median(between_s) == pytest.approx(0.1, abs=0.04)
