"""Comparison of the interfaces in a profile with those of a robot."""

import asyncio
import json
from dataclasses import replace
from typing import Any, cast

import pytest

from caris_desktop.robot import robot_checks
from caris_desktop.robot.discovery import ExploreError, check_streams, explore_robot
from caris_desktop.robot.profile import load_profile, parse_profile, shipped_profiles
from caris_desktop.robot.profile_model import CameraTopic, RobotProfile, TopicSource
from caris_desktop.robot.robot_checks import (
    LinkProbe,
    RobotInventory,
    check,
    missing_from,
    named_in,
    queue_advice,
    services_of,
    settled_inventory,
)
from caris_desktop.robot.transport import RosbridgeClient, ServiceCallError
from caris_desktop.ros.dialect import Dialect
from tests.robot.loop_bench import Bridge

TIAGO = load_profile("tiago")
TOPICS = {named.topic: named.types[0] for named in named_in(TIAGO)} | {
    "/move_base/goal": "move_base_msgs/MoveBaseActionGoal",
    "/tts/goal": "pal_interaction_msgs/TtsActionGoal",
    "/play_motion/goal": "play_motion_msgs/PlayMotionActionGoal",
}
WHOLE = RobotInventory(TOPICS, frozenset())


def without(*topics: str) -> RobotInventory:
    return replace(WHOLE, topics={topic: kind for topic, kind in TOPICS.items() if topic not in topics})


def test_a_robot_with_everything_lacks_nothing() -> None:
    assert missing_from(TIAGO, WHOLE) == []


def test_each_thing_that_is_missing_is_a_sentence_of_its_own() -> None:
    sentences = missing_from(
        TIAGO, without("/scan", "/key_vel", "/tts/goal", "/move_base/goal", "/head_controller/command")
    )
    assert sentences == [
        "Driving: nothing on the robot subscribes to /key_vel.",
        "LIDAR: the robot has no topic /scan.",
        "Head: nothing on the robot subscribes to /head_controller/command.",
        "Navigation: the robot has no action /move_base.",
        "Speech: the robot has no action /tts.",
    ]


def test_occasional_topics_are_not_missing() -> None:
    assert missing_from(TIAGO, without("/move_base/GlobalPlanner/plan", "/amcl_pose", "/initialpose")) == []


def test_pictures_that_are_there_uncompressed_are_reported_with_what_to_do() -> None:
    camera = TIAGO.cameras[0].topic
    raw = camera.removesuffix("/compressed")
    only_raw = replace(without(camera), topics={**without(camera).topics, raw: "sensor_msgs/Image"})
    for inventory in (only_raw, replace(WHOLE, topics={**TOPICS, camera: "sensor_msgs/Image"})):
        [sentence] = missing_from(TIAGO, inventory)
        assert "only available uncompressed. Add 'type: Image'" in sentence
        assert "image_transport republish raw compressed" in sentence
    takes_raw = replace(TIAGO, cameras=(CameraTopic("front", raw, type="Image"),))
    assert missing_from(takes_raw, only_raw) == []
    [sentence] = missing_from(replace(TIAGO, cameras=(CameraTopic("front", camera, type="Image"),)), WHOLE)
    assert sentence == f"Camera front: {camera} is compressed: remove 'type: Image'."


def test_controls_without_effect_are_one_sentence() -> None:
    lacking = without("/play_motion/goal", "/power/battery_level")
    [sentence] = missing_from(TIAGO, lacking)
    assert sentence.endswith("they use: Battery, Wave, Fold the arm.")


def test_another_type_is_reported_with_the_expected_one_as_the_robot_spells_it() -> None:
    profile = load_profile("turtlebot4")
    topics = {named.topic: named.types[0].replace("/", "/msg/", 1) for named in named_in(profile)}
    topics = {topic: kind.replace("/msg/msg/", "/msg/") for topic, kind in topics.items()}
    names = frozenset(service for _field, _label, service in services_of(profile)) | {"/slam_toolbox/serialize_map"}
    inventory = RobotInventory(topics | {"/cmd_vel": "geometry_msgs/msg/Twist"}, names, None)
    assert inventory.dialect is Dialect.ROS2
    [sentence] = missing_from(profile, inventory)
    assert (
        sentence
        == "Driving: /cmd_vel has the type geometry_msgs/msg/Twist, but geometry_msgs/msg/TwistStamped was expected."
    )


def test_one_of_the_nodes_for_maps_is_enough() -> None:
    profile = replace(load_profile("simulated-ros2"), controls=())
    topics = {named.topic: named.types[0].replace("/", "/msg/", 1) for named in named_in(profile)}
    stop = {"/emergency_stop/set"}
    for there in ("/slam_toolbox/serialize_map", "/map_server/load_map"):
        inventory = RobotInventory(topics, frozenset(stop | {there}), frozenset({"/navigate_to_pose"}))
        assert missing_from(profile, inventory) == []
    [sentence] = missing_from(profile, RobotInventory(topics, frozenset(stop), frozenset({"/navigate_to_pose"})))
    assert sentence.startswith("Maps: the robot has none of /slam_toolbox/serialize_map,")


def test_an_action_that_the_robot_does_not_list_is_not_called_missing() -> None:
    profile = replace(load_profile("generic-ros2"), maps=None)
    topics = {named.topic: named.types[0].replace("/", "/msg/", 1) for named in named_in(profile)}
    assert missing_from(profile, RobotInventory(topics, frozenset(), None)) == []
    assert missing_from(profile, RobotInventory(topics, frozenset(), frozenset())) == [
        "Navigation: the robot has no action /navigate_to_pose."
    ]


def test_every_name_of_every_shipped_profile_is_looked_for() -> None:
    for name in shipped_profiles():
        profile = load_profile(name)
        looked_for = {named.topic for named in named_in(profile)}
        sources = (profile.scan, profile.odometry, profile.map, profile.map_updates, profile.path, profile.battery)
        assert {source.topic for source in sources if source is not None} <= looked_for
        assert {profile.velocity.topic, *(camera.topic for camera in profile.cameras)} <= looked_for
    text = (
        "version: 1\nros: 1\nvelocity: {topic: a}\n"
        "emergency_stop: {topic: b, set_service: c, clear_service: d}\nspeech: {topic: e, speaking: f, stop: g}\n"
    )
    profile = parse_profile(text, file_name="x", name="x")
    assert [named.topic for named in named_in(profile)] == ["/a", "/e", "/f", "/g", "/b"]
    assert [service for _field, _label, service in services_of(profile)] == ["/c", "/d"]


ROBOT_WITH_SCAN = RobotProfile("test", "Test", scan=TopicSource("/scan"))


def test_without_rosapi_a_robot_whose_streams_come_lacks_nothing_that_is_known() -> None:
    async def ask(bridge: Bridge) -> tuple[list[str], list[tuple[str, str]]]:
        await bridge.open()
        address = f"ws://127.0.0.1:{bridge.port}"
        scan = {"ranges": [1.0], "angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.1, "range_max": 5.0}

        async def publish() -> None:
            while True:
                await bridge.publish("/scan", scan)
                await asyncio.sleep(0.05)

        publishing = asyncio.create_task(publish())
        try:
            checked = await check(ROBOT_WITH_SCAN, address, 5.0)
            listened = await check_streams(ROBOT_WITH_SCAN, address, seconds=0.5)
        finally:
            publishing.cancel()
            await bridge.close()
        return checked, [(line.field, line.state) for line in listened]

    checked, listened = asyncio.run(ask(Bridge()))
    assert checked == []
    assert ("rosapi", "quiet") in listened
    assert ("velocity", "quiet") in listened
    assert ("scan", "nothing") not in listened


def test_a_rosbridge_with_one_queue_is_named_with_both_parameters() -> None:
    async def ask(*values: bool) -> str:
        bridge = Bridge()
        bridge.answers["/rosbridge_websocket/get_parameters"] = {"values": [{"bool_value": value} for value in values]}
        await bridge.open()
        try:
            return await queue_advice(RobotProfile("test", "Test", ros=2), f"ws://127.0.0.1:{bridge.port}", 5.0)
        finally:
            await bridge.close()

    told = asyncio.run(ask(False, False))
    assert "(false: send_action_goals_in_new_thread, call_services_in_new_thread)" in told
    assert asyncio.run(ask(True, True)) == ""


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        ("Service /rosapi/topics does not exist", "rosbridge says “Service /rosapi/topics does not exist”."),
        ("x" * 5000, "rosbridge says “" + "x" * 300 + "…”."),
        (None, "rosapi does not respond."),
    ],
)
@pytest.mark.long
def test_a_reply_of_rosapi_is_shown(answer: str | None, told: str) -> None:
    async def ask(bridge: Bridge) -> tuple[list[str], str]:
        await bridge.open()
        bridge.answers = {"/rosapi/topics": lambda _: answer, "/rosapi/services": {"services": []}}
        address = f"ws://127.0.0.1:{bridge.port}"
        try:
            checked = await check(ROBOT_WITH_SCAN, address, 1.0)
            with pytest.raises(ExploreError) as raised:
                await explore_robot(address, timeout_s=1.0)
        finally:
            await bridge.close()
        return checked, raised.value.what

    [silent, unknown], what = asyncio.run(ask(Bridge()))
    assert silent == "LIDAR: no messages on /scan."
    assert unknown == f"Other missing parts are unknown: {told} Start rosapi in addition to rosbridge."
    assert what == f"The robot does not report its topics and services: {told}"


@pytest.mark.logs(r"robot\.(transport|bridge_socket): ")
def test_a_call_that_is_answered_by_a_status_only_fails_with_its_words(caplog: pytest.LogCaptureFixture) -> None:
    async def ask(bridge: Bridge) -> str:
        async def react(operation: dict[str, Any]) -> None:
            if operation["op"] == "call_service":
                words = "the type is not installed"
                await bridge.send(json.dumps({"op": "status", "level": "error", "id": operation["id"], "msg": words}))

        bridge.on_operation = react
        bridge.answers["/rosapi/topics"] = lambda _: None
        await bridge.open()
        probe = LinkProbe()
        ros = RosbridgeClient(f"ws://127.0.0.1:{bridge.port}", probe, service_timeout_s=20.0)
        ros.connect()
        try:
            assert await probe.outcome == ("", "")
            with pytest.raises(ServiceCallError) as raised:
                await ros.ask("/rosapi/topics", "rosapi/Topics")
        finally:
            await ros.aclose(0.3)
            await bridge.close()
        return raised.value.answer

    assert asyncio.run(ask(Bridge())) == "the type is not installed"
    assert "rosbridge says: the type is not installed" in caplog.text


def test_nodes_that_a_new_bridge_finds_one_by_one_are_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    found = ("/odom", "/scan", "/map")
    counts = iter((1, 2, 3, 3))

    async def names(_ros: object) -> RobotInventory:
        return RobotInventory(dict.fromkeys(found[: next(counts)], "a/msg/B"), frozenset())

    monkeypatch.setattr(robot_checks, "list_inventory", names)
    monkeypatch.setattr(robot_checks, "_SETTLED_S", 0.0)
    inventory = asyncio.run(settled_inventory(cast(RosbridgeClient, None)))
    assert tuple(inventory.topics) == found
