"""Floor plan: walls with doors, furniture, and named places. Metres in the map frame.

Everything consists of upright, axis-parallel boxes, so that LIDAR, camera and collisions share one fast ray
intersection.
"""

import math

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.value_class import dataclass

Colour = tuple[int, int, int]  # blue, green, red
Area = tuple[float, float, float, float]  # x0, y0, x1, y1

WALL_HEIGHT_M = 2.6
DOOR_HEIGHT_M = 2.1
WALL_THICKNESS_M = 0.12
WIDTH_M, DEPTH_M = 16.0, 10.0
MAP_ORIGIN_M = (-1.0, -2.5)
MAP_SIZE_M = (18.0, 13.5)


@dataclass(frozen=True, slots=True)
class Box:
    """Upright box; ``low_m`` and ``high_m`` are heights above the floor."""

    x0_m: float
    y0_m: float
    x1_m: float
    y1_m: float
    low_m: float
    high_m: float
    colour: Colour = (200, 200, 200)


@dataclass(frozen=True, slots=True)
class Furniture:
    """Piece of furniture: footprint for collisions and LIDAR, and the parts that the camera sees."""

    name: str
    footprint: Box
    parts: tuple[Box, ...]


@dataclass(frozen=True, slots=True)
class Door:
    """Opening in a wall, from ``start_m`` to ``end_m`` along it, with a sign above it."""

    start_m: float
    end_m: float
    sign: str = ""


@dataclass(frozen=True, slots=True)
class WallRun:
    """Straight wall. ``along`` is the axis it is parallel to, ``at_m`` its middle on the other axis."""

    along: str
    at_m: float
    start_m: float
    end_m: float
    doors: tuple[Door, ...] = ()


@dataclass(frozen=True, slots=True)
class Place:
    """Named place; at ``pose`` the robot faces the eponymous object."""

    name: str
    pose: Pose2D


@dataclass(frozen=True, slots=True)
class Poster:
    """Picture on a wall: centre, orientation (degrees), and size."""

    x_m: float
    y_m: float
    facing_deg: int
    width_m: float
    height_m: float
    middle_height_m: float
    kind: str
    text: str = ""


_RUNS = (
    WallRun("x", 0.0, 0.0, 16.0, (Door(2.0, 3.1, "Exit"),)),
    WallRun("x", 10.0, 0.0, 16.0),
    WallRun("y", 0.0, 0.0, 10.0),
    WallRun("y", 16.0, 0.0, 10.0),
    WallRun(
        "x", 4.2, 0.0, 16.0, (Door(1.6, 4.0, "Reception"), Door(8.4, 9.5, "Robot Lab"), Door(13.0, 14.1, "Kitchen"))
    ),
    WallRun(
        "x",
        5.8,
        0.0,
        16.0,
        (Door(2.05, 2.95, "Counselling"), Door(6.6, 7.7, "Meeting Room"), Door(12.0, 13.1, "Exhibition")),
    ),
    WallRun("y", 6.0, 0.0, 4.2, (Door(2.6, 3.7, "Robot Lab"),)),
    WallRun("y", 12.0, 0.0, 4.2, (Door(1.4, 2.5, "Kitchen"),)),
    WallRun("y", 4.6, 5.8, 10.0),
    WallRun("y", 10.0, 5.8, 10.0),
    # the porch, where people are out of sight
    WallRun("y", 1.4, -1.6, 0.0),
    WallRun("y", 3.7, -1.6, 0.0),
    WallRun("x", -1.6, 1.4, 3.7),
)

_WALL: Colour = (214, 222, 226)
_OAK: Colour = (96, 140, 186)
_PALE_OAK: Colour = (140, 180, 214)
_WHITE: Colour = (232, 234, 236)
_STEEL: Colour = (150, 150, 146)
_DARK: Colour = (58, 54, 52)
_SCREEN: Colour = (92, 62, 40)
_BLUE: Colour = (150, 104, 62)
_TEAL: Colour = (128, 128, 60)
_ORANGE: Colour = (40, 120, 236)
_GREEN: Colour = (72, 130, 76)
_RED: Colour = (70, 70, 176)
_CLAY: Colour = (88, 118, 176)


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
        return Box(start_m, run.at_m - half, end_m, run.at_m + half, low_m, high_m, _WALL)
    return Box(run.at_m - half, start_m, run.at_m + half, end_m, low_m, high_m, _WALL)


@dataclass(frozen=True, slots=True)
class Lintel:
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


def _whole(name: str, box: Box, *more: Box) -> Furniture:
    return Furniture(name, box, (box, *more))


def _table(name: str, area: Area, high: float, colour: Colour, *on_top: Box) -> Furniture:
    x0, y0, x1, y1 = area
    leg, slab = 0.06, 0.05
    legs = tuple(
        Box(x, y, x + leg, y + leg, 0.0, high - slab, _DARK)
        for x in (x0 + 0.04, x1 - leg - 0.04)
        for y in (y0 + 0.04, y1 - leg - 0.04)
    )
    return Furniture(
        name, Box(x0, y0, x1, y1, 0.0, high), (*legs, Box(x0, y0, x1, y1, high - slab, high, colour), *on_top)
    )


def _chair(x: float, y: float, back: str, colour: Colour) -> Furniture:
    """Chair of 0.42 m with its lower left corner at (x, y); ``back`` is the side of its back: n, s, e or w."""
    size, seat, thin = 0.42, 0.46, 0.06
    backs = {
        "n": (x, y + size - thin, x + size, y + size),
        "s": (x, y, x + size, y + thin),
        "e": (x + size - thin, y, x + size, y + size),
        "w": (x, y, x + thin, y + size),
    }
    legs = tuple(
        Box(x + dx, y + dy, x + dx + 0.04, y + dy + 0.04, 0.0, seat - 0.06, _DARK)
        for dx in (0.02, size - 0.06)
        for dy in (0.02, size - 0.06)
    )
    return Furniture(
        "chair",
        Box(x, y, x + size, y + size, 0.0, 0.9),
        (*legs, Box(x, y, x + size, y + size, seat - 0.06, seat, colour), Box(*backs[back], seat, 0.9, colour)),
    )


def _armchair(
    x0: float, y0: float, back: str, colour: Colour, *, width: float = 0.75, depth: float = 0.75
) -> Furniture:
    """Armchair or sofa: seat, back and two arms."""
    x1, y1, arm = x0 + width, y0 + depth, 0.14
    seat = Box(x0, y0, x1, y1, 0.08, 0.44, colour)
    if back in "ns":
        edge = (x0, y1 - 0.18, x1, y1) if back == "n" else (x0, y0, x1, y0 + 0.18)
        arms = ((x0, y0, x0 + arm, y1), (x1 - arm, y0, x1, y1))
    else:
        edge = (x1 - 0.18, y0, x1, y1) if back == "e" else (x0, y0, x0 + 0.18, y1)
        arms = ((x0, y0, x1, y0 + arm), (x0, y1 - arm, x1, y1))
    parts = (seat, Box(*edge, 0.44, 0.84, colour), *(Box(*side, 0.44, 0.6, colour) for side in arms))
    return Furniture("armchair", Box(x0, y0, x1, y1, 0.0, 0.84), parts)


def _shelf(name: str, area: Area, high: float) -> Furniture:
    """Bookshelf; the camera draws its books."""
    return _whole(name, Box(*area, 0.0, high, _OAK))


def _plant(x: float, y: float) -> Furniture:
    pot = Box(x - 0.16, y - 0.16, x + 0.16, y + 0.16, 0.0, 0.36, _CLAY)
    leaves = (
        Box(x - 0.05, y - 0.05, x + 0.05, y + 0.05, 0.36, 0.62, (52, 92, 60)),
        Box(x - 0.24, y - 0.24, x + 0.24, y + 0.24, 0.58, 0.92, _GREEN),
        Box(x - 0.16, y - 0.16, x + 0.16, y + 0.16, 0.92, 1.2, (84, 150, 90)),
    )
    return Furniture("plant", Box(x - 0.2, y - 0.2, x + 0.2, y + 0.2, 0.0, 1.2), (pot, *leaves))


FURNITURE: tuple[Furniture, ...] = (
    # reception
    _whole(
        "reception desk",
        Box(4.6, 0.75, 5.15, 2.35, 0.0, 1.02, _PALE_OAK),
        Box(4.55, 0.7, 5.2, 2.4, 1.02, 1.07, _WHITE),
        Box(4.86, 1.25, 4.92, 1.75, 1.14, 1.46, _DARK),
    ),
    _chair(5.4, 1.3, "e", _BLUE),
    _armchair(0.1, 2.35, "w", _TEAL, width=0.75, depth=1.5),
    _plant(5.6, 0.4),
    _plant(0.4, 0.42),
    _whole("dock", Box(0.06, 4.82, 0.2, 5.18, 0.0, 0.3, _DARK)),
    # robot lab
    _table(
        "lab bench",
        (6.8, 0.1, 9.3, 0.85),
        0.9,
        _WHITE,
        Box(7.0, 0.3, 7.5, 0.36, 0.96, 1.3, _SCREEN),
        Box(7.9, 0.2, 8.3, 0.6, 0.9, 1.12, _STEEL),
        Box(8.6, 0.25, 9.1, 0.31, 0.96, 1.3, _SCREEN),
    ),
    _whole(
        "robot arm",
        Box(10.55, 0.45, 11.25, 1.15, 0.0, 0.72, _STEEL),
        Box(10.78, 0.68, 11.02, 0.92, 0.72, 0.9, _DARK),
        Box(10.83, 0.73, 10.97, 0.87, 0.9, 1.4, _ORANGE),
        Box(10.4, 0.74, 10.99, 0.86, 1.4, 1.52, _ORANGE),
        Box(10.4, 0.76, 10.5, 0.84, 1.15, 1.4, _DARK),
    ),
    _shelf("tool shelf", (10.1, 3.78, 11.7, 4.14), 1.8),
    _chair(7.0, 3.6, "n", _RED),
    # kitchen
    _whole(
        "kitchen counter",
        Box(15.34, 0.3, 15.94, 3.0, 0.0, 0.88, _WHITE),
        Box(15.3, 0.28, 15.94, 3.02, 0.88, 0.92, _OAK),
        Box(15.5, 0.6, 15.8, 0.85, 0.92, 1.22, _DARK),
        Box(15.55, 2.2, 15.75, 2.4, 0.92, 1.16, _RED),
    ),
    _whole("fridge", Box(15.28, 3.1, 15.94, 3.8, 0.0, 1.8, _WHITE)),
    _table("kitchen table", (13.1, 1.5, 14.1, 2.3), 0.75, _PALE_OAK),
    _chair(13.4, 2.42, "n", _TEAL),
    _chair(13.4, 0.96, "s", _TEAL),
    # counselling room
    _armchair(0.5, 7.3, "w", _BLUE),
    _armchair(2.7, 8.8, "n", _CLAY),
    _table("coffee table", (1.3, 8.4, 1.95, 9.0), 0.45, _OAK),
    _shelf("bookshelf", (0.06, 8.6, 0.4, 9.8), 1.9),
    _plant(4.2, 9.6),
    # meeting room
    _table(
        "meeting table",
        (6.1, 7.75, 8.7, 8.85),
        0.75,
        _PALE_OAK,
        Box(6.5, 8.1, 6.8, 8.35, 0.75, 0.77, _DARK),
        Box(7.9, 8.3, 8.2, 8.52, 0.75, 0.77, _WHITE),
    ),
    _chair(6.3, 7.28, "s", _DARK),
    _chair(7.7, 7.28, "s", _DARK),
    _chair(6.3, 8.92, "n", _DARK),
    _chair(7.7, 8.92, "n", _DARK),
    # exhibition
    _whole(
        "display case", Box(11.0, 8.2, 11.7, 8.9, 0.0, 0.95, _WHITE), Box(11.15, 8.35, 11.55, 8.75, 0.95, 1.3, _RED)
    ),
    _whole("display case", Box(14.2, 7.5, 14.9, 8.2, 0.0, 0.95, _WHITE), Box(14.4, 7.7, 14.7, 8.0, 0.95, 1.35, _TEAL)),
    _shelf("book wall", (10.06, 6.6, 10.4, 8.4), 1.9),
    _armchair(12.2, 9.15, "n", _TEAL, width=1.9),
    _plant(15.5, 9.5),
    _plant(15.6, 6.3),
)

_N, _E, _S, _W = 90, 0, 270, 180
POSTERS: tuple[Poster, ...] = (
    Poster(0.06, 1.3, _E, 0.9, 1.2, 1.5, "poster", "Welcome"),
    Poster(5.94, 1.55, _W, 1.5, 0.6, 1.75, "sign", "Reception"),
    Poster(3.9, 0.06, _N, 1.1, 1.1, 1.5, "window"),
    Poster(5.1, 4.14, _S, 0.7, 0.9, 1.5, "poster", "Robots"),
    Poster(8.0, 0.06, _N, 2.0, 0.8, 1.75, "window"),
    Poster(10.9, 0.06, _N, 1.2, 0.9, 1.7, "poster", "Robot arm"),
    Poster(6.06, 1.2, _E, 0.8, 1.0, 1.5, "poster", "Safety"),
    Poster(11.94, 3.3, _W, 0.7, 0.9, 1.5, "poster", "Lab rules"),
    Poster(13.4, 0.06, _N, 1.4, 1.0, 1.6, "window"),
    Poster(12.06, 3.4, _E, 0.7, 0.9, 1.5, "poster", "Coffee"),
    Poster(2.3, 9.94, _S, 1.6, 1.1, 1.6, "window"),
    Poster(0.06, 6.6, _E, 0.8, 1.0, 1.5, "poster", "Breathe"),
    Poster(7.4, 9.94, _S, 2.2, 1.1, 1.55, "screen", "Agenda"),
    Poster(9.94, 7.2, _W, 0.8, 1.0, 1.5, "poster", "Ideas"),
    Poster(13.1, 9.94, _S, 1.8, 0.9, 1.7, "window"),
    Poster(15.94, 7.8, _W, 1.4, 1.0, 1.55, "poster", "Exhibition"),
    Poster(15.94, 5.0, _W, 0.8, 1.2, 1.45, "window"),
    Poster(5.6, 4.26, _N, 0.7, 0.9, 1.5, "poster", "Welcome"),
    Poster(11.2, 4.26, _N, 0.9, 0.7, 1.5, "poster", "Research"),
    Poster(5.0, 5.74, _S, 0.9, 0.7, 1.5, "poster", "People"),
    Poster(9.4, 5.74, _S, 0.7, 0.9, 1.5, "poster", "Study"),
)


def _place(name: str, x_m: float, y_m: float, heading_deg: float) -> Place:
    return Place(name, Pose2D(x_m, y_m, math.radians(heading_deg)))


PLACES: tuple[Place, ...] = (
    _place("reception", 1.0, 1.3, 20),
    _place("entrance", 2.55, 0.85, 90),
    _place("lab bench", 8.0, 1.6, -90),
    _place("robot arm", 10.9, 1.9, -90),
    _place("kitchen", 14.75, 2.0, 0),
    _place("counselling room", 2.4, 7.2, 115),
    _place("meeting room", 7.15, 6.65, 90),
    _place("exhibition", 12.9, 7.6, 60),
    _place("corridor", 9.0, 5.0, 0),
    _place("charging station", 0.8, 5.0, 0),
)
START = PLACES[0].pose

SOLID: tuple[Box, ...] = WALLS + tuple(piece.footprint for piece in FURNITURE)
"""What stops a body and returns a laser beam."""
