"""Goal navigation: plan a path, follow it, stop for people, and report the outcome."""

import math
from functools import cache
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.geometry import ZERO_TWIST, Pose2D, Twist2D, wrap_angle
from caris_desktop.domain.value_class import Value
from caris_desktop.simulator.floor_plan import MAP_ORIGIN_M, MAP_SIZE_M, SOLID
from caris_desktop.simulator.lidar import corners_of
from caris_desktop.simulator.simulated_base import RADIUS_M, clearance_m

Point = tuple[float, float]

CELL_M = 0.1
COLUMNS, ROWS = round(MAP_SIZE_M[0] / CELL_M), round(MAP_SIZE_M[1] / CELL_M)
_WALL_COST = 1e6
_COMFORT_M = 0.65
_MAX_SWEEPS = 80


def plan(
    start: Point, goal: Point, *, body_m: float, avoid: NDArray[np.float64] | None = None, give_way_m: float = 0.5
) -> list[Point] | None:
    """Path from ``start`` to ``goal`` with a clearance of ``body_m``, or None.

    Parameters
    ----------
    avoid
        Circles (x, y, radius), shape (n, 3), that are in the way as well.
    give_way_m
        How far from the goal the way may end where the goal itself is not free.
    """
    clearance = _clearance()
    xs, ys = _axes()
    for x, y, radius in [] if avoid is None else avoid.tolist():
        clearance = np.minimum(clearance, np.hypot(xs[None, :] - x, ys[:, None] - y) - radius)
    free = clearance >= body_m
    goal_cell = _nearest_free(goal, free, give_way_m)
    start_cell = _nearest_free(start, free, 0.6)
    if goal_cell is None or start_cell is None:
        return None
    cost = np.where(free, 1.0 + 2.0 * np.clip(_COMFORT_M - clearance, 0.0, _COMFORT_M), _WALL_COST)
    field = _cost_to_go(cost, goal_cell)
    if field[start_cell] >= _WALL_COST:
        return None
    cells = _downhill(field, start_cell, goal_cell)
    points = [(MAP_ORIGIN_M[0] + (x + 0.5) * CELL_M, MAP_ORIGIN_M[1] + (y + 0.5) * CELL_M) for y, x in cells]
    points[0] = start
    if math.dist(points[-1], goal) <= CELL_M:
        points[-1] = goal
    return _pulled_straight(points, clearance, body_m)


def length_m(points: list[Point]) -> float:
    """Length of a path."""
    return sum(math.dist(a, b) for a, b in pairwise(points))


def in_sight(a: Point, b: Point) -> bool:
    """True if there is no solid object between two points."""
    steps = max(2, int(math.dist(a, b) / 0.1))
    return all(
        clearance_m(a[0] + (b[0] - a[0]) * i / steps, a[1] + (b[1] - a[1]) * i / steps) > 0.05 for i in range(steps + 1)
    )


@cache
def _clearance() -> NDArray[np.float64]:
    """Distance of each cell's centre to the nearest solid object, shape (ROWS, COLUMNS)."""
    xs, ys = _axes()
    clearance = np.full((ROWS, COLUMNS), np.inf)
    for x0, y0, x1, y1 in corners_of(SOLID).tolist():
        beside = np.maximum(np.maximum(x0 - xs, xs - x1), 0.0)
        above = np.maximum(np.maximum(y0 - ys, ys - y1), 0.0)
        clearance = np.minimum(clearance, np.hypot(beside[None, :], above[:, None]))
    return clearance


def _axes() -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    return (MAP_ORIGIN_M[0] + (np.arange(COLUMNS) + 0.5) * CELL_M, MAP_ORIGIN_M[1] + (np.arange(ROWS) + 0.5) * CELL_M)


def _nearest_free(point: Point, free: NDArray[np.bool_], within_m: float) -> tuple[int, int] | None:
    x, y = point[0] - MAP_ORIGIN_M[0], point[1] - MAP_ORIGIN_M[1]
    if not (0.0 <= x <= MAP_SIZE_M[0] and 0.0 <= y <= MAP_SIZE_M[1]):
        return None
    cell = min(int(y / CELL_M), ROWS - 1), min(int(x / CELL_M), COLUMNS - 1)
    if free[cell]:
        return cell
    rows, columns = np.nonzero(free)
    if not len(rows):
        return None
    distance = np.hypot(rows - cell[0], columns - cell[1]) * CELL_M
    nearest = int(distance.argmin())
    return (int(rows[nearest]), int(columns[nearest])) if distance[nearest] <= within_m else None


def _cost_to_go(cost: NDArray[np.float64], goal: tuple[int, int]) -> NDArray[np.float64]:
    """Minimum cost from each cell to the goal, by sweeps of rows and columns until nothing improves.

    A sweep in one direction is a running minimum over ``field - walked``, where ``walked`` is the accumulated cost
    along the line; so a straight segment of any length costs one numpy call.
    """
    field = np.full(cost.shape, _WALL_COST * 1e3)
    field[goal] = 0.0
    along_x, along_y = np.cumsum(cost, axis=1), np.cumsum(cost, axis=0)
    back_x = np.cumsum(cost[:, ::-1], axis=1)[:, ::-1]
    back_y = np.cumsum(cost[::-1], axis=0)[::-1]
    for _ in range(_MAX_SWEEPS):
        before = field
        field = np.minimum(field, np.minimum.accumulate(field - along_x, axis=1) + along_x)
        field = np.minimum(field, np.minimum.accumulate((field - back_x)[:, ::-1], axis=1)[:, ::-1] + back_x)
        field = np.minimum(field, np.minimum.accumulate(field - along_y, axis=0) + along_y)
        field = np.minimum(field, np.minimum.accumulate((field - back_y)[::-1], axis=0)[::-1] + back_y)
        if np.allclose(field, before, rtol=0.0, atol=1e-6):
            break
    return field


def _downhill(field: NDArray[np.float64], start: tuple[int, int], goal: tuple[int, int]) -> list[tuple[int, int]]:
    cells = [start]
    while cells[-1] != goal:  # each cell costs less than the one before
        row, column = cells[-1]
        r0, c0 = max(row - 1, 0), max(column - 1, 0)
        around = field[r0 : row + 2, c0 : column + 2]
        best = np.unravel_index(int(around.argmin()), around.shape)
        following = (r0 + int(best[0]), c0 + int(best[1]))
        if field[following] >= field[row, column]:
            break
        cells.append(following)
    return cells


def _pulled_straight(points: list[Point], clearance: NDArray[np.float64], body_m: float) -> list[Point]:
    straight, here = [points[0]], 0
    while here < len(points) - 1:
        following = here + 1
        step = max(1, (len(points) - here) // 2)
        while step:
            ahead = following + step
            if ahead < len(points) and _passable(points[here], points[ahead], clearance, body_m):
                following = ahead
            else:
                step //= 2
        straight.append(points[following])
        here = following
    return straight


def _passable(a: Point, b: Point, clearance: NDArray[np.float64], body_m: float) -> bool:
    steps = max(2, int(math.dist(a, b) / (CELL_M / 2)))
    share = np.linspace(0.0, 1.0, steps)
    columns = ((a[0] + (b[0] - a[0]) * share - MAP_ORIGIN_M[0]) / CELL_M).astype(int)
    rows = ((a[1] + (b[1] - a[1]) * share - MAP_ORIGIN_M[1]) / CELL_M).astype(int)
    return bool((clearance[rows, columns] >= body_m).all())


GoalEnding = Literal["reached", "cancelled", "preempted", "aborted"]

CRUISE_MPS = 0.6
_TURN_RADPS = 1.2
_SLOW_DOWN_MPS2 = 0.6
_LOOK_AHEAD_M = 0.45
_REACHED_M, _REACHED_RAD = 0.08, 0.05
_KEEP_M = RADIUS_M + 0.1
_PERSON_GAP_M = 0.55
_REPLAN_AFTER_S, _GIVE_UP_AFTER_S = 3.0, 25.0


class Progress(Value):
    """Progress of a goal."""

    goal_id: str
    distance_left_m: float
    elapsed_s: float


class GoalEnded(Value):
    """End of a goal."""

    goal_id: str
    ending: GoalEnding
    detail: str


class GoalFollower:
    """Follows one goal at a time, ``goal_id``, at most at ``top_mps``. Pure calculation: pose in, wanted twist out.

    ``plans_made`` counts path plans.
    """

    def __init__(self) -> None:
        self.goal_id: str | None = None
        self._target = Pose2D(0.0, 0.0, 0.0)
        self._way: list[Point] = []
        self._started_s = 0.0
        self._held_since_s: float | None = None
        self._replanned_s = 0.0
        self._left_m = 0.0
        self.top_mps = CRUISE_MPS
        self.plans_made = 0

    def limit(self, top_mps: float) -> None:
        """Set the speed limit; a value above its own speed removes it."""
        self.top_mps = min(max(0.0, top_mps), CRUISE_MPS)

    def start(
        self, goal_id: str, target_in_map: Pose2D, *, pose: Pose2D, people: NDArray[np.float64], now_s: float
    ) -> list[GoalEnded]:
        """Start a goal; preempts the present one. An unreachable goal ends at once."""
        ended = self.end("preempted", "replaced by a newer goal")
        way = self._plan(pose, target_in_map, people)
        if way is None:
            return [*ended, GoalEnded(goal_id, "aborted", "there is no path to the goal")]
        self.goal_id, self._target, self._way = goal_id, target_in_map, way
        self._started_s = self._replanned_s = now_s
        self._held_since_s = None
        self._left_m = length_m(way)
        return ended

    def end(self, ending: GoalEnding, detail: str) -> list[GoalEnded]:
        """End the present goal, if any."""
        if self.goal_id is None:
            return []
        goal_id, self.goal_id, self._way = self.goal_id, None, []
        return [GoalEnded(goal_id, ending, detail)]

    def progress(self, now_s: float) -> Progress | None:
        """Progress of the present goal."""
        if self.goal_id is None:
            return None
        return Progress(self.goal_id, self._left_m, now_s - self._started_s)

    def path_from(self, pose: Pose2D) -> list[Point]:
        """Remaining path from ``pose``; empty without a goal."""
        return [(pose.x_m, pose.y_m), *self._way] if self._way else []

    def step(self, pose: Pose2D, people: NDArray[np.float64], now_s: float) -> tuple[Twist2D, list[GoalEnded]]:
        """Wanted twist, and the goal's end if reached."""
        if self.goal_id is None:
            return ZERO_TWIST, []
        here = (pose.x_m, pose.y_m)
        while len(self._way) > 1 and _passed(here, self._way):
            del self._way[0]
        self._left_m = math.dist(here, self._way[0]) + length_m(self._way)
        if len(self._way) == 1 and math.dist(here, self._way[0]) < _REACHED_M:
            turn_left = wrap_angle(self._target.heading_rad - pose.heading_rad)
            if abs(turn_left) < _REACHED_RAD:
                return ZERO_TWIST, self.end("reached", "the goal was reached")
            return Twist2D(turn_radps=_turn(turn_left)), []
        aim = _ahead(here, self._way)
        off = wrap_angle(math.atan2(aim[1] - pose.y_m, aim[0] - pose.x_m) - pose.heading_rad)
        gap_m = _gap_to_people(here, aim, people)
        if gap_m < _PERSON_GAP_M:
            return self._hold(pose, people, now_s, off)
        self._held_since_s = None
        forward = 0.0
        if abs(off) < 0.7:
            forward = min(self.top_mps, math.sqrt(2.0 * _SLOW_DOWN_MPS2 * self._left_m)) * math.cos(off) ** 3
            forward = min(forward, max(0.12, 0.6 * (gap_m - _PERSON_GAP_M)))
        return Twist2D(forward, 0.0, _turn(off)), []

    def _hold(
        self, pose: Pose2D, people: NDArray[np.float64], now_s: float, off: float
    ) -> tuple[Twist2D, list[GoalEnded]]:
        if self._held_since_s is None:
            self._held_since_s = now_s
        held_s = now_s - self._held_since_s
        if held_s > _GIVE_UP_AFTER_S:
            return ZERO_TWIST, self.end("aborted", "a person stood in the way for too long")
        if held_s > _REPLAN_AFTER_S and now_s - self._replanned_s > _REPLAN_AFTER_S:
            self._replanned_s = now_s
            self._way = self._plan(pose, self._target, people) or self._way
        return Twist2D(turn_radps=_turn(off) if abs(off) > 0.3 else 0.0), []

    def _plan(self, pose: Pose2D, target: Pose2D, people: NDArray[np.float64]) -> list[Point] | None:
        here, goal = (pose.x_m, pose.y_m), (target.x_m, target.y_m)
        self.plans_made += 1
        around = plan(here, goal, body_m=_KEEP_M, avoid=people + np.array([0.0, 0.0, 0.3]))
        return around or plan(here, goal, body_m=_KEEP_M)


def _passed(here: Point, way: list[Point]) -> bool:
    (x0, y0), (x1, y1) = way[0], way[1]
    beyond = (here[0] - x0) * (x1 - x0) + (here[1] - y0) * (y1 - y0) > 0.0
    return math.dist(here, way[0]) < 0.15 or (beyond and math.dist(here, way[0]) < 0.5)


def _ahead(here: Point, way: list[Point]) -> Point:
    """Point of the path at the look-ahead distance."""
    last, left_m = here, _LOOK_AHEAD_M
    for point in way:
        stretch = math.dist(last, point)
        # never cut a corner whose next segment leads elsewhere
        if stretch >= left_m or (stretch > 0.15 and last == here):
            share = min(1.0, left_m / stretch) if stretch else 1.0
            return last[0] + (point[0] - last[0]) * share, last[1] + (point[1] - last[1]) * share
        left_m -= stretch
        last = point
    return last


def _gap_to_people(here: Point, aim: Point, people: NDArray[np.float64]) -> float:
    """Clearance ahead to the nearest person, ``inf`` if there is none in the lane."""
    reach = math.dist(here, aim)
    if reach < 1e-6 or not len(people):
        return math.inf
    ux, uy = (aim[0] - here[0]) / reach, (aim[1] - here[1]) / reach
    gaps = [math.inf]
    for x, y, radius in people.tolist():
        along = (x - here[0]) * ux + (y - here[1]) * uy
        beside = abs((y - here[1]) * ux - (x - here[0]) * uy)
        if along > 0.0 and beside < radius + RADIUS_M + 0.05 and along < 2.5:
            gaps.append(along - radius)
    return min(gaps)


def _turn(angle_rad: float) -> float:
    return min(max(2.2 * angle_rad, -_TURN_RADPS), _TURN_RADPS)
