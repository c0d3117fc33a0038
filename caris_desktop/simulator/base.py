"""The differential-drive base: acceleration limits, collisions, and a command lease of its own."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.geometry import Pose2D, Twist2D, wrap_angle
from caris_desktop.simulator.floor_plan import SOLID
from caris_desktop.simulator.ray_casting import corners_of

STEP_S = 0.02
RADIUS_M = 0.25
MAX_FORWARD_MPS, MAX_REVERSE_MPS, MAX_TURN_RADPS = 1.0, 0.5, 1.8
SPEED_UP_MPS2, BRAKE_MPS2 = 1.0, 5.0
TURN_UP_RADPS2, TURN_BRAKE_RADPS2 = 3.5, 10.0
LEASE_S = 0.5

_CORNERS = corners_of(SOLID)
_PUSHES = 3


@dataclass(frozen=True, slots=True)
class BaseState:
    """Where the base really is, and how fast it really moves."""

    pose_in_map: Pose2D
    forward_mps: float = 0.0
    turn_radps: float = 0.0
    touching: bool = False
    collisions: int = 0


def limited(wanted: Twist2D) -> Twist2D:
    """``wanted`` within what the base can do. It cannot move sideways."""
    return Twist2D(
        min(max(wanted.forward_mps, -MAX_REVERSE_MPS), MAX_FORWARD_MPS),
        0.0,
        min(max(wanted.turn_radps, -MAX_TURN_RADPS), MAX_TURN_RADPS),
    )


def step(state: BaseState, wanted: Twist2D, people: NDArray[np.float64], *, dt_s: float = STEP_S) -> BaseState:
    """The state ``dt_s`` later. ``people`` are circles (x, y, radius) in the map, shape (people, 3)."""
    wanted = limited(wanted)
    forward = _approach(state.forward_mps, wanted.forward_mps, SPEED_UP_MPS2 * dt_s, BRAKE_MPS2 * dt_s)
    turn = _approach(state.turn_radps, wanted.turn_radps, TURN_UP_RADPS2 * dt_s, TURN_BRAKE_RADPS2 * dt_s)
    pose = state.pose_in_map
    if forward == 0.0 and turn == 0.0:
        return replace(state, forward_mps=0.0, turn_radps=0.0, touching=False)
    heading_between = pose.heading_rad + turn * dt_s / 2.0
    x = pose.x_m + forward * dt_s * math.cos(heading_between)
    y = pose.y_m + forward * dt_s * math.sin(heading_between)
    free_x, free_y = push_out(x, y, RADIUS_M, people)
    touching = (free_x, free_y) != (x, y)
    if touching:
        # what is left of the motion after sliding along the obstacle is the speed that the wheels still have
        moved = (free_x - pose.x_m) * math.cos(heading_between) + (free_y - pose.y_m) * math.sin(heading_between)
        forward = math.copysign(min(abs(forward), max(0.0, moved * math.copysign(1.0, forward)) / dt_s), forward)
        if not is_free(free_x, free_y, RADIUS_M - 0.005, people):
            free_x, free_y, forward = pose.x_m, pose.y_m, 0.0
    return BaseState(
        pose_in_map=Pose2D(free_x, free_y, wrap_angle(pose.heading_rad + turn * dt_s)),
        forward_mps=forward,
        turn_radps=turn,
        touching=touching,
        collisions=state.collisions + (1 if touching and not state.touching else 0),
    )


def push_out(x_m: float, y_m: float, radius_m: float, people: NDArray[np.float64]) -> tuple[float, float]:
    """The nearest position where a body of ``radius_m`` touches nothing; the same one where it already does not."""
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
    """Whether a body of ``radius_m`` fits there."""
    return clearance_m(x_m, y_m) >= radius_m and all(
        math.hypot(x_m - px, y_m - py) >= radius_m + pr for px, py, pr in people.tolist()
    )


def clearance_m(x_m: float, y_m: float) -> float:
    """Distance to the nearest wall or piece of furniture; zero inside one."""
    near_x = np.clip(x_m, _CORNERS[:, 0], _CORNERS[:, 2])
    near_y = np.clip(y_m, _CORNERS[:, 1], _CORNERS[:, 3])
    return float(np.hypot(x_m - near_x, y_m - near_y).min())


def _approach(now: float, wanted: float, speed_up: float, brake: float) -> float:
    slowing = abs(wanted) < abs(now) or now * wanted < 0.0
    limit = brake if slowing else speed_up
    if now * wanted < 0.0 and abs(now) < limit:
        return 0.0
    return now + min(max(wanted - now, -limit), limit)
