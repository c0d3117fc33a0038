"""The simulated robot: ties base, LIDAR, navigation, people and map together in fixed steps of time."""

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from caris_desktop.domain.geometry import ZERO_TWIST, Pose2D, Twist2D, wrap_angle
from caris_desktop.domain.sensing import LaserScan, Odometry
from caris_desktop.simulator import base, lidar
from caris_desktop.simulator.base import STEP_S, BaseState
from caris_desktop.simulator.floor_plan import START
from caris_desktop.simulator.mapping import Mapper
from caris_desktop.simulator.navigation import GoalEnded, Navigator, Progress
from caris_desktop.simulator.people import Crowd, Seen

ROBOT_FROM_CAMERA = Pose2D(0.15, 0.0, 0.0)
_FORWARD_SCALE, _TURN_SCALE = 1.008, 1.012  # what the wheels' encoders believe
_BATTERY_LASTS_S = 4.0 * 3600.0
_LOCALISATION_NOISE_M, _LOCALISATION_NOISE_RAD = 0.008, 0.004


@dataclass(frozen=True, slots=True)
class View:
    """What the camera needs to draw one picture."""

    map_from_camera: Pose2D
    people: tuple[Seen, ...]


class Robot:
    """The robot and its surroundings. Told commands, stepped every 20 ms, asked for what its sensors see.

    The same seed and the same commands in the same steps give the same run.
    """

    def __init__(self, seed: int) -> None:
        scan_noise, drift_noise, pose_noise = np.random.SeedSequence(seed).spawn(3)
        self._scan_noise = np.random.default_rng(scan_noise)
        self._drift_noise = np.random.default_rng(drift_noise)
        self._pose_noise = np.random.default_rng(pose_noise)
        self._crowd = Crowd(seed)
        self._navigator = Navigator()
        self._mapper = Mapper()
        self._base = BaseState(START)
        self._odom_from_robot = Pose2D(0.0, 0.0, 0.0)
        self._believed = START
        self._wanted = ZERO_TWIST
        self._lease_until_s = -math.inf
        self._steps = 0
        self._ended: deque[GoalEnded] = deque()
        self.battery_fraction = 0.93
        self.emergency_stopped = False

    @property
    def now_s(self) -> float:
        """Simulated time."""
        return self._steps * STEP_S

    @property
    def truth(self) -> BaseState:
        """Where the base really is."""
        return self._base

    @property
    def pose_in_map(self) -> Pose2D:
        """Where the robot believes it is, which is right within a centimetre or two."""
        return self._believed

    @property
    def map_from_odom(self) -> Pose2D:
        """The correction that localisation makes to the odometry."""
        return self._believed @ self._odom_from_robot.inverse()

    @property
    def mapper(self) -> Mapper:
        return self._mapper

    @property
    def people(self) -> tuple[Seen, ...]:
        return self._crowd.seen

    @property
    def goal_id(self) -> str | None:
        """The navigation goal that is under way."""
        return self._navigator.goal_id

    def drive(self, twist: Twist2D) -> None:
        """Take a velocity command; it holds for 0.5 s. One that moves ends a navigation goal."""
        if twist.moving:
            self._ended.extend(self._navigator.end("aborted", "somebody drives the robot directly"))
        self._wanted = twist
        self._lease_until_s = self.now_s + base.LEASE_S

    def go(self, goal_id: str, target_in_map: Pose2D) -> bool:
        """Start a navigation goal. False where it is refused because of the emergency stop."""
        if self.emergency_stopped:
            return False
        self._wanted = ZERO_TWIST
        self._ended.extend(
            self._navigator.start(
                goal_id,
                target_in_map,
                pose=self._base.pose_in_map,
                people=self._crowd.bodies,
                now_s=self.now_s,
            )
        )
        return True

    def cancel_goal(self) -> None:
        """Cancel the navigation goal that is under way, if there is one."""
        self._ended.extend(self._navigator.end("cancelled", "the goal was cancelled"))

    def set_emergency_stop(self, stopped: bool) -> None:
        """Latch or clear the emergency stop. While latched nothing moves and goals are refused."""
        self.emergency_stopped = stopped
        self._wanted = ZERO_TWIST
        if stopped:
            self._ended.extend(self._navigator.end("aborted", "the emergency stop was pressed"))

    def take_ended_goals(self) -> list[GoalEnded]:
        """Goals that ended since the last call."""
        ended = list(self._ended)
        self._ended.clear()
        return ended

    def progress(self) -> Progress | None:
        """How far the goal under way has come."""
        return self._navigator.progress(self.now_s)

    def step(self) -> None:
        """Let 20 ms pass."""
        self._steps += 1
        self._crowd.step(self._base.pose_in_map, STEP_S)
        bodies = self._crowd.bodies
        twist, ended = self._navigator.step(self._base.pose_in_map, bodies, self.now_s)
        self._ended.extend(ended)
        if self._navigator.goal_id is None:
            twist = self._wanted if self.now_s <= self._lease_until_s else ZERO_TWIST
        if self.emergency_stopped:
            twist = ZERO_TWIST
        before = self._base
        self._base = base.step(before, twist, bodies)
        self._drift(before, self._base)
        self.battery_fraction = max(0.0, self.battery_fraction - STEP_S / _BATTERY_LASTS_S)

    def scan(self, *, stamp_ns: int) -> LaserScan:
        """What the LIDAR sees now; the map learns from it."""
        scan = lidar.scan_from(self._base.pose_in_map, self._crowd.legs, self._scan_noise, stamp_ns=stamp_ns)
        self._believed = self._localised()
        self._mapper.add(scan, self._believed)
        return scan

    def odometry(self, *, stamp_ns: int) -> Odometry:
        """What the wheels tell: a pose that drifts away, and the velocity."""
        twist = Twist2D(self._base.forward_mps, 0.0, self._base.turn_radps)
        return Odometry(stamp_ns, stamp_ns, self._odom_from_robot, twist)

    def view(self) -> View:
        """What the camera would see now."""
        return View(self._base.pose_in_map @ ROBOT_FROM_CAMERA, self._crowd.seen)

    def _localised(self) -> Pose2D:
        pose = self._base.pose_in_map
        dx, dy, turn = self._pose_noise.normal(0.0, 1.0, 3).tolist()
        return Pose2D(
            pose.x_m + dx * _LOCALISATION_NOISE_M,
            pose.y_m + dy * _LOCALISATION_NOISE_M,
            wrap_angle(pose.heading_rad + turn * _LOCALISATION_NOISE_RAD),
        )

    def _drift(self, before: BaseState, after: BaseState) -> None:
        moved = before.pose_in_map.inverse() @ after.pose_in_map
        if moved == Pose2D(0.0, 0.0, 0.0):
            return
        slip = float(self._drift_noise.normal(0.0, 0.02))
        felt = replace(
            moved,
            x_m=moved.x_m * _FORWARD_SCALE,
            heading_rad=moved.heading_rad * _TURN_SCALE + slip * abs(moved.x_m),
        )
        self._odom_from_robot = self._odom_from_robot @ felt
        self._believed = self._believed @ moved
