"""Path planning: a cost-to-go field on a grid, followed downhill and straightened."""

import math
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from caris_desktop.simulator.floor_plan import MAP_ORIGIN_M, MAP_SIZE_M, SOLID
from caris_desktop.simulator.lidar import corners_of
from caris_desktop.simulator.simulated_base import clearance_m

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
    if avoid is not None and len(avoid):
        clearance = np.minimum(clearance, _clearance_of_circles(avoid))
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
    points = [_middle(cell) for cell in cells]
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


def _clearance_of_circles(circles: NDArray[np.float64]) -> NDArray[np.float64]:
    xs, ys = _axes()
    clearance = np.full((ROWS, COLUMNS), np.inf)
    for x, y, radius in circles.tolist():
        clearance = np.minimum(clearance, np.hypot(xs[None, :] - x, ys[:, None] - y) - radius)
    return clearance


def _cell(point: Point) -> tuple[int, int]:
    column = int((point[0] - MAP_ORIGIN_M[0]) / CELL_M)
    row = int((point[1] - MAP_ORIGIN_M[1]) / CELL_M)
    return min(max(row, 0), ROWS - 1), min(max(column, 0), COLUMNS - 1)


def _middle(cell: tuple[int, int]) -> Point:
    return MAP_ORIGIN_M[0] + (cell[1] + 0.5) * CELL_M, MAP_ORIGIN_M[1] + (cell[0] + 0.5) * CELL_M


def _nearest_free(point: Point, free: NDArray[np.bool_], within_m: float) -> tuple[int, int] | None:
    x, y = point
    if not (
        MAP_ORIGIN_M[0] <= x <= MAP_ORIGIN_M[0] + MAP_SIZE_M[0]
        and MAP_ORIGIN_M[1] <= y <= MAP_ORIGIN_M[1] + MAP_SIZE_M[1]
    ):
        return None
    cell = _cell(point)
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
    row, column = start
    while (row, column) != goal and len(cells) < ROWS * COLUMNS:
        r0, c0 = max(row - 1, 0), max(column - 1, 0)
        around = field[r0 : row + 2, c0 : column + 2]
        best = np.unravel_index(int(around.argmin()), around.shape)
        following = (r0 + int(best[0]), c0 + int(best[1]))
        if field[following] >= field[row, column]:
            break
        row, column = following
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
