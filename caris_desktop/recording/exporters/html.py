"""HTML report of a session: one self-contained page for screen and print, with its drawings."""

import base64
import itertools
import logging
import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.events import (
    LATE_FROM_S,
    RESPONSE_LIMIT_S,
    EmergencyStopChanged,
    PreflightChecked,
    Problem,
    RobotChosen,
    ScenarioOpened,
)
from caris_desktop.domain.media_checks import decoded, jpeg_of
from caris_desktop.domain.sensing import OccupancyGrid, Odometry, RobotPose
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation.annotation_editing import AnnotationError
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument
from caris_desktop.recording.exporters.methods import by_means
from caris_desktop.recording.exporters.templates import duration, write_own_page, write_page
from caris_desktop.recording.measures.session_measures import Measures, measure, read_facts
from caris_desktop.recording.pseudonyms import coding_of
from caris_desktop.recording.replay.session_timeline import SessionTimeline
from caris_desktop.recording.session.session_data import SessionData
from caris_desktop.recording.session.session_header import clock_text
from caris_desktop.recording.session.session_marks import FinalMark
from caris_desktop.recording.session.session_protocol import open_words, preflight_of, read_scenario
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext
from caris_desktop.recording.studies.data_quality import data_quality_problems

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
    """Interval on the timeline, or a point event without ``end_ns``. ``look`` is its CSS class."""

    start_ns: int
    end_ns: int | None
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
    session: Session, rows: Sequence[tuple[str, Sequence[Item]]], curve: Curve | None, shades: Sequence[Item]
) -> list[Drawing]:
    """Timeline of the session as strips of about ten minutes; ``shades`` lie behind all rows."""
    lasts_s = session.duration_s
    if lasts_s <= 0.0:
        return []
    strip_s = lasts_s
    if lasts_s > _ONE_STRIP_S:
        strip_s = max(600.0, math.ceil(lasts_s / 12 / 600.0) * 600.0)
    begins_s = (number * strip_s for number in range(max(1, math.ceil(lasts_s / strip_s - 1e-6))))
    return [_strip(session, rows, curve, shades, begins_s=begin_s, ends_s=begin_s + strip_s) for begin_s in begins_s]


def _strip(
    session: Session,
    rows: Sequence[tuple[str, Sequence[Item]]],
    curve: Curve | None,
    shades: Sequence[Item],
    *,
    begins_s: float,
    ends_s: float,
) -> Drawing:
    def x(seconds: float) -> float:
        return _LABEL_PX + (min(max(seconds, begins_s), ends_s) - begins_s) / (ends_s - begins_s) * _PLOT_PX

    def placed(items: Sequence[Item]) -> list[Drawing]:
        drawings = []
        for item in items:
            times_s = [session.clock.session_s(at_ns) for at_ns in (item.start_ns, item.end_ns) if at_ns is not None]
            start_s, end_s = times_s[0], times_s[-1]
            if end_s >= begins_s and start_s < ends_s:
                width = None if item.end_ns is None else x(end_s) - x(start_s)
                title = f"{' to '.join(map(clock_text, times_s))}  {item.title}"
                drawings.append(
                    {"x": x(start_s), "width": width, "look": item.look, "title": title, "shape": item.shape}
                )
        return drawings

    until_s = min(ends_s, session.duration_s)
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


_log = logging.getLogger(__name__)
_MAX_PHOTOS = 60
_PHOTO_WIDTH_PX = 480
_MAX_PEOPLE_ROWS = 6
_MAX_WAY_POINTS = 20_000
_SPEAKERS = {"participant": "Participant", "robot": "Robot", "wizard": "Wizard"}
_SPEAKER_LOOKS = {"participant": "participant", "robot": "robot-speech", "wizard": "note"}
_SOURCES = {
    "keyboard": "Keyboard",
    "gamepad": "Gamepad",
    "onscreen": "On-screen buttons",
    "rehearsal": "Rehearsed script",
    "stop": "Stop",
    "lease": "Safety stop",
    "none": "Not specified",
}


def write_html(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Write ``report.html`` into the folder ``out``, or what the researcher's template makes.

    Raises OSError, SessionError, ExportError.
    """
    data = read_facts(session, lambda fraction: context.progress(0.7 * fraction))
    with SessionTimeline(session) as timeline:
        grid = next((value for value in timeline.state_at(session.ended_ns) if isinstance(value, OccupancyGrid)), None)
    context.progress(0.8)
    report = _report(data, measure(data), grid)
    context.progress(0.95)
    if context.template is not None:
        path = write_own_page(out, "report", context.template, **report)
    else:
        path = write_page(out / "report.html", "report.html.j2", **report)
    context.progress(1.0)
    return [path]


def _report(data: SessionData, measures: Measures, grid: OccupancyGrid | None) -> dict[str, Any]:
    session, header = data.session, data.session.header
    robots = data.of(RobotChosen)
    preflight = preflight_of(data.of(PreflightChecked))
    coding = _coding(session)
    rows = list(_rows(data, measures, coding))
    shades = [Item(*pause, "pause", "Recording paused") for pause in data.pauses]
    return {
        "name": session.folder.name,
        "trial": defaultdict(str, session.trial),
        "started_utc_ns": session.clock.anchor.utc_ns_at(session.started_ns),
        "started_ns": session.started_ns,
        "lasts_s": session.duration_s,
        "robot": (robots[-1].title or robots[-1].name) if robots else header.robot.profile,
        "scenario": _scenarios(data) or header.scenario.title,
        "checks": {"count": len(preflight.checks), "passed": preflight.passed, "not_passed": open_words(preflight)},
        "version": header.program_version,
        "missing": list(data_quality_problems(data, measures)),
        "values": measures.values,
        "parts": defaultdict(dict, measures.parts),
        "time_line": time_line(session, rows, _speed(data), shades),
        "looks": {item.look for _, items in (*rows, ("", shades)) for item in items},
        "map": _map(data, measures, grid),
        "responses_s": measures.response_times_s,
        "content_responses_s": [reply.delay_s for reply in measures.content_responses],
        "reactions_s": [reply.delay_s for reply in measures.reactions],
        "gaps_s": measures.gaps_s,
        "gaps_by_means": by_means(measures.gaps),
        "response_limit_s": RESPONSE_LIMIT_S,
        "histogram": histogram(measures.response_times_s) if measures.response_times_s else None,
        "sources": _SOURCES,
        "steps": measures.steps,
        "late_from_s": LATE_FROM_S,
        "notes": [
            (mark.start_ns, mark.note or mark_words(mark)) for mark in data.marks if mark.kind == "note" or mark.note
        ],
        "coded": [
            (tier.name, tier.coder, len(made), sum(item.end_ms - item.start_ms for item in made) / 1000)
            for tier in coding.tiers
            if (made := coding.of_tier(tier.tier_id))
        ],
        "models": measures.models,
        "answers": data.answers,
        "photos": len(data.photos),
        "shown_photos": [
            (photo.stamp_ns, photo.file_name, _thumbnail(session.folder, photo.file_name))
            for photo in data.photos[:_MAX_PHOTOS]
        ],
        "utterances": sum(utterance.said for utterance in data.utterances),
        "turns": _transcript(data, measures) if data.utterances else [],
        "alarms": measures.alarms,
        "problems": _problems(data),
    }


def _scenarios(data: SessionData) -> str:
    """``Tour guide, from 2:22 Mental health check``."""
    titles: list[str] = []
    before = ""
    for opened in data.of(ScenarioOpened):
        if opened.title != before:
            at_s = max(0, round(data.session.clock.session_s(opened.stamp_ns)))
            titles.append(f"from {at_s // 60}:{at_s % 60:02} {opened.title}" if titles else opened.title)
        before = opened.title
    return ", ".join(titles)


def _coding(session: Session) -> AnnotationDocument:
    try:
        return coding_of(session, on_damaged=lambda what: _log.warning("left out of the report: %s", what))
    except AnnotationError as error:
        _log.warning("left out of the report: %s", error)
        return AnnotationDocument()


def _problems(data: SessionData) -> list[Problem]:
    return [problem for problem in data.of(Problem) if problem.severity != "info"]


# Timeline


def _speed(data: SessionData) -> Curve | None:
    values = sorted(data.of(Odometry), key=attrgetter("stamp_ns"))
    if not values:
        return None
    seconds = np.array([data.session.clock.session_s(value.stamp_ns) for value in values])
    speed_mps = np.array([math.hypot(value.twist.forward_mps, value.twist.left_mps) for value in values])
    top_mps = max(0.1, float(np.nanmax(speed_mps)))
    return Curve(f"Speed, up to {top_mps:.1f} m/s", seconds, speed_mps, top_mps)


def _rows(data: SessionData, measures: Measures, coding: AnnotationDocument) -> Iterator[tuple[str, list[Item]]]:
    """Rows of the timeline; some may be empty."""
    for speaker, name in _SPEAKERS.items():
        look = _SPEAKER_LOOKS[speaker]
        yield (
            name,
            [
                Item(item.start_ns, item.end_ns, "filler" if item.origin == "filler" else look, item.text)
                for item in data.utterances
                if item.speaker == speaker and item.said and item.start_ns is not None
            ],
        )
    visits = ((visit, "late" if visit.late_s >= LATE_FROM_S else "step") for visit in data.step_visits)
    yield "Protocol", [Item(visit.start_ns, visit.end_ns, look, visit.title) for visit, look in visits]
    goals = ((goal, "failed-goal" if goal.label == "failed" else "navigated") for goal in measures.navigation)
    yield "Driving", [
        *(Item(one.start_ns, one.end_ns, "driven", _SOURCES.get(one.source, one.source)) for one in data.drives),
        *(Item(goal.start_ns, goal.end_ns, look, f"Navigation, {goal.label}") for goal, look in goals),
    ]  # fmt: skip
    people: dict[str, list[Item]] = {}
    for visit in data.visits:
        name = f"Person {visit.number or visit.person_id}"
        people.setdefault(name, []).append(Item(visit.start_ns, visit.end_ns, "present", f"{name} is present"))
    yield from list(people.items())[:_MAX_PEOPLE_ROWS]
    rest = [span for spans in list(people.values())[_MAX_PEOPLE_ROWS:] for span in spans]
    yield f"{len(people) - _MAX_PEOPLE_ROWS} more identities", rest
    yield "Marks", [_mark(mark) for mark in data.marks if mark.kind != "wizard_error"]
    yield "Wizard errors", [_mark(mark) for mark in data.marks if mark.kind == "wizard_error"]
    for tier in coding.tiers:
        coded = ((one, one.start_ms * 1_000_000, one.end_ms * 1_000_000) for one in coding.of_tier(tier.tier_id))
        started_ns = data.session.started_ns
        yield tier.name, [Item(started_ns + start, started_ns + end, "coder", one.value) for one, start, end in coded]
    yield "Link, problems", [
        *(Item(one.start_ns, one.end_ns, "trouble", f"Link: {one.label}") for one in measures.link_trouble),
        *(Item(one.stamp_ns, None, "trouble", f"{one.what} {one.meaning}", "dot") for one in _problems(data)),
    ]  # fmt: skip


def _mark(mark: FinalMark) -> Item:
    looks: dict[str, tuple[str, Shape]] = {"wizard_error": ("error", "triangle"), "note": ("note", "dot")}
    look, shape = looks.get(mark.kind, ("mark", "diamond"))
    words = ": ".join(part for part in (mark_words(mark), mark.note) if part)
    return Item(mark.start_ns, mark.end_ns, look, words, shape)


def mark_words(mark: FinalMark) -> str:
    """Label of the mark, or its kind."""
    return mark.label or {"wizard_error": "Wizard error", "note": "Note"}.get(mark.kind, "Mark")


# Trajectory on the map


def _map(data: SessionData, measures: Measures, grid: OccupancyGrid | None) -> dict[str, Any] | None:
    poses = [(value.stamp_ns, value.pose_in_map) for value in data.of(RobotPose)]
    in_map = bool(poses)
    poses = sorted(poses or [(value.stamp_ns, value.pose_in_odom) for value in data.of(Odometry)], key=itemgetter(0))
    if not poses:
        return None
    stamps_ns = np.array([stamp_ns for stamp_ns, _ in poses], np.int64)
    points = np.array([(pose.x_m, pose.y_m, pose.heading_rad) for _, pose in poses], np.float64)
    headings_rad = points[:, 2]
    if not in_map:
        steps = np.diff(points[:, :2], axis=0, append=points[-1:, :2])
        headings_rad = np.arctan2(steps[:, 1], steps[:, 0])
    by_itself = np.zeros(stamps_ns.size, bool)
    for stretch in measures.navigation:
        by_itself |= (stamps_ns >= stretch.start_ns) & (stamps_ns <= stretch.end_ns)
    thin = max(1, stamps_ns.size // _MAX_WAY_POINTS)
    way = Trajectory(
        seconds=((stamps_ns - data.session.started_ns) / 1e9)[::thin],
        points_m=points[::thin, :2],
        headings_rad=headings_rad[::thin],
        by_itself=by_itself[::thin],
    )
    scenarios = data.of(ScenarioOpened)
    named = read_scenario(scenarios[-1]).places if scenarios and in_map else ()
    places = [Pin(pose.x_m, pose.y_m, "place", name, name) for name, pose in named]

    def pin(at_ns: int, look: str, words: str, shape: Shape) -> Pin:
        x_m, y_m, _ = points[max(0, int(np.searchsorted(stamps_ns, at_ns, side="right")) - 1)].tolist()
        return Pin(x_m, y_m, look, f"{clock_text(data.session.clock.session_s(at_ns))}  {words}", "", shape)

    pins = [
        pin(mark.start_ns, "mark", mark_words(mark), "diamond") if mark.kind == "mark" else
        pin(mark.start_ns, "error", f"Wizard error: {mark.label}", "triangle")
        for mark in data.marks
        if mark.kind != "note"
    ]  # fmt: skip
    stops = (event for event in data.of(EmergencyStopChanged) if event.latched)
    pins += [pin(event.stamp_ns, "trouble", "Emergency stop", "square") for event in stops]
    pins += [pin(photo.stamp_ns, "note", "Photo", "dot") for photo in data.photos]
    drawing = path_on_map(way, grid if in_map else None, places, pins)
    return drawing | {"in_map": in_map, "by_itself": bool(by_itself.any()), "looks": {pin.look for pin in pins}}


# Photos and transcript


def _thumbnail(folder: Path, file_name: str) -> str:
    """Small JPEG in base64; empty if the image is missing or lies outside the session."""
    path = folder / file_name
    try:
        if not path.resolve().is_relative_to(folder.resolve()):
            _log.warning("%s names a photo outside of the session: %s", folder, file_name)
            return ""
        image = decoded(path.read_bytes())
    except (OSError, ValueError) as error:
        # ValueError: an impossible file name, with a NUL or a lone surrogate.
        _log.warning("%.300r cannot be read: %.300s", str(path), error)
        return ""
    return base64.b64encode(jpeg_of(image, quality=82, most_px=_PHOTO_WIDTH_PX)).decode("ascii")


def _transcript(data: SessionData, measures: Measures) -> list[dict[str, Any]]:
    """Utterances, and between them marks and pauses, in order of time; ``chips`` are pairs of text and look."""
    replies = {reply.utterance_id: reply for reply in measures.responses}
    turns = []

    def add(at_ns: int, look: str, who: str, text: str, chips: Sequence[tuple[str, str]], *, said: bool = True) -> None:
        turns.append({"at_ns": at_ns, "look": look, "who": who, "text": text, "chips": chips, "said": said})

    for item in data.utterances:
        if not item.said and item.origin == "heard" and not item.text:
            continue  # without a speaker
        chips = []
        if reply := replies.get(item.utterance_id):
            chips.append((f"after {reply.delay_s:.1f} s", "blue"))
        if item.speaker == "robot":
            chips.append((item.origin, ""))
        if not item.said:
            chips.append(("never said", "amber"))
        elif item.state in ("interrupted", "failed"):
            chips.append((item.state, "amber" if item.state == "interrupted" else "red"))
        if item.heard_text is not None:
            chips.append((f"corrected from “{item.heard_text}”", ""))
        chips += [(tag, "") for tag in item.tags]
        at_ns = item.start_ns if item.start_ns is not None else item.requested_ns or 0
        add(at_ns, f"by-{item.speaker}", _SPEAKERS.get(item.speaker, "Somebody"), item.text, chips, said=item.said)
    for mark in data.marks:
        kind = {"wizard_error": ("wizard error", "red"), "note": ("note", "")}.get(mark.kind, ("mark", "amber"))
        lasted = "" if mark.end_ns is None else f" ({duration((mark.end_ns - mark.start_ns) / 1e9)})"
        add(mark.start_ns, "aside", "", f"{mark_words(mark)}{lasted}{f': {mark.note}' if mark.note else ''}", [kind])
    for start_ns, end_ns in data.pauses:
        text = f"The recording was paused for {duration((end_ns - start_ns) / 1e9)}."
        add(start_ns, "aside", "", text, [("pause", "")])
    return sorted(turns, key=itemgetter("at_ns"))
