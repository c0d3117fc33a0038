"""Every shipped profile against the simulated robot of its model: sensing, driving, speech, navigation, stop.

The robot models follow the publications of the manufacturers, not the profiles: a mismatch is a fault in one of them.
"""

import math
import multiprocessing
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import pytest

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.control_definitions import (
    CallService,
    ControlEffect,
    ControlValue,
    PublishMessage,
    SendActionGoal,
)
from caris_desktop.domain.events import ControlUsed, EmergencyStopChanged, GoalChanged, UtteranceChanged
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.link_commands import (
    CancelGoal,
    Drive,
    GoTo,
    MoveHead,
    Release,
    Say,
    SetEmergencyStop,
    SetGuard,
    StopMotion,
    UseControl,
)
from caris_desktop.domain.sensing import (
    BatteryState,
    FrameRef,
    HeadState,
    LaserScan,
    OccupancyGrid,
    Odometry,
    RobotPose,
)
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.robot.link import check_robot
from caris_desktop.robot.profile import load_profile, shipped_profiles
from caris_desktop.robot.profile_model import RobotProfile
from tests.robot.link_bench import LinkProcess
from tests.robot.test_media_link import run_with_ring
from tests.support.polling import wait_for
from tests.support.simulated_robot import RosbridgeClient, SimulatedRobot

V = TypeVar("V")

ROBOT_MODEL_OF = {
    "generic-ros1": ("generic", 1),
    "generic-ros2": ("generic", 2),
    "simulated": ("generic", 1),
    "simulated-ros2": ("generic", 2),
    "tiago": ("tiago", 1),
    "tiago-base": ("tiago-base", 1),
    "turtlebot3": ("turtlebot3", 2),
    "turtlebot3-humble": ("turtlebot3-humble", 2),
    "turtlebot4": ("turtlebot4", 2),
    "pepper": ("pepper", 1),
    "nao": ("nao", 1),
}
_IMPORTED_BY_LINKS = tuple(f"caris_desktop.robot.{name}" for name in ("control_link", "media_link", "link_process"))
IN_THE_CORRIDOR = "pose:10.4,5,0"


@dataclass(frozen=True, slots=True)
class Bench:
    """Simulated robot of a model, its profile, and both links of the console."""

    profile: RobotProfile
    robot: SimulatedRobot
    client: RosbridgeClient
    link: LinkProcess
    media: LinkProcess

    def state(self) -> dict[str, Any]:
        state: dict[str, Any] = self.client.call("/simulator/state")
        return state

    def stands(self) -> bool:
        state = self.state()
        return all(abs(state[name]) < 1e-6 for name in ("speed_mps", "speed_left_mps", "speed_radps"))

    def drive_until(self, twist: Twist2D, until: Callable[[], V], what: str) -> V:
        """Hold a key, and press it again if a busy machine was too slow to renew the lease."""

        def held() -> V:
            self.link.send(Drive(now_ns(), twist, "keyboard"))
            return until()

        return wait_for(held, what, every_s=0.03)


def test_every_shipped_profile_has_a_robot_model() -> None:
    assert set(shipped_profiles()) == set(ROBOT_MODEL_OF)


_IN_EVERY_RUN = {"pepper", "tiago", "turtlebot4"}
"""One of each kind: with head and speech, ROS 1, ROS 2."""


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(name, marks=[] if name in _IN_EVERY_RUN else [pytest.mark.long]) for name in sorted(ROBOT_MODEL_OF)
    ],
)
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    # fork the links of all profiles from one process that has imported their modules
    multiprocessing.set_forkserver_preload(["tests.robot.test_media_link", *_IMPORTED_BY_LINKS])
    robot_model, ros = ROBOT_MODEL_OF[request.param]
    ring = FrameRing.create()
    with SimulatedRobot("--empty", robot_model=robot_model, ros=ros) as robot, RosbridgeClient(robot.address) as client:
        client.call("/simulator/fault", command=IN_THE_CORRIDOR)
        link = LinkProcess(robot.address, request.param, method="forkserver")
        media = LinkProcess(robot.address, request.param, body=run_with_ring, extra=(ring.name,), method="forkserver")
        try:
            link.wait_for_state("connected")
            yield Bench(load_profile(request.param), robot, client, link, media)
        finally:
            link.close()
            media.close()
            ring.close()


@pytest.mark.long("pepper", "tiago", "turtlebot4")
def test_the_robot_has_everything_that_the_profile_names(bench: Bench) -> None:
    assert check_robot(bench.profile, bench.robot.address) == []


@pytest.mark.long("pepper", "tiago", "turtlebot4")
def test_every_control_of_the_profile_is_obeyed(bench: Bench) -> None:
    controls = [control for control in bench.profile.controls if control.effect is not None]
    if not controls:
        pytest.skip("this profile has no controls")
    for control in controls:
        values: dict[str, ControlValue] = {"slider": control.highest, "text": "Hello"}
        value = control.choices[0].value if control.choices else values.get(control.kind, True)
        bench.link.send(UseControl(now_ns(), f"use {control.id}", control.id, value))

        def states(wanted: str = f"use {control.id}") -> list[tuple[str, str]]:
            return [(used.state, used.detail) for used in bench.link.of(ControlUsed) if used.request_id == wanted]

        wait_for(lambda states=states: states()[-1:] and states()[-1][0] in ("succeeded", "failed"), f"{control.title}")
        assert states()[-1][0] == "succeeded", states()
    taken = [order["name"] for order in bench.state()["orders"]]
    named = [_name_of(control.effect) for control in controls if control.effect is not None]
    # the controls of the default model move parts of it; those of other models are only recorded
    assert set(taken) == (set() if bench.robot.robot_model == "generic" else set(named))
    if bench.robot.robot_model == "generic":
        panel = bench.state()["panel"]
        assert panel["waves_begun"] == 1
        assert panel["volume"] == 100.0


def _name_of(effect: ControlEffect) -> str:
    match effect:
        case PublishMessage(topic, _, _):
            return topic
        case CallService(service, _, _):
            return service
        case SendActionGoal(action, _, _):
            return action


@pytest.mark.long("pepper", "tiago", "turtlebot4")
def test_named_topics_arrive(bench: Bench) -> None:
    profile = bench.profile
    of_link: dict[type, object] = {LaserScan: profile.scan, Odometry: profile.odometry, RobotPose: profile.pose}
    of_link |= {BatteryState: profile.battery, HeadState: profile.head}
    for kind, named in of_link.items():
        if named:
            wait_for(lambda kind=kind: bench.link.of(kind), f"{kind.__name__} of {profile.title}")
    if profile.map:
        wait_for(lambda: bench.media.of(OccupancyGrid), "a map")
    if profile.cameras:
        frame = wait_for(lambda: bench.media.of(FrameRef), "a picture")[-1]
        assert (frame.width_px, frame.height_px) == (640, 480)
    if profile.scan:
        _check_scan_against_the_corridor(bench.link.of(LaserScan)[-1])
    if profile.battery:
        assert bench.link.of(BatteryState)[-1].charge_fraction == pytest.approx(0.93, abs=0.01)


def _check_scan_against_the_corridor(scan: LaserScan) -> None:
    """The walls of the corridor are at the right distances only with the right position and direction of the
    scanner.
    """
    for side_rad, wall_m in ((math.pi / 2, 0.74), (-math.pi / 2, 0.74)):
        index = (side_rad - scan.robot_from_laser.heading_rad - scan.angle_min_rad) / scan.angle_increment_rad
        index = round(index) % round(2 * math.pi / scan.angle_increment_rad)
        assert float(scan.ranges_m[index]) == pytest.approx(wall_m, abs=0.06)


@pytest.mark.long("pepper", "tiago")
def test_it_is_driven_and_stands_when_released(bench: Bench) -> None:
    # without a laser there is no guard; and the corridor is narrow for a cautious guard
    bench.link.send(SetGuard(now_ns(), on=False))
    limits, start = bench.profile.driving_limits, bench.state()["pose"]
    bench.drive_until(
        Twist2D(limits.forward_mps), lambda: bench.state()["speed_mps"] > 0.6 * limits.forward_mps, "it moves"
    )
    bench.link.send(Release(now_ns()))
    wait_for(bench.stands, "it stands")
    assert bench.state()["pose"]["x_m"] > start["x_m"]
    turns_radps = min(0.2, 0.6 * limits.turn_radps)
    bench.drive_until(
        Twist2D(0.0, 0.0, limits.turn_radps), lambda: bench.state()["speed_radps"] > turns_radps, "it turns left"
    )
    bench.link.send(Release(now_ns()))
    wait_for(bench.stands, "it stands")
    if bench.profile.holonomic:
        bench.drive_until(
            Twist2D(0.0, limits.left_mps), lambda: bench.state()["speed_left_mps"] > 0.5 * limits.left_mps, "it strafes"
        )
        bench.link.send(StopMotion(now_ns()))
        wait_for(bench.stands, "it stands")
    if bench.profile.odometry:
        wait_for(lambda: not bench.link.of(Odometry)[-1].twist.moving, "and says so")


def test_it_speaks(bench: Bench) -> None:
    if bench.profile.speech is None:
        pytest.skip("this robot has no voice of its own")
    bench.link.send(Say(now_ns(), "hello", "Hello"))

    def states() -> list[str]:
        return [change.state for change in bench.link.of(UtteranceChanged) if change.utterance_id == "hello"]

    wait_for(lambda: bench.state()["speaking"] == "Hello", "the robot speaks")
    wait_for(lambda: states()[-1:] == ["finished"], f"it is told that it was said, have {states()}")
    assert states()[0] == "started"


def test_the_head_points_where_it_is_reported(bench: Bench) -> None:
    if bench.profile.head is None:
        pytest.skip("this robot has no head that turns")
    bench.link.send(MoveHead(now_ns(), 0.3, 0.2))

    def looks() -> bool:
        head = bench.state()["head"]
        return bool(abs(head["pan_rad"] - 0.3) < 0.02 and abs(head["tilt_rad"] - 0.2) < 0.02)

    wait_for(looks, "it looks left and down")
    wait_for(
        lambda: (
            abs(bench.link.of(HeadState)[-1].pan_rad - 0.3) + abs(bench.link.of(HeadState)[-1].tilt_rad - 0.2) < 0.05
        ),
        "and says so",
    )
    bench.link.send(MoveHead(now_ns(), 0.0, 0.0))


def test_it_navigates_and_a_goal_is_cancelled(bench: Bench) -> None:
    if bench.profile.navigation is None:
        pytest.skip("this robot does not navigate by itself")
    bench.client.call("/simulator/fault", command=IN_THE_CORRIDOR)

    def states(goal_id: str) -> list[str]:
        return [change.state for change in bench.link.of(GoalChanged) if change.goal_id == goal_id]

    bench.link.send(GoTo(now_ns(), "near", Pose2D(10.6, 5.0, 0.0)))
    wait_for(lambda: states("near")[-1:] == ["reached"], "the near goal is reached")
    assert bench.state()["pose"]["x_m"] == pytest.approx(10.6, abs=0.12)
    bench.link.send(GoTo(now_ns(), "far", Pose2D(14.0, 5.0, 0.0)))
    wait_for(lambda: "active" in states("far") and bench.state()["speed_mps"] > 0.05, "it is on its way")
    bench.link.send(CancelGoal(now_ns()))
    wait_for(lambda: states("far")[-1] == "cancelled", "the far goal is cancelled")
    wait_for(bench.stands, "it stands")


@pytest.mark.long("pepper", "tiago")
def test_it_is_stopped_and_its_own_emergency_stop_is_pressed(bench: Bench) -> None:
    limits = bench.profile.limits
    moving = Twist2D(limits.forward_mps)

    def moves() -> bool:
        return bool(bench.state()["speed_mps"] > 0.3 * limits.forward_mps)

    bench.client.call("/simulator/fault", command=IN_THE_CORRIDOR)
    bench.link.send(SetGuard(now_ns(), on=False))
    bench.drive_until(moving, moves, "it moves")
    bench.link.send(StopMotion(now_ns()))
    wait_for(bench.stands, "it stands")
    bench.drive_until(moving, moves, "it moves again")
    bench.link.send(SetEmergencyStop(now_ns(), latched=True))
    wait_for(bench.stands, "it stands")
    own = bench.profile.emergency_stop
    if own is not None and own.commands_robot:
        wait_for(lambda: bench.state()["emergency_stopped"], "the robot's own stop is pressed")
    bench.link.send(SetEmergencyStop(now_ns(), latched=False))
    wait_for(lambda: not bench.state()["emergency_stopped"], "the robot's own stop is released")
    if own is not None and own.topic is not None and not own.commands_robot:
        # somebody presses the button on the robot
        bench.client.call("/simulator/fault", command="press_stop_button")
        wait_for(lambda: bench.link.of(EmergencyStopChanged)[-1].latched, "the console learns of the robot's button")
        bench.client.call("/simulator/fault", command="release_stop_button")
