"""Robot profiles: what loads, and what a mistake in one is answered with."""

import pickle
from pathlib import Path

import pytest

from caris_desktop.robot.profile import ProfileError, load_profile, parse_profile, shipped_profiles

GOOD = "version: 1\nros: 1\nvelocity:\n  topic: /cmd_vel\n"


def message_of(text: str) -> str:
    with pytest.raises(ProfileError) as raised:
        parse_profile(text, file_name="robot.yaml", name="robot")
    return str(raised.value)


def test_the_shipped_profiles_load_and_travel_to_another_process() -> None:
    assert set(shipped_profiles()) == {"simulated", "simulated-ros2", "generic-ros1", "generic-ros2"}
    for name in shipped_profiles():
        profile = load_profile(name)
        assert pickle.loads(pickle.dumps(profile)) == profile  # noqa: S301 - our own bytes


def test_the_simulated_profiles_name_what_the_simulator_offers() -> None:
    profile = load_profile("simulated")
    assert profile.velocity.topic == "/cmd_vel"
    assert profile.navigation is not None
    assert (profile.navigation.kind, profile.navigation.name) == ("move_base", "/move_base")
    assert profile.speech is not None
    assert (profile.speech.topic, profile.speech.speaking, profile.speech.stop) == (
        "/tts",
        "/tts/speaking",
        "/tts/stop",
    )
    assert [camera.topic for camera in profile.cameras] == ["/camera/image_raw/compressed"]
    ros2 = load_profile("simulated-ros2")
    assert ros2.ros == 2
    assert ros2.navigation is not None
    assert ros2.navigation.kind == "navigate_to_pose"


def test_an_address_is_a_profile_with_the_usual_names() -> None:
    profile = load_profile("ws://192.168.1.20:9090")
    assert (profile.ros, profile.address) == (1, "ws://192.168.1.20:9090")
    profile = load_profile("ws://192.168.1.20:9090?ros=2")
    assert (profile.ros, profile.address) == (2, "ws://192.168.1.20:9090")


@pytest.mark.parametrize("address", ["http://robot:9090", "ws://", "ws://host:99999", "ws://host?ros=3", "ws://h?x=1"])
def test_an_address_that_cannot_be_one_is_refused(address: str) -> None:
    with pytest.raises(ProfileError, match=r"address"):
        load_profile(address)


def test_a_profile_file_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "turtle.yaml"
    path.write_text(GOOD + "limits: {forward_mps: 0.22}\nscan: {topic: scan, throttle_ms: 100}\n")
    profile = load_profile(str(path))
    assert profile.name == "turtle"
    assert profile.limits.forward_mps == 0.22
    assert profile.scan is not None
    assert profile.scan.throttle_ms == 100
    assert profile.navigation is None


@pytest.mark.parametrize(
    ("text", "line", "names"),
    [
        (GOOD + "veloctiy: {}\n", 5, ["veloctiy", "velocity"]),
        ("version: 1\nros: 3\nvelocity: {topic: /cmd_vel}\n", 2, ["ros", "3", "1, 2"]),
        ("version: 1\nros: 1\nvelocity:\n  topic: /cmd_vel\n  type: Twits\n", 5, ["Twits", "Twist, TwistStamped"]),
        (GOOD + "limits:\n  forward_mps: -1\n", 6, ["limits.forward_mps", "a number above 0"]),
        (GOOD + "limits:\n  forward_mps: fast\n", 6, ["limits.forward_mps", "fast"]),
        (GOOD + "scan: {topic: /my scan}\n", 5, ["scan.topic", "a ROS name"]),
        (GOOD + "cameras:\n  - {name: front, topic: /a}\n  - {name: back}\n", 7, ["cameras.1", "topic"]),
        ("version: 1\nros: 1\nros: 2\n", 3, ["ros", "twice"]),
        ("version: 1\nros: [1\n", 3, ["not YAML"]),
        ("version: 7\nros: 1\n", 1, ["version 7", "newer"]),
        ("ros: 1\n", 1, ["version"]),
    ],
)
def test_a_mistake_is_named_with_its_line_and_what_is_allowed(text: str, line: int, names: list[str]) -> None:
    message = message_of(text)
    assert f"robot.yaml, line {line}:" in message
    for name in names:
        assert name in message


@pytest.mark.parametrize("text", ["", "just a text", "- a\n- b\n", "version: 1\nros: !!python/object:os.system 1\n"])
def test_what_is_no_profile_at_all_is_refused(text: str) -> None:
    assert "robot.yaml" in message_of(text)


def test_a_profile_that_is_not_there_is_answered_with_those_that_are() -> None:
    with pytest.raises(ProfileError, match="generic-ros1"):
        load_profile("pepper")
    with pytest.raises(ProfileError, match="cannot be read"):
        load_profile("/nowhere/robot.yaml")
