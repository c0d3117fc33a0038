"""Geometry of the report's drawings in pixels: timeline, trajectory on the map and histogram; a template draws them."""

import base64
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.sensing import OccupancyGrid
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session.session_header import clock_text

Shape = Literal["bar", "diamond", "triangle", "dot", "square"]
Point = tuple[float, float]
Drawing = dict[str, Any]
"""What a macro of ``drawings.j2`` draws."""

_LABEL_PX, _PLOT_PX = 132.0, 948.0
_SPEED_ROW_PX = 34.0
_ONE_STRIP_S = 12 * 60.0
_MAP_PX = 1080.0
_MAP_MAX_HEIGHT_PX = 620.0
_WAY_CHUNKS = 48
_SCALE_PX = 18.0
# Red, green, blue, alpha: grey on a light page and on a dark one.
_UNKNOWN = (0x7A, 0x8A, 0x9B, 0x38)


class Item(Value):
    """Interval from ``start_s`` to ``end_s`` of the session, or a point event. ``look`` is its CSS class."""

    start_s: float
    end_s: float | None
    look: str
    title: str
    shape: Shape = "bar"


class Curve(Value, eq=False):
    """Values over time, filled from zero to ``top``."""

    label: str
    seconds: NDArray[np.float64]
    values: NDArray[np.float64]
    top: float


class Pin(Value):
    """Marker on the map."""

    x_m: float
    y_m: float
    look: str
    title: str
    label: str = ""
    shape: Shape = "dot"


class Trajectory(Value, eq=False):
    """Trajectory of the robot: ``points_m`` float64, shape (n, 2), at ``seconds``; ``by_itself`` while navigating
    autonomously.
    """

    seconds: NDArray[np.float64]
    points_m: NDArray[np.float64]
    headings_rad: NDArray[np.float64]
    by_itself: NDArray[np.bool_]


def _step(span: float, most: int, steps: Sequence[float]) -> float:
    return next((step for step in steps if span / step <= most), steps[-1])


# Timeline


def time_line(
    rows: Sequence[tuple[str, Sequence[Item]]], curve: Curve | None, shades: Sequence[Item], lasts_s: float
) -> list[Drawing]:
    """Timeline of the session as strips of about ten minutes; ``shades`` lie behind all rows."""
    if lasts_s <= 0.0:
        return []
    strip_s = lasts_s
    if lasts_s > _ONE_STRIP_S:
        strip_s = max(600.0, math.ceil(lasts_s / 12 / 600.0) * 600.0)
    begins_s = (number * strip_s for number in range(max(1, math.ceil(lasts_s / strip_s - 1e-6))))
    return [_strip(rows, curve, shades, begin_s, begin_s + strip_s, lasts_s) for begin_s in begins_s]


def _strip(  # noqa: PLR0917 - the parts of a strip and its times
    rows: Sequence[tuple[str, Sequence[Item]]],
    curve: Curve | None,
    shades: Sequence[Item],
    begins_s: float,
    ends_s: float,
    lasts_s: float,
) -> Drawing:
    def x(seconds: float) -> float:
        return _LABEL_PX + (min(max(seconds, begins_s), ends_s) - begins_s) / (ends_s - begins_s) * _PLOT_PX

    def placed(items: Sequence[Item]) -> list[Drawing]:
        return [
            {
                "x": x(item.start_s),
                "width": None if item.end_s is None else x(item.end_s) - x(item.start_s),
                "look": item.look,
                "title": item.title,
                "shape": item.shape,
            }
            for item in items
            if (item.start_s if item.end_s is None else item.end_s) >= begins_s and item.start_s < ends_s
        ]

    until_s = min(ends_s, lasts_s)
    step_s = _step(ends_s - begins_s, 12, (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 14400))
    first = math.ceil(begins_s / step_s)
    ticks_s = [step_s * number for number in range(first, math.floor((until_s + 1e-6) / step_s) + 1)]
    return {
        "begins_s": begins_s,
        "ends_s": until_s,
        "right": x(until_s),
        "ticks": [(x(tick_s), clock_text(tick_s)) for tick_s in ticks_s],
        "shades": placed(shades),
        "curve": None if curve is None else (curve.label, x(ends_s), _outline(curve, begins_s, ends_s, x)),
        "rows": [(label, its) for label, items in rows if (its := placed(items))],
    }


def _outline(curve: Curve, begins_s: float, ends_s: float, x: Callable[[float], float]) -> str:
    base = 4.0 + _SPEED_ROW_PX
    begin, end = np.searchsorted(curve.seconds, [begins_s, ends_s])
    seconds, values = curve.seconds[begin:end], np.nan_to_num(curve.values[begin:end], posinf=0.0, neginf=0.0)
    if not seconds.size or curve.top <= 0.0:
        return ""
    # The maximum per pixel: a short jerk must not vanish.
    pixels = np.array([round(x(float(moment)) * 2) for moment in seconds])
    firsts = np.flatnonzero(np.diff(pixels, prepend=pixels[0] - 1))
    tops = np.maximum.reduceat(values, firsts)
    points = [
        f"{pixels[first] / 2:.1f} {base - min(1.0, top / curve.top) * _SPEED_ROW_PX:.1f}"
        for first, top in zip(firsts, tops, strict=True)
    ]
    return f"M{pixels[0] / 2:.1f} {base:.1f}L{'L'.join(points)}L{pixels[-1] / 2:.1f} {base:.1f}z"


# Trajectory on the map


def path_on_map(way: Trajectory, grid: OccupancyGrid | None, places: Sequence[Pin], pins: Sequence[Pin]) -> Drawing:
    """Trajectory with at least one point, on the map if there is one; ``places`` lie below it, ``pins`` above."""
    left, bottom, right, top = _bounds(way, grid)
    scale = _MAP_PX / (right - left)

    def spot(x_m: float, y_m: float) -> Point:
        return (x_m - left) * scale, (top - y_m) * scale

    def placed(pins: Sequence[Pin]) -> list[Drawing]:
        spots = ((pin, *spot(pin.x_m, pin.y_m)) for pin in pins)
        return [
            {"x": x, "y": y, "look": pin.look, "title": pin.title, "label": pin.label, "shape": pin.shape}
            for pin, x, y in spots
        ]

    named = placed([pin for pin in places if left < pin.x_m - 0.2 and pin.x_m + 0.2 < right and bottom < pin.y_m < top])
    # Below the map, so that the scale bar covers no data.
    height = (top - bottom) * scale + _SCALE_PX
    scale_m = _step(_MAP_PX / scale / 6, 1, (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100))
    return {
        "width": _MAP_PX,
        "height": height,
        "image": None if grid is None else _image(grid, spot, scale, height),
        "places": named,
        "lines": _path_lines(way, spot),
        "minutes": _minutes(way, spot, [(pin["x"], pin["y"]) for pin in named]),
        "pins": placed(pins),
        "start": spot(*way.points_m[0]),
        "end": spot(*way.points_m[-1]),
        "turn": -math.degrees(float(way.headings_rad[-1])),
        "scale_m": scale_m,
        "scale_px": scale_m * scale,
    }


def _corners(grid: OccupancyGrid, columns: Sequence[int], rows: Sequence[int]) -> list[Point]:
    """Map points of corners of cells, counter-clockwise; ``columns`` and ``rows`` are the first and the last."""
    origin, cell_m = grid.origin_in_map, grid.resolution_m
    cosine, sine = math.cos(origin.heading_rad), math.sin(origin.heading_rad)
    corners = ((columns[0], rows[0]), (columns[1], rows[0]), (columns[1], rows[1]), (columns[0], rows[1]))
    return [
        (origin.x_m + cosine * x_m - sine * y_m, origin.y_m + sine * x_m + cosine * y_m)
        for x_m, y_m in ((column * cell_m, row * cell_m) for column, row in corners)
    ]


def _bounds(way: Trajectory, grid: OccupancyGrid | None) -> tuple[float, float, float, float]:
    points = way.points_m
    if grid is not None:
        rows, columns = np.nonzero(grid.cells >= 0)
        if rows.size:
            known = _corners(grid, (columns.min(), columns.max() + 1), (rows.min(), rows.max() + 1))
            points = np.concatenate([points, known])
    margin = 0.5
    left, bottom = (points.min(axis=0) - margin).tolist()
    right, top = (points.max(axis=0) + margin).tolist()
    # Always as wide as the page, so that text has the same size everywhere.
    width = max(4.0, right - left, (top - bottom) * _MAP_PX / _MAP_MAX_HEIGHT_PX)
    height = max(width / 4, top - bottom)
    middle_x, middle_y = (left + right) / 2, (bottom + top) / 2
    return middle_x - width / 2, middle_y - height / 2, middle_x + width / 2, middle_y + height / 2


def _image(grid: OccupancyGrid, spot: Callable[[float, float], Point], scale: float, height: float) -> Drawing:
    """The map, and the outline of the area beyond it, which is drawn like its unknown cells."""
    rows, columns = grid.cells.shape
    origin = grid.origin_in_map
    x, y = spot(origin.x_m, origin.y_m)
    across, along = (cells * grid.resolution_m * scale for cells in (columns, rows))
    corners = (spot(*corner) for corner in _corners(grid, (0, columns), (0, rows)))
    outline = "L".join(f"{corner_x:.1f} {corner_y:.1f}" for corner_x, corner_y in corners)
    red, green, blue, alpha = _UNKNOWN
    return {
        "beyond": f"M0 0H{_MAP_PX:.1f}V{height:.1f}H0zM{outline}z",
        "colour": f"rgb({red},{green},{blue})",
        "opacity": alpha / 255,
        "png": base64.b64encode(map_png(grid)).decode("ascii"),
        "x": x,
        "y": y,
        "width": across,
        "height": along,
        "turn": -math.degrees(origin.heading_rad),
    }


def map_png(grid: OccupancyGrid) -> bytes:
    """Map as PNG with transparent free space, for light and dark pages."""
    import cv2

    cells = np.flipud(grid.cells)
    largest = 2000
    if max(cells.shape) > largest:
        # Walls are thin: each block of cells takes its most occupied one.
        block = math.ceil(max(cells.shape) / largest)
        padded = np.pad(cells, [(0, -size % block) for size in cells.shape], constant_values=-1)
        rows, columns = (size // block for size in padded.shape)
        cells = padded.reshape(rows, block, columns, block).max(axis=(1, 3))
    image = np.zeros((*cells.shape, 4), np.uint8)
    image[cells < 0] = (*_UNKNOWN[2::-1], _UNKNOWN[3])
    known = cells >= 0
    image[known] = (0x88, 0x70, 0x5F, 0)
    image[known, 3] = (np.clip(cells[known].astype(np.float32), 0, 100) * 2.55).astype(np.uint8)
    done, content = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not done:
        raise OSError("the map could not be encoded as an image")
    return content.tobytes()


def _path_lines(way: Trajectory, spot: Callable[[float, float], Point]) -> list[tuple[str, float, bool]]:
    """Points, opacity and kind of pieces that darken with time and are dashed where the robot navigated."""
    count = len(way.points_m)
    if count < 2:
        return []
    lines = []
    bounds = sorted({*np.linspace(0, count - 1, min(_WAY_CHUNKS, count - 1) + 1).astype(int).tolist(),
                     *(np.flatnonzero(np.diff(way.by_itself)) + 1).tolist()})  # fmt: skip
    for begin, end in itertools.pairwise(bounds):
        points = _thinned([spot(*point) for point in way.points_m[begin : end + 1]])
        if len(points) > 1:
            text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
            lines.append((text, 0.35 + 0.65 * end / (count - 1), bool(way.by_itself[begin])))
    return lines


def _thinned(points: list[Point]) -> list[Point]:
    """Drop points closer than a visible distance; the last one stays."""
    thinned = points[:1]
    for point in points[1:-1]:
        if math.dist(point, thinned[-1]) >= 1.5:
            thinned.append(point)
    return [*thinned, points[-1]] if math.dist(points[-1], thinned[-1]) > 0.2 else thinned


def _minutes(
    way: Trajectory, spot: Callable[[float, float], Point], places: Sequence[Point]
) -> list[tuple[float, float, str, bool]]:
    """Position and time at each full minute (or five, ten...), if the robot moved since the last one shown, and whether
    the name of a place is on its right.
    """
    begins_s, ends_s = float(way.seconds[0]), float(way.seconds[-1])
    step_s = _step(ends_s - begins_s, 12, (30, 60, 120, 300, 600, 1200, 1800, 3600, 7200))
    minutes: list[tuple[float, float, str, bool]] = []
    moment_s = math.floor(max(0.0, begins_s) / step_s + 1.0) * step_s
    while moment_s < ends_s:
        here = spot(*way.points_m[int(np.searchsorted(way.seconds, moment_s))])
        if not minutes or math.dist(here, minutes[-1][:2]) > 26.0:
            crowded = any(math.dist(here, place) < 40.0 for place in places)
            minutes.append((*here, clock_text(moment_s), crowded))
        moment_s += step_s
    return minutes


# Distribution


def histogram(values: Sequence[float]) -> Drawing:
    """Bars of the histogram of at least one value, a dot per value, axes and a line at the median."""
    left, inner, plot_height = 34.0, 474.0, 150.0
    largest = max(*values, 1.0)
    width = _step(largest, 18, (0.1, 0.2, 0.25, 0.5, 1, 2, 5, 10))
    bins = max(1, math.ceil(largest / width + 1e-9))
    counts = np.bincount([min(bins - 1, int(value / width)) for value in values], minlength=bins).tolist()
    highest = max(counts)

    def x(value: float) -> float:
        return left + value / (bins * width) * inner

    step = _step(highest, 4, (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 5000))
    label_step = _step(bins * width, 8, (0.1, 0.2, 0.5, 1, 2, 5, 10, 20))
    labels = math.floor(bins * width / label_step + 1e-9) + 1
    return {
        "ticks": [
            (number * step / highest * plot_height, number * step) for number in range(math.floor(highest / step) + 1)
        ],
        "bars": [
            {
                "x": x(index * width) + 1.0,
                "width": max(1.0, x((index + 1) * width) - x(index * width) - 2.0),
                "height": count / highest * plot_height,
                "from": index * width,
                "to": (index + 1) * width,
                "count": count,
            }
            for index, count in enumerate(counts)
            if count
        ],
        "dots": [x(value) for value in values],
        "labels": [(x(number * label_step), number * label_step) for number in range(labels)],
        "median": float(np.median(values)),
        "median_x": x(float(np.median(values))),
    }
