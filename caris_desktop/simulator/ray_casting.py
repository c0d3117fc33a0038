"""Intersection of many horizontal rays with many boxes and circles at once."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from caris_desktop.simulator.floor_plan import Box

Array = NDArray[np.floating]
_TINY = 1e-12


def corners_of(boxes: Iterable[Box]) -> Array:
    """float64, shape (boxes, 4): x0, y0, x1, y1."""
    return np.array([(box.x0_m, box.y0_m, box.x1_m, box.y1_m) for box in boxes], dtype=np.float64).reshape(-1, 4)


def entry_and_exit(
    x_m: float, y_m: float, cos: Array, sin: Array, corners: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Entry and exit distances of rays from (x, y) for each box.

    Parameters
    ----------
    cos, sin
        Direction of each ray, shape (rays,); their length is the unit of the distances.
    corners
        Shape (boxes, 4), from :func:`corners_of`.

    Returns
    -------
    entry, exit
        Distances, shape (boxes, rays); ``entry`` is ``inf`` where the ray misses.
    through_x
        Whether the ray enters through a side perpendicular to the x axis.
    """
    inverse_x = 1.0 / np.where(np.abs(cos) < _TINY, _TINY, cos)
    inverse_y = 1.0 / np.where(np.abs(sin) < _TINY, _TINY, sin)
    to_x0 = (corners[:, 0:1] - x_m) * inverse_x
    to_x1 = (corners[:, 2:3] - x_m) * inverse_x
    to_y0 = (corners[:, 1:2] - y_m) * inverse_y
    to_y1 = (corners[:, 3:4] - y_m) * inverse_y
    near_x, near_y = np.minimum(to_x0, to_x1), np.minimum(to_y0, to_y1)
    entry = np.maximum(near_x, near_y)
    leave = np.minimum(np.maximum(to_x0, to_x1), np.maximum(to_y0, to_y1))
    missed = (entry > leave) | (leave <= 0.0)
    through_x = near_x >= near_y
    return np.where(missed, np.inf, np.maximum(entry, 0.0)), leave, through_x


def circle_hits(x_m: float, y_m: float, cos: Array, sin: Array, circles: Array) -> Array:
    """Distance to each circle (x, y, radius; shape (circles, 3)) along each unit ray, ``inf`` if missed."""
    to_x, to_y = circles[:, 0:1] - x_m, circles[:, 1:2] - y_m
    along = to_x * cos + to_y * sin
    beside = to_y * cos - to_x * sin
    inside = circles[:, 2:3] ** 2 - beside**2
    distance = along - np.sqrt(np.maximum(inside, 0.0))
    return np.where((inside < 0.0) | (distance <= 0.0), np.inf, distance)
