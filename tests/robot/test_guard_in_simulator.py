"""The guarded lease drives the simulator's base with the simulator's LIDAR, in simulated time."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import GuardChanged
from caris_desktop.domain.geometry import ZERO_TWIST, Pose2D, Twist2D, wrap_angle
from caris_desktop.domain.link_commands import Release
from caris_desktop.domain.sensing import LaserScan, Odometry, lidar_mounting
from caris_desktop.robot.guard import Footprint, GuardLimit, ObstacleGuard, transformed
from caris_desktop.robot.lease import MotionLease
from caris_desktop.robot.profile import load_profile
from caris_desktop.robot.profile_model import FloorOutline, MotionLimits, RobotProfile
from caris_desktop.simulator import lidar, simulated_base
from caris_desktop.simulator.floor_plan import DEPTH_M, WIDTH_M
from caris_desktop.simulator.lidar import ALL_AROUND, LidarModel
from caris_desktop.simulator.simulated_base import (
    DIFFERENTIAL,
    HOLONOMIC,
    RADIUS_M,
    STEP_S,
    BaseModel,
    BaseState,
    clearance_m,
)
from caris_desktop.simulator.simulated_people import BODY_M
from tests.robot.link_bench import LinkProcess
from tests.support.polling import wait_for
from tests.support.simulated_robot import SimulatedRobot

PROFILE = load_profile("simulated")
NOBODY = np.empty((0, 3))
Circles = NDArray[np.float64]


@dataclass
class GuardedRobot:
    """Robot in the building: 50 Hz base, 10 Hz LIDAR, 25 Hz odometry with drift, 20 Hz commands.

    Sensor data arrive after 40 ms and commands after 20 ms, both plus ``delay_s`` of the network.
    """

    pose: Pose2D
    profile: RobotProfile = PROFILE
    base_model: BaseModel = DIFFERENTIAL
    lidar_model: LidarModel = ALL_AROUND
    bodies: Callable[[float], Circles] = lambda _now_s: NOBODY
    legs: Callable[[float], Circles] = lambda _now_s: NOBODY
    seed: int = 0
    delay_s: float = 0.0
    now_s: float = 1.0
    gaps_m: list[float] = field(default_factory=list)
    limits: list[GuardLimit] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.state = BaseState(self.pose)
        self.guard = ObstacleGuard(self.profile)
        self.lease = MotionLease(self.profile.limits, allow=self._allow)
        self.noise = np.random.default_rng(self.seed)
        self.wanted = deque([ZERO_TWIST], maxlen=1 + round(self.delay_s / STEP_S))
        self.steps = 0
        self._odom_from_robot = Pose2D(3.0, -2.0, 1.0)
        self._late: list[tuple[float, LaserScan | Odometry]] = []

    def _allow(self, twist: Twist2D, now_s: float) -> float:
        limit = self.guard.limit(twist, now_s)
        self.limits.append(limit)
        return limit.fraction

    def push(self, twist: Twist2D, duration_s: float, *, until_still: bool = False) -> "GuardedRobot":
        """Hold a key for ``duration_s``; ``until_still`` ends it once the robot has stood for half a second."""
        still_steps = 0
        for _ in range(round(duration_s / STEP_S)):
            self.lease.drive(twist, "keyboard", self.now_s)
            self._step()
            moving = abs(self.state.forward_mps) + abs(self.state.left_mps) + abs(self.state.turn_radps) > 1e-3
            still_steps = 0 if moving else still_steps + 1
            if until_still and still_steps > 25:
                break
        return self

    def wait(self, duration_s: float) -> "GuardedRobot":
        """Hold no key."""
        self.lease.release(self.now_s)
        for _ in range(round(duration_s / STEP_S)):
            self._step()
        return self

    def _step(self) -> None:
        wanted = self.wanted[0]
        self.wanted.append(self.wanted[-1])
        while (leased := self.lease.next_twist(self.now_s)) is not None:
            self.guard.note_sent(leased.twist, self.now_s)
            self.wanted[-1] = leased.twist
        before, self.state = (
            self.state,
            simulated_base.step(self.state, wanted, self.bodies(self.now_s), model=self.base_model),
        )
        moved = before.pose_in_map.inverse() @ self.state.pose_in_map
        self._odom_from_robot = self._odom_from_robot @ Pose2D(
            moved.x_m * 1.008, moved.y_m, moved.heading_rad * 1.012 + float(self.noise.normal(0.0, 0.02)) * moved.x_m
        )
        self.steps += 1
        self.now_s += STEP_S
        robot_ns = round((self.now_s + 1000.0) * 1e9)
        if self.steps % 2 == 0:
            twist = Twist2D(self.state.forward_mps, self.state.left_mps, self.state.turn_radps)
            self._late.append((self.now_s + 0.04 + self.delay_s, Odometry(0, robot_ns, self._odom_from_robot, twist)))
        if self.steps % 5 == 0:
            scan = lidar.scan_from(
                self.state.pose_in_map, self.legs(self.now_s), self.noise, stamp_ns=robot_ns, model=self.lidar_model
            )
            mount = self.lidar_model.mount
            mounting = lidar_mounting(mount)
            if mounting != "tilted":
                scan = scan.mounted(mount.floor, upside_down=mounting == "upside_down")
                self._late.append((self.now_s + 0.04 + self.delay_s, scan))
        while self._late and self._late[0][0] <= self.now_s + 1e-9:
            value = replace(self._late.pop(0)[1], stamp_ns=round(self.now_s * 1e9))
            if isinstance(value, Odometry):
                self.guard.add_odometry(value)
            else:
                self.guard.add_scan(value)
                self.lease.reconsider(self.now_s)
        pose, radius_m = self.state.pose_in_map, self.base_model.radius_m
        people_m = [math.hypot(pose.x_m - x, pose.y_m - y) - r for x, y, r in self.bodies(self.now_s).tolist()]
        self.gaps_m.append(min([clearance_m(pose.x_m, pose.y_m), *people_m]) - radius_m)


def free_poses(count: int, seed: int, *, gap_m: float = 0.15) -> list[Pose2D]:
    """Random poses in the building with clearance around the robot."""
    chance = np.random.default_rng(seed)
    poses: list[Pose2D] = []
    while len(poses) < count:
        x, y = float(chance.uniform(0.0, WIDTH_M)), float(chance.uniform(0.0, DEPTH_M))
        if clearance_m(x, y) >= RADIUS_M + gap_m:
            poses.append(Pose2D(x, y, wrap_angle(float(chance.uniform(-math.pi, math.pi)))))
    return poses


FAST = replace(PROFILE, limits=MotionLimits(forward_mps=1.0, backward_mps=0.5, turn_radps=1.8))
SIDEWAYS = replace(PROFILE, limits=MotionLimits(forward_mps=0.5, backward_mps=0.5, left_mps=0.5))


@pytest.mark.parametrize("poses", [24, pytest.param(100, marks=pytest.mark.long)])
@pytest.mark.long("24")
def test_pushed_at_walls_from_many_poses_it_touches_nothing(poses: int) -> None:
    """Full speed of the profile: ahead, back, and in curves to both sides."""
    pushes = (Twist2D(0.5), Twist2D(-0.3), Twist2D(0.5, 0.0, 0.6), Twist2D(0.5, 0.0, -1.0))
    gaps_m, blocked = [], 0
    for number, pose in enumerate(free_poses(poses, seed=1)):
        robot = GuardedRobot(pose, seed=number).wait(0.3)
        robot.push(pushes[number % 4], 3.5, until_still=True)
        gaps_m.append(min(robot.gaps_m))
        blocked += robot.limits[-1].state == "blocked"
        assert robot.state.collisions == 0, (number, pose)
    print(f"{poses} poses: least gap {min(gaps_m):.3f} m, {blocked} ended at an obstacle")
    assert min(gaps_m) > 0.03
    assert blocked > poses // 3, "many of them did meet something"


@pytest.mark.parametrize(
    ("profile", "model", "pushes"),
    [
        (FAST, DIFFERENTIAL, (Twist2D(1.0), Twist2D(1.0, 0.0, 1.5), Twist2D(-0.5))),
        (SIDEWAYS, HOLONOMIC, (Twist2D(0.0, 0.5), Twist2D(0.35, -0.35), Twist2D(0.0, -0.5, 1.0))),
    ],
    ids=["twice as fast", "sideways"],
)
@pytest.mark.long
def test_neither_does_a_faster_or_a_holonomic_base(
    profile: RobotProfile, model: BaseModel, pushes: tuple[Twist2D, ...]
) -> None:
    gaps_m = []
    for number, pose in enumerate(free_poses(12, seed=5)):
        robot = GuardedRobot(pose, profile=profile, base_model=model, seed=number).wait(0.3)
        robot.push(pushes[number % 3], 4.0, until_still=True)
        gaps_m.append(min(robot.gaps_m))
        assert robot.state.collisions == 0, (number, pose)
    print(f"least gap {min(gaps_m):.3f} m")
    assert min(gaps_m) > 0.03


class _BoxRobot(GuardedRobot):
    """Rectangular robot that is longer at the back; checks the corners, as the simulated base is only a point."""

    CORNERS_M = ((-0.45, -0.25), (0.3, -0.25), (0.35, 0.0), (0.3, 0.25), (-0.45, 0.25))

    def _step(self) -> None:
        super()._step()
        outline = transformed(self.state.pose_in_map, Footprint(radius_m=0.0, corners_m=self.CORNERS_M).outline_m)
        self.gaps_m[-1] = min(clearance_m(x, y) for x, y in outline.tolist())


@pytest.mark.long
def test_a_long_robot_swings_none_of_its_corners_into_anything_for_any_keys() -> None:
    profile = replace(SIDEWAYS, footprint=FloorOutline(polygon_m=_BoxRobot.CORNERS_M))
    keys = (Twist2D(0.5), Twist2D(0.0, 0.0, 1.0), Twist2D(0.0, 0.5), Twist2D(-0.5, 0.3, -1.0), Twist2D(0.5, 0.0, 1.0))
    chance = np.random.default_rng(3)
    gaps_m, states = [], set()
    for number, pose in enumerate(free_poses(4, seed=77, gap_m=0.35)):
        robot = _BoxRobot(pose, profile=profile, base_model=BaseModel(radius_m=0.02, left_mps=0.5), seed=number)
        robot.wait(0.3)
        for _ in range(6):
            robot.push(keys[int(chance.integers(len(keys)))], float(chance.uniform(0.3, 1.2)))
        gaps_m.append(min(robot.gaps_m))
        states |= {limit.state for limit in robot.limits}
    print(f"long robot: least gap {min(gaps_m):.3f} m")
    assert min(gaps_m) > 0.02
    assert "blocked" in states


def test_straight_before_a_wall_it_stops_at_most_0_3_m_away() -> None:
    stops_m = []
    for number, (pose, push) in enumerate(
        [
            (Pose2D(4.0, 5.0, math.pi), Twist2D(0.5)),  # along the corridor to its end
            (Pose2D(14.6, 5.2, 0.0), Twist2D(0.5)),
            (Pose2D(9.5, 5.0, math.pi / 2), Twist2D(0.5)),
            (Pose2D(9.5, 5.0, math.pi / 2), Twist2D(-0.3)),
            (Pose2D(1.0, 5.0, 0.0), Twist2D(-0.3)),
            (Pose2D(14.0, 5.0, math.pi), Twist2D(-0.3)),
        ]
    ):
        robot = GuardedRobot(pose, seed=number).wait(0.3)
        robot.push(push, 9.0, until_still=True)
        stops_m.append(robot.gaps_m[-1])
        assert robot.limits[-1].state == "blocked"
    print("stops at", [round(stop_m, 3) for stop_m in stops_m])
    assert min(stops_m) > 0.1
    assert max(stops_m) < 0.3


def test_from_where_it_stopped_it_drives_away_and_turns() -> None:
    robot = GuardedRobot(Pose2D(9.5, 5.0, math.pi / 2)).wait(0.3).push(Twist2D(0.5), 3.0, until_still=True)
    before = robot.state.pose_in_map
    robot.push(Twist2D(0.0, 0.0, 1.0), 1.0)
    assert abs(wrap_angle(robot.state.pose_in_map.heading_rad - before.heading_rad)) > 0.7
    robot.push(Twist2D(-0.3), 1.0)
    assert robot.gaps_m[-1] > robot.gaps_m[-51] + 0.1


@pytest.mark.long
def test_a_door_of_0_9_m_is_passed_from_both_sides_also_when_not_met_exactly() -> None:
    """Door of the counselling room: its posts are 0.2 m from a centred robot."""
    slowest = 1.0
    for aside_m, askew_rad in ((0.0, 0.0), (0.08, 0.0), (-0.08, 0.0), (0.03, -0.04), (-0.03, 0.04)):
        for y_m, heading_rad in ((4.9, math.pi / 2), (6.9, -math.pi / 2)):
            robot = GuardedRobot(Pose2D(2.5 + aside_m, y_m, heading_rad + askew_rad)).wait(0.3)
            robot.push(Twist2D(0.5), 3.9)
            through_m = abs(robot.state.pose_in_map.y_m - y_m)
            assert through_m > 1.6, (aside_m, askew_rad, y_m, robot.limits[-1])
            assert min(robot.gaps_m) > 0.03
            slowest = min(slowest, *(limit.fraction for limit in robot.limits[:60]))
    print(f"slowest in the door: {slowest * 100:.0f} % of what was asked")


def _person(x_m: float, y_m: float, heading_rad: float) -> tuple[Circles, Circles]:
    """Body and legs of a person."""
    dx, dy = 0.11 * math.cos(heading_rad), 0.11 * math.sin(heading_rad)
    legs = [[x_m + dx, y_m + dy, 0.06], [x_m - dx, y_m - dy, 0.06]]
    return np.array([[x_m, y_m, BODY_M]]), np.array(legs)


def test_it_stops_before_people_whichever_way_they_stand() -> None:
    gaps_m = []
    for turn, aside_m in ((0, 0.0), (1, 0.1), (2, -0.1), (3, 0.15), (4, -0.15), (5, 0.0)):
        bodies, legs = _person(7.0, 5.0 + aside_m, turn * math.pi / 6)
        robot = GuardedRobot(Pose2D(5.8, 5.0, 0.0), bodies=lambda _s, b=bodies: b, legs=lambda _s, g=legs: g, seed=turn)
        robot.wait(0.3).push(Twist2D(0.5), 4.0, until_still=True)
        assert robot.state.collisions == 0
        assert robot.limits[-1].state == "blocked"
        gaps_m.append(min(robot.gaps_m))
    print("gap to the body", [round(gap_m, 3) for gap_m in gaps_m])
    assert min(gaps_m) > 0.03


@pytest.mark.long
def test_a_latency_of_300_ms_makes_it_slower_and_not_bolder() -> None:
    gaps_m = []
    for number, pose in enumerate(free_poses(6, seed=9)):
        robot = GuardedRobot(pose, delay_s=0.3, seed=number).wait(0.8)
        robot.guard.add_round_trip(0.6)
        robot.push((Twist2D(0.5), Twist2D(0.5, 0.0, 0.8), Twist2D(-0.3))[number % 3], 5.0)
        assert robot.state.collisions == 0
        gaps_m.append(min(robot.gaps_m))
    print(f"600 ms there and back: least gap {min(gaps_m):.3f} m")
    assert min(gaps_m) > 0.03


MOUNTED = {
    "upside down": replace(ALL_AROUND, roll_rad=math.pi),
    "pitched over": replace(ALL_AROUND, pitch_rad=math.pi),
    "looking back": replace(ALL_AROUND, robot_from_laser=Pose2D(-0.15, 0.0, math.pi)),
    "upside down, looking back": replace(ALL_AROUND, robot_from_laser=Pose2D(-0.15, 0.05, math.pi), roll_rad=math.pi),
    "aside": replace(ALL_AROUND, robot_from_laser=Pose2D(0.05, -0.15, 0.8)),
    "upside down, aside": replace(ALL_AROUND, robot_from_laser=Pose2D(0.05, 0.15, -0.8), roll_rad=math.pi),
    "a little tilted": replace(ALL_AROUND, pitch_rad=math.radians(3.0), roll_rad=math.radians(-3.0)),
    "upside down, a little tilted": replace(ALL_AROUND, pitch_rad=math.radians(3.0), roll_rad=math.radians(183.0)),
}


@pytest.mark.parametrize("model", MOUNTED.values(), ids=MOUNTED)
@pytest.mark.parametrize(
    ("post", "twist"),
    [
        ((10.3, 5.15), Twist2D(0.5)),  # ahead, a little to the left
        ((7.9, 4.85), Twist2D(-0.3)),
        ((9.9, 5.75), Twist2D(0.5, 0.0, 0.9)),  # on an arc to the left
        ((9.15, 5.45), Twist2D(0.0, 0.0, 1.0)),  # a corner of the footprint turns into it
    ],
    ids=["ahead", "back", "arc", "turn"],
)
@pytest.mark.long
def test_however_the_lidar_is_mounted_the_robot_stops_at_the_same_distance(
    model: LidarModel, post: tuple[float, float], twist: Twist2D, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lidar, "NOISE_M", 0.0)  # noise alone varies the result by 2 cm
    profile = replace(PROFILE, footprint=FloorOutline(polygon_m=((0.4, 0.2), (-0.4, 0.2), (-0.4, -0.2), (0.4, -0.2))))
    legs = np.array([[*post, 0.05]])

    def gap_m(lidar_model: LidarModel) -> float:
        robot = GuardedRobot(Pose2D(9.0, 5.0, 0.0), profile=profile, lidar_model=lidar_model, legs=lambda _s: legs)
        robot.wait(0.3).push(twist, 6.0, until_still=True)
        assert robot.limits[-1].state == "blocked"
        return float(Footprint.of(profile).gap_m(transformed(robot.state.pose_in_map.inverse(), legs[:, :2]))[0]) - 0.05

    upright_m, mounted_m = gap_m(ALL_AROUND), gap_m(model)
    print(f"{twist}: upright {upright_m:.3f} m, mounted so {mounted_m:.3f} m")
    assert upright_m > 0.01
    assert mounted_m == pytest.approx(upright_m, abs=0.02)


def test_a_person_who_steps_into_the_path_is_not_run_into() -> None:
    """A person enters from the side and stops a metre ahead of a robot at full speed."""

    def where(now_s: float) -> tuple[Circles, Circles]:
        return _person(7.6, 5.0 - min(0.0, 1.1 * (now_s - 2.9)), math.pi / 2)

    robot = GuardedRobot(Pose2D(5.8, 5.0, 0.0), bodies=lambda s: where(s)[0], legs=lambda s: where(s)[1])
    robot.wait(0.3).push(Twist2D(0.5), 4.0, until_still=True)
    assert robot.state.collisions == 0
    assert min(robot.gaps_m) > 0.03


def test_with_a_forward_lidar_it_backs_off_slowly_until_it_has_turned() -> None:
    ahead_only = LidarModel(
        beams=360, angle_min_rad=-math.pi / 2, angle_increment_rad=math.pi / 360, robot_from_laser=Pose2D(0.2, 0.0, 0.0)
    )
    robot = GuardedRobot(Pose2D(9.0, 5.0, 0.0), lidar_model=ahead_only).wait(0.3).push(Twist2D(0.5), 1.5)
    assert robot.state.forward_mps == pytest.approx(0.5), "ahead nothing is in its way"
    robot.push(Twist2D(-0.3), 1.5)
    assert robot.state.forward_mps == pytest.approx(-0.1)
    assert robot.limits[-1].state == "blind"
    robot.push(Twist2D(0.0, 0.0, 1.0), 3.4)
    robot.push(Twist2D(-0.3), 1.0)
    assert robot.state.forward_mps == pytest.approx(-0.3), "it has seen what is behind it now"


def test_overridden_it_pushes_on() -> None:
    robot = GuardedRobot(Pose2D(9.5, 5.0, math.pi / 2)).wait(0.3)
    robot.guard.switch(on=False)
    robot.push(Twist2D(0.5), 3.0)
    assert robot.state.collisions > 0


def test_over_rosbridge_the_robot_stops_before_the_wall_until_the_guard_is_overridden() -> None:
    """Real link and real simulator, each in a separate process."""
    with SimulatedRobot("--empty") as simulator:
        link = LinkProcess(simulator.address)
        try:
            wait_for(lambda: link.of(Odometry), "odometry")
            for heading_deg, forward_mps in ((90, 0.5), (-115, -0.3)):
                simulator.call("/simulator/reset_pose", x=9.5, y=5.0, heading_deg=heading_deg)
                wait_for(lambda: abs(simulator.state()["pose"]["x_m"] - 9.5) < 0.01, "it stands there")
                seen = len(link.of(LaserScan))
                wait_for(lambda seen=seen: len(link.of(LaserScan)) > seen + 1, "it sees where it is")
                told = len(link.of(GuardChanged))

                def blocked(told: int = told, forward_mps: float = forward_mps) -> bool:
                    link.drive(forward_mps)  # again, in case a busy computer renewed the lease too late
                    return "blocked" in [guard.state for guard in link.of(GuardChanged)[told:]]

                wait_for(blocked, "the guard", every_s=0.05)
                link.hold(lambda: link.of(Odometry)[-1].twist == ZERO_TWIST, "it stands")
                state = simulator.state()
                print(f"{forward_mps:+.1f} m/s: stands {state['gap_m']:.3f} m before the wall")
                assert state["touches"] == 0
                assert 0.05 < state["min_gap_m"] <= state["gap_m"] < 0.3
                distance_m = [g.distance_m for g in link.of(GuardChanged)[told:]][-1]
                assert distance_m is not None
                assert distance_m < 0.3
                link.send(Release(now_ns()))
            link.drive_until(
                lambda: simulator.state()["touches"] >= 1,
                "the wall stops it",
                forward_mps=0.5,
                guard=False,
                timeout_s=30,
            )
            assert "overridden" in [g.state for g in link.of(GuardChanged)]
        finally:
            link.close()
