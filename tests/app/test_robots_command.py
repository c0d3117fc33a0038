"""``caris-desktop robots`` with the simulated robot."""

import argparse
from pathlib import Path

import pytest

from caris_desktop.app import robots_command
from caris_desktop.robot.profile import load_profile
from tests.support.simulated_robot import SimulatedRobot


@pytest.fixture(autouse=True)
def own_robots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("caris_desktop.robot.profile.platformdirs.user_config_dir", lambda *_a, **_k: str(tmp_path))
    return tmp_path / "robots"


def run(*words: str) -> int:
    parser = argparse.ArgumentParser()
    robots_command.add_arguments(parser)
    return robots_command.run(parser.parse_args(list(words)))


def test_known_robots_are_listed_and_a_broken_profile_says_why(
    own_robots: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own_robots.mkdir()
    (own_robots / "broken.yaml").write_text("version: 1\n")
    assert run() == 0
    printed = capsys.readouterr().out
    assert "tiago                shipped  TIAGo" in printed
    assert "broken               own " in printed
    assert "'ros' and 'velocity' are missing" in printed


@pytest.mark.long
def test_an_unknown_robot_is_explored_saved_and_listened_to(
    own_robots: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with SimulatedRobot(ros=2) as robot:
        assert run("--explore", robot.address, "--save", "Robot of the lab") == 0
        printed = capsys.readouterr().out
        assert "It resembles Simulated robot (ROS 2): --robot simulated-ros2 (100% of its names)." in printed
        assert load_profile("robot-of-the-lab").address == robot.address
        assert (own_robots / "robot-of-the-lab.yaml").is_file()
        assert run("--explore", robot.address, "--save", "Robot of the lab") == 1
        # A busy machine publishes late, so it may take a longer listening time.
        assert 0 in (run("--listen", "robot-of-the-lab", "--seconds", seconds) for seconds in ("1.5", "3", "6"))
        assert "ok   LIDAR" in capsys.readouterr().out


def test_a_robot_that_is_not_there_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--explore", "ws://127.0.0.1:9") == 1
    assert "Start rosbridge on the robot" in capsys.readouterr().err
    assert run("--save", "A") == 2
    assert run("--listen", "nobody") == 1
    assert "no robot profile named 'nobody'" in capsys.readouterr().err
