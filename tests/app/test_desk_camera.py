"""Desk camera in addition to the robot's camera: the whole console detects people in both and matches them."""

from pathlib import Path

import pytest

from caris_desktop.domain.shipped import layouts_dir
from tests.perception.shared_data import INT8_WEIGHTS, needs_int8_weights
from tests.support.console_process import ConsoleProcess
from tests.support.simulated_robot import SimulatedRobot

CAMERAS = """
cameras:
  - source: robot
  - source: ADDRESS
    name: desk
    place: Desk
    mount: {width_px: 640, height_px: 480, horizontal_fov_deg: 70, z_m: 1.5, tilt_deg: 14.3}
"""
DESK = "places:\n  - {name: Desk, x_m: 5.2, y_m: 2.6, heading_deg: -170}\n"


@pytest.mark.long  # tests/people tests the same with simulated time
@needs_int8_weights
def test_a_person_before_the_robot_and_the_desk_is_one_row(tmp_path: Path) -> None:
    visits = tmp_path / "visits.csv"
    visits.write_text("person,comes_s,stays_s,clothes\n1,2,600,1\n", encoding="utf-8")
    with SimulatedRobot("--visits", str(visits), "--desk-camera", "0") as robot:
        address = robot.next_line().partition(" at ")[2].strip()
        scenario = tmp_path / "desk.yaml"
        text = (layouts_dir() / "tour-guide.yaml").read_text(encoding="utf-8")
        assert text.count("\nplaces:\n") == 1
        text = text.replace("\nplaces:\n", f"\n{DESK}") + CAMERAS.replace("ADDRESS", address)
        scenario.write_text(text, encoding="utf-8")
        console = ConsoleProcess(robot.address, tmp_path / "study", CARIS_MODELS_DIR=str(INT8_WEIGHTS.parent))
        try:
            console.wait_until_shown(link="connected")
            console.send_command(f"open {scenario}")
            console.wait_until_shown(perception="ready", timeout_s=120)
            shown = console.wait_until_shown(people_here=1, seen_by=[["desk", "front"]], timeout_s=120)
            assert not [problem for problem in shown["problems"] if "Desk" in problem]
        finally:
            console.close()
