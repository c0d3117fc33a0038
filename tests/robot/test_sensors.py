"""Sensor data over rosbridge: scans, timed transforms, paths and the simulated clock."""

import asyncio
import math
from dataclasses import replace
from functools import reduce
from operator import matmul
from typing import Any

import numpy as np
import pytest

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import Gap, GoalChanged, LinkQuality, Problem
from caris_desktop.domain.geometry import Pose2D, Pose3D, Twist2D
from caris_desktop.domain.link_commands import CancelGoal, Drive, GoTo
from caris_desktop.domain.sensing import LaserScan, Odometry, PlannedPath, RobotPose
from caris_desktop.robot import control_link, sensors
from caris_desktop.robot.profile_model import (
    LaserMount,
    NavigationServer,
    RobotProfile,
    TopicSource,
    TransformFrames,
    VelocityTopic,
)
from caris_desktop.robot.sensors import points_in_parent
from caris_desktop.ros.dialect import Dialect, encode_time
from caris_desktop.ros.message_conversion import (
    encode_clock,
    encode_laser_scan,
    encode_odometry,
    encode_path,
    encode_tf_message,
)
from caris_desktop.ros.rosbridge import encode_json
from tests.robot.loop_bench import Bridge, LoopBench, inventory, with_link

ROBOT = RobotProfile(
    "test",
    "Test",
    scan=TopicSource("/scan"),
    odometry=TopicSource("/odom"),
    tf=TopicSource("/tf"),
    tf_static=TopicSource("/tf_static"),
    path=TopicSource("/plan"),
    map=TopicSource("/map"),
    frames=TransformFrames(base="base_footprint"),
    navigation=NavigationServer("move_base", "/robot1/move_base"),
)
START_NS = 100_000_000_000
MS = 1_000_000


def scan_message(stamp_ns: int, frame: str = "laser") -> dict[str, Any]:
    scan = LaserScan(0, None, frame, 0.0, 0.1, 0.1, 10.0, np.ones(3, np.float32), Pose2D(0.0, 0.0, 0.0))
    return encode_laser_scan(Dialect.ROS1, scan, stamp_ns=stamp_ns)


async def tell_transforms(bench: LoopBench, *told: tuple[str, str, Pose2D], at_ns: int, static: bool = False) -> None:
    message = encode_tf_message(Dialect.ROS1, list(told), stamp_ns=at_ns)
    await bench.bridge.publish("/tf_static" if static else "/tf", message)


async def scans(bench: LoopBench, count: int) -> list[LaserScan]:
    await bench.until(lambda: len(bench.of(LaserScan)) >= count, f"{count} scans")
    return bench.of(LaserScan)


def test_a_scan_of_a_turning_robot_lies_where_it_was_taken() -> None:
    async def test(bench: LoopBench) -> None:
        mounted = Pose2D(0.2, 0.0, math.pi)
        await tell_transforms(bench, ("base_footprint", "base_link", Pose2D(0, 0, 0)), at_ns=0, static=True)
        await tell_transforms(bench, ("base_link", "/laser", mounted), at_ns=0, static=True)
        # A localizer publishes its transform ahead of time.
        for step in range(11):
            at_ns = START_NS + step * 50 * MS
            await tell_transforms(bench, ("map", "odom", Pose2D(1.0, 0.0, 0.0)), at_ns=at_ns + 100 * MS)
            await tell_transforms(bench, ("odom", "base_footprint", Pose2D(2.0, 0.0, 0.05 * step)), at_ns=at_ns)
        # Taken 75 ms before the newest transform: at a heading of 0.425 between two samples.
        await bench.bridge.publish("/scan", scan_message(START_NS + 425 * MS), cbor=True)
        # And a scan 50 ms ahead of the transforms.
        await scans(bench, 1)
        await bench.bridge.publish("/scan", scan_message(START_NS + 550 * MS), cbor=True)
        past, ahead = await scans(bench, 2)
        for scan, heading_rad in ((past, 0.425), (ahead, 0.55)):
            assert scan.robot_from_laser is not None
            assert (scan.robot_from_laser.x_m, scan.robot_from_laser.heading_rad) == pytest.approx((0.2, math.pi))
            assert scan.map_from_laser is not None
            expected = Pose2D(3.0, 0.0, heading_rad) @ mounted
            assert (scan.map_from_laser.x_m, scan.map_from_laser.y_m) == pytest.approx((expected.x_m, expected.y_m))
            assert scan.map_from_laser.heading_rad == pytest.approx(expected.heading_rad)
        assert bench.of(RobotPose)[-1].pose_in_map.x_m == 3.0
        assert bench.of(Problem) == []

    with_link(ROBOT, test)


def turned(*, roll: float = 0.0, pitch: float = 0.0, heading: float = 0.0, x_m: float = 0.0) -> Pose3D:
    """Frame with rotations in the order of URDF: heading, pitch, roll."""
    frame = Pose3D(x_m, 0.0, 0.3, 0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2))
    frame = frame @ Pose3D(0.0, 0.0, 0.0, 0.0, math.sin(pitch / 2), 0.0, math.cos(pitch / 2))
    return frame @ Pose3D(0.0, 0.0, 0.0, math.sin(roll / 2), 0.0, 0.0, math.cos(roll / 2))


UPSIDE_DOWN = {
    "rolled": (("base_footprint", "laser", turned(roll=math.pi, x_m=0.2)),),
    "pitched": (("base_footprint", "laser", turned(pitch=math.pi, x_m=0.2)),),
    "rolled, looking back": (("base_footprint", "laser", turned(roll=math.pi, heading=math.pi, x_m=-0.2)),),
    "on a mast that hangs": (
        ("base_footprint", "mast", turned(roll=math.pi, heading=0.4, x_m=0.1)),
        ("mast", "laser", turned(heading=1.1, x_m=0.1)),
    ),
    "two quarter turns": (
        ("base_footprint", "mast", turned(roll=math.pi / 2, x_m=0.1)),
        ("mast", "laser", turned(roll=math.pi / 2, x_m=0.1)),
    ),
    "nearly": (("base_footprint", "laser", turned(roll=3.1, x_m=0.2)),),
}


async def tell_frames(bench: LoopBench, *frames: tuple[str, str, Pose3D], static: bool = True) -> None:
    message = encode_tf_message(Dialect.ROS1, frames, stamp_ns=0 if static else START_NS)
    await bench.bridge.publish("/tf_static" if static else "/tf", message)


@pytest.mark.parametrize("static", [True, False], ids=["tf_static", "tf"])
@pytest.mark.parametrize("frames", UPSIDE_DOWN.values(), ids=UPSIDE_DOWN)
def test_the_scan_of_a_lidar_upside_down_lies_where_its_beams_went(
    frames: tuple[tuple[str, str, Pose3D], ...], static: bool
) -> None:
    ranges_m = np.array([1.0, 2.0, 0.0, np.inf, 3.0], np.float32)
    message = encode_laser_scan(
        Dialect.ROS1,
        LaserScan(0, None, "laser", 0.3, 0.5, 0.0, 10.0, ranges_m, None, intensities=np.arange(5, dtype=np.float32)),
        stamp_ns=START_NS,
    )
    base_from_laser = reduce(matmul, (pose for _, _, pose in frames))
    went = []
    for beam in (0, 1, 4):
        angle_rad = 0.3 + 0.5 * beam
        x, y, _ = base_from_laser.rotated(math.cos(angle_rad), math.sin(angle_rad), 0.0)
        went.append((base_from_laser.x_m + ranges_m[beam] * x, base_from_laser.y_m + ranges_m[beam] * y))

    async def test(bench: LoopBench) -> None:
        await tell_frames(bench, *frames, static=static)
        await bench.bridge.publish("/scan", message)
        [scan] = await scans(bench, 1)
        assert scan.robot_from_laser is not None
        points = scan.points(scan.robot_from_laser)
        assert np.sort(points, axis=0) == pytest.approx(np.sort(np.array(went), axis=0), abs=0.01)
        assert scan.intensities.tolist() == [4, 3, 2, 1, 0]
        # The guard reads the same scan with other code.
        guard = bench.link._guard
        assert np.sort(guard._points_in_odom, axis=0) == pytest.approx(np.sort(points, axis=0), abs=1e-5)
        assert bench.of(Problem) == []

    with_link(ROBOT, test)


@pytest.mark.parametrize("tilt_deg", [-30.0, 8.0, 90.0, 150.0, 172.0])
def test_a_tilted_lidar_is_refused_in_words_and_only_the_profile_can_overrule_that(tilt_deg: float) -> None:
    frame = ("base_footprint", "laser", turned(pitch=math.radians(tilt_deg), x_m=0.2))

    async def test(bench: LoopBench) -> None:
        await tell_frames(bench, frame)
        await bench.bridge.publish("/scan", scan_message(START_NS))
        [scan] = await scans(bench, 1)
        assert (scan.robot_from_laser, scan.map_from_laser) == (None, None)
        [problem] = bench.of(Problem)
        assert f"tilted by {abs(tilt_deg):.0f} degrees (frame 'laser'" in problem.what
        assert bench.link._guard.limit(Twist2D(0.5), now_ns() / 1e9).state == "blind"

    async def overruled(bench: LoopBench) -> None:
        await tell_frames(bench, frame)
        await bench.bridge.publish("/scan", scan_message(START_NS))
        [scan] = await scans(bench, 1)
        assert scan.robot_from_laser is not None
        assert scan.angle_min_rad == pytest.approx(-0.2), "reversed"
        assert bench.of(Problem) == []

    with_link(ROBOT, test)
    with_link(replace(ROBOT, laser=LaserMount(mounting="upside_down")), overruled)


def test_without_tf_the_profile_gives_the_mounting() -> None:
    robot = replace(ROBOT, tf=None, tf_static=None, laser=LaserMount(Pose2D(0.1, 0.0, 0.5), "upside_down"))

    async def test(bench: LoopBench) -> None:
        await bench.bridge.publish("/scan", scan_message(START_NS))
        [scan] = await scans(bench, 1)
        assert (scan.robot_from_laser, scan.angle_min_rad) == (Pose2D(0.1, 0.0, 0.5), pytest.approx(-0.2))

    with_link(robot, test)


def test_until_the_transforms_come_a_scan_has_no_place() -> None:
    async def test(bench: LoopBench) -> None:
        await bench.bridge.publish("/scan", scan_message(START_NS))
        await scans(bench, 1)
        await tell_frames(bench, ("base_footprint", "laser", turned(roll=math.pi)))
        await bench.bridge.publish("/scan", scan_message(START_NS))
        before, after = await scans(bench, 2)
        assert before.robot_from_laser is None
        assert after.angle_min_rad == pytest.approx(-0.2)

    with_link(ROBOT, test)


def test_a_wrong_frame_is_one_problem_and_the_scan_is_shown_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensors, "FRAMES_KNOWN_AFTER_NS", 0)
    robot = replace(ROBOT, laser=LaserMount(Pose2D(0.3, 0.0, 0.0)))

    async def test(bench: LoopBench) -> None:
        await tell_transforms(
            bench, ("tiago/base_footprint", "Tiago/laser", Pose2D(0, 0, 0)), ("a", "b", Pose2D(0, 0, 0)),
            ("b", "a", Pose2D(0, 0, 0)), at_ns=START_NS,
        )  # fmt: skip
        for number in range(3):
            await bench.bridge.publish("/scan", scan_message(START_NS))
            await scans(bench, number + 1)
        await bench.bridge.publish("/scan", scan_message(START_NS, "a"))
        assert {scan.robot_from_laser.x_m for scan in await scans(bench, 4)} == {0.3}
        assert {scan.map_from_laser for scan in bench.of(LaserScan)} == {None}
        first, second = bench.of(Problem)
        assert "has no transform from base_footprint to 'laser'; similar frames: Tiago/laser." in first.what
        assert "to 'a'" in second.what

    with_link(robot, test)


def test_a_robot_without_a_pose_is_to_be_given_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensors, "PLACE_KNOWN_AFTER_NS", 0)

    async def test(bench: LoopBench) -> None:
        for step in range(5):
            await tell_transforms(bench, ("odom", "base_footprint", Pose2D(step, 0, 0)), at_ns=START_NS + step * MS)
        [problem] = await bench.until(lambda: bench.of(Problem), "a problem")
        assert "has no transform from 'map' to 'base_footprint'" in problem.what
        assert "Set the robot's pose on the map" in problem.advice
        assert "base_footprint, odom" in problem.advice

    with_link(ROBOT, test)


def test_a_path_is_thinned_and_brought_into_the_map() -> None:
    async def test(bench: LoopBench) -> None:
        turned = Pose2D(1.0, 2.0, math.pi / 2)
        await tell_transforms(bench, ("map", "odom", turned), at_ns=START_NS)
        points = np.stack([np.linspace(0.0, 10.0, 2000), np.zeros(2000)], axis=1).astype(np.float32)
        await bench.bridge.publish("/plan", encode_path(Dialect.ROS1, points, stamp_ns=START_NS, frame_id="/odom"))
        [path] = await bench.until(lambda: bench.of(PlannedPath), "a path")
        assert path.points_in_map.shape == (500, 2)
        assert path.points_in_map.dtype == np.float32
        assert path.points_in_map[0] == pytest.approx((1.0, 2.0), abs=1e-5)
        assert path.points_in_map[-1] == pytest.approx((1.0, 12.0), abs=1e-5)
        await bench.bridge.publish("/plan", encode_path(Dialect.ROS1, points[:3], stamp_ns=START_NS, frame_id="moon"))
        await bench.bridge.publish("/plan", encode_path(Dialect.ROS1, points[:0], stamp_ns=START_NS, frame_id="map"))
        await bench.until(lambda: len(bench.of(PlannedPath)) == 2, "an empty path, and none of the moon")
        assert bench.of(PlannedPath)[-1].points_in_map.shape == (0, 2)

    with_link(ROBOT, test)


def test_points_are_brought_from_one_frame_into_another() -> None:
    moved = points_in_parent(Pose2D(1.0, 0.0, math.pi), np.array([[1.0, 1.0]], np.float32))
    assert moved[0] == pytest.approx((0.0, -1.0))


def test_the_distance_left_is_reported_also_where_the_robot_does_not_and_the_path_ends_with_the_goal() -> None:
    def status(goal_id: str, number: int) -> dict[str, Any]:
        return {"goal_id": {"stamp": {"secs": 0, "nsecs": 0}, "id": goal_id}, "status": number, "text": ""}

    async def test(bench: LoopBench) -> None:
        await tell_transforms(bench, ("map", "base_footprint", Pose2D(0.0, 0.0, 0.0)), at_ns=START_NS)
        await bench.until(lambda: bench.of(RobotPose), "a pose")
        bench.send(GoTo(now_ns(), "g", Pose2D(3.0, 4.0, 0.0)))
        [goal] = await bench.until(lambda: bench.bridge.published("/robot1/move_base/goal"), "the goal")
        assert goal["goal"]["target_pose"]["header"]["frame_id"] == "map"
        assert bench.of(GoalChanged)[0].distance_left_m == 5.0
        goal_id = goal["goal_id"]["id"]
        await bench.bridge.publish("/robot1/move_base/status", {"status_list": [status(goal_id, 1)]})
        await bench.until(lambda: bench.of(GoalChanged)[-1].state == "active", "active")

        def nearer() -> bool:
            return bench.of(GoalChanged)[-1].distance_left_m == pytest.approx(2.0)

        for step in range(30):
            pose = Pose2D(3.0, 2.0, 0.0)
            await tell_transforms(bench, ("map", "base_footprint", pose), at_ns=START_NS + (step + 1) * 50 * MS)
            await asyncio.sleep(0.03)
            if nearer():
                break
        assert nearer()
        bench.send(CancelGoal(now_ns()))
        await bench.until(lambda: bench.bridge.published("/robot1/move_base/cancel"), "the cancellation")
        await bench.bridge.publish("/robot1/move_base/result", {"status": status(goal_id, 2), "result": {}})
        await bench.until(lambda: bench.of(GoalChanged)[-1].state == "cancelled", "cancelled")
        assert bench.of(PlannedPath)[-1].points_in_map.shape == (0, 2)
        bench.send(GoTo(now_ns(), "h", Pose2D(3.0, 4.0, 0.0)))
        _, goal = await bench.until(lambda: bench.bridge.published("/robot1/move_base/goal")[1:] and
                                    bench.bridge.published("/robot1/move_base/goal"), "another goal")  # fmt: skip
        rejected = {"status": status(goal["goal_id"]["id"], 5), "result": {}}
        await bench.bridge.publish("/robot1/move_base/result", rejected)
        await bench.until(lambda: bench.of(GoalChanged)[-1].state == "failed", "refused")
        assert bench.of(GoalChanged)[-1].detail == "the robot aborted without giving a reason"

    with_link(ROBOT, test)


def test_goals_of_ros2_are_in_the_profiles_map_frame_and_known_by_their_uuid() -> None:
    robot = replace(
        ROBOT,
        ros=2,
        frames=TransformFrames(map="robot1/map"),
        navigation=NavigationServer("navigate_to_pose", "/robot1/navigate_to_pose"),
    )

    async def test(bench: LoopBench) -> None:
        bench.send(GoTo(now_ns(), "g", Pose2D(3.0, 4.0, 0.0)))
        [goal] = await bench.until(lambda: bench.bridge.operations("send_action_goal"), "the goal")
        assert goal["action"] == "/robot1/navigate_to_pose"
        assert goal["args"]["pose"]["header"]["frame_id"] == "robot1/map"
        entry = {"goal_info": {"goal_id": {"uuid": list(range(16))}, "stamp": {"sec": 1, "nanosec": 0}}, "status": 2}
        await bench.bridge.publish("/robot1/navigate_to_pose/_action/status", {"status_list": [entry]})
        await bench.until(lambda: bench.of(GoalChanged)[-1].state == "active", "active before any feedback")
        # Proof that the goal of this name is the one that was sent.
        feedback = {"op": "action_feedback", "id": goal["id"], "action": goal["action"], "values": {}}
        await bench.bridge.send(encode_json(feedback))
        await bench.until(lambda: bench.link._navigator._server._with_feedback == goal["id"], "feedback")
        bench.send(Drive(now_ns(), Twist2D(0.2), "keyboard"))
        name = "/robot1/navigate_to_pose/_action/cancel_goal"
        [call] = await bench.until(lambda: bench.bridge.operations("call_service", name), "the cancellation")
        assert call["args"]["goal_info"]["goal_id"]["uuid"] == list(range(16))
        assert bench.bridge.operations("cancel_action_goal")[0]["id"] == goal["id"]

    with_link(robot, test)


def test_stamps_follow_the_simulated_clock() -> None:
    robot = RobotProfile(
        "test",
        "Test",
        ros=2,
        simulation_time=True,
        velocity=VelocityTopic("/cmd_vel", "TwistStamped"),
        guard=ROBOT.guard,
    )

    async def test(bench: LoopBench) -> None:
        simulated_ns = 40_000_000_000
        for _ in range(3):
            await bench.bridge.publish("/clock", encode_clock(Dialect.ROS2, simulated_ns))
            simulated_ns += 20 * MS
            await asyncio.sleep(0.02)
        quality = await bench.until(lambda: [q for q in bench.of(LinkQuality) if q.clock_offset_ms], "an offset")
        assert quality
        bench.send(Drive(now_ns(), Twist2D(0.2), "keyboard"))

        def moving() -> list[dict[str, Any]]:
            # A new link sends zero before it knows the clock.
            return [each for each in bench.bridge.published("/cmd_vel") if each["twist"]["linear"]["x"]]

        [first, *_] = await bench.until(moving, "a velocity")
        assert abs(first["header"]["stamp"]["sec"] - 40) <= 3

    with_link(robot, test)


ZERO_ROTATION = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0}


def test_an_odometry_without_rotation_costs_the_pose_and_not_the_speed() -> None:
    async def test(bench: LoopBench) -> None:
        message = encode_odometry(
            Dialect.ROS1, Odometry(0, None, Pose2D(0, 0, 0), Twist2D(0.3, 0.0, 0.1)), stamp_ns=START_NS
        )
        message["pose"]["pose"]["orientation"] = ZERO_ROTATION
        for number in range(3):
            await bench.bridge.publish("/odom", message)
            await bench.until(lambda number=number: len(bench.of(Odometry)) > number, "an odometry")
        told = bench.of(Odometry)
        assert {odometry.twist for odometry in told} == {Twist2D(0.3, 0.0, 0.1)}
        assert told[-1].pose_in_odom.x_m > told[0].pose_in_odom.x_m, "its way is reckoned"
        [problem] = bench.of(Problem)
        assert "reports no orientation (a zero quaternion)" in problem.what

    with_link(ROBOT, test)


@pytest.mark.parametrize("bad", [{"rotation": ZERO_ROTATION}, {"translation": {"x": None, "y": 0.0, "z": 0.0}}])
def test_a_transform_that_is_none_is_named_and_the_others_are_used(bad: dict[str, Any]) -> None:
    async def test(bench: LoopBench) -> None:
        message = encode_tf_message(
            Dialect.ROS1,
            [("base_footprint", "gripper", Pose2D(0, 0, 0)), ("base_footprint", "laser", Pose2D(0.4, 0, 0))],
            stamp_ns=START_NS,
        )
        message["transforms"][0]["transform"].update(bad)
        await bench.bridge.publish("/tf", message)
        await bench.bridge.publish("/scan", scan_message(START_NS))
        [scan] = await scans(bench, 1)
        assert scan.robot_from_laser is not None
        assert scan.robot_from_laser.x_m == pytest.approx(0.4)
        [problem] = bench.of(Problem)
        assert "from 'base_footprint' to 'gripper' cannot be used" in problem.what

    with_link(ROBOT, test)


@pytest.mark.parametrize(
    ("late_s", "stale"), [(0.1, False), (3.0, True), (10.0, False), (3600.0, False), (-3600.0, False)]
)
def test_the_guard_counts_what_is_known_of_a_scan_s_age(late_s: float, stale: bool) -> None:
    """With a known robot clock. An implausible stamp belongs to another clock, and the age counts from arrival."""

    def prepare(bridge: Bridge) -> None:
        def robot_time(_arguments: Any) -> dict[str, Any]:
            return {"time": encode_time(Dialect.ROS1, now_ns() + START_NS)}

        bridge.answers["/rosapi/get_time"] = robot_time

    async def test(bench: LoopBench) -> None:
        await tell_transforms(bench, ("base_footprint", "laser", Pose2D(0, 0, 0)), at_ns=0, static=True)
        await bench.until(lambda: bench.link._measurement.offset_at(now_ns()) is not None, "the robot's clock")
        await bench.bridge.publish("/scan", scan_message(now_ns() + START_NS - round(late_s * 1e9)))
        [scan] = await scans(bench, 1)
        assert bench.link._guard.stale(scan.stamp_ns / 1e9) is stale

    with_link(ROBOT, test, prepare=prepare)


def test_a_robot_that_lacks_something_is_asked_again_until_it_has_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control_link, "INVENTORY_AGAIN_S", (0.02,))
    robot = RobotProfile("test", "Test", scan=TopicSource("/scan"))
    there = {"/cmd_vel": "geometry_msgs/Twist"}

    async def test(bench: LoopBench) -> None:
        [missing] = await bench.until(lambda: bench.of(Problem), "what is missing")
        assert (missing.cause, "LIDAR" in missing.what) == ("robot_lacks", True)
        asked = len(bench.bridge.operations("call_service", "/rosapi/topics"))
        await bench.until(
            lambda: len(bench.bridge.operations("call_service", "/rosapi/topics")) > asked + 2, "it is asked again"
        )
        assert len(bench.of(Problem)) == 1, "and said once"
        bench.bridge.answers.update(inventory({**there, "/scan": "sensor_msgs/LaserScan"}))
        over = await bench.until(lambda: bench.of(Problem)[1:], "the end of it")
        assert [(problem.severity, problem.cause) for problem in over] == [("info", "robot_lacks")]

    with_link(robot, test, prepare=lambda bridge: bridge.answers.update(inventory(there)))


def test_messages_lost_in_transit_are_a_gap_in_the_record() -> None:
    async def test(bench: LoopBench) -> None:
        kept = [number for number in range(100) if number not in (60, 71, 72)]
        for number in kept:
            await bench.bridge.publish("/scan", scan_message(START_NS + number * 100 * MS))
            await scans(bench, kept.index(number) + 1)
        [gap] = await bench.until(lambda: bench.of(Gap), "the gap")
        assert (gap.stream, gap.count) == ("scan", 3)

    with_link(ROBOT, test)
