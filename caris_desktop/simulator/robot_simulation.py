"""Simulated robot: base, head, camera view, LIDAR, navigation, people and map in fixed time steps."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from caris_desktop.domain.geometry import ZERO_TWIST, Pose2D, Twist2D, wrap_angle
from caris_desktop.domain.sensing import LaserScan, Odometry, lidar_mounting
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.simulator import lidar, simulated_base
from caris_desktop.simulator.floor_plan import START
from caris_desktop.simulator.lidar import ALL_AROUND, LidarModel
from caris_desktop.simulator.lidar import FRAME_ID as LASER_FRAME
from caris_desktop.simulator.simulated_base import DIFFERENTIAL, STEP_S, BaseModel, BaseState
from caris_desktop.simulator.simulated_mapping import Mapper
from caris_desktop.simulator.simulated_navigation import GoalEnded, GoalFollower, in_sight
from caris_desktop.simulator.simulated_people import Crowd, Seen, Visit

DEFAULT_SPEED_RADPS = 0.8


class HeadModel(Value):
    """Range and speed of a head: pan left positive, tilt down positive, from straight ahead."""

    pan_range_rad: tuple[float, float] = (-1.2, 1.2)
    tilt_range_rad: tuple[float, float] = (-0.5, 0.7)
    fastest_radps: float = 1.5


MOVABLE = HeadModel()


@dataclass(slots=True)
class Joint:
    """One motor, which turns towards its newest target."""

    range_rad: tuple[float, float]
    fastest_radps: float
    angle_rad: float = 0.0
    target_rad: float = 0.0
    speed_radps: float = DEFAULT_SPEED_RADPS

    def turn_to(self, target_rad: float, speed_radps: float = DEFAULT_SPEED_RADPS) -> None:
        """Start turning, within the limits of range and speed."""
        lowest, highest = self.range_rad
        self.target_rad = min(max(target_rad, lowest), highest)
        self.speed_radps = min(max(speed_radps, 0.01), self.fastest_radps)

    def step(self, dt_s: float) -> None:
        most = self.speed_radps * dt_s
        self.angle_rad += min(max(self.target_rad - self.angle_rad, -most), most)


class Head:
    """Pan joint (left positive) and tilt joint (down positive); they are independent."""

    def __init__(self, model: HeadModel = MOVABLE) -> None:
        self.pan = Joint(model.pan_range_rad, model.fastest_radps)
        self.tilt = Joint(model.tilt_range_rad, model.fastest_radps)

    def step(self, dt_s: float) -> None:
        """Advance the simulation by ``dt_s``."""
        self.pan.step(dt_s)
        self.tilt.step(dt_s)


WIDTH_PX, HEIGHT_PX = 640, 480
FOV_RAD = math.radians(70.0)
FOCAL_PX = WIDTH_PX / 2.0 / math.tan(FOV_RAD / 2.0)
MOUNT_HEIGHT_M = 1.1
RATE_HZ = 15.0
_FARTHEST_M = 9.0


def sees(map_from_camera: Pose2D, x_m: float, y_m: float) -> bool:
    """True if a person at (x, y) is fully within the image width and not behind a wall."""
    distance_m = math.hypot(x_m - map_from_camera.x_m, y_m - map_from_camera.y_m)
    if not 0.5 < distance_m < _FARTHEST_M:
        return False
    bearing = math.atan2(y_m - map_from_camera.y_m, x_m - map_from_camera.x_m)
    margin = math.atan2(0.3, distance_m)
    if abs(wrap_angle(bearing - map_from_camera.heading_rad)) > FOV_RAD / 2.0 - margin:
        return False
    return in_sight((map_from_camera.x_m, map_from_camera.y_m), (x_m, y_m))


ROBOT_FROM_CAMERA = Pose2D(0.15, 0.0, 0.0)
_FORWARD_SCALE, _TURN_SCALE = 1.008, 1.012  # scale errors of the wheel encoders
_BATTERY_LASTS_S = 4.0 * 3600.0
_LOCALISATION_NOISE_M, _LOCALISATION_NOISE_RAD = 0.008, 0.004
_FINDS_ITSELF_WITHIN_M, _FINDS_ITSELF_WITHIN_RAD = 1.0, 0.7
_FINDS_ITSELF_IN_S = 1.5
_SCAN_PERIOD_S = 0.1
_MAPS_WITHIN_M, _MAPS_WITHIN_RAD = 0.05, 0.03
_NO_ERROR = Pose2D(0.0, 0.0, 0.0)


class View(Value):
    """Camera pose and people for one image. ``tilt_rad``: down positive."""

    map_from_camera: Pose2D
    people: tuple[Seen, ...]
    tilt_rad: float = 0.0
    height_m: float = MOUNT_HEIGHT_M


class Body(Value):
    """Hardware of the robot: base, LIDAR, head and camera mounting."""

    base: BaseModel = DIFFERENTIAL
    lidar: LidarModel | None = ALL_AROUND
    laser_frame: str = LASER_FRAME
    head: HeadModel = MOVABLE
    robot_from_camera: Pose2D = ROBOT_FROM_CAMERA
    camera_height_m: float = MOUNT_HEIGHT_M


DEFAULT_BODY = Body()


class Robot:
    """Robot and surroundings: receives commands, is stepped every 20 ms, and returns sensor data.

    Equal seed and commands per step give equal runs. The step count is its only clock.

    Parameters
    ----------
    seed
        Of the noise and of the people's walks.
    body
        What the robot is made of.
    populated
        Whether people walk about.
    visits
        Who comes, instead of those who are always there.
    """

    def __init__(
        self, seed: int, *, body: Body = DEFAULT_BODY, populated: bool = True, visits: Sequence[Visit] | None = None
    ) -> None:
        scan_noise, drift_noise, pose_noise = np.random.SeedSequence(seed).spawn(3)
        self._scan_noise = np.random.default_rng(scan_noise)
        self._drift_noise = np.random.default_rng(drift_noise)
        self._pose_noise = np.random.default_rng(pose_noise)
        self.body = body
        self._crowd = Crowd(seed, visits if populated else ())
        self.head = Head(body.head)
        self.navigation = GoalFollower()
        self.mapper = Mapper()
        self._base = BaseState(START)
        self._odom_from_robot = Pose2D(0.0, 0.0, 0.0)
        self._believed = START
        self._pose_error = _NO_ERROR
        self.min_gap_m = math.inf  # since it was last placed; ``inf`` before the first step
        self._touches_before = 0
        self._commanded = ZERO_TWIST
        self._lease_until_s = -math.inf
        self._steps = 0
        self._ended: list[GoalEnded] = []
        self.battery_fraction = 0.93
        self.emergency_stopped = False
        self.mapping_paused = False

    @property
    def now_s(self) -> float:
        """Simulated time."""
        return self._steps * STEP_S

    @property
    def truth(self) -> BaseState:
        """True pose and velocity."""
        return self._base

    @property
    def pose_in_map(self) -> Pose2D:
        """Localized pose: accurate to one or two centimetres, unless it was set otherwise."""
        return self._believed

    @property
    def map_from_odom(self) -> Pose2D:
        """Odometry correction by the localization."""
        return self._believed @ self._odom_from_robot.inverse()

    @property
    def people(self) -> tuple[Seen, ...]:
        return self._crowd.seen

    @property
    def touches(self) -> int:
        """Number of collisions since it was last placed."""
        return self._base.collisions - self._touches_before

    @property
    def gap_m(self) -> float:
        """Present clearance, including people."""
        pose = self._base.pose_in_map
        return simulated_base.gap_m(pose.x_m, pose.y_m, self.body.base.radius_m, self._crowd.bodies)

    def drive(self, twist: Twist2D) -> None:
        """Apply a velocity command for 0.5 s. Motion ends a navigation goal."""
        if twist.moving:
            self._ended.extend(self.navigation.end("aborted", "the robot is being driven manually"))
        self._commanded = twist
        self._lease_until_s = self.now_s + simulated_base.LEASE_S

    def go(self, goal_id: str, target_in_map: Pose2D) -> bool:
        """Start a navigation goal. False if the emergency stop is set."""
        if self.emergency_stopped:
            return False
        self._commanded = ZERO_TWIST
        self._ended.extend(
            self.navigation.start(
                goal_id, target_in_map, pose=self._navigation_pose, people=self._crowd.bodies, now_s=self.now_s
            )
        )
        return True

    def cancel_goal(self) -> None:
        """Cancel the present navigation goal, if any."""
        self._ended.extend(self.navigation.end("cancelled", "the goal was cancelled"))

    def place(self, pose_in_map: Pose2D) -> bool:
        """Place the robot, standing still and localized; resets collisions and clearance.

        False, without effect, if it does not fit.
        """
        if not simulated_base.is_free(pose_in_map.x_m, pose_in_map.y_m, self.body.base.radius_m, self._crowd.bodies):
            return False
        self._ended.extend(self.navigation.end("aborted", "the robot was moved to another place"))
        self._base = BaseState(pose_in_map, collisions=self._base.collisions)
        self._touches_before = self._base.collisions
        self.min_gap_m = self.gap_m
        self._commanded = ZERO_TWIST
        self._pose_error = _NO_ERROR
        self._believed = pose_in_map
        return True

    def assume_pose(self, pose_in_map: Pose2D) -> None:
        """Set the localized pose. It converges to the truth from a limited error."""
        truth = self._base.pose_in_map
        self._pose_error = Pose2D(
            pose_in_map.x_m - truth.x_m,
            pose_in_map.y_m - truth.y_m,
            wrap_angle(pose_in_map.heading_rad - truth.heading_rad),
        )
        self._believed = pose_in_map

    @property
    def localised(self) -> bool:
        """True if the localized pose is right or will converge."""
        return _within(self._pose_error, _FINDS_ITSELF_WITHIN_M, _FINDS_ITSELF_WITHIN_RAD)

    @property
    def path_in_map(self) -> list[tuple[float, float]]:
        """Remaining path to the goal from the robot; empty without a goal."""
        return self.navigation.path_from(self._navigation_pose)

    def set_emergency_stop(self, stopped: bool) -> None:
        """Latch or clear the emergency stop. While latched nothing moves and goals are refused."""
        self.emergency_stopped = stopped
        self._commanded = ZERO_TWIST
        if stopped:
            self._ended.extend(self.navigation.end("aborted", "the emergency stop was pressed"))

    def take_ended_goals(self) -> list[GoalEnded]:
        """Goals that ended since the last call."""
        ended, self._ended = self._ended, []
        return ended

    def step(self) -> None:
        """Advance the simulation by 20 ms."""
        self._steps += 1
        self._crowd.step(self._base.pose_in_map, STEP_S)
        self.head.step(STEP_S)
        bodies = self._crowd.bodies
        twist, ended = self.navigation.step(self._navigation_pose, bodies, self.now_s)
        self._ended.extend(ended)
        if self.navigation.goal_id is None:
            twist = self._commanded if self.now_s <= self._lease_until_s else ZERO_TWIST
        if self.emergency_stopped:
            twist = ZERO_TWIST
        before = self._base
        self._base = simulated_base.step(before, twist, bodies, model=self.body.base)
        self._drift(before, self._base)
        self.min_gap_m = min(self.min_gap_m, self.gap_m)
        self.battery_fraction = max(0.0, self.battery_fraction - STEP_S / _BATTERY_LASTS_S)

    def scan(self, *, stamp_ns: int) -> LaserScan:
        """Present LIDAR scan, which also updates localization and map.

        A robot without a LIDAR returns its mapping sensor's scan, the default one.
        """
        scan = lidar.scan_from(
            self._base.pose_in_map,
            self._crowd.legs,
            self._scan_noise,
            stamp_ns=stamp_ns,
            model=self.body.lidar or ALL_AROUND,
            frame_id=self.body.laser_frame,
        )
        if _within(self._pose_error, 1e-3, 1e-3):
            self._pose_error = _NO_ERROR
        elif self.localised:
            left, error = math.exp(-_SCAN_PERIOD_S / _FINDS_ITSELF_IN_S), self._pose_error
            self._pose_error = Pose2D(error.x_m * left, error.y_m * left, error.heading_rad * left)
        pose = self._navigation_pose
        dx, dy, turn = self._pose_noise.normal(0.0, 1.0, 3).tolist()
        self._believed = Pose2D(
            pose.x_m + dx * _LOCALISATION_NOISE_M,
            pose.y_m + dy * _LOCALISATION_NOISE_M,
            wrap_angle(pose.heading_rad + turn * _LOCALISATION_NOISE_RAD),
        )
        if not self.mapping_paused and _within(self._pose_error, _MAPS_WITHIN_M, _MAPS_WITHIN_RAD):
            mount = (self.body.lidar or ALL_AROUND).mount
            mounting = lidar_mounting(mount)
            if mounting != "tilted":
                self.mapper.add(scan.mounted(mount.floor, upside_down=mounting == "upside_down"), self._believed)
        return scan

    def odometry(self, *, stamp_ns: int) -> Odometry:
        """Odometry: a drifting pose, and the velocity."""
        twist = Twist2D(self._base.forward_mps, self._base.left_mps, self._base.turn_radps)
        return Odometry(stamp_ns, stamp_ns, self._odom_from_robot, twist)

    def view(self) -> View:
        """Present view of the camera."""
        camera = self._base.pose_in_map @ self.body.robot_from_camera
        turned = replace(camera, heading_rad=wrap_angle(camera.heading_rad + self.head.pan.angle_rad))
        return View(turned, self.people, self.head.tilt.angle_rad, self.body.camera_height_m)

    @property
    def _navigation_pose(self) -> Pose2D:
        """Pose for navigation: with the localization error, without its noise."""
        truth, error = self._base.pose_in_map, self._pose_error
        if error == _NO_ERROR:
            return truth
        return Pose2D(truth.x_m + error.x_m, truth.y_m + error.y_m, wrap_angle(truth.heading_rad + error.heading_rad))

    def _drift(self, before: BaseState, after: BaseState) -> None:
        moved = before.pose_in_map.inverse() @ after.pose_in_map
        if moved == _NO_ERROR:
            return
        slip = float(self._drift_noise.normal(0.0, 0.02))
        felt = replace(
            moved, x_m=moved.x_m * _FORWARD_SCALE, heading_rad=moved.heading_rad * _TURN_SCALE + slip * abs(moved.x_m)
        )
        self._odom_from_robot = self._odom_from_robot @ felt
        self._believed = self._believed @ moved


def _within(error: Pose2D, distance_m: float, angle_rad: float) -> bool:
    return math.hypot(error.x_m, error.y_m) <= distance_m and abs(error.heading_rad) <= angle_rad
