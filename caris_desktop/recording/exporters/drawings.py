"""SVG drawings of the HTML report: time line, map, histogram and share bar, coloured by the page's style sheet."""

import base64
import itertools
import math
from collections.abc import Sequence
from dataclasses import field
from html import escape
from typing import Any, Literal

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import OccupancyGrid
from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.session.session_clock import clock_text

Shape = Literal["bar", "diamond", "triangle", "dot", "shade"]

_LABEL_PX, _PLOT_PX = 132.0, 948.0
_ROW_PX, _ROW_GAP_PX, _AXIS_PX = 18.0, 7.0, 22.0
_SPEED_ROW_PX = 34.0
_ONE_STRIP_S = 12 * 60.0
_LEAST_BAR_PX = 1.6
_MAP_PX = 1080.0
_MAP_MAX_HEIGHT_PX = 620.0
_WAY_CHUNKS = 48
_SCALE_PX = 18.0
# Red, green, blue, alpha: grey on a light page and on a dark one.
_UNKNOWN = (0x7A, 0x8A, 0x9B, 0x38)


@dataclass(frozen=True, slots=True)
class Item:
    """Interval from ``start_s`` to ``end_s`` of the session, or a point event. ``css_class`` is its CSS class."""

    start_s: float
    end_s: float | None
    css_class: str
    title: str
    shape: Shape = "bar"


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the time line."""

    label: str
    items: tuple[Item, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """Row with a curve over time, filled from zero to ``top``."""

    label: str
    seconds: NDArray[np.float64]
    values: NDArray[np.float64]
    top: float
    css_class: str


@dataclass(frozen=True, slots=True)
class Part:
    """Part of a share bar, such as a speaker's share of the talk."""

    label: str
    value: float
    css_class: str
    shown: str


@dataclass(frozen=True, slots=True)
class Pin:
    """Marker on the map."""

    x_m: float
    y_m: float
    css_class: str
    title: str
    label: str = ""
    shape: Literal["dot", "diamond", "triangle", "square"] = "dot"


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Trajectory of the robot: ``points_m`` float64, shape (n, 2), at ``seconds``; ``by_itself`` while navigating
    autonomously.
    """

    seconds: NDArray[np.float64]
    points_m: NDArray[np.float64]
    headings_rad: NDArray[np.float64]
    by_itself: NDArray[np.bool_]
    pins: tuple[Pin, ...] = field(default=())


def duration_text(seconds: float) -> str:
    """``4.2 s``, ``3 min 12 s``, ``1 h 05 min``."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    total_s = round(seconds)
    if total_s < 3600:
        return f"{total_s // 60} min {total_s % 60:02d} s"
    return f"{total_s // 3600} h {total_s % 3600 // 60:02d} min"


# SVG


def _attributes(values: dict[str, Any]) -> str:
    present = {key.rstrip("_").replace("_", "-"): value for key, value in values.items() if value is not None}
    return "".join(
        f' {key}="{escape(f"{value:.2f}".rstrip("0").rstrip(".") if isinstance(value, float) else str(value))}"'
        for key, value in present.items()
    )


def _element(name: str, *inside: str | Markup, **attributes: Any) -> Markup:
    """SVG or HTML element; content that is not Markup is escaped."""
    content = "".join(part if isinstance(part, Markup) else escape(str(part)) for part in inside)
    opening = f"<{name}{_attributes(attributes)}"
    return Markup(f"{opening}>{content}</{name}>" if content else f"{opening}/>")  # noqa: S704 - escaped above


def _svg(width: float, height: float, *inside: Markup, title: str, css_class: str = "drawing") -> Markup:
    return _element(
        "svg",
        _element("title", title),
        *inside,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {width:.0f} {height:.0f}",
        role="img",
        class_=css_class,
    )


def _text(x: float, y: float, text: str, css_class: str = "label", anchor: str | None = None) -> Markup:
    return _element("text", text, x=x, y=y, class_=css_class, text_anchor=anchor)


def _step(span: float, most: int, steps: Sequence[float]) -> float:
    return next((step for step in steps if span / step <= most), steps[-1])


# Time line


def time_line(rows: Sequence[Row], curves: Sequence[Curve], shades: Sequence[Item], lasts_s: float) -> list[Markup]:
    """Time line of the session as strips of about ten minutes; ``shades`` lie behind all rows."""
    if lasts_s <= 0.0:
        return []
    strip_s = lasts_s
    if lasts_s > _ONE_STRIP_S:
        strip_s = max(600.0, math.ceil(lasts_s / 12 / 600.0) * 600.0)
    count = max(1, math.ceil(lasts_s / strip_s - 1e-6))
    return [
        _strip(rows, curves, shades, begins_s=number * strip_s, span_s=strip_s, lasts_s=lasts_s)
        for number in range(count)
    ]


def _strip(
    rows: Sequence[Row],
    curves: Sequence[Curve],
    shades: Sequence[Item],
    *,
    begins_s: float,
    span_s: float,
    lasts_s: float,
) -> Markup:
    ends_s = begins_s + span_s
    rows = [row for row in rows if any(_within(item, begins_s, ends_s) for item in row.items)]
    height = 4.0 + (_ROW_PX + _ROW_GAP_PX) * len(rows) + (_SPEED_ROW_PX + _ROW_GAP_PX) * len(curves)

    def x(seconds: float) -> float:
        return _LABEL_PX + (min(max(seconds, begins_s), ends_s) - begins_s) / span_s * _PLOT_PX

    right = x(min(ends_s, lasts_s))
    parts = [
        _element("rect", x=_LABEL_PX, y=0.0, width=right - _LABEL_PX, height=height, class_="plot", rx=4.0),
        *_time_axis(begins_s, span_s, min(ends_s, lasts_s), height, x),
    ]
    for shade in shades:
        end_s = shade.end_s if shade.end_s is not None else shade.start_s
        if end_s > begins_s and shade.start_s < ends_s:
            left = x(shade.start_s)
            parts.append(
                _element(
                    "rect",
                    _element("title", shade.title),
                    x=left,
                    y=0.0,
                    width=max(2.0, x(end_s) - left),
                    height=height,
                    class_=shade.css_class,
                )
            )
    y = 4.0
    for curve in curves:
        parts.append(_curve(curve, y, begins_s, ends_s, x))
        parts.append(_text(_LABEL_PX - 10.0, y + _SPEED_ROW_PX / 2 + 4.0, curve.label, anchor="end"))
        y += _SPEED_ROW_PX + _ROW_GAP_PX
    for row in rows:
        middle = y + _ROW_PX / 2
        parts.append(_text(_LABEL_PX - 10.0, middle + 4.0, _shortened(row.label, 20), anchor="end"))
        parts.append(_element("line", x1=_LABEL_PX, x2=right, y1=middle, y2=middle, class_="rail"))
        parts += [_item(item, x, y) for item in row.items if _within(item, begins_s, ends_s)]
        y += _ROW_PX + _ROW_GAP_PX
    title = f"Event log from {clock_text(begins_s)} to {clock_text(min(ends_s, lasts_s))}"
    return _svg(_LABEL_PX + _PLOT_PX + 20.0, height + _AXIS_PX, *parts, title=title)


def _within(item: Item, begins_s: float, ends_s: float) -> bool:
    return (item.start_s if item.end_s is None else item.end_s) >= begins_s and item.start_s < ends_s


def _time_axis(begins_s: float, span_s: float, ends_s: float, height: float, x: Any) -> list[Markup]:
    step_s = _step(span_s, 12, (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 14400))
    parts = []
    moment_s = math.ceil(begins_s / step_s) * step_s
    while moment_s <= ends_s + 1e-6:
        parts.append(_element("line", x1=x(moment_s), x2=x(moment_s), y1=0.0, y2=height, class_="tick"))
        parts.append(_text(x(moment_s), height + 15.0, clock_text(moment_s), "axis", "middle"))
        moment_s += step_s
    return parts


def _item(item: Item, x: Any, y: float) -> Markup:
    left = x(item.start_s)
    title = _element("title", item.title)
    middle = y + _ROW_PX / 2
    if item.shape == "bar" and item.end_s is not None:
        width = max(_LEAST_BAR_PX, x(item.end_s) - left)
        return _element(
            "rect",
            title,
            x=left,
            y=y + 2.0,
            width=width,
            height=_ROW_PX - 4.0,
            rx=min(3.0, width / 2),
            class_=item.css_class,
        )
    parts = []
    if item.end_s is not None:
        parts.append(
            _element("rect", x=left, y=middle - 2.0, width=max(1.0, x(item.end_s) - left), height=4.0, rx=2.0,
                     class_=f"{item.css_class} stretch")
        )  # fmt: skip
    parts.append(_symbol(item.shape, left, middle, 6.0, item.css_class))
    return _element("g", title, *parts)


def _symbol(shape: str, x: float, y: float, r: float, css_class: str) -> Markup:
    if shape == "diamond":
        return _element("path", d=f"M{x:.1f} {y - r:.1f}l{r} {r}l-{r} {r}l-{r} -{r}z", class_=css_class)
    if shape == "triangle":
        return _element("path", d=f"M{x:.1f} {y - r:.1f}l{r} {1.75 * r}h-{2 * r}z", class_=css_class)
    if shape == "square":
        return _element("rect", x=x - r * 0.8, y=y - r * 0.8, width=r * 1.6, height=r * 1.6, rx=1.5, class_=css_class)
    return _element("circle", cx=x, cy=y, r=r * 0.75, class_=css_class)


def _curve(curve: Curve, y: float, begins_s: float, ends_s: float, x: Any) -> Markup:
    base = y + _SPEED_ROW_PX
    begin, end = np.searchsorted(curve.seconds, [begins_s, ends_s])
    seconds, values = curve.seconds[begin:end], np.nan_to_num(curve.values[begin:end], posinf=0.0, neginf=0.0)
    line = _element("line", x1=_LABEL_PX, x2=x(ends_s), y1=base, y2=base, class_="rail")
    if not seconds.size or curve.top <= 0.0:
        return line
    # The maximum per pixel: a short jerk must not vanish.
    pixels = np.array([round(x(float(moment)) * 2) for moment in seconds])
    firsts = np.flatnonzero(np.diff(pixels, prepend=pixels[0] - 1))
    tops = np.maximum.reduceat(values, firsts)
    points = [
        f"{pixels[first] / 2:.1f} {base - min(1.0, top / curve.top) * _SPEED_ROW_PX:.1f}"
        for first, top in zip(firsts, tops, strict=True)
    ]
    outline = f"M{pixels[0] / 2:.1f} {base:.1f}L{'L'.join(points)}L{pixels[-1] / 2:.1f} {base:.1f}z"
    return _element("g", line, _element("path", d=outline, class_=curve.css_class))


# Trajectory on the map


def path_on_map(way: Trajectory, grid: OccupancyGrid | None, places: Sequence[Pin]) -> Markup:
    """Trajectory on the map. ``grid`` may be None; at least one point is required."""
    left, bottom, right, top = _bounds(way, grid)
    scale = _MAP_PX / (right - left)
    width, height = _MAP_PX, (top - bottom) * scale

    def spot(x_m: float, y_m: float) -> tuple[float, float]:
        return (x_m - left) * scale, (top - y_m) * scale

    # Below the map, so that the scale bar covers no data.
    total_height = height + _SCALE_PX
    parts = [_element("rect", x=0.0, y=0.0, width=width, height=total_height, class_="floor", rx=8.0)]
    if grid is not None:
        parts += [_beyond(grid, spot, width, total_height), _map_picture(grid, spot, scale)]
    inside = [pin for pin in places if left < pin.x_m - 0.2 and pin.x_m + 0.2 < right and bottom < pin.y_m < top]
    parts += [_pin(pin, spot, width) for pin in inside]
    parts += _path_lines(way, spot)
    parts += _minutes(way, spot, [spot(pin.x_m, pin.y_m) for pin in inside])
    parts += [_pin(pin, spot, width) for pin in way.pins]
    parts.append(_start(spot(*way.points_m[0])))
    parts.append(_robot(spot(*way.points_m[-1]), float(way.headings_rad[-1])))
    parts.append(_scale_bar(width, total_height, scale))
    return _svg(width, total_height, *parts, title="Path of the robot on the map", css_class="drawing map")


def _bounds(way: Trajectory, grid: OccupancyGrid | None) -> tuple[float, float, float, float]:
    xs, ys = [way.points_m[:, 0]], [way.points_m[:, 1]]
    if grid is not None:
        rows, columns = np.nonzero(grid.cells >= 0)
        if rows.size:
            origin, cell_m = grid.origin_in_map, grid.resolution_m
            across = np.array([columns.min(), columns.max() + 1]) * cell_m
            along = np.array([rows.min(), rows.max() + 1]) * cell_m
            for dx in across:
                for dy in along:
                    cosine, sine = math.cos(origin.heading_rad), math.sin(origin.heading_rad)
                    xs.append(np.array([origin.x_m + cosine * dx - sine * dy]))
                    ys.append(np.array([origin.y_m + sine * dx + cosine * dy]))
    x_m, y_m = np.concatenate(xs), np.concatenate(ys)
    margin = 0.5
    left, right = float(x_m.min()) - margin, float(x_m.max()) + margin
    bottom, top = float(y_m.min()) - margin, float(y_m.max()) + margin
    # Always as wide as the page, so that text has the same size everywhere.
    width = max(4.0, right - left, (top - bottom) * _MAP_PX / _MAP_MAX_HEIGHT_PX)
    height = max(width / 4, top - bottom)
    middle_x, middle_y = (left + right) / 2, (bottom + top) / 2
    left, right = middle_x - width / 2, middle_x + width / 2
    bottom, top = middle_y - height / 2, middle_y + height / 2
    return left, bottom, right, top


def _map_picture(grid: OccupancyGrid, spot: Any, scale: float) -> Markup:
    height_m, width_m = (size * grid.resolution_m for size in grid.cells.shape)
    origin = grid.origin_in_map
    x, y = spot(origin.x_m, origin.y_m)
    png = base64.b64encode(map_png(grid)).decode("ascii")
    return _element(
        "image", href=f"data:image/png;base64,{png}", x=x, y=y - height_m * scale, width=width_m * scale,
        height=height_m * scale, preserveAspectRatio="none", style="image-rendering:pixelated",
        transform=f"rotate({-math.degrees(origin.heading_rad):.3f} {x:.2f} {y:.2f})" if origin.heading_rad else None,
    )  # fmt: skip


def _beyond(grid: OccupancyGrid, spot: Any, width: float, height: float) -> Markup:
    """Area outside the map, drawn like its unknown cells."""
    rows, columns = grid.cells.shape
    across_m, along_m = columns * grid.resolution_m, rows * grid.resolution_m
    origin = grid.origin_in_map
    cosine, sine = math.cos(origin.heading_rad), math.sin(origin.heading_rad)
    corners = [
        spot(origin.x_m + cosine * x_m - sine * y_m, origin.y_m + sine * x_m + cosine * y_m)
        for x_m, y_m in ((0.0, 0.0), (across_m, 0.0), (across_m, along_m), (0.0, along_m))
    ]
    outline = "L".join(f"{x:.1f} {y:.1f}" for x, y in corners)
    around = f"M0 0H{width:.1f}V{height:.1f}H0zM{outline}z"
    red, green, blue, alpha = _UNKNOWN
    return _element("path", d=around, fill=f"rgb({red},{green},{blue})", fill_opacity=alpha / 255, fill_rule="evenodd")


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


def _path_lines(way: Trajectory, spot: Any) -> list[Markup]:
    """Trajectory in pieces that darken with time; dashed where the robot navigated autonomously."""
    count = len(way.points_m)
    if count < 2:
        return []
    parts = []
    bounds = sorted({*np.linspace(0, count - 1, min(_WAY_CHUNKS, count - 1) + 1).astype(int).tolist(),
                     *(np.flatnonzero(np.diff(way.by_itself)) + 1).tolist()})  # fmt: skip
    for begin, end in itertools.pairwise(bounds):
        points = _thinned([spot(*point) for point in way.points_m[begin : end + 1]])
        if len(points) > 1:
            age = 0.35 + 0.65 * end / (count - 1)
            itself = bool(way.by_itself[begin])
            parts.append(
                _element(
                    "polyline",
                    points=" ".join(f"{x:.1f},{y:.1f}" for x, y in points),
                    stroke_opacity=age,
                    class_="way itself" if itself else "way",
                )
            )
    return parts


def _thinned(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Drop points closer than a visible distance; the last one stays."""
    thinned = points[:1]
    for point in points[1:-1]:
        if math.dist(point, thinned[-1]) >= 1.5:
            thinned.append(point)
    return [*thinned, points[-1]] if math.dist(points[-1], thinned[-1]) > 0.2 else thinned


def _minutes(way: Trajectory, spot: Any, places_px: Sequence[tuple[float, float]]) -> list[Markup]:
    """Position at each full minute (or five, ten...), if the robot moved since the last one shown."""
    begins_s, ends_s = float(way.seconds[0]), float(way.seconds[-1])
    step_s = _step(ends_s - begins_s, 12, (30, 60, 120, 300, 600, 1200, 1800, 3600, 7200))
    parts: list[Markup] = []
    last: tuple[float, float] | None = None
    moment_s = math.floor(max(0.0, begins_s) / step_s + 1.0) * step_s
    while moment_s < ends_s:
        index = int(np.searchsorted(way.seconds, moment_s))
        here = spot(*way.points_m[index])
        if last is None or math.dist(here, last) > 26.0:
            last = here
            parts.append(_element("circle", cx=here[0], cy=here[1], r=3.2, class_="minute"))
            # The names of places stand to the right of them.
            crowded = any(math.dist(here, place) < 40.0 for place in places_px)
            label_x, anchor = (here[0] - 9.0, "end") if crowded else (here[0] + 6.0, None)
            parts.append(_text(label_x, here[1] - 6.0, clock_text(moment_s), "minute-label", anchor))
        moment_s += step_s
    return parts


def _pin(pin: Pin, spot: Any, width: float) -> Markup:
    x, y = spot(pin.x_m, pin.y_m)
    parts = [_element("title", pin.title), _symbol(pin.shape, x, y, 6.5, pin.css_class)]
    if pin.label:
        near_right = x > width - 110.0
        parts.append(
            _text(x + (-9.0 if near_right else 9.0), y + 4.0, pin.label, "pin-label", "end" if near_right else "start")
        )
    return _element("g", *parts)


def _start(at_px: tuple[float, float]) -> Markup:
    return _element("circle", _element("title", "Start"), cx=at_px[0], cy=at_px[1], r=6.0, class_="start")


def _robot(at_px: tuple[float, float], heading_rad: float) -> Markup:
    """Robot marker with heading, as on the console's map."""
    x, y = at_px
    turn = -math.degrees(heading_rad)
    return _element(
        "g",
        _element("title", "End"),
        _element(
            "path", d="M15 0L6 -5.5L6 5.5z", class_="robot", transform=f"translate({x:.1f} {y:.1f}) rotate({turn:.1f})"
        ),
        _element("circle", cx=x, cy=y, r=8.0, class_="robot ring"),
    )  # fmt: skip


def _scale_bar(width: float, height: float, scale: float) -> Markup:
    metres = _step(width / scale / 6, 1, (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100))
    length = metres * scale
    y = height - 14.0
    return _element(
        "g",
        _element("path", d=f"M14 {y - 5:.1f}v5h{length:.1f}v-5", class_="scale"),
        _text(14.0 + length / 2, y - 8.0, f"{metres:g} m", "axis", "middle"),
    )


# Distributions and shares


def histogram(values: Sequence[float], *, unit: str, median: float, title: str, css_class: str) -> Markup:
    """Histogram with one dot per value below and a line at the median. At least one value."""
    width, plot_top, plot_height, left = 520.0, 26.0, 150.0, 34.0
    largest = max(*values, 1.0)
    bin_width = _step(largest, 18, (0.1, 0.2, 0.25, 0.5, 1, 2, 5, 10))
    bins = max(1, math.ceil(largest / bin_width + 1e-9))
    counts = np.bincount([min(bins - 1, int(value / bin_width)) for value in values], minlength=bins)
    highest = int(counts.max())
    inner = width - left - 12.0
    base = plot_top + plot_height

    def x(value: float) -> float:
        return left + value / (bins * bin_width) * inner

    parts = []
    step = _step(highest, 4, (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 5000))
    for number in range(0, math.floor(highest / step) + 1):
        y = base - number * step / highest * plot_height
        parts.append(_element("line", x1=left, x2=width - 12.0, y1=y, y2=y, class_="tick"))
        parts.append(_text(left - 6.0, y + 4.0, f"{number * step:g}", "axis", "end"))
    for index, count in enumerate(counts.tolist()):
        if count:
            begin, bar_height = x(index * bin_width), count / highest * plot_height
            words = f"{index * bin_width:g} to {(index + 1) * bin_width:g} {unit}: {count}"
            parts.append(
                _element(
                    "rect",
                    _element("title", words),
                    x=begin + 1.0,
                    y=base - bar_height,
                    width=max(1.0, x((index + 1) * bin_width) - begin - 2.0),
                    height=bar_height,
                    rx=2.0,
                    class_=css_class,
                )
            )
    for value in values:
        parts.append(_element("circle", cx=x(value), cy=base + 10.0, r=2.6, class_=f"{css_class} each"))
    label_step = _step(bins * bin_width, 8, (0.1, 0.2, 0.5, 1, 2, 5, 10, 20))
    for number in range(math.floor(bins * bin_width / label_step + 1e-9) + 1):
        parts.append(_text(x(number * label_step), base + 30.0, f"{number * label_step:g}", "axis", "middle"))
    parts.append(_text(width - 12.0, base + 46.0, f"{title} ({unit})", "axis", "end"))
    parts.append(_element("line", x1=x(median), x2=x(median), y1=plot_top - 6.0, y2=base + 16.0, class_="median"))
    near_right = x(median) > width - 140.0
    parts.append(
        _text(x(median) + (-6.0 if near_right else 6.0), plot_top + 2.0, f"median {median:.1f} {unit}", "median-label",
              "end" if near_right else None)
    )  # fmt: skip
    return _svg(width, base + 54.0, *parts, title=f"{title}: {len(values)} values, median {median:.2f} {unit}")


def share_bar(parts: Sequence[Part], *, title: str) -> Markup:
    """Stacked bar of parts; labels are in the table next to it."""
    total = sum(part.value for part in parts)
    width, height = 520.0, 22.0
    if total <= 0.0:
        return Markup("")
    drawn = []
    x = 0.0
    for part in parts:
        length = part.value / total * width
        if length > 0.0:
            drawn.append(
                _element(
                    "rect",
                    _element("title", f"{part.label}: {part.shown}"),
                    x=x,
                    y=0.0,
                    width=max(1.0, length - 1.5),
                    height=height,
                    rx=min(4.0, length / 2),
                    class_=part.css_class,
                )
            )
        x += length
    return _svg(width, height, *drawn, title=title)


def _shortened(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"


def pose_pin(pose: Pose2D, name: str) -> Pin:
    """A named place."""
    return Pin(pose.x_m, pose.y_m, "place", name, name)
