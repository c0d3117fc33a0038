"""Shipped profiles: complete, documented and plausible; test_every_profile drives them."""

import re

import pytest

from caris_desktop.domain.shipped import resources_dir
from caris_desktop.robot.link import check_robot
from caris_desktop.robot.profile import load_profile, shipped_profiles
from tests.support.simulated_robot import SimulatedRobot


def test_these_profiles_are_shipped() -> None:
    robots = {"nao", "pepper", "tiago", "tiago-base", "turtlebot3", "turtlebot3-humble", "turtlebot4"}
    assert set(shipped_profiles()) == robots | {"simulated", "simulated-ros2", "generic-ros1", "generic-ros2"}


@pytest.mark.parametrize("name", shipped_profiles())
def test_a_shipped_profile_reports_where_its_names_are_from_and_can_be_driven(name: str) -> None:
    text = (resources_dir() / "robots" / f"{name}.yaml").read_text(encoding="utf-8")
    assert text.startswith("# yaml-language-server: $schema=../schemas/robot-profile.schema.json\n")
    about = " ".join(line.lstrip("# ") for line in text.splitlines()[1:] if line.startswith("#"))
    assert re.search(r"Names from|caris-desktop simulate|usual names", about)
    if not name.startswith("simulated"):
        assert "Not verified" in about or "Not tried" in about
    profile = load_profile(name)
    assert profile.odometry is not None
    assert profile.guard.on
    assert 0.05 <= profile.limits.forward_mps <= 0.7
    # Stopping distance from 0.7 m/s must be within the range of the guard.
    assert profile.limits.forward_mps**2 / (2 * profile.limits.deceleration_mps2) < 0.5


def test_the_wizard_of_a_humanoid_can_go_sideways_and_look_around() -> None:
    for name in ("pepper", "nao"):
        profile = load_profile(name)
        assert profile.holonomic
        assert profile.head is not None
        assert profile.head.kind == "joint_angles"
        assert profile.cameras[0].model is not None
        assert profile.cameras[0].model.on_head


def test_the_camera_of_the_simulated_robot_is_the_one_that_it_draws_with() -> None:
    from caris_desktop.simulator import robot_simulation
    from caris_desktop.simulator.robot_simulation import Body

    for name in ("simulated", "simulated-ros2"):
        model = load_profile(name).cameras[0].model
        assert model is not None
        assert (model.width_px, model.height_px) == (robot_simulation.WIDTH_PX, robot_simulation.HEIGHT_PX)
        assert model.fx_px == pytest.approx(robot_simulation.FOCAL_PX)
        assert (model.x_m, model.z_m) == (Body().robot_from_camera.x_m, Body().camera_height_m)


def test_a_profile_for_the_other_ros_is_reported_and_not_taken() -> None:
    with SimulatedRobot(robot_model="turtlebot4") as robot:
        first, *_ = check_robot(load_profile("tiago"), robot.address)
    assert "runs ROS 2, but the profile says ROS 1" in first
