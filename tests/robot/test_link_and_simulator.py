"""Both links against the simulated robot, in ROS 1 and ROS 2."""

import math
import time
from collections.abc import Iterator

import pytest

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.control_definitions import ControlValue, PublishMessage, RobotControl, SendActionGoal
from caris_desktop.domain.events import (
    CommandSent,
    ControlUsed,
    DriveEnded,
    GoalChanged,
    HeadMoved,
    InitialPoseSet,
    MapOperation,
    MappingChanged,
    MapRequestChanged,
    NavigationSpeedChanged,
    Problem,
    RequestState,
    UtteranceChanged,
)
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.link_commands import (
    CancelGoal,
    GoTo,
    LimitGoals,
    MoveHead,
    OfferControls,
    Release,
    RequestMap,
    Say,
    SetEmergencyStop,
    SetInitialPose,
    StopMotion,
    UseControl,
)
from caris_desktop.domain.sensing import (
    BatteryState,
    ControlReadings,
    FrameRef,
    HeadState,
    LaserScan,
    OccupancyGrid,
    Odometry,
    PlannedPath,
    RobotPose,
)
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.robot.link import check_robot
from caris_desktop.robot.maps import UNSURE
from caris_desktop.robot.profile import load_profile
from tests.robot.link_bench import LinkProcess
from tests.robot.test_media_link import run_with_ring
from tests.support.polling import wait_for
from tests.support.simulated_robot import SimulatedRobot
from tests.support.twist_listener import TwistListener

PROFILES = {1: "simulated", 2: "simulated-ros2"}


@pytest.fixture(scope="module", params=[1, 2], ids=["ros1", "ros2"])
def simulator(request: pytest.FixtureRequest) -> Iterator[SimulatedRobot]:
    with SimulatedRobot(ros=request.param) as running:
        yield running


@pytest.fixture(scope="module")
def running_link(simulator: SimulatedRobot) -> Iterator[LinkProcess]:
    process = LinkProcess(simulator.address, PROFILES[simulator.ros])
    process.wait_for_state("connected")
    yield process
    process.close()


@pytest.fixture
def link(running_link: LinkProcess) -> LinkProcess:
    running_link.values.clear()
    return running_link


@pytest.mark.long("ros1")
def test_every_stream_arrives(simulator: SimulatedRobot, link: LinkProcess) -> None:
    ring = FrameRing.create()
    media = LinkProcess(simulator.address, PROFILES[simulator.ros], body=run_with_ring, extra=(ring.name,))
    try:
        for kind in (LaserScan, Odometry, RobotPose, BatteryState):
            wait_for(lambda kind=kind: link.of(kind), kind.__name__)
        for kind in (FrameRef, OccupancyGrid):
            wait_for(lambda kind=kind: media.of(kind), kind.__name__)
        image_bgr = wait_for(lambda: (ring.read(media.of(FrameRef)[-1]),), "pixels")[0]
        assert image_bgr is not None
        assert image_bgr.shape == (480, 640, 3)
        assert image_bgr.std() > 5.0
        assert link.of(LaserScan)[-1].ranges_m.shape == (720,)
        assert link.of(Problem) + media.of(Problem) == []
    finally:
        media.close()
        ring.close()
    assert check_robot(load_profile(PROFILES[simulator.ros]), simulator.address) == []


def test_driving_moves_it_and_an_independent_client_sees_exactly_what_is_reported(
    simulator: SimulatedRobot, link: LinkProcess
) -> None:
    listener = TwistListener(simulator.address)
    # The subscription is active once it receives a zero command.
    link.send(StopMotion(now_ns()))
    wait_for(lambda: listener.seen, "the listener listens")
    wait_for(lambda: link.of(Odometry), "odometry")
    link.drive(0.3)
    link.hold(lambda: link.of(Odometry)[-1].twist.forward_mps > 0.15, "the robot moves")
    link.send(Release(now_ns()))
    wait_for(lambda: abs(link.of(Odometry)[-1].twist.forward_mps) < 0.02, "the robot stands still")
    wait_for(lambda: now_ns() - link.of(CommandSent)[-1].stamp_ns > 300_000_000, "silence")
    reported = [(sent.twist.forward_mps, sent.twist.turn_radps) for sent in link.of(CommandSent)]
    seen = [(twist.forward_mps, twist.turn_radps) for twist in listener.seen]
    assert len(seen) > 15
    assert reported[-len(seen) :] == seen
    listener.close()


def test_a_goal_is_reached_and_another_cancelled(simulator: SimulatedRobot, link: LinkProcess) -> None:
    start = wait_for(lambda: link.of(RobotPose), "a pose")[-1].pose_in_map

    def states(goal_id: str) -> list[str]:
        return [change.state for change in link.of(GoalChanged) if change.goal_id == goal_id]

    link.send(GoTo(now_ns(), "near", Pose2D(start.x_m + 0.4, start.y_m, 0.0), "near by"))
    wait_for(lambda: states("near")[-1:] == ["reached"], f"reached, have {states('near')}")
    assert states("near")[:2] == ["requested", "active"]
    assert any(change.distance_left_m for change in link.of(GoalChanged))
    link.send(GoTo(now_ns(), "back", start))
    wait_for(lambda: "active" in states("back"), "active")
    link.send(CancelGoal(now_ns()))
    wait_for(lambda: states("back")[-1] == "cancelled", "cancelled")


def test_it_speaks(simulator: SimulatedRobot, link: LinkProcess) -> None:
    link.send(Say(now_ns(), "u", "Hello"))
    wait_for(lambda: [u.state for u in link.of(UtteranceChanged)] == ["started", "finished"], "said")


def test_a_scan_says_where_in_the_map_it_was_taken(simulator: SimulatedRobot, link: LinkProcess) -> None:
    scan = wait_for(lambda: [scan for scan in link.of(LaserScan) if scan.map_from_laser], "a placed scan")[-1]
    pose = wait_for(lambda: link.of(RobotPose), "a pose")[-1].pose_in_map
    laser = pose @ scan.robot_from_laser
    assert math.hypot(scan.map_from_laser.x_m - laser.x_m, scan.map_from_laser.y_m - laser.y_m) < 0.1


def test_the_head_turns_and_reports(simulator: SimulatedRobot, link: LinkProcess) -> None:
    link.send(MoveHead(now_ns(), 0.5, 0.2))
    wait_for(lambda: link.of(HeadMoved), "the order")
    wait_for(lambda: link.of(HeadState) and abs(link.of(HeadState)[-1].pan_rad - 0.5) < 0.05, "the head is there")
    assert abs(link.of(HeadState)[-1].tilt_rad - 0.2) < 0.05
    link.send(MoveHead(now_ns(), 0.0, 0.0))


@pytest.mark.long("ros1")
def test_a_goal_is_driven_no_faster_than_drive_says(simulator: SimulatedRobot, link: LinkProcess) -> None:
    start = wait_for(lambda: link.of(RobotPose), "a pose")[-1].pose_in_map
    link.send(LimitGoals(now_ns(), 0.25))
    wait_for(lambda: link.of(NavigationSpeedChanged), "what it keeps to")
    assert link.of(NavigationSpeedChanged)[-1].limit_mps == 0.25

    def drive_to(goal_id: str, target: Pose2D) -> float:
        link.values.clear()
        link.send(GoTo(now_ns(), goal_id, target))
        wait_for(lambda: any(change.state == "reached" for change in link.of(GoalChanged)), "there")
        return max(odometry.twist.forward_mps for odometry in link.of(Odometry))

    there = Pose2D(start.x_m + 1.0, start.y_m, 0.0)
    assert 0.15 < drive_to("slow", there) <= 0.26
    link.send(LimitGoals(now_ns(), 0.6))
    assert drive_to("fast", start) > 0.35


def test_a_goal_shows_its_path_until_it_ends(simulator: SimulatedRobot, link: LinkProcess) -> None:
    start = wait_for(lambda: link.of(RobotPose), "a pose")[-1].pose_in_map
    link.send(GoTo(now_ns(), "far", Pose2D(start.x_m + 3.0, start.y_m, 0.0)))
    path = wait_for(lambda: [path for path in link.of(PlannedPath) if len(path.points_in_map)], "a path")[0]
    assert math.hypot(path.points_in_map[0][0] - start.x_m, path.points_in_map[0][1] - start.y_m) < 0.5
    assert link.of(GoalChanged)[0].distance_left_m == pytest.approx(3.0, abs=0.3)
    link.send(CancelGoal(now_ns()))
    wait_for(lambda: link.of(GoalChanged)[-1].state == "cancelled", "cancelled")
    wait_for(lambda: len(link.of(PlannedPath)[-1].points_in_map) == 0, "no path any more")


def test_maps_are_saved_loaded_and_switched(simulator: SimulatedRobot, link: LinkProcess) -> None:
    def outcome(operation: MapOperation, name: str = "") -> RequestState:
        request_id = f"{operation} {name}"
        link.send(RequestMap(now_ns(), request_id, operation, name))
        told = lambda: [change for change in link.of(MapRequestChanged) if change.request_id == request_id][1:]  # noqa: E731
        return wait_for(told, request_id)[0].state

    assert outcome("save", "link test") == "succeeded"
    assert outcome("load", "link test") == "succeeded"
    assert link.of(MapRequestChanged)[-1].detail == UNSURE
    assert outcome("start_localization") == "succeeded"
    assert link.of(MappingChanged)[-1].mapping is False
    assert outcome("start_mapping") == "succeeded"
    last = link.of(MappingChanged)[-1]
    assert (last.mapping, last.can_save, last.can_load, last.can_switch) == (True, True, True, True)
    link.send(SetInitialPose(now_ns(), wait_for(lambda: link.of(RobotPose), "a pose")[-1].pose_in_map))
    wait_for(lambda: link.of(InitialPoseSet), "the place")


def test_the_robots_controls_are_used_and_read(simulator: SimulatedRobot, link: LinkProcess) -> None:
    def outcome(control: str, value: ControlValue) -> ControlUsed:
        link.send(UseControl(now_ns(), f"{control} {value}", control, value))
        told = lambda: [event for event in link.of(ControlUsed) if event.request_id == f"{control} {value}"][1:]  # noqa: E731
        return wait_for(told, control)[0]

    for control, value in (
        ("wave", True),
        ("eyes", False),
        ("volume", 35.0),
        ("screen", "Hello"),
        ("light_blue", True),
    ):
        assert outcome(control, value).state == "succeeded", control

    def read() -> dict[str, ControlValue]:
        told = link.of(ControlReadings)
        return dict(told[-1].values) if told else {}

    wait_for(lambda: read().get("volume") == 35.0, "the volume")
    wait_for(lambda: "temperature" in read(), "the temperature")
    wait_for(lambda: read().get("eyes") is False, "the eyes")
    refused = outcome("volume", "loud")
    assert refused.state == "failed"
    assert "must be a number, but it is the text 'loud'" in refused.detail


def test_a_killed_robot_is_found_again_and_gets_nothing_old() -> None:
    # The bridge double covers ROS 1.
    simulator = SimulatedRobot(ros=2)
    link = LinkProcess(simulator.address, PROFILES[2])
    listener = None
    try:
        wait_for(lambda: link.of(LaserScan) and link.of(Odometry), "scans and odometry")
        link.drive(0.3)
        link.hold(lambda: link.of(Odometry)[-1].twist.forward_mps > 0.1, "the robot moves")
        changes = len(link.states())
        simulator.kill()
        killed_s = time.monotonic()
        link.hold(lambda: "lost" in link.states()[changes:], "the loss")
        assert time.monotonic() - killed_s < 1.0
        assert len(link.of(DriveEnded)) == 1
        simulator = SimulatedRobot(ros=2, port=simulator.port)
        ready_s = time.monotonic()
        listener = TwistListener(simulator.address)
        link.hold(lambda: "connected" in link.states()[changes:], "the reconnection")
        assert time.monotonic() - ready_s < 3.0
        scans, poses = len(link.of(LaserScan)), len(link.of(RobotPose))
        link.hold(lambda: len(link.of(LaserScan)) > scans + 3 and len(link.of(RobotPose)) > poses, "streams again")
        assert not any(twist.moving for twist in listener.seen)
        link.drive(0.3)
        wait_for(lambda: any(twist.moving for twist in listener.seen), "a new key press moves it")
    finally:
        link.close()
        if listener is not None:
            listener.close()
        simulator.kill()


GOAL = {"header": {"frame_id": "map"}, "pose": {"position": {"x": 9.0, "y": 5.0}, "orientation": {"w": 1.0}}}
DISGUISES = (
    RobotControl(
        "lamp", "Lamp", "button", moves=False, group="Lights",
        effect=PublishMessage("/move_base/goal", "move_base_msgs/MoveBaseActionGoal", {"goal": {"target_pose": GOAL}}),
    ),
    RobotControl(
        "sound", "Sound", "button", moves=False,
        effect=PublishMessage("/move_base_simple/goal", "geometry_msgs/PoseStamped", GOAL),
    ),
    RobotControl(
        "face", "Face", "button", moves=False,
        effect=SendActionGoal("/move_base", "move_base_msgs/MoveBaseAction", {"target_pose": GOAL}),
    ),
)  # fmt: skip


@pytest.mark.logs("robot")
def test_a_goal_in_the_guise_of_a_lamp_moves_nothing_under_a_stop_or_without_the_permission_to_drive() -> None:
    with SimulatedRobot("--empty", ros=1) as robot:
        link = LinkProcess(robot.address)
        try:
            link.wait_for_state("connected")

            def refused(why: str) -> None:
                before = len(link.of(ControlUsed))
                for control in DISGUISES:
                    link.send(UseControl(now_ns(), f"{control.id} {why}", control.id, True))
                wait_for(lambda: sum(used.state == "failed" for used in link.of(ControlUsed)[before:]) == 3, why)

            # Measured at the base, independently of the command path.
            def way_m() -> float:
                here = robot.state()["pose"]
                return math.hypot(here["x_m"] - begin["x_m"], here["y_m"] - begin["y_m"])

            begin = robot.state()["pose"]
            link.send(OfferControls(now_ns(), DISGUISES, driving_permitted=False))
            link.send(SetEmergencyStop(now_ns(), True))
            refused("stopped, without permission")
            link.send(OfferControls(now_ns(), DISGUISES))
            refused("stopped")
            link.send(SetEmergencyStop(now_ns(), False))
            wait_for(lambda: not robot.state()["emergency_stopped"], "released")
            link.send(OfferControls(now_ns(), DISGUISES, driving_permitted=False))
            refused("without permission")
            odometries = len(link.of(Odometry))
            wait_for(lambda: len(link.of(Odometry)) > odometries + 40, "two seconds of odometry")
            assert (robot.state()["goal_id"], way_m()) == ("", 0.0)
            # With both settings it drives, as a moving control may.
            link.send(OfferControls(now_ns(), DISGUISES))
            link.send(UseControl(now_ns(), "drive", "lamp", True))
            wait_for(lambda: way_m() > 0.3, "it drives")
        finally:
            link.close()
