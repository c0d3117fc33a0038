"""Robot profiles: loading, error messages for mistakes, and round trips of written profiles."""

import math
import pickle
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.control_definitions import CallService, PublishMessage, SendActionGoal
from caris_desktop.domain.schema_fields import Group, is_group, keys_of
from caris_desktop.robot import profile as profile_module
from caris_desktop.robot.profile import (
    ProfileText,
    leaves_ros_open,
    list_profiles,
    load_profile,
    own_profile_file,
    parse_profile,
    polygon_mistake,
    profile_data,
    profile_yaml,
    read_profile,
    save_profile,
    shipped_profiles,
    with_ros,
)
from caris_desktop.robot.profile_model import FloorOutline, ProfileError, ProfileFile, RobotProfile, SpeechAction
from tests.support.examples import examples
from tests.support.translated_messages import untranslated_part

GOOD = "version: 1\nros: 1\nvelocity:\n  topic: /cmd_vel\n"
GOOD2 = "version: 1\nros: 2\nvelocity: {topic: cmd_vel}\n"


def parsed(text: str, file_name: str = "robot.yaml") -> RobotProfile:
    return parse_profile(text, file_name=file_name, name="robot")


def message_of(text: str, file_name: str = "robot.yaml") -> str:
    with pytest.raises(ProfileError) as raised:
        parsed(text, file_name)
    return str(raised.value)


def test_the_shipped_profiles_load_and_travel_to_another_process() -> None:
    assert {"simulated", "simulated-ros2", "generic-ros1", "generic-ros2"} <= set(shipped_profiles())
    for name in shipped_profiles():
        profile = load_profile(name)
        assert pickle.loads(pickle.dumps(profile)) == profile  # noqa: S301 - our own bytes


def test_an_address_is_a_profile_with_the_usual_names_and_nothing_of_one_robot_alone() -> None:
    profile = load_profile("ws://192.168.1.20:9090")
    assert (profile.ros, profile.address) == (1, "ws://192.168.1.20:9090")
    assert (
        replace(load_profile("generic-ros1"), name="address", title=profile.title, address=profile.address) == profile
    )
    # Features that only the simulated robot has would be reported as missing.
    assert (profile.controls, profile.head, profile.speech, profile.emergency_stop) == ((), None, None, None)
    assert profile.cameras[0].model is None
    profile = load_profile("ws://192.168.1.20:9090?ros=2")
    assert (profile.ros, profile.address) == (2, "ws://192.168.1.20:9090")
    assert profile.path == load_profile("generic-ros2").path


def test_an_address_says_whether_it_leaves_the_ros_version_open() -> None:
    assert leaves_ros_open("ws://robot:9090")
    assert not leaves_ros_open("ws://robot:9090?ros=1")
    assert not leaves_ros_open("simulated")
    assert load_profile(with_ros("ws://robot:9090", 2)).ros == 2


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
    assert (profile.scan.topic, profile.scan.throttle_ms) == ("/scan", 100)
    assert profile.navigation is None


def test_a_namespace_stands_before_every_relative_name_and_no_absolute_one() -> None:
    profile = parsed(
        GOOD
        + """
namespace: /lab/robot1
scan: {topic: scan}
tf: {topic: /tf}
cameras:
  - {name: front, topic: camera/image/compressed, info: camera/camera_info}
navigation: {kind: move_base, name: move_base}
initial_pose: initialpose
maps: {slam_toolbox: slam_toolbox}
speech: {topic: tts, speaking: /tts/speaking}
emergency_stop: {set_service: stop/set, clear_service: stop/clear}
head: {kind: joint_angles, topic: joint_angles, pan_joint: a, tilt_joint: b}
controls:
  - {id: a, title: A, kind: button, call: {service: wave, type: std_srvs/Trigger}}
  - {id: b, title: B, kind: readout, shows: {topic: heat, type: std_msgs/Float32, field: data}}
  - {id: c, title: C, kind: button, action: {name: dance, type: a/DanceAction}}
"""
    )
    assert profile.velocity.topic == "/cmd_vel"
    assert profile.scan is not None
    assert profile.scan.topic == "/lab/robot1/scan"
    assert profile.tf is not None
    assert profile.tf.topic == "/tf"
    assert profile.cameras[0].info == "/lab/robot1/camera/camera_info"
    assert profile.navigation is not None
    assert profile.navigation.name == "/lab/robot1/move_base"
    assert profile.initial_pose == "/lab/robot1/initialpose"
    assert profile.maps is not None
    assert profile.maps.slam_toolbox == "/lab/robot1/slam_toolbox"
    assert profile.speech is not None
    assert (profile.speech.topic, profile.speech.speaking) == ("/lab/robot1/tts", "/tts/speaking")
    assert profile.emergency_stop is not None
    assert profile.emergency_stop.clear_service == "/lab/robot1/stop/clear"
    assert profile.head is not None
    assert profile.head.joint_states == "/lab/robot1/joint_states"
    call, shows, action = profile.controls
    assert isinstance(call.effect, CallService)
    assert call.effect.service == "/lab/robot1/wave"
    assert shows.reading is not None
    assert shows.reading.topic == "/lab/robot1/heat"
    assert isinstance(action.effect, SendActionGoal)
    assert action.effect.action == "/lab/robot1/dance"


def test_maps_and_fixed_transforms_are_latched_unless_the_file_says_otherwise() -> None:
    profile = parsed(
        GOOD + "map: {topic: /map}\ntf_static: {topic: /tf_static, latched: false}\npose: {topic: /p, latched: true}\n"
    )
    assert profile.map is not None
    assert profile.tf_static is not None
    assert profile.pose is not None
    assert (profile.map.latched, profile.tf_static.latched, profile.pose.latched) == (True, False, True)


def test_a_camera_is_described_as_its_data_sheet_does() -> None:
    camera = """cameras:
  - name: front
    topic: /c
    model: {width_px: 640, height_px: 480, horizontal_fov_deg: 90, x_m: 0.1, z_m: 1.2, tilt_deg: 45}
"""
    model = parsed(GOOD + camera).cameras[0].model
    assert model is not None
    assert model.fx_px == pytest.approx(320.0)
    assert (model.cx_px, model.cy_px, model.x_m, model.heading_rad) == (320.0, 240.0, 0.1, 0.0)
    # looking down at 45 degrees from 1.2 m, the image centre is 1.2 m ahead
    assert model.floor_point(320.0, 240.0) == pytest.approx((1.3, 0.0))
    lens = "model: {width_px: 640, height_px: 480, fx_px: 500, cy_px: 200}"
    model = parsed(GOOD + f"cameras:\n  - {{name: a, topic: /c, {lens}}}\n").cameras[0].model
    assert model == CameraModel(640, 480, 500.0, 500.0, 320.0, 200.0)


def test_a_footprint_is_a_circle_or_an_outline_counter_clockwise() -> None:
    assert parsed(GOOD).footprint_radius_m == 0.25
    assert parsed(GOOD + "footprint_radius_m: 0.3\n").footprint_radius_m == 0.3
    assert parsed(GOOD + "footprint: {radius_m: 0.2}\n").footprint_radius_m == 0.2
    clockwise = parsed(GOOD + "footprint: {polygon_m: [[0.3, 0.2], [0.3, -0.2], [-0.3, -0.2], [-0.3, 0.2]]}\n")
    assert clockwise.footprint_m == ((-0.3, 0.2), (-0.3, -0.2), (0.3, -0.2), (0.3, 0.2))
    assert clockwise.footprint_radius_m == pytest.approx(math.hypot(0.3, 0.2))


def test_a_voice_that_is_an_action_and_every_kind_of_emergency_stop() -> None:
    speech = "speech: {action: {name: /tts, type: a/TtsAction, goal: {rawtext: {text: $value, lang_id: en_GB}}}}\n"
    profile = parsed(GOOD + speech)
    assert profile.speech is not None
    assert profile.speech.action == SpeechAction(
        "/tts", "a/TtsAction", {"rawtext": {"text": "$value", "lang_id": "en_GB"}}
    )
    stop = parsed(GOOD + "emergency_stop: {service: /motors, service_field: on, service_stop_value: false}\n")
    assert stop.emergency_stop is not None
    assert (stop.emergency_stop.service_field, stop.emergency_stop.service_stop_value) == ("on", False)
    stop = parsed(
        GOOD2 + "emergency_stop: {set_service: /s, clear_service: /c, service_type: std_srvs/srv/Empty, topic: /t}\n"
    )
    assert stop.emergency_stop is not None
    assert stop.emergency_stop.service_type == "std_srvs/Empty"


def test_words_that_other_yaml_readers_take_for_something_else_are_words() -> None:
    profile = parsed(
        GOOD + "guard: {on: false, stop_distance_m: 2e-1}\ntitle: 12:30\n"
        "controls:\n  - {id: a, title: Off, kind: choice, choices: [{title: yes, value: no}],\n"
        "     publish: {topic: /t, type: a/B, message: {data: $value}}}\n"
    )
    assert (profile.guard.on, profile.guard.stop_distance_m, profile.title) == (False, 0.2, "12:30")
    assert (profile.controls[0].choices[0].title, profile.controls[0].choices[0].value) == ("yes", "no")


CONTROL = "controls:\n  - {id: a, title: A, kind: %s}\n"
PUBLISH = "publish: {topic: /t, type: a/B, message: {data: %s}}"
HEAD = "head: {kind: joint_angles, topic: /j, pan_joint: a, tilt_joint: b, %s}\n"
CAMERA = "cameras:\n  - {name: a, topic: /c, model: {width_px: 64, height_px: 48, %s}}\n"


@pytest.mark.parametrize(
    ("text", "line", "names"),
    [
        (GOOD + "veloctiy: {}\n", 5, ["veloctiy", "Did you mean 'velocity'"]),
        ("version: 1\nros: 3\nvelocity: {topic: /cmd_vel}\n", 2, ["ros", "3", "1, 2"]),
        (GOOD + "  type: Twits\n", 5, ["Twits", "Twist, TwistStamped", "mean"]),
        (GOOD + "limits:\n  forward_mps: -1\n", 6, ["limits.forward_mps", "is -1. Allowed: more than 0"]),
        (GOOD + "limits:\n  forward_mps: fast\n", 6, ["limits.forward_mps", "must be a number, found 'fast'"]),
        (GOOD + "scan: {topic: /my scan}\n", 5, ["scan.topic", "a ROS name"]),
        (GOOD + "scan:\n", 5, ["scan", "found nothing", "{topic: /scan"]),
        (GOOD + "scan: /scan\n", 5, ["scan", "'key: value' lines", "{topic: /scan"]),
        (GOOD + "cameras:\n  - {name: front, topic: /a}\n  - {name: back}\n", 7, ["cameras[2]", "'topic' is missing"]),
        (GOOD + "cameras:\n  - {name: a, topic: /a}\n  - {name: a, topic: /b}\n", 7, ["duplicate camera name", "a"]),
        ("version: 1\nros: 1\nros: 2\n", 3, ["ros", "duplicate key"]),
        ("version: 1\nros: [1\n", 3, ["not valid YAML"]),
        ("version: 7\nros: 1\n", 1, ["version 7", "newer"]),
        ("ros: 1\n", 1, ["version"]),
        (GOOD + "title: &a x\nnamespace: *a\n", 6, ["references"]),
        (GOOD + "title: !!python/name:os.system\n", 5, ["tag"]),
        (GOOD + "command_rate_hz: .inf\n", 5, ["finite number"]),
        (GOOD + "namespace: 1robot\n", 5, ["namespace", "robot1"]),
        (GOOD2 + "scan: {topic: /robot/1/scan}\n", 4, ["scan.topic", "ROS 2", "digit"]),
        (GOOD2 + "scan: {topic: /my__scan}\n", 4, ["ROS 2"]),
        (GOOD + "address: ws://user:secret@host:9090\n", 5, ["address", "without a password"]),
        (GOOD + "footprint: {polygon_m: [[1, 1], [-1, 1]]}\n", 5, ["footprint.polygon_m", "2 entries", "at least 3"]),
        (GOOD + "footprint: {polygon_m: [[1, 1], [2, 1], [2, 2]]}\n", 5, ["footprint.polygon_m", "centre"]),
        (GOOD + "footprint: {polygon_m: [[1, 1], [-1, -1], [1, -1], [-1, 1]]}\n", 5, ["cross"]),
        (GOOD + "  timeout_s: 0.5\n", 5, ["'velocity.timeout_s' also requires 'timeout_source'", "documented"]),
        (GOOD + "  timeout_source: a page\n", 5, ["velocity.timeout_source", "is allowed only with 'timeout_s'"]),
        (GOOD + "  timeout_s: 0\n", 5, ["velocity.timeout_s"]),
        (GOOD + "footprint: {}\n", 5, ["either radius_m or polygon_m"]),
        (GOOD + "footprint: {radius_m: 1}\nfootprint_radius_m: 1\n", 6, ["remove one of the two"]),
        (GOOD + CAMERA % "z_m: 1", 6, ["either horizontal_fov_deg or fx_px"]),
        (GOOD + CAMERA % "fx_px: 9, heading_deg: 1, heading_rad: 1", 6, ["heading_rad", "remove one of the two"]),
        (GOOD + CAMERA % "fx_px: 9, on_head: true", 6, ["also requires 'head'"]),
        (GOOD + "navigation: {kind: navigate_to_pose, name: /n}\n", 5, ["ros: 1", "move_base"]),
        (GOOD + "speech: {action: {name: /say, type: nav2_msgs/Spin, goal: {a: $value}}}\n", 5, ["moves the robot"]),
        (GOOD + "speech: {topic: cmd_vel}\n", 5, ["speech.topic", "moves the robot"]),
        (GOOD + "speech: {speaking: /s}\n", 5, ["speech", "a topic, an action, a service or a web interface"]),
        (GOOD + "speech: {service: {name: /s, type: a/B, request: {text: hi}}}\n", 5, ["service.request", "$value"]),
        (GOOD + "speech: {web: {url: http://robot/say}}\n", 5, ["speech.web.url", "$value"]),
        (GOOD + "speech: {web: {url: 'ftp://robot/$value'}}\n", 5, ["speech.web.url", "http://HOST:PORT/PATH"]),
        (GOOD + "speech: {web: {url: 'http://me:secret@robot/$value'}}\n", 5, ["speech.web.url", "without a password"]),
        (GOOD + "speech: {action: {name: /s, type: a/B, goal: {text: hi}}}\n", 5, ["speech.action.goal", "$value"]),
        (
            GOOD + "emergency_stop: {set_service: /s}\n",
            5, ["set_service", "also requires 'clear_service'", "never released"],
        ),
        (
            GOOD + "emergency_stop: {service: /s, command_topic: /c}\n",
            5, ["command_topic' cannot", "remove one of the two"],
        ),
        (GOOD + "emergency_stop: {inverted: true}\n", 5, ["inverted", "topic", "an emergency stop requires"]),
        (GOOD + HEAD % "pan_range_rad: [1, -1]", 5, ["head.pan_range_rad", "lower"]),
        (GOOD + HEAD.replace("tilt_joint: b", "tilt_joint: a") % "speed_radps: 1", 5, ["two different joints"]),
        (GOOD + "maps: {folder: ../../etc}\n", 5, ["maps.folder"]),
        (GOOD + CONTROL % "button", 6, ["controls[1].kind", "'publish', 'call' or 'action'"]),
        (GOOD + CONTROL % f"readout, {PUBLISH % 1}", 6, ["controls[1].publish", "controls[1].kind", "'shows'"]),
        (GOOD + CONTROL % f"knob, {PUBLISH % 1}", 6, ["unknown kind 'knob'", "slider"]),
        (GOOD + CONTROL % f"slider, range: [1, 0], {PUBLISH % '$value'}", 6, ["the lower number first"]),
        (GOOD + CONTROL % f"toggle, {PUBLISH % 1}", 6, ["$value", "no effect"]),
        (GOOD + CONTROL % f"button, range: [0, 1], {PUBLISH % 1}", 6, ["'kind: slider', found 'button'"]),
        (GOOD + CONTROL % f"button, {PUBLISH.replace('a/B', 'a/Twist') % 1}", 6, ["Only driving"]),
        (GOOD + CONTROL % f"button, {PUBLISH.replace('/t', 'cmd_vel') % 1}", 6, ["Only driving"]),
        (
            GOOD + CONTROL % f"button, {PUBLISH % 1}" + CONTROL.split("\n")[1] % f"text, {PUBLISH % 1}",
            7, ["duplicate control"],
        ),
        (GOOD + "security: {certificate_sha256: 'AB:CD'}\n", 5, ["certificate_sha256", "64 hexadecimal digits"]),
        (GOOD + "security: {rosauth_secret_env: my secret}\n", 5, ["rosauth_secret_env", "environment variable"]),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_its_line_and_what_is_allowed(text: str, line: int, names: list[str]) -> None:
    message = message_of(text)
    assert f"robot.yaml, line {line}:" in message
    for name in names:
        assert name in message, message
    assert untranslated_part(lambda: message_of(text)) == []


def test_a_profile_of_an_older_version_is_raised_step_by_step(monkeypatch: pytest.MonkeyPatch) -> None:
    def name_the_velocity(data: dict[str, Any]) -> dict[str, Any]:
        return {key: value for key, value in data.items() if key != "drive"} | {"velocity": {"topic": data["drive"]}}

    def double_the_rate(data: dict[str, Any]) -> dict[str, Any]:
        return {**data, "command_rate_hz": data["command_rate_hz"] * 2}

    monkeypatch.setattr(profile_module, "PROFILE_VERSION", 3)
    monkeypatch.setattr(profile_module, "MIGRATIONS", {1: name_the_velocity, 2: double_the_rate})
    with pytest.raises(ProfileError, match="line 1: this profile has version 4, made for a newer"):
        ProfileText("version: 4\nros: 1\n", "robot.yaml").raise_to_newest()
    text = ProfileText("version: 1\nros: 1\ndrive: /cmd_vel\ncommand_rate_hz: 10\n", "robot.yaml")
    text.raise_to_newest()
    assert text.data == {"version": 3, "ros": 1, "velocity": {"topic": "/cmd_vel"}, "command_rate_hz": 20}


def test_there_is_a_step_from_every_older_version() -> None:
    assert set(profile_module.MIGRATIONS) == set(range(1, profile_module.PROFILE_VERSION))


def test_a_password_in_an_address_is_not_repeated() -> None:
    assert "secret" not in message_of(GOOD + "address: ws://user:secret@host:9090\n")


@pytest.mark.parametrize("text", ["", "just a text", "- a\n- b\n", "version: 1\nros: !!python/object:os.system 1\n"])
def test_a_file_that_is_no_profile_is_refused(text: str) -> None:
    assert "robot.yaml" in message_of(text)


def test_a_bomb_of_references_and_a_tower_of_brackets_are_refused_at_once() -> None:
    bomb = "a: &a [x]\n" + "".join(f"{b}: &{b} [*{a}, *{a}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True))
    assert "references" in message_of(bomb)
    assert "levels" in message_of("a: " + "[" * 2000)
    assert "larger" in message_of("#" * 2_000_000)


@settings(max_examples=examples(60), deadline=None)
@given(st.text(max_size=60) | st.binary(max_size=60).map(lambda data: data.decode("latin-1")))
def test_nothing_but_a_profile_error_comes_of_any_text(text: str) -> None:
    for head in ("", GOOD):
        try:
            parsed(head + text)
        except ProfileError as error:
            assert "robot.yaml" in str(error)


def test_a_profile_that_is_not_there_is_answered_with_those_that_are(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match=r"mean 'pepper'.*generic-ros1"):
        load_profile("peper", user_dir=tmp_path)
    with pytest.raises(ProfileError, match="cannot be read"):
        load_profile("/nowhere/robot.yaml")


def test_certificates_lie_next_to_the_profile(tmp_path: Path) -> None:
    (tmp_path / "lab.pem").write_text("not checked here")
    (tmp_path.parent / "other.pem").write_text("")
    path = tmp_path / "robot.yaml"
    path.write_text(GOOD + "security: {ca_file: lab.pem, rosauth_secret_env: LAB_SECRET}\n")
    profile = read_profile(path)
    assert profile.security.ca_file == str((tmp_path / "lab.pem").resolve())
    assert profile.security.rosauth_secret_env == "LAB_SECRET"
    save_profile(profile, tmp_path / "copy.yaml")
    assert "ca_file: lab.pem" in (tmp_path / "copy.yaml").read_text()
    with pytest.raises(ProfileError, match="Copy the certificate file"):
        save_profile(profile, tmp_path / "elsewhere" / "copy.yaml")
    for outside in ("../other.pem", str(tmp_path.parent / "other.pem")):
        assert "folder of the profile" in message_of(GOOD + f"security: {{ca_file: '{outside}'}}\n", str(path))
    assert "lost.pem does not exist" in message_of(GOOD + "security: {ca_file: lost.pem}\n", str(path))


def test_own_profiles_are_listed_and_a_broken_one_hides_nothing(tmp_path: Path) -> None:
    (tmp_path / "lab-robot.yaml").write_text(GOOD + "title: Robot of the lab\naddress: ws://10.0.0.5:9090\n")
    (tmp_path / "broken.yaml").write_text(GOOD + "nonsense: 1\n")
    (tmp_path / "pepper.yaml").write_text(GOOD + "title: Our Pepper\n")
    listed = {profile.name: profile for profile in list_profiles(tmp_path)}
    assert set(listed) == {"lab-robot", "broken", *shipped_profiles()}
    assert (listed["lab-robot"].title, listed["lab-robot"].address) == ("Robot of the lab", "ws://10.0.0.5:9090")
    assert not listed["lab-robot"].shipped
    assert "nonsense" in listed["broken"].error
    assert (listed["pepper"].title, listed["pepper"].shipped) == ("Our Pepper", False)
    assert listed["nao"].shipped
    (tmp_path / "broken.yaml").write_text(GOOD + "title: Mended\n")
    assert {profile.name: profile.title for profile in list_profiles(tmp_path)}["broken"] == "Mended"
    assert load_profile("lab-robot", user_dir=tmp_path).title == "Robot of the lab"
    assert load_profile("pepper", user_dir=tmp_path).title == "Our Pepper"
    assert load_profile("nao", user_dir=tmp_path / "not there").title == "NAO"


@pytest.mark.parametrize("name", shipped_profiles())
def test_a_shipped_profile_reads_back_as_it_was_written(name: str, tmp_path: Path) -> None:
    profile = load_profile(name, user_dir=tmp_path)
    path = tmp_path / "robots" / f"{name}.yaml"
    save_profile(profile, path)
    assert read_profile(path) == profile
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    assert max(len(line) for line in path.read_text().splitlines()) < 130


def test_a_profile_the_file_cannot_hold_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text("before")
    with pytest.raises(ProfileError, match="not saved"):
        save_profile(
            replace(load_profile("simulated"), footprint=FloorOutline(polygon_m=((1, 0), (-1, -1), (0, 1)))), path
        )
    with pytest.raises(ProfileError, match="more than 0"):
        profile = load_profile("simulated")
        save_profile(replace(profile, limits=replace(profile.limits, forward_mps=0.0)), path)
    assert path.read_text() == "before"
    with pytest.raises(ProfileError, match="valid profile name"):
        save_profile(load_profile("simulated"), tmp_path / "my robot.yaml")
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(ProfileError, match="not written"):
        save_profile(load_profile("simulated"), blocked / "robot.yaml")


def test_a_base_that_may_not_stop_automatically_is_driven_at_half_speed() -> None:
    limits = "limits: {forward_mps: 0.4, backward_mps: 0.2, left_mps: 0.1, turn_radps: 1.0}\n"
    for timeout, known in (("", False), ("0.5", True), ("1.5", False)):
        timeout_text = f"  timeout_s: {timeout}\n  timeout_source: its manual\n" if timeout else ""
        profile = parsed(GOOD + timeout_text + limits)
        assert profile.stops_by_itself is known
        speeds = profile.driving_limits
        factor = 1.0 if known else 0.5
        assert (speeds.forward_mps, speeds.backward_mps, speeds.left_mps, speeds.turn_radps) == pytest.approx(
            (0.4 * factor, 0.2 * factor, 0.1 * factor, 1.0 * factor)
        )
        assert speeds.deceleration_mps2 == profile.limits.deceleration_mps2


def test_a_title_becomes_a_file_name() -> None:
    assert own_profile_file("Ümit's Robot 2 (ROS 1)").name == "umit-s-robot-2-ros-1.yaml"
    assert own_profile_file("机器人").name == "robot.yaml"


NAMES = st.from_regex(r"\A/?[a-z][a-z0-9]{0,6}(/[a-z][a-z0-9]{0,4}){0,2}\Z")
WORDS = st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1, max_size=12)
NUMBERS = st.floats(0.06, 1.9, allow_nan=False)
ANGLES = st.floats(-90.0, 90.0, allow_nan=False)
SOURCES = st.fixed_dictionaries(
    {"topic": NAMES}, optional={"throttle_ms": st.integers(0, 9999), "latched": st.booleans()}
)
PUBLISHES = st.fixed_dictionaries(
    # Never on the velocity topic, which is refused.
    {"topic": NAMES.map(lambda name: f"{name}_said"), "type": st.just("std_msgs/String")},
    optional={"message": st.just({"data": "at $value %"})},
)
VALUES = st.one_of(st.booleans(), st.floats(-9, 9), st.integers(-9, 9), WORDS, st.sampled_from(["yes", "1e3", "~", ""]))
SLIDERS = st.tuples(st.floats(-9, 0), st.floats(1, 9)).map(list)
CONTROLS = st.one_of(
    st.fixed_dictionaries(
        {
            "kind": st.sampled_from(["slider"]),
            "title": WORDS,
            "range": SLIDERS,
            "call": st.just({"service": "set", "type": "a/B", "request": {"value": ["$value", 1.0, 2]}}),
        },
        optional={"step": st.floats(0, 0.5), "unit": st.just("%")},
    ),
    st.fixed_dictionaries(
        {
            "kind": st.sampled_from(["toggle", "text"]),
            "title": WORDS,
            "action": st.just({"name": "do", "type": "a/DoAction", "goal": {"what": "$value"}}),
        },
    ),
    st.fixed_dictionaries(
        {"kind": st.just("button"), "title": WORDS, "publish": PUBLISHES},
        optional={"group": WORDS, "confirm": st.booleans(), "moves": st.booleans()},
    ),
    st.fixed_dictionaries(
        {
            "kind": st.just("choice"),
            "title": WORDS,
            "publish": st.just({"topic": "/t_said", "type": "a/B", "message": {"data": "$value"}}),
            "choices": st.lists(st.fixed_dictionaries({"title": WORDS, "value": VALUES}), min_size=1, max_size=3),
        }
    ),
    st.fixed_dictionaries(
        {
            "kind": st.just("readout"),
            "title": WORDS,
            "shows": st.fixed_dictionaries(
                {"topic": NAMES, "type": st.just("a/B"), "field": st.sampled_from(["data", "status[0].level"])},
                optional={"scale": NUMBERS, "throttle_ms": st.integers(0, 9999)},
            ),
        }
    ),
)
MODELS = st.fixed_dictionaries(
    {"width_px": st.integers(16, 2000), "height_px": st.integers(16, 2000), "horizontal_fov_deg": st.floats(5, 170)},
    optional={"x_m": NUMBERS, "z_m": NUMBERS, "heading_deg": ANGLES, "tilt_deg": ANGLES},
) | st.fixed_dictionaries(
    {"width_px": st.integers(16, 2000), "height_px": st.integers(16, 2000), "fx_px": st.floats(1, 5000)},
    optional={"fy_px": st.floats(1, 5000), "cx_px": st.floats(0, 900), "tilt_rad": st.floats(-1.5, 1.5)},
)
TIMEOUTS = st.fixed_dictionaries({"timeout_s": st.floats(0.01, 60), "timeout_source": WORDS}) | st.just({})
VELOCITIES = st.fixed_dictionaries(
    {"topic": NAMES}, optional={"type": st.sampled_from(["Twist", "TwistStamped"]), "frame_id": WORDS}
)
LIMITS = ("forward_mps", "turn_radps", "acceleration_mps2", "deceleration_mps2", "turn_deceleration_radps2")
RANGES = st.tuples(st.floats(-7, 0), st.floats(0.1, 7)).map(list)
SPEED_LIMITS = st.fixed_dictionaries(
    {"reconfigure": NAMES}, optional={"parameters": st.lists(st.sampled_from(["a", "b"]), min_size=1, max_size=3)}
)
PROFILES = st.fixed_dictionaries(
    {"version": st.just(1), "ros": st.just(1), "velocity": st.builds(dict.__or__, VELOCITIES, TIMEOUTS)},
    optional={
        "title": WORDS,
        "address": st.sampled_from(["ws://10.0.0.5:9090", "wss://robot.lab/bridge"]),
        "namespace": st.sampled_from(["robot1", "/lab/two"]),
        "security": st.fixed_dictionaries({}, optional={"rosauth_secret_env": st.just("SECRET_OF_MINE")}),
        "simulation_time": st.booleans(),
        "command_rate_hz": st.floats(5, 100),
        "limits": st.fixed_dictionaries({}, optional=dict.fromkeys((*LIMITS, "backward_mps", "left_mps"), NUMBERS)),
        "guard": st.fixed_dictionaries(
            {}, optional={"on": st.booleans(), "stop_distance_m": st.floats(0, 1), "reaction_s": NUMBERS}
        ),
        "footprint": st.fixed_dictionaries({"radius_m": NUMBERS})
        | st.fixed_dictionaries({"polygon_m": st.just([[0.3, 0.21], [-0.3, 0.2], [-0.3, -0.2], [0.31, -0.2]])}),
        **dict.fromkeys(
            ("scan", "odometry", "pose", "tf", "tf_static", "map", "map_updates", "path", "battery"), SOURCES
        ),
        "frames": st.fixed_dictionaries({}, optional=dict.fromkeys(("map", "odom", "base"), NAMES)),
        "cameras": st.lists(
            st.fixed_dictionaries(
                {"name": st.sampled_from(["a", "b-2", "C_3", "4"]), "topic": NAMES},
                optional={
                    "model": MODELS,
                    "info": NAMES,
                    "type": st.sampled_from(["CompressedImage", "Image"]),
                    "throttle_ms": st.integers(0, 10_000),
                },
            ),
            max_size=4,
            unique_by=lambda camera: camera["name"],
        ),
        "navigation": st.fixed_dictionaries({"kind": st.just("move_base"), "name": NAMES})
        | st.fixed_dictionaries(
            {"kind": st.just("move_base"), "name": NAMES, "max_mps": st.floats(0.01, 5), "speed_limit": SPEED_LIMITS}
        ),
        "initial_pose": NAMES,
        "maps": st.fixed_dictionaries(
            {"slam_toolbox": NAMES},
            optional={"folder": st.sampled_from(["/maps", "m a"]), "map_server": NAMES, "map_saver": NAMES},
        ),
        "speech": st.fixed_dictionaries({"topic": NAMES}, optional={"stop": NAMES, "speaking": NAMES})
        | st.just({"action": {"name": "say", "type": "a/SayAction", "goal": {"text": ["$value", 1, None, True, 0.5]}}}),
        "audio": st.fixed_dictionaries(
            {"topic": NAMES},
            optional={"speaker": NAMES, "rate_hz": st.integers(4000, 192_000), "format": st.sampled_from(["mp3"])},
        )
        | st.fixed_dictionaries({"speaker": NAMES}),
        "emergency_stop": st.fixed_dictionaries(
            {"topic": NAMES}, optional={"inverted": st.booleans(), "command_topic": NAMES}
        )
        | st.fixed_dictionaries(
            {"service": NAMES}, optional={"service_stop_value": st.booleans(), "service_field": st.just("on")}
        )
        | st.fixed_dictionaries(
            {"set_service": NAMES, "clear_service": NAMES},
            optional={"service_type": st.sampled_from(["std_srvs/Empty", "std_srvs/srv/Trigger"]), "topic": NAMES},
        ),
        "head": st.fixed_dictionaries(
            {
                "kind": st.sampled_from(["joint_trajectory", "joint_angles"]),
                "topic": NAMES,
                "pan_joint": st.just("a"),
                "tilt_joint": WORDS.filter(lambda word: word != "a"),
            },
            optional={
                "speed_radps": NUMBERS,
                "pan_sign": st.sampled_from([1, -1]),
                "tilt_sign": st.sampled_from([1, -1]),
                "joint_states": NAMES,
                "pan_range_rad": RANGES,
                "tilt_range_rad": RANGES,
            },
        ),
        "controls": st.lists(CONTROLS, max_size=3).map(
            lambda controls: [{"id": f"c{number}", **control} for number, control in enumerate(controls)]
        ),
        "laser": st.fixed_dictionaries(
            {
                "robot_from_laser": st.fixed_dictionaries(
                    {}, optional={"x_m": NUMBERS, "y_m": st.floats(-9, 9), "heading_deg": ANGLES}
                )
                | st.fixed_dictionaries({"heading_rad": st.floats(-6.2831, 6.2831)})
            }
        ),
    },
)


@settings(max_examples=examples(60), deadline=None)
@given(PROFILES)
def test_any_profile_reads_back_as_it_was_written(data: dict[str, Any]) -> None:
    profile = parsed(profile_yaml(data))
    written = profile_yaml(profile_data(profile, Path()))
    assert parsed(written) == profile, written


@settings(max_examples=examples(50), deadline=None)
@given(st.dictionaries(WORDS, VALUES | st.lists(VALUES, max_size=3) | st.dictionaries(WORDS, VALUES, max_size=3)))
def test_any_data_is_the_same_data_after_writing_and_reading(data: dict[str, Any]) -> None:
    assert ProfileText(profile_yaml({"a": 1, **data}), "f").data == {"a": 1, **data}


def test_every_key_is_read_and_written(tmp_path: Path) -> None:
    """A declared key without a test could get lost silently."""
    (tmp_path / "lab.pem").write_text("not checked here")
    tried: set[str] = set()
    for text in EVERY_KEY:
        data = ProfileText(text, "robot.yaml").data
        tried.update(keys_in(ProfileFile, data))
        profile = parsed(text, str(tmp_path / "robot.yaml"))
        written = profile_data(profile, tmp_path)
        assert parsed(profile_yaml(written), str(tmp_path / "robot.yaml")) == profile
        # Alternatives are written in one form, and keys without a default are always written.
        assert set(written) >= set(data) - {"namespace", "footprint_radius_m"}
    assert tried == set(declared_keys(ProfileFile))


EVERY_KEY = (
    """
version: 1
title: Everything
ros: 1
address: wss://robot:9090
namespace: lab
security:
  ca_file: lab.pem
  certificate_sha256: "0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A:0A"
  rosauth_secret_env: SECRET
simulation_time: true
velocity: {topic: cmd, type: TwistStamped, frame_id: base, timeout_s: 0.5, timeout_source: its manual}
command_rate_hz: 10
limits:
  forward_mps: 0.4
  backward_mps: 0.2
  left_mps: 0.1
  turn_radps: 0.9
  acceleration_mps2: 1.5
  deceleration_mps2: 2.5
  turn_acceleration_radps2: 3.5
  turn_deceleration_radps2: 4.5
guard: {on: false, stop_distance_m: 0.2, reaction_s: 0.5}
footprint: {polygon_m: [[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]]}
scan: {topic: scan, throttle_ms: 50, latched: true}
odometry: {topic: odom}
pose: {topic: pose}
tf: {topic: /tf}
tf_static: {topic: /tf_static, throttle_ms: 5, latched: false}
map: {topic: map, latched: false}
map_updates: {topic: map_updates}
path: {topic: plan}
battery: {topic: battery}
frames: {map: a, odom: b, base: c}
laser: {robot_from_laser: {x_m: 0.1, y_m: 0.2, heading_deg: 30}, mounting: upside_down}
cameras:
  - {name: front, topic: c, throttle_ms: 33, type: Image, info: c/info,
     model: {width_px: 64, height_px: 48, fx_px: 50, fy_px: 51, cx_px: 30, cy_px: 20, x_m: 0.1, y_m: 0.2, z_m: 1.3,
             heading_rad: 0.123456, tilt_rad: 0.2, on_head: true}}
navigation:
  {kind: move_base, name: move_base, max_mps: 0.5, speed_limit: {reconfigure: planner, parameters: [max_vel]}}
initial_pose: initialpose
maps: {slam_toolbox: slam, map_server: maps, map_saver: saver, folder: /maps}
speech: {topic: say, speaking: saying, stop: hush, says: own_words}
audio:
  {topic: ears, type: AudioDataStamped, format: mp3, rate_hz: 44100, channels: 2, info: ears/form, speaker: mouth}
emergency_stop: {topic: stopped, inverted: true, service: stop, service_field: on, service_stop_value: false}
head:
  kind: joint_angles
  topic: head
  pan_joint: a
  tilt_joint: b
  joint_states: joints
  pan_range_rad: [-1, 1]
  tilt_range_rad: [-0.4, 0.4]
  speed_radps: 0.5
  pan_sign: -1
  tilt_sign: -1
controls:
  - {id: a, title: A, kind: slider, group: G, unit: m, range: [0, 2], step: 0.5, confirm: true, moves: false,
     publish: {topic: t, type: a/B, message: {data: $value}},
     shows: {topic: t, type: a/B, field: data, scale: 2, throttle_ms: 100}}
  - {id: b, title: B, kind: choice, choices: [{title: One, value: 1}],
     call: {service: s, type: a/B, request: {data: $value}}}
  - {id: c, title: C, kind: button, action: {name: d, type: a/DoAction, goal: {x: 1.0}}}
""",
    """
version: 1
ros: 2
velocity: {topic: /cmd_vel}
footprint: {radius_m: 0.3}
laser: {robot_from_laser: {heading_rad: 0.123456}}
cameras:
  - {name: front, topic: c, model: {width_px: 64, height_px: 48, horizontal_fov_deg: 60, heading_deg: 10, tilt_deg: 20}}
navigation: {kind: navigate_to_pose, name: navigate, speed_limit: {topic: speed_limit}}
speech: {action: {name: say, type: a/action/Say, goal: {text: $value}}}
emergency_stop: {set_service: s, clear_service: c, service_type: std_srvs/srv/Empty}
""",
    "version: 1\nros: 2\nvelocity: {topic: v}\nfootprint_radius_m: 0.3\nemergency_stop: {command_topic: stop}\n"
    "speech: {service: {name: say, type: a/Say, request: {text: $value}, answers_at_end: true, stop: hush}}\n",
    "version: 1\nros: 2\nvelocity: {topic: v}\nfootprint_radius_m: 0.3\nspeech:\n"
    "  web: {url: http://robot/say, body: {text: $value}, answers_at_end: true, stop: http://robot/hush}\n",
)


def declared_keys(group: Group) -> Iterator[str]:
    for key in keys_of(group):
        yield f"{group.__name__}.{key.name}"
        kind = (key.form.item or key.form).kind
        if is_group(kind):
            yield from declared_keys(kind)


def keys_in(group: Group, data: dict[str, Any]) -> Iterator[str]:
    for key in keys_of(group):
        if key.name in data:
            yield f"{group.__name__}.{key.name}"
            kind = (key.form.item or key.form).kind
            for each in data[key.name] if key.form.item else [data[key.name]]:
                if is_group(kind):
                    yield from keys_in(kind, each)


def test_an_outline_with_the_centre_on_its_edge_or_twice_the_same_corner_is_none() -> None:
    square = [(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)]
    assert polygon_mistake(square) == ""
    assert polygon_mistake([*square, square[0]])
    assert polygon_mistake([(0.0, 0.5), (1.0, 0.5), (1.0, -0.5), (0.0, -0.5)])
    assert polygon_mistake([(-1.0, 0.0), (0.0, 0.0), (1.0, 0.0)])


def test_values_of_the_panel_keep_their_types() -> None:
    profile = load_profile("tiago")
    torso = next(control for control in profile.controls if control.id == "torso")
    assert isinstance(torso.effect, PublishMessage)
    assert torso.effect.message["points"] == [{"positions": ["$value"], "time_from_start": {"secs": 3, "nsecs": 0}}]
