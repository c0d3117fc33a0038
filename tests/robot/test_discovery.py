"""Exploration of a robot: the proposed profile for various interfaces, and the check of each stream."""

import asyncio
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import pytest
from websockets.asyncio.server import ServerConnection, serve
from websockets.http11 import Response

from caris_desktop.domain.media_checks import picture_size
from caris_desktop.domain.translation import LocalizedText
from caris_desktop.robot.discovery import (
    _DESCRIPTIONS,
    ExploreError,
    StreamCheck,
    check_streams,
    detect_dialect,
    explore_robot,
    load_profile_blocking,
    value_at,
)
from caris_desktop.robot.profile import load_profile, read_profile, save_profile
from caris_desktop.robot.profile_model import AudioInterface, LaserMount, ProfileError, RobotProfile, SecuritySettings
from caris_desktop.robot.profile_proposal import Proposal, RobotOffer, profile_of, propose
from caris_desktop.robot.transport import RosbridgeClient, ServiceCallError
from caris_desktop.ros.dialect import Dialect
from tests.support.simulated_robot import SimulatedRobot

_POSE = {"pose": {"position": {"x": 0.0, "y": 0.0}, "orientation": {"z": 0.0, "w": 1.0}}}
_FRAME = {
    "header": {"stamp": {"secs": 1, "nsecs": 0}, "frame_id": "base"},
    "transform": {"translation": {"x": 0.0, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}},
}
DESCRIBED: dict[str, tuple[Callable[[Any], str], dict[str, Any]]] = {
    "path": (_DESCRIPTIONS["nav_msgs/Path"], {"header": {"frame_id": "map"}, "poses": [_POSE, _POSE]}),
    "bool": (_DESCRIPTIONS["std_msgs/Bool"], {"data": True}),
    "battery": (_DESCRIPTIONS["sensor_msgs/BatteryState"], {"percentage": float("nan")}),
    "frames": (
        _DESCRIPTIONS["tf2_msgs/TFMessage"],
        {"transforms": [{**_FRAME, "child_frame_id": name} for name in ("a", "b", "c")]},
    ),
}
ROS1 = {
    "/cmd_vel": "geometry_msgs/Twist",
    "/scan": "sensor_msgs/LaserScan",
    "/odom": "nav_msgs/Odometry",
    "/tf": "tf2_msgs/TFMessage",
}


def offer(topics: dict[str, str], **more: object) -> RobotOffer:
    return RobotOffer(topics, dialect=Dialect.ROS1, **more)  # type: ignore[arg-type]  # the words of the tests below


def chosen(topics: dict[str, str], **more: object) -> dict[str, str]:
    return propose(offer(topics, **more)).chosen


def why(proposal: Proposal, field: str) -> str:
    return next(each.why for each in proposal.fields if each.field == field)


def test_the_usual_names_are_proposed_and_what_is_not_there_is_left_empty() -> None:
    proposal = propose(offer(ROS1))
    values = proposal.chosen
    assert (values["velocity"], values["scan"], values["odometry"], values["tf"]) == (
        "/cmd_vel",
        "/scan",
        "/odom",
        "/tf",
    )
    assert (values["map"], values["speech"], values["navigation"]) == ("", "", "")
    assert why(proposal, "map") == "The robot offers nothing of this kind."
    assert why(proposal, "scan") == "Its type is sensor_msgs/LaserScan. It is named “scan”."


def test_a_microphone_and_a_loudspeaker_are_distinguished() -> None:
    topics = {
        "/audio/audio": "audio_common_msgs/AudioData",
        "/audio/audio_info": "audio_common_msgs/AudioInfo",
        "/speaker/audio": "audio_common_msgs/AudioData",
    }
    counts = {"publishers": {"/audio/audio": 1, "/audio/audio_info": 1}, "subscribers": {"/speaker/audio": 1}}
    found = offer(ROS1 | topics, **counts)
    robot = profile_of(found, propose(found).chosen, name="r", title="R", address="ws://r:9090")
    assert robot.audio == AudioInterface("/audio/audio", info="/audio/audio_info", speaker="/speaker/audio")
    stamped = offer(ROS1 | {"/mic": "audio_common_msgs/AudioDataStamped"})
    robot = profile_of(stamped, propose(stamped).chosen, name="r", title="R", address="ws://r:9090")
    assert robot.audio == AudioInterface("/mic", "AudioDataStamped")
    assert profile_of(offer(ROS1), chosen(ROS1), name="r", title="R", address="ws://r:9090").audio is None


def test_the_type_counts_before_the_name() -> None:
    proposal = propose(offer(ROS1 | {"/scan": "sensor_msgs/PointCloud2", "/hokuyo": "sensor_msgs/LaserScan"}))
    assert proposal.chosen["scan"] == "/hokuyo"
    stamped = profile_of(
        offer({"/cmd_vel": "geometry_msgs/TwistStamped"}),
        {"velocity": "/cmd_vel"},
        name="a",
        title="A",
        address="ws://a",
    )
    assert stamped.velocity.type == "TwistStamped"


def test_of_several_the_robot_s_own_comes_first_and_the_doubtful_ones_are_candidates() -> None:
    proposal = propose(
        offer(
            ROS1
            | {
                "/camera/depth/image/compressed": "sensor_msgs/CompressedImage",
                "/camera/color/image_raw/compressed": "sensor_msgs/CompressedImage",
                "/camera/color/image_rect/compressed": "sensor_msgs/CompressedImage",
                "/rear/image_raw/compressed": "sensor_msgs/CompressedImage",
                "/move_base/local_costmap/costmap": "nav_msgs/OccupancyGrid",
                "/rear_scan": "sensor_msgs/LaserScan",
            }
        )
    )
    values = proposal.chosen
    assert values["cameras.0"] == "/camera/color/image_raw/compressed"
    assert values["cameras.1"] == values["cameras.2"] == ""
    assert values["map"] == ""
    assert values["scan"] == "/scan"
    scan = next(each for each in proposal.fields if each.field == "scan")
    assert [candidate.value for candidate in scan.candidates] == ["/scan", "/rear_scan"]
    assert "“rear” in its name makes it unlikely" in scan.candidates[1].why


def test_raw_pictures_are_taken_where_there_are_no_compressed_ones_and_that_is_reported() -> None:
    raw = {"/camera/image_raw": "sensor_msgs/Image", "/camera/depth/image_raw": "sensor_msgs/Image"}
    both = propose(offer({**raw, "/camera/image_raw/compressed": "sensor_msgs/CompressedImage"}))
    assert both.chosen["cameras.0"] == "/camera/image_raw/compressed"
    assert not any("republish" in note for note in both.notes)
    found = offer({**raw, "/camera/camera_info": "sensor_msgs/CameraInfo"})
    only_raw = propose(found)
    assert only_raw.chosen["cameras.0"] == "/camera/image_raw"
    assert "not compressed" in why(only_raw, "cameras.0")
    assert any("republish" in note for note in only_raw.notes)
    [camera] = profile_of(found, only_raw.chosen, name="a", title="A", address="ws://a").cameras
    assert (camera.type, camera.topic, camera.info) == ("Image", "/camera/image_raw", "/camera/camera_info")


def test_a_person_drives_through_the_input_of_the_multiplexer() -> None:
    names = ("/nav_vel", "/key_vel", "/joy_vel", "/mobile_base_controller/cmd_vel", "/twist_mux/out")
    topics = dict.fromkeys(names, "geometry_msgs/Twist")
    proposal = propose(offer(topics))
    assert proposal.chosen["velocity"] == "/key_vel"
    assert any("multiplexer" in note for note in proposal.notes)


def test_a_topic_that_nothing_publishes_comes_behind_one_that_something_does() -> None:
    topics = ROS1 | {"/scan_filtered": "sensor_msgs/LaserScan"}
    assert chosen(topics, publishers={"/scan": 0, "/scan_filtered": 1})["scan"] == "/scan_filtered"


def test_namespaces_are_found_and_one_robot_is_mapped_at_a_time() -> None:
    topics = {f"/{robot}/{name}": kind for robot in ("robot1", "robot2") for name, kind in (*ROS1.items(),)} | {
        "/tf": "tf2_msgs/TFMessage",
        "/mobile_base_controller/cmd_vel": "geometry_msgs/Twist",
    }
    topics = {topic.replace("//", "/"): kind for topic, kind in topics.items()}
    first = propose(offer(topics))
    assert first.namespaces == ("robot1", "robot2")
    assert first.chosen["velocity"] == "/robot1/cmd_vel"
    second = propose(offer(topics), namespace="robot2")
    assert (second.chosen["velocity"], second.chosen["scan"]) == ("/robot2/cmd_vel", "/robot2/scan")
    assert second.chosen["tf"] == "/robot2/tf"


@pytest.mark.parametrize(
    ("services", "expected", "field", "stops_with"),
    [
        ({"/emergency_stop/set": "std_srvs/SetBool"}, "/emergency_stop/set", "data", True),
        ({"/motor_power": "std_srvs/srv/SetBool"}, "/motor_power", "data", False),
        ({"/e_stop": "irobot_create_msgs/srv/EStop"}, "/e_stop", "e_stop_on", True),
        ({"/lights/set": "std_srvs/SetBool"}, "", "", True),
    ],
)
def test_an_emergency_stop_is_reported_with_its_field_and_sense(
    services: dict[str, str], expected: str, field: str, stops_with: bool
) -> None:
    found = offer(ROS1, services=services)
    values = propose(found).chosen
    assert values["emergency_stop.service"] == expected
    stop = profile_of(found, values, name="a", title="A", address="ws://a").emergency_stop
    if not expected:
        assert stop is None
    else:
        assert stop is not None
        assert (stop.service, stop.service_field, stop.service_stop_value) == (expected, field, stops_with)


def test_two_services_make_one_emergency_stop() -> None:
    found = offer(ROS1, services={"/estop/trigger": "std_srvs/Empty", "/estop/reset": "std_srvs/Empty"})
    values = propose(found).chosen
    assert values["emergency_stop.service"] == "/estop/trigger | /estop/reset"
    stop = profile_of(found, values, name="a", title="A", address="ws://a").emergency_stop
    assert stop is not None
    assert (stop.set_service, stop.clear_service, stop.service_type) == (
        "/estop/trigger",
        "/estop/reset",
        "std_srvs/Empty",
    )


def test_the_robots_microphone_is_not_its_voice() -> None:
    topics = ROS1 | {
        "/speech_recognition/result": "std_msgs/String",
        "/tts/status": "std_msgs/String",
        "/stop": "std_msgs/Empty",
    }
    values = chosen(topics)
    assert (values["speech"], values["speech.stop"]) == ("", "")
    assert chosen(topics | {"/robot/say": "std_msgs/String"})["speech"] == "/robot/say"


def test_a_head_needs_joints_that_are_known() -> None:
    topics = ROS1 | {
        "/head_controller/command": "trajectory_msgs/JointTrajectory",
        "/arm_controller/command": "trajectory_msgs/JointTrajectory",
        "/joint_states": "sensor_msgs/JointState",
    }
    assert chosen(topics)["head"] == ""
    found = offer(topics, joints=("wheel", "head_2_joint", "head_1_joint"))
    values = propose(found).chosen
    assert values["head"] == "/head_controller/command"
    head = profile_of(found, values, name="a", title="A", address="ws://a").head
    assert head is not None
    assert (head.pan_joint, head.tilt_joint, head.joint_states) == ("head_1_joint", "head_2_joint", "/joint_states")


def test_a_robot_that_offers_nothing_is_proposed_nothing_and_still_makes_a_profile(tmp_path: Path) -> None:
    nothing = RobotOffer({})
    proposal = propose(nothing)
    assert set(proposal.chosen.values()) == {""}
    assert any("No topic for driving was found" in note for note in proposal.notes)
    profile = profile_of(nothing, proposal.chosen, name="empty", title="Empty", address="ws://10.0.0.5:9090")
    save_profile(profile, tmp_path / "empty.yaml")
    assert read_profile(tmp_path / "empty.yaml") == profile


def test_a_simulator_s_clock_is_noticed() -> None:
    found = offer(ROS1 | {"/clock": "rosgraph_msgs/Clock"})
    assert profile_of(found, propose(found).chosen, name="a", title="A", address="ws://a").simulation_time


def in_words(detail: str) -> str:
    """Text looked up for the wizard, with its values."""
    if not isinstance(detail, LocalizedText):
        return f"<{detail}>"
    return " ".join(
        [
            f"<{detail.template}>",
            *(
                f"{name}={in_words(value) if isinstance(value, LocalizedText) else value}"
                for name, value in detail.values.items()
            ),
        ]
    )


def test_descriptions_of_a_message_can_be_translated() -> None:
    sentences = {kind: in_words(describe({**message})) for kind, (describe, message) in DESCRIBED.items()}
    assert sentences == {
        "path": "<{number} points.> number=2",
        "bool": "<Now {value}.> value=true",
        "battery": "<Its charge is not reported.>",
        "frames": "<Frames {frames}.> frames=<{names} and {number} more> names=a, b number=1",
    }


def heard(profile: RobotProfile, address: str) -> dict[str, StreamCheck]:
    """Checks of all streams; a longer listening time if a busy machine publishes late."""
    for seconds in (1.2, 3.0, 6.0):
        checks = asyncio.run(check_streams(profile, address, seconds=seconds))
        if {check.state for check in checks} <= {"good", "quiet"}:
            break
    return {check.field: check for check in checks}


@pytest.fixture(scope="module", params=[1, 2], ids=["ros1", "ros2"])
def robot(request: pytest.FixtureRequest) -> Iterator[SimulatedRobot]:
    with SimulatedRobot(ros=request.param) as simulated:
        yield simulated


def test_the_ros_version_is_detected(robot: SimulatedRobot) -> None:
    assert asyncio.run(detect_dialect(robot.address)) is Dialect(robot.ros)
    assert load_profile_blocking(robot.address).ros == robot.ros
    assert load_profile_blocking(f"{robot.address}?ros=1").ros == 1


@pytest.mark.long("ros2")
def test_an_unknown_robot_is_explored_checked_and_saved(robot: SimulatedRobot, tmp_path: Path) -> None:
    steps: list[str] = []
    found = asyncio.run(explore_robot(robot.address, on_progress=steps.append))
    assert steps[0] == "Connecting"
    assert found.offer.dialect is Dialect(robot.ros)
    assert found.resembles[0].name == ("simulated" if robot.ros == 1 else "simulated-ros2")
    assert found.resembles[0].share == 1.0

    proposed = profile_of(found.offer, found.proposal.chosen, name="found", title="Found", address=robot.address)
    known = load_profile(found.resembles[0].name)
    # The timeout of the base cannot be queried.
    known = replace(known, velocity=replace(known.velocity, timeout_s=None, timeout_source=""))
    for field in (
        "ros", "velocity", "scan", "odometry", "tf", "tf_static", "frames", "map", "map_updates", "path", "battery",
        "initial_pose", "maps", "speech", "emergency_stop",
    ):  # fmt: skip
        assert getattr(proposed, field) == getattr(known, field), field
    assert known.navigation is not None
    # The speed setting of a ROS 1 planner cannot be queried, so no parameter for it is proposed.
    told = known.navigation if robot.ros == 2 else replace(known.navigation, max_mps=None, speed_limit=None)
    assert proposed.navigation == told
    assert proposed.head is not None
    assert known.head is not None
    assert (proposed.head.topic, proposed.head.pan_joint) == (known.head.topic, known.head.pan_joint)
    assert proposed.cameras[0].topic == known.cameras[0].topic
    assert proposed.limits.forward_mps < known.limits.forward_mps

    by_field = heard(proposed, robot.address)
    assert {check.state for check in by_field.values()} <= {"good", "quiet"}, by_field
    scan = by_field["scan"]
    assert scan.rate_hz is not None
    assert 0.5 < scan.rate_hz < 20.0
    assert scan.age_s is not None
    assert "beams" in scan.detail
    assert "640x480" in by_field["cameras.0"].detail
    assert "m in cells of" in by_field["map"].detail
    assert by_field["path"].state == "quiet"

    save_profile(proposed, tmp_path / "found.yaml")
    assert load_profile("found", user_dir=tmp_path) == proposed


def test_a_wrong_profile_is_reported_line_by_line(robot: SimulatedRobot, tmp_path: Path) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(
        f"version: 1\nros: {robot.ros}\naddress: {robot.address}\nvelocity: {{topic: /cmd_vel, type: TwistStamped}}\n"
        "scan: {topic: /odom}\nodometry: {topic: /nothing}\ntf: {topic: /tf}\n"
        "emergency_stop: {service: /nothing/set}\n"
        "controls:\n  - id: a\n    title: A\n    kind: readout\n"
        "    shows: {topic: /eyes/state, type: std_msgs/Bool, field: dat}\n"
    )
    told: list[StreamCheck] = []
    listening = check_streams(read_profile(path), seconds=1.2, on_check=told.append)
    checks = {check.field: check for check in asyncio.run(listening)}
    assert {check.field for check in told} == set(checks)
    states = {field: check.state for field, check in checks.items()}
    assert states.pop("tf") in ("good", "slow")
    assert states == {
        "velocity": "wrong",
        "scan": "wrong",
        "odometry": "nothing",
        "emergency_stop.service": "nothing",
        "controls.a.shows": "wrong",
    }
    assert "sensor_msgs/LaserScan was expected" in checks["scan"].detail
    assert "the message has no dat" in checks["controls.a.shows"].detail
    assert in_words(checks["scan"].detail).startswith("<Its type is {kind}; {expected} was expected.>")
    unread = in_words(checks["controls.a.shows"].detail)
    assert unread == "<The messages cannot be used: {error}.> error=<the message has no {path}> path=dat"


@pytest.mark.parametrize(
    ("roll_deg", "state", "said"),
    [
        ("0", "good", "Mounted upright."),
        ("180", "good", "Mounted upside down"),
        ("20", "wrong", "tilted by 20 degrees"),
    ],
)
@pytest.mark.long("0-*", "20-*")
def test_listening_says_how_the_lidar_is_mounted(roll_deg: str, state: str, said: str) -> None:
    with SimulatedRobot("--empty", "--lidar-roll-deg", roll_deg) as robot:
        profile = replace(load_profile("simulated"), address=robot.address)
        [scan] = [check for check in asyncio.run(check_streams(profile, seconds=1.2)) if check.field == "scan"]
        assert (scan.state, said in scan.detail) == (state, True), scan.detail
        profile = replace(profile, laser=LaserMount(mounting="upright"))
        [scan] = [check for check in asyncio.run(check_streams(profile, seconds=1.2)) if check.field == "scan"]
        assert "Mounted upright, as set in the profile." in scan.detail


@pytest.mark.long
def test_listening_shows_what_rosbridge_does_not_let_through() -> None:
    with SimulatedRobot("--empty", "--topics-glob", "/scan", "/odom*", "/tf*", "/rosapi*") as robot:
        profile = replace(load_profile("simulated"), address=robot.address)
        checks = {check.field: check for check in asyncio.run(check_streams(profile, seconds=1.2))}
        assert (checks["velocity"].state, "topics_glob" in checks["velocity"].detail) == ("wrong", True)
        assert checks["scan"].state in ("good", "slow")


def test_an_unanswered_question_for_subscribers_is_not_reported_as_none(monkeypatch: pytest.MonkeyPatch) -> None:
    nodes = RosbridgeClient.nodes

    async def without_subscribers(
        self: RosbridgeClient, kind: Literal["publishers", "subscribers"], topic: str
    ) -> list[str]:
        if kind == "subscribers":
            raise ServiceCallError("no answer")
        return [*await nodes(self, kind, topic), "/joystick"]

    monkeypatch.setattr(RosbridgeClient, "nodes", without_subscribers)
    with SimulatedRobot("--empty") as robot:
        profile = replace(load_profile("simulated"), address=robot.address)
        checks = {check.field: check for check in asyncio.run(check_streams(profile, seconds=0.2))}
    assert (checks["velocity"].state, checks["velocity"].detail) == ("good", "The robot has this topic.")


def test_the_other_ros_is_refused_before_anything_is_subscribed(robot: SimulatedRobot) -> None:
    other = load_profile("tiago" if robot.ros == 2 else "turtlebot4")
    with pytest.raises(ExploreError, match=f"runs ROS {robot.ros}") as raised:
        asyncio.run(check_streams(other, robot.address))
    assert f"'ros: {robot.ros}'" in raised.value.advice


def test_a_robot_with_other_interface_names_is_recognised() -> None:
    with SimulatedRobot(robot_model="pepper") as robot:
        found = asyncio.run(explore_robot(robot.address))
    assert [each.name for each in found.resembles] == ["pepper"]
    values = found.proposal.chosen
    assert (values["scan"], values["head"], values["speech"]) == ("/pepper_robot/laser", "/joint_angles", "/speech")


def test_an_empty_address_is_reported_and_ros_1_assumed() -> None:
    address = "ws://127.0.0.1:9"
    with pytest.raises(ExploreError, match="no rosbridge is running") as raised:
        asyncio.run(explore_robot(address, timeout_s=2.0))
    assert "Start rosbridge" in raised.value.advice
    assert load_profile_blocking(address, timeout_s=1.0).ros == 1
    with pytest.raises(ProfileError):
        load_profile_blocking("ws://:")


def test_the_size_of_a_picture_is_read_from_its_head() -> None:
    jpeg = b"\xff\xd8\xff\xe0\x00\x04ab\xff\xc0\x00\x11\x08\x01\xe0\x02\x80" + bytes(12)
    assert picture_size(jpeg) == (640, 480)
    assert picture_size(b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR" + (320).to_bytes(4) + (240).to_bytes(4)) == (320, 240)
    for broken in (b"", b"\xff\xd8", jpeg[:14], b"GIF89a", b"\xff\xd8\xff\xe0\x00\x00" * 3):
        assert picture_size(broken) is None


def test_a_value_is_found_by_its_path() -> None:
    message = {"status": [{"level": 2, "name": "x"}], "data": True}
    assert value_at(message, "status[0].level") == 2
    assert value_at(message, "data") is True
    for path in ("status", "status[1].level", "data.x", "nothing"):
        with pytest.raises(ValueError, match=r"status|data|nothing"):
            value_at(message, path)


@pytest.mark.long
def test_a_namespaced_robot_with_a_clock_of_its_own() -> None:
    with SimulatedRobot("--namespace", "robot7", "--simulation-time", robot_model="turtlebot4") as robot:
        found = asyncio.run(explore_robot(robot.address))
        profile = profile_of(found.offer, found.proposal.chosen, name="a", title="A", address=robot.address)
        checks = heard(profile, robot.address)
    assert found.proposal.namespace == "robot7"
    assert profile.simulation_time
    assert profile.velocity.topic == "/robot7/cmd_vel"
    assert profile.scan is not None
    assert profile.scan.topic == "/robot7/scan"
    assert profile.tf is not None
    assert profile.tf.topic == "/robot7/tf"
    assert {check.state for check in checks.values()} <= {"good", "quiet"}, checks


def test_a_robot_that_wants_a_secret_is_explored_with_it_and_not_without(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EXPLORE_SECRET", "open-sesame-1234")
    security = SecuritySettings(rosauth_secret_env="EXPLORE_SECRET")
    with SimulatedRobot("--rosauth-secret-env", "EXPLORE_SECRET") as robot:
        with pytest.raises(ExploreError, match="closed the connection during the query") as unnamed:
            asyncio.run(explore_robot(robot.address, timeout_s=5.0))
        assert "If the robot requires a secret (rosauth)" in unnamed.value.advice
        found = asyncio.run(explore_robot(robot.address, security=security))
        assert found.proposal.chosen["velocity"] == "/cmd_vel"
        monkeypatch.setenv("EXPLORE_SECRET", "another-sesame-1")
        with pytest.raises(ExploreError, match="refused this console") as raised:
            asyncio.run(explore_robot(robot.address, security=security, timeout_s=5.0))
    assert "EXPLORE_SECRET" in raised.value.advice
    assert "sesame" not in str(raised.value)


def test_a_server_that_is_not_ready_is_waited_for_and_not_taken_for_another_port() -> None:
    async def refused() -> ExploreError:
        async with serve(lambda _none: asyncio.sleep(0), "127.0.0.1", 0, process_request=_not_ready) as server:
            port = next(iter(server.sockets)).getsockname()[1]
            with pytest.raises(ExploreError) as raised:
                await explore_robot(f"ws://127.0.0.1:{port}", timeout_s=5.0)
            return raised.value

    error = asyncio.run(refused())
    assert "does not accept connections at the moment (HTTP 503)" in error.what
    assert "Wait a moment" in error.advice and "9090" not in error.advice


def _not_ready(connection: ServerConnection, _request: object) -> Response:
    return connection.respond(503, "not yet")
