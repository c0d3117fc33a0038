"""Floor plan: walls with doors, furniture, and named places. Metres in the map frame.

Everything consists of upright, axis-parallel boxes, so that LIDAR, camera and collisions share one fast ray
intersection. The plan itself is ``resources/simulator/floor-plan.yaml``.
"""

import math
from collections.abc import Callable
from typing import Any

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.value_class import Value
from caris_desktop.simulator.shipped_data import built, shipped_data

Colour = tuple[int, int, int]  # blue, green, red
Area = tuple[float, float, float, float]  # x0, y0, x1, y1

WALL_HEIGHT_M = 2.6
DOOR_HEIGHT_M = 2.1
WALL_THICKNESS_M = 0.12
WIDTH_M, DEPTH_M = 16.0, 10.0
MAP_ORIGIN_M = (-1.0, -2.5)
MAP_SIZE_M = (18.0, 13.5)


class Box(Value):
    """Upright box; ``low_m`` and ``high_m`` are heights above the floor."""

    x0_m: float
    y0_m: float
    x1_m: float
    y1_m: float
    low_m: float
    high_m: float
    colour: Colour = (200, 200, 200)


class Furniture(Value):
    """Piece of furniture: footprint for collisions and LIDAR, and the parts that the camera sees."""

    name: str
    footprint: Box
    parts: tuple[Box, ...]


class Door(Value):
    """Opening in a wall, from ``start_m`` to ``end_m`` along it, with a sign above it."""

    start_m: float
    end_m: float
    sign: str = ""


class WallRun(Value):
    """Straight wall. ``along`` is the axis it is parallel to, ``at_m`` its middle on the other axis."""

    along: str
    at_m: float
    start_m: float
    end_m: float
    doors: tuple[Door, ...] = ()


class Place(Value):
    """Named place; at ``pose`` the robot faces the eponymous object."""

    name: str
    pose: Pose2D


class Poster(Value):
    """Picture on a wall: centre, orientation (degrees), size, and name of its file."""

    x_m: float
    y_m: float
    facing_deg: int
    width_m: float
    height_m: float
    middle_height_m: float
    picture: str


_PLAN = shipped_data("floor-plan.yaml")
_COLOURS: dict[str, Colour] = {name: tuple(colour) for name, colour in _PLAN["colours"].items()}
_RUNS: tuple[WallRun, ...] = built(tuple[WallRun, ...], _PLAN["walls"])


def _box(*row: Any) -> Box:
    """Box with a named colour."""
    x0, y0, x1, y1, low, high, colour = row
    return Box(x0, y0, x1, y1, low, high, _COLOURS[colour])


def _wall_rects(run: WallRun) -> list[Box]:
    half = WALL_THICKNESS_M / 2.0
    edges = [run.start_m - half]
    for door in run.doors:
        edges += [door.start_m, door.end_m]
    edges.append(run.end_m + half)
    return [_run_box(run, start, end, 0.0, WALL_HEIGHT_M) for start, end in zip(edges[::2], edges[1::2], strict=True)]


def _run_box(run: WallRun, start_m: float, end_m: float, low_m: float, high_m: float) -> Box:
    half = WALL_THICKNESS_M / 2.0
    if run.along == "x":
        return _box(start_m, run.at_m - half, end_m, run.at_m + half, low_m, high_m, "wall")
    return _box(run.at_m - half, start_m, run.at_m + half, end_m, low_m, high_m, "wall")


class Lintel(Value):
    """Wall above a door, with a sign on both sides."""

    box: Box
    along: str
    sign: str


WALLS: tuple[Box, ...] = tuple(box for run in _RUNS for box in _wall_rects(run))
LINTELS: tuple[Lintel, ...] = tuple(
    Lintel(_run_box(run, door.start_m, door.end_m, DOOR_HEIGHT_M, WALL_HEIGHT_M), run.along, door.sign)
    for run in _RUNS
    for door in run.doors
)


def _whole(name: str, *boxes: list[Any]) -> Furniture:
    parts = tuple(_box(*box) for box in boxes)
    return Furniture(name, parts[0], parts)


def _legs(area: Area, thick: float, inset: float, high: float) -> tuple[Box, ...]:
    x0, y0, x1, y1 = area
    return tuple(
        _box(x, y, x + thick, y + thick, 0.0, high, "dark")
        for x in (x0 + inset, x1 - thick - inset)
        for y in (y0 + inset, y1 - thick - inset)
    )


def _table(name: str, area: Area, high: float, colour: str, *on_top: list[Any]) -> Furniture:
    x0, y0, x1, y1 = area
    slab = 0.05
    legs = _legs(area, 0.06, 0.04, high - slab)
    return Furniture(
        name,
        Box(x0, y0, x1, y1, 0.0, high),
        (*legs, _box(x0, y0, x1, y1, high - slab, high, colour), *(_box(*box) for box in on_top)),
    )


def _chair(x: float, y: float, back: str, colour: str) -> Furniture:
    """Chair of 0.42 m with its lower left corner at (x, y); ``back`` is the side of its back: n, s, e or w."""
    size, seat, thin = 0.42, 0.46, 0.06
    backs = {
        "n": (x, y + size - thin, x + size, y + size),
        "s": (x, y, x + size, y + thin),
        "e": (x + size - thin, y, x + size, y + size),
        "w": (x, y, x + thin, y + size),
    }
    legs = _legs((x, y, x + size, y + size), 0.04, 0.02, seat - 0.06)
    return Furniture(
        "chair",
        Box(x, y, x + size, y + size, 0.0, 0.9),
        (*legs, _box(x, y, x + size, y + size, seat - 0.06, seat, colour), _box(*backs[back], seat, 0.9, colour)),
    )


def _armchair(x0: float, y0: float, back: str, colour: str, size: tuple[float, float] = (0.75, 0.75)) -> Furniture:
    """Armchair or sofa: seat, back and two arms."""
    x1, y1, arm = x0 + size[0], y0 + size[1], 0.14
    seat = _box(x0, y0, x1, y1, 0.08, 0.44, colour)
    if back in "ns":
        edge = (x0, y1 - 0.18, x1, y1) if back == "n" else (x0, y0, x1, y0 + 0.18)
        arms = ((x0, y0, x0 + arm, y1), (x1 - arm, y0, x1, y1))
    else:
        edge = (x1 - 0.18, y0, x1, y1) if back == "e" else (x0, y0, x0 + 0.18, y1)
        arms = ((x0, y0, x1, y0 + arm), (x0, y1 - arm, x1, y1))
    parts = (seat, _box(*edge, 0.44, 0.84, colour), *(_box(*side, 0.44, 0.6, colour) for side in arms))
    return Furniture("armchair", Box(x0, y0, x1, y1, 0.0, 0.84), parts)


def _plant(x: float, y: float) -> Furniture:
    pot = _box(x - 0.16, y - 0.16, x + 0.16, y + 0.16, 0.0, 0.36, "clay")
    leaves = (
        Box(x - 0.05, y - 0.05, x + 0.05, y + 0.05, 0.36, 0.62, (52, 92, 60)),
        _box(x - 0.24, y - 0.24, x + 0.24, y + 0.24, 0.58, 0.92, "green"),
        Box(x - 0.16, y - 0.16, x + 0.16, y + 0.16, 0.92, 1.2, (84, 150, 90)),
    )
    return Furniture("plant", Box(x - 0.2, y - 0.2, x + 0.2, y + 0.2, 0.0, 1.2), (pot, *leaves))


_KINDS: dict[str, Callable[..., Furniture]] = {
    "whole": _whole, "table": _table, "chair": _chair, "armchair": _armchair, "plant": _plant
}  # fmt: skip
FURNITURE: tuple[Furniture, ...] = tuple(_KINDS[kind](*parameters) for kind, *parameters in _PLAN["furniture"])
POSTERS: tuple[Poster, ...] = built(tuple[Poster, ...], _PLAN["posters"])
PLACES: tuple[Place, ...] = tuple(
    Place(name, Pose2D(x_m, y_m, math.radians(heading_deg))) for name, x_m, y_m, heading_deg in _PLAN["places"]
)
START = PLACES[0].pose

SOLID: tuple[Box, ...] = WALLS + tuple(piece.footprint for piece in FURNITURE)
"""What stops a body and returns a laser beam."""
