"""Map state: what the map shows besides its grid."""

import math
from collections import deque
from dataclasses import field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QPointF

from caris_desktop.domain.events import GoalChanged
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import LaserScan, PersonPlace
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.scenario.scenario_model import Place

TRAIL_STEP_M = 0.05
TRAIL_POINTS = 4000
"""Maximum points of the trail: two hundred metres."""

TRAIL_SHADES = 8
_TRAIL_JUMP_M = 1.0

Tool = Literal["look", "goal", "pose", "place", "measure"]
Layer = Literal["lidar", "people", "places", "trail"]


class Aim(Value):
    """Point being chosen on the map, with its heading as far as set; for a measurement with its other end."""

    at: QPointF  # metres in the map
    heading_rad: float | None
    anchored: bool  # position fixed, the rest still open
    end: QPointF | None = None


class Trail:
    """Driven path: a point every five centimetres, the newest ``TRAIL_POINTS``."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, float]] = deque(maxlen=TRAIL_POINTS)
        self.version = 0

    def __len__(self) -> int:
        return len(self._points)

    def add(self, pose: Pose2D) -> None:
        if self._points:
            moved_m = math.dist(self._points[-1], (pose.x_m, pose.y_m))
            if moved_m < TRAIL_STEP_M:
                return
            if moved_m > _TRAIL_JUMP_M and not math.isnan(self._points[-1][0]):
                # A jump of the localization, which the robot did not drive.
                self._points.append((math.nan, math.nan))
        self._points.append((pose.x_m, pose.y_m))
        self.version += 1

    def clear(self) -> None:
        self._points.clear()
        self.version += 1

    def pieces(self) -> list[tuple[float, NDArray[np.float64]]]:
        """Pieces as (strength 0..1, points of shape (n, 2) in metres), oldest first; NaN where the line is broken."""
        points = np.array(self._points, np.float64).reshape(-1, 2)
        per_shade = max(2, math.ceil(len(points) / TRAIL_SHADES))
        firsts = enumerate(range(0, len(points), per_shade), start=1)
        return [(shade / TRAIL_SHADES, points[first : first + per_shade + 1]) for shade, first in firsts]


@dataclass(slots=True)
class MapState:
    """Map state without the grid.

    ``people``: position, label, and whether it is a given name; ``selected``: id of a person. ``chips``: lines of
    (text, role) at the upper edge; roles: warning, good, bad, hint. ``mark``: point that a popup asks about.
    ``unconfirmed``: the pose was not confirmed after a crash.
    """

    places: tuple[Place, ...] = ()
    pose: Pose2D | None = None
    pose_freshness: str = "none"
    unconfirmed: bool = False
    scan_points_m: NDArray[np.float64] | None = None
    scan_freshness: str = "none"
    path_m: NDArray[np.float32] | None = None
    people: tuple[tuple[PersonPlace, str, bool], ...] = ()
    people_freshness: str = "none"
    selected: str = ""
    outline_m: tuple[tuple[float, float], ...] = ()
    guard: tuple[str, float | None] = ("absent", None)
    goal: GoalChanged | None = None
    chips: list[tuple[str, str]] = field(default_factory=list)
    hint: str = ""
    mark: QPointF | None = None
    waiting: str = field(default_factory=lambda: tr("Waiting for the map"))
    trail: Trail = field(default_factory=Trail)
    hidden: set[Layer] = field(default_factory=set)
    rotate: bool = False
    tool: Tool = "look"
    aim: Aim | None = None
    pointer: QPointF | None = None
    hovered: str | None = None


def scan_points_in_map(scan: LaserScan, map_from_robot: Pose2D) -> NDArray[np.float64]:
    """End points of the beams, float64 of shape (returns, 2), metres in the map; empty if the pose of the laser is
    unknown.
    """
    if scan.robot_from_laser is None:
        return np.zeros((0, 2))
    return scan.points(map_from_robot @ scan.robot_from_laser)


def legend(state: MapState, *, has_grid: bool) -> list[tuple[str, str, str]]:
    """Colour role, symbol and word of each kind of thing that is shown without a label of its own."""
    robot = state.pose is not None and state.pose_freshness != "none"
    lidar = "lidar" not in state.hidden and state.scan_freshness in ("fresh", "stale")
    shown = (
        (robot, "blue", "●", tr("robot")),
        (lidar and state.scan_points_m is not None and len(state.scan_points_m) > 0, "lidar", "•••", tr("LIDAR")),
        (has_grid, "map_wall", "▬", tr("wall")),
        (has_grid, "map_unknown", "□", tr("unknown")),
        (state.goal is not None and not state.goal.place, "green", "○", tr("goal")),
    )
    return [(role, symbol, word) for is_shown, role, symbol, word in shown if is_shown]


def length_in_words(start: QPointF, end: QPointF) -> str:
    return tr("{distance:.2f} m").format(distance=math.dist(start.toTuple(), end.toTuple()))
