"""Whole console with the robot: places, goals, maps, controls, people on the map, and a switch of the robot."""

import math
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from caris_desktop.robot.profile import load_profile, save_profile
from tests.support.console_process import ConsoleProcess
from tests.support.polling import wait_for
from tests.support.simulated_robot import SimulatedRobot
from tests.support.twist_listener import TwistListener


@pytest.fixture(scope="module")
def robot() -> Iterator[SimulatedRobot]:
    with SimulatedRobot() as robot:
        yield robot


@pytest.fixture(scope="module")
def own_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the wizard's scenarios and robots."""
    return tmp_path_factory.mktemp("config") / "caris-desktop"


@pytest.fixture(scope="module")
def console(
    robot: SimulatedRobot, own_files: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[ConsoleProcess]:
    folder = tmp_path_factory.mktemp("console")
    profile = _profile("simulated", robot.address, folder / "first.yaml")
    console = ConsoleProcess(str(profile), folder / "study", with_models=True, XDG_CONFIG_HOME=str(own_files.parent))
    console.wait_until_shown(link="connected", drive_allowed=True, video="fresh", scan="fresh")
    yield console
    console.close()


def _profile(shipped: str, address: str, path: Path) -> Path:
    """A shipped profile with another address."""
    path.parent.mkdir(parents=True, exist_ok=True)
    save_profile(replace(load_profile(shipped), address=address), path)
    return path


@pytest.mark.long
def test_the_wizard_sends_the_robot_and_uses_what_it_offers(
    robot: SimulatedRobot, console: ConsoleProcess, own_files: Path
) -> None:
    here = robot.state()["pose"]
    console.send_command(f"go {here['x_m'] + 1.2} {here['y_m'] + 0.3}")
    console.wait_until_shown(goal="active", path="fresh")
    console.wait_until_shown(goal="reached")
    there = robot.state()["pose"]
    assert math.dist((there["x_m"], there["y_m"]), (here["x_m"] + 1.2, here["y_m"] + 0.3)) < 0.4

    console.send_command("place 9.0 5.0 My corner")
    wait_for(lambda: "My corner" in console.shown["places"], "the new place")
    saved = yaml.safe_load((own_files / "scenarios" / "tour-guide.yaml").read_text(encoding="utf-8"))
    assert {"name": "My corner", "x_m": 9, "y_m": 5, "heading_deg": 0} in saved["places"]

    console.send_command("use wave true")
    wait_for(lambda: console.shown["controls"].get("wave") == "succeeded", "the robot has waved")
    console.send_command("save_map lab")
    wait_for(lambda: any("The map lab was saved." in text for text in console.shown["problems"]), "the saved map")
    assert console.shown["readings"], "the robot tells its readings"


@pytest.mark.long  # people/test_location tests the geometry
@pytest.mark.timeout(300)
def test_people_stand_on_the_map_where_they_are(robot: SimulatedRobot, console: ConsoleProcess) -> None:
    console.wait_until_shown(perception="ready", timeout_s=90)
    errors: list[float] = []

    def placed() -> bool:
        shown = console.shown["people_in_map"]
        if shown:
            truth = [(person["x_m"], person["y_m"]) for person in robot.state()["people"]]
            errors.extend(min(math.dist(place, one) for one in truth) for place in shown)
        return len(errors) >= 10

    wait_for(placed, "people on the map", timeout_s=150)
    errors.sort()
    # They walk at up to 1 m/s, and the displayed value is a few tenths of a second old.
    assert errors[len(errors) // 2] < 0.5, errors


@pytest.mark.long
def test_another_robot_takes_the_place_of_the_first(
    robot: SimulatedRobot, console: ConsoleProcess, own_files: Path
) -> None:
    with SimulatedRobot(ros=2) as second:
        _profile("simulated-ros2", second.address, own_files / "robots" / "second.yaml")
        first_hears, second_hears = TwistListener(robot.address), TwistListener(second.address)
        console.hold("A", lambda: [twist for twist in first_hears.seen if twist.moving], "the first is driven")
        console.send_command("robot second")
        console.wait_until_shown(robot="second", link="connected", video="fresh", scan="fresh", drive_allowed=True)
        switched_ns = time.monotonic_ns()
        assert not first_hears.seen[-1].moving, "the first was left standing"
        assert not [twist for twist in second_hears.seen if twist.moving], "a key held from before does not drive"
        console.send_command("release A")
        console.hold("D", lambda: [twist for twist in second_hears.seen if twist.moving], "the second is driven")
        console.send_command("release D")
        assert not [twist for twist in first_hears.seen if twist.at_ns > switched_ns]
        console.send_command("robot nowhere")
        wait_for(lambda: any("was not connected" in text for text in console.shown["problems"]), "a refusal in words")
        assert console.shown["robot"] == "second"
        first_hears.close()
        second_hears.close()
