"""Mobile base, differential or holonomic: acceleration limits, collisions, and a command timeout."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.geometry import Pose2D, Twist2D, wrap_angle
from caris_desktop.domain.value_class import Value
from caris_desktop.simulator.floor_plan import SOLID
from caris_desktop.simulator.lidar import corners_of

STEP_S = 0.02
RADIUS_M = 0.25
MAX_FORWARD_MPS, MAX_REVERSE_MPS, MAX_TURN_RADPS = 1.0, 0.5, 1.8
SPEED_UP_MPS2, BRAKE_MPS2 = 1.0, 5.0
TURN_UP_RADPS2, TURN_BRAKE_RADPS2 = 3.5, 10.0
LEASE_S = 0.5

_CORNERS = corners_of(SOLID)
_PUSHES = 3


class BaseModel(Value):
    """Capabilities of a base. ``left_mps`` is 0 for differential drive."""

    radius_m: float = RADIUS_M
    forward_mps: float = MAX_FORWARD_MPS
    reverse_mps: float = MAX_REVERSE_MPS
    left_mps: float = 0.0
    turn_radps: float = MAX_TURN_RADPS


DIFFERENTIAL = BaseModel()
HOLONOMIC = BaseModel(left_mps=0.5)


class BaseState(Value):
    """True pose and velocity of the base."""

    pose_in_map: Pose2D
    forward_mps: float = 0.0
    turn_radps: float = 0.0
    touching: bool = False
    collisions: int = 0
    left_mps: float = 0.0


def limited(command: Twist2D, model: BaseModel = DIFFERENTIAL) -> Twist2D:
    """``command`` within the base's limits."""
    return Twist2D(
        min(max(command.forward_mps, -model.reverse_mps), model.forward_mps),
        min(max(command.left_mps, -model.left_mps), model.left_mps),
        min(max(command.turn_radps, -model.turn_radps), model.turn_radps),
    )


def step(
    state: BaseState,
    command: Twist2D,
    people: NDArray[np.float64],
    *,
    dt_s: float = STEP_S,
    model: BaseModel = DIFFERENTIAL,
) -> BaseState:
    """State after ``dt_s``. ``people`` are circles (x, y, radius) in the map, shape (people, 3)."""
    command = limited(command, model)
    forward = _approach(state.forward_mps, command.forward_mps, SPEED_UP_MPS2 * dt_s, BRAKE_MPS2 * dt_s)
    left = _approach(state.left_mps, command.left_mps, SPEED_UP_MPS2 * dt_s, BRAKE_MPS2 * dt_s)
    turn = _approach(state.turn_radps, command.turn_radps, TURN_UP_RADPS2 * dt_s, TURN_BRAKE_RADPS2 * dt_s)
    pose = state.pose_in_map
    if forward == 0.0 and left == 0.0 and turn == 0.0:
        return replace(state, forward_mps=0.0, left_mps=0.0, turn_radps=0.0, touching=False)
    heading_between = pose.heading_rad + turn * dt_s / 2.0
    cos, sin = math.cos(heading_between), math.sin(heading_between)
    x = pose.x_m + (forward * cos - left * sin) * dt_s
    y = pose.y_m + (forward * sin + left * cos) * dt_s
    free_x, free_y = push_out(x, y, model.radius_m, people)
    touching = (free_x, free_y) != (x, y)
    if touching:
        # the motion left after sliding along the obstacle is the wheels' speed
        moved_x, moved_y = (free_x - pose.x_m) / dt_s, (free_y - pose.y_m) / dt_s
        forward = _at_most(forward, moved_x * cos + moved_y * sin)
        left = _at_most(left, moved_y * cos - moved_x * sin)
        if not is_free(free_x, free_y, model.radius_m - 0.005, people):
            free_x, free_y, forward, left = pose.x_m, pose.y_m, 0.0, 0.0
    return BaseState(
        pose_in_map=Pose2D(free_x, free_y, wrap_angle(pose.heading_rad + turn * dt_s)),
        forward_mps=forward,
        left_mps=left,
        turn_radps=turn,
        touching=touching,
        collisions=state.collisions + (1 if touching and not state.touching else 0),
    )


def push_out(x_m: float, y_m: float, radius_m: float, people: NDArray[np.float64]) -> tuple[float, float]:
    """Nearest collision-free position of a body of ``radius_m``; unchanged if free already."""
    for _ in range(_PUSHES):
        near_x = np.clip(x_m, _CORNERS[:, 0], _CORNERS[:, 2])
        near_y = np.clip(y_m, _CORNERS[:, 1], _CORNERS[:, 3])
        distance = np.hypot(x_m - near_x, y_m - near_y)
        deepest = int(distance.argmin())
        moved = False
        if distance[deepest] < radius_m - 1e-9:
            gap = max(float(distance[deepest]), 1e-6)
            scale = (radius_m - gap) / gap
            x_m += (x_m - float(near_x[deepest])) * scale
            y_m += (y_m - float(near_y[deepest])) * scale
            moved = True
        for person_x, person_y, person_radius in people.tolist():
            away_x, away_y = x_m - person_x, y_m - person_y
            gap = max(math.hypot(away_x, away_y), 1e-6)
            if gap < radius_m + person_radius - 1e-9:
                scale = (radius_m + person_radius - gap) / gap
                x_m, y_m, moved = x_m + away_x * scale, y_m + away_y * scale, True
        if not moved:
            break
    return x_m, y_m


def is_free(x_m: float, y_m: float, radius_m: float, people: NDArray[np.float64]) -> bool:
    """True if a body of ``radius_m`` fits there."""
    return clearance_m(x_m, y_m) >= radius_m and all(
        math.hypot(x_m - px, y_m - py) >= radius_m + pr for px, py, pr in people.tolist()
    )


def clearance_m(x_m: float, y_m: float) -> float:
    """Distance to the nearest wall or furniture; zero inside one."""
    near_x = np.clip(x_m, _CORNERS[:, 0], _CORNERS[:, 2])
    near_y = np.clip(y_m, _CORNERS[:, 1], _CORNERS[:, 3])
    return float(np.hypot(x_m - near_x, y_m - near_y).min())


def gap_m(x_m: float, y_m: float, radius_m: float, people: NDArray[np.float64]) -> float:
    """Clearance from the body's edge to the nearest object, including people; negative on overlap."""
    nearest_m = clearance_m(x_m, y_m)
    for person_x, person_y, person_radius in people.tolist():
        nearest_m = min(nearest_m, math.hypot(x_m - person_x, y_m - person_y) - float(person_radius))
    return nearest_m - radius_m


def _at_most(speed: float, moved: float) -> float:
    """``speed``, limited to the actual motion in its direction."""
    return math.copysign(min(abs(speed), max(0.0, math.copysign(1.0, speed) * moved)), speed)


def _approach(now: float, target: float, speed_up: float, brake: float) -> float:
    slowing = abs(target) < abs(now) or now * target < 0.0
    limit = brake if slowing else speed_up
    if now * target < 0.0 and abs(now) < limit:
        return 0.0
    return now + min(max(target - now, -limit), limit)
