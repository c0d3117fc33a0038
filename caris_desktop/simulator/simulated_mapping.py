"""Occupancy mapping during exploration."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import LaserScan, OccupancyGrid
from caris_desktop.domain.value_class import Value
from caris_desktop.simulator.floor_plan import MAP_ORIGIN_M, MAP_SIZE_M

RESOLUTION_M = 0.05
WIDTH, HEIGHT = round(MAP_SIZE_M[0] / RESOLUTION_M), round(MAP_SIZE_M[1] / RESOLUTION_M)
_HIT, _MISS, _LIMIT = 6, 2, 40
_OCCUPIED_FROM, _FREE_FROM = 4, -2
_CELLS_WORTH_TELLING = 10
_SHIFT = 4  # fractional bits of cv2's drawing coordinates


class MapChange(Value, eq=False):
    """Rectangle of new cells: int8, shape (height, width), with its origin at column ``left``, row ``bottom``."""

    left: int
    bottom: int
    cells: NDArray[np.int8]


class Mapper:
    """Evidence per cell: hits increase it, passing beams decrease it."""

    def __init__(self) -> None:
        self._evidence = np.zeros((HEIGHT, WIDTH), dtype=np.int16)
        self._known = np.zeros((HEIGHT, WIDTH), dtype=bool)
        self._published: NDArray[np.int8] | None = None

    def add(self, scan: LaserScan, map_from_robot: Pose2D) -> None:
        """Add one scan made at ``map_from_robot``; ignored without a laser pose."""
        if scan.robot_from_laser is None:
            return
        laser = map_from_robot @ scan.robot_from_laser
        ranges = scan.ranges_m.astype(np.float64)
        # readings below the range are from blind beams
        hit = np.isfinite(ranges) & (ranges >= scan.range_min_m)
        angles = laser.heading_rad + scan.angle_min_rad + scan.angle_increment_rad * np.arange(len(ranges))
        # a beam without an echo frees the cells up to the counted range
        reach = np.where(hit, ranges - RESOLUTION_M, np.where(np.isinf(ranges), scan.range_max_m * 0.8, 0.0))
        free = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
        outline = np.stack(
            [
                (laser.x_m + reach * np.cos(angles) - MAP_ORIGIN_M[0]) / RESOLUTION_M - 0.5,
                (laser.y_m + reach * np.sin(angles) - MAP_ORIGIN_M[1]) / RESOLUTION_M - 0.5,
            ],
            axis=1,
        )
        cv2.fillPoly(free, [np.round(outline * (1 << _SHIFT)).astype(np.int32)], 1, shift=_SHIFT)
        struck = np.zeros((HEIGHT, WIDTH), dtype=bool)
        columns = ((laser.x_m + ranges[hit] * np.cos(angles[hit]) - MAP_ORIGIN_M[0]) / RESOLUTION_M).astype(int)
        rows = ((laser.y_m + ranges[hit] * np.sin(angles[hit]) - MAP_ORIGIN_M[1]) / RESOLUTION_M).astype(int)
        inside = (rows >= 0) & (rows < HEIGHT) & (columns >= 0) & (columns < WIDTH)
        struck[rows[inside], columns[inside]] = True
        passed = free.astype(bool) & ~struck
        self._evidence[passed] -= _MISS
        self._evidence[struck] += _HIT
        np.clip(self._evidence, -_LIMIT, _LIMIT, out=self._evidence)
        self._known |= passed | struck

    def cells(self) -> NDArray[np.int8]:
        """int8, shape (HEIGHT, WIDTH): -1 unknown, 0 free, 100 occupied."""
        cells = np.full((HEIGHT, WIDTH), -1, dtype=np.int8)
        cells[self._known & (self._evidence <= _FREE_FROM)] = 0
        cells[self._known & (self._evidence >= _OCCUPIED_FROM)] = 100
        return cells

    def grid(self, *, stamp_ns: int) -> OccupancyGrid:
        """Whole map."""
        origin = Pose2D(MAP_ORIGIN_M[0], MAP_ORIGIN_M[1], 0.0)
        return OccupancyGrid(stamp_ns, stamp_ns, RESOLUTION_M, origin, self.cells())

    def change(self) -> "MapChange | None":
        """Changes since the last returned ones, as one rectangle; None if only a few cells changed."""
        cells = self.cells()
        before = self._published if self._published is not None else np.full_like(cells, -1)
        rows, columns = np.nonzero(cells != before)
        if len(rows) < _CELLS_WORTH_TELLING:
            return None
        self._published = cells
        bottom, top = int(rows.min()), int(rows.max()) + 1
        left, right = int(columns.min()), int(columns.max()) + 1
        return MapChange(left, bottom, cells[bottom:top, left:right].copy())

    def snapshot(self) -> tuple[NDArray[np.int16], NDArray[np.bool_]]:
        """State for later restoration: evidence, and known cells."""
        return self._evidence.copy(), self._known.copy()

    def restore(self, evidence: NDArray[np.int16], known: NDArray[np.bool_]) -> None:
        """Restore a snapshot.

        Raises
        ------
        ValueError
            When it is not one of this building.
        """
        if evidence.shape != (HEIGHT, WIDTH) or known.shape != (HEIGHT, WIDTH):
            raise ValueError(f"the map is not {WIDTH} x {HEIGHT} cells")
        self._evidence = np.clip(evidence, -_LIMIT, _LIMIT).astype(np.int16)
        self._known = known.astype(bool)

    def replace(self, cells: NDArray[np.int8]) -> None:
        """Use a finished map: int8, shape (HEIGHT, WIDTH), -1 unknown, 0 free, 100 occupied.

        Raises
        ------
        ValueError
            When it has another size.
        """
        self.restore(np.where(cells > 50, _LIMIT, -_LIMIT).astype(np.int16), cells >= 0)

    @property
    def known_share(self) -> float:
        """Fraction of known cells, 0..1."""
        return float(np.count_nonzero(self._known)) / math.prod(self._known.shape)
