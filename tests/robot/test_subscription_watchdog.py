"""Silent topics: the requested encoding, and the reaction to missing messages."""

from dataclasses import replace
from typing import Any

import pytest

from caris_desktop.domain.events import Problem
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import LaserScan, Odometry
from caris_desktop.robot import subscription_watchdog
from caris_desktop.robot.profile_model import (
    CameraTopic,
    HeadInterface,
    NavigationServer,
    RobotProfile,
    TopicSource,
    TransformFrames,
)
from caris_desktop.ros.definitions import cbor_carries
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ros.message_conversion import encode_odometry, encode_tf_message
from tests.robot.loop_bench import Answer, Bridge, LoopBench, with_link
from tests.robot.test_sensors import ROBOT, START_NS, scan_message

WHOLE = RobotProfile(
    "test",
    "Test",
    scan=TopicSource("/scan"),
    odometry=TopicSource("/odom"),
    pose=TopicSource("/amcl_pose"),
    tf=TopicSource("/tf"),
    tf_static=TopicSource("/tf_static"),
    path=TopicSource("/plan"),
    battery=TopicSource("/battery"),
    map=TopicSource("/map"),
    cameras=(CameraTopic("front", "/image", info="/info"),),
    head=HeadInterface("joint_trajectory", "/head", "pan", "tilt"),
    frames=TransformFrames(base="base_footprint"),
    navigation=NavigationServer("move_base", "/move_base"),
)
PUBLISHED: dict[str, Answer] = {
    "/rosapi/publishers": lambda request: {"publishers": ["/robot"] if request["topic"] != "/tf" else []}
}


@pytest.mark.parametrize(
    ("type_", "carried"),
    [
        ("sensor_msgs/LaserScan", True),
        ("sensor_msgs/msg/LaserScan", True),
        ("nav_msgs/OccupancyGrid", True),
        ("sensor_msgs/CompressedImage", True),
        ("sensor_msgs/Image", True),
        ("tf2_msgs/TFMessage", True),
        ("actionlib_msgs/GoalStatusArray", True),
        ("nav_msgs/Odometry", False),
        ("nav_msgs/msg/Odometry", False),
        ("geometry_msgs/PoseWithCovarianceStamped", False),
        ("sensor_msgs/CameraInfo", False),
        ("sensor_msgs/JointState", False),
        ("nobody_msgs/Knows", False),
    ],
)
def test_types_that_rosbridge_can_send_as_cbor(type_: str, carried: bool) -> None:
    assert cbor_carries(type_) is carried


@pytest.mark.parametrize("media", [False, True])
@pytest.mark.parametrize("ros", [1, 2])
def test_each_topic_is_requested_in_an_encoding_that_its_type_can_be_sent_in(ros: Any, media: bool) -> None:
    async def test(bench: LoopBench) -> None:
        wanted = {"/map", "/image", "/info"} if media else {"/scan", "/odom", "/amcl_pose", "/joint_states", "/tf"}
        asked = await bench.until(
            lambda: (
                {line["topic"]: line["compression"] for line in bench.bridge.operations("subscribe")}
                if wanted <= {line["topic"] for line in bench.bridge.operations("subscribe")}
                else None
            ),
            "the subscriptions",
        )
        binary = {topic for topic in wanted if asked[topic] == "cbor"}
        assert binary == {"/map", "/image", "/scan", "/tf"} & wanted

    with_link(replace(WHOLE, ros=ros), test, media=media)


def test_a_silent_topic_is_requested_in_the_other_encoding(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(subscription_watchdog, "FIRST_CHECK_S", 0.1)

    def prepare(bridge: Bridge) -> None:
        bridge.answers.update(PUBLISHED)

        async def react(operation: dict[str, Any]) -> None:
            # Server that cannot encode scans as CBOR, and reports no error.
            if operation["op"] == "subscribe" and operation["topic"] == "/scan" and operation["compression"] == "none":
                await bridge.publish("/scan", scan_message(START_NS))

        bridge.on_operation = react

    async def test(bench: LoopBench) -> None:
        [problem] = await bench.until(
            lambda: [problem for problem in bench.of(Problem) if "/scan" in problem.what], "it is told"
        )
        await bench.until(lambda: len(bench.of(LaserScan)) == 2, "a scan again")
        asked = bench.bridge.operations("subscribe", "/scan")
        # The first encoding is tried again, to find the cause.
        assert [line["compression"] for line in asked] == ["cbor", "none", "cbor", "none"]
        # A ROS 1 server changes the subscription in place, without a gap.
        assert len({line["id"] for line in asked}) == 1
        assert bench.bridge.operations("unsubscribe") == []
        assert (problem.severity, "it does in plain text (JSON)" in problem.what) == ("info", True)
        # No new request for a topic without a publisher.
        assert len(bench.bridge.operations("subscribe", "/tf")) == 1
        await bench.bridge.drop()
        await bench.until(lambda: len(bench.bridge.operations("subscribe", "/scan")) == 5, "the next connection")
        assert bench.bridge.operations("subscribe", "/scan")[4]["compression"] == "none"

    with_link(ROBOT, test, prepare=prepare)


def test_a_robot_that_was_only_slow_keeps_the_encoding_that_is_usual(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subscription_watchdog, "FIRST_CHECK_S", 0.5)

    def prepare(bridge: Bridge) -> None:
        bridge.answers.update(PUBLISHED)

        async def react(operation: dict[str, Any]) -> None:
            # Silent at first. A late JSON message after the second request for CBOR proves nothing.
            asked = len(bridge.operations("subscribe", "/scan"))
            if operation["op"] == "subscribe" and operation["topic"] == "/scan" and asked > 1:
                await bridge.publish("/scan", scan_message(START_NS))
                await bridge.publish("/scan", scan_message(START_NS), cbor=operation["compression"] == "cbor")

        bridge.on_operation = react

    async def test(bench: LoopBench) -> None:
        await bench.until(lambda: len(bench.bridge.operations("subscribe", "/tf_static")) == 3, "the others go on")
        asked = [line["compression"] for line in bench.bridge.operations("subscribe", "/scan")]
        assert asked == ["cbor", "none", "cbor"]
        assert bench.of(Problem) == []

    with_link(ROBOT, test, prepare=prepare)


def test_a_topic_that_comes_stays_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subscription_watchdog, "FIRST_CHECK_S", 0.1)
    looked: list[str] = []

    def prepare(bridge: Bridge) -> None:
        def publishers(request: dict[str, Any]) -> dict[str, Any]:
            looked.append(request["topic"])
            return {"publishers": ["/robot"]}

        bridge.answers["/rosapi/publishers"] = publishers

    async def test(bench: LoopBench) -> None:
        odometry = Odometry(0, None, Pose2D(1.0, 2.0, 0.0), Twist2D())
        await bench.bridge.publish("/odom", encode_odometry(Dialect.ROS1, odometry, stamp_ns=START_NS))
        await bench.until(lambda: bench.of(Odometry), "odometry")
        await bench.until(lambda: looked.count("/tf_static") == 2, "two looks at those that are silent")
        assert "/odom" not in looked
        assert len(bench.bridge.operations("subscribe", "/odom")) == 1
        assert [line["compression"] for line in bench.bridge.operations("subscribe", "/tf_static")][:2] == [
            "cbor",
            "none",
        ]

    with_link(ROBOT, test, prepare=prepare)


def test_in_ros2_a_silent_topic_is_first_requested_again_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subscription_watchdog, "FIRST_CHECK_S", 0.1)

    def prepare(bridge: Bridge) -> None:
        bridge.answers.update(PUBLISHED)

        async def react(operation: dict[str, Any]) -> None:
            # As rosbridge of ROS 2: the first subscription was made before the publisher existed and is volatile.
            ended = bridge.operations("unsubscribe", "/tf_static")
            if operation["op"] == "subscribe" and operation["topic"] == "/tf_static" and len(ended) == 1:
                message = encode_tf_message(Dialect.ROS2, [("base_footprint", "laser", Pose2D(0.4, 0, 0))], stamp_ns=1)
                await bridge.publish("/tf_static", message)

        bridge.on_operation = react

    async def test(bench: LoopBench) -> None:
        async def mounted() -> bool:
            await bench.bridge.publish("/scan", scan_message(START_NS))
            count = len(bench.of(LaserScan))
            await bench.until(lambda: len(bench.of(LaserScan)) > count, "a scan")
            place = bench.of(LaserScan)[-1].robot_from_laser
            # None until the transforms arrive.
            return place is not None and place.x_m == 0.4

        while not await mounted():
            pass
        subscriptions = bench.bridge.operations("subscribe", "/tf_static")
        assert [line["compression"] for line in subscriptions] == ["cbor", "cbor"]
        assert [line["id"] for line in bench.bridge.operations("unsubscribe", "/tf_static")] == [subscriptions[0]["id"]]
        assert bench.of(Problem) == []

    with_link(replace(ROBOT, ros=2), test, prepare=prepare)
