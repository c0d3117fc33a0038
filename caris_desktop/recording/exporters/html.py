"""HTML report of a session: one self-contained page for screen and print."""

import base64
import logging
import math
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from caris_desktop.domain.actor import in_words
from caris_desktop.domain.events import (
    LATE_FROM_S,
    RESPONSE_LIMIT_S,
    EmergencyStopChanged,
    PreflightChecked,
    Problem,
    RobotChosen,
    ScenarioOpened,
)
from caris_desktop.domain.picture_checks import decoded, jpeg_of
from caris_desktop.domain.sensing import OccupancyGrid, Odometry, RobotPose
from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.annotation.annotation_editing import AnnotationError
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument
from caris_desktop.recording.exporters import drawings
from caris_desktop.recording.exporters.drawings import Curve, Item, Part, Pin, Row, Trajectory, duration_text
from caris_desktop.recording.exporters.formatting import counted
from caris_desktop.recording.exporters.templates import write_own_page, write_page
from caris_desktop.recording.measures.distributions import SummaryStats, per_10_min
from caris_desktop.recording.measures.session_measures import (
    THIS_COMPUTER,
    Delay,
    Measures,
    ModelUse,
    measure,
    read_facts,
)
from caris_desktop.recording.pseudonyms import coding_of
from caris_desktop.recording.replay.session_timeline import SessionTimeline
from caris_desktop.recording.session.scenario_text import ScenarioText, read_scenario
from caris_desktop.recording.session.session_checks import open_words, preflight_of
from caris_desktop.recording.session.session_clock import clock_text
from caris_desktop.recording.session.session_data import SessionData
from caris_desktop.recording.session.session_marks import FinalMark
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session.utterances import SpokenUtterance
from caris_desktop.recording.session_export import ExportContext
from caris_desktop.recording.studies.data_quality import data_quality_problems

_log = logging.getLogger(__name__)
_MAX_PHOTOS = 60
_PHOTO_WIDTH_PX = 480
_MAX_PEOPLE_ROWS = 6
_MAX_WAY_POINTS = 20_000
_SPEAKERS = {"participant": "Participant", "robot": "Robot", "wizard": "Wizard"}
_SOMEBODY = "Somebody"
_SPEAKER_LOOKS = {"participant": "participant", "robot": "robot-speech", "wizard": "note"}
_ORIGINS = {
    "typed": ("Typed by the wizard", "share-0"),
    "phrase": ("Phrases of the scenario", "share-1"),
    "suggestion": ("Suggested replies", "share-2"),
    "assistant": ("Language model", "share-3"),
    "filler": ("Fillers", "share-4"),
    "dictated": ("Dictated by the wizard", "share-6"),
    "own_voice": ("The wizard's own voice", "share-7"),
    "heard": ("Heard", "share-5"),
}
_SOURCES = {
    "keyboard": "Keyboard",
    "gamepad": "Gamepad",
    "onscreen": "On-screen buttons",
    "rehearsal": "Rehearsed script",
    "stop": "Stop",
    "lease": "Safety stop",
    "none": "Not specified",
}
_SEVERITIES = {"error": "red", "warning": "amber", "info": ""}
_USES = {
    "": ("", ""),
    "said": ("said", "green"),
    "edited": ("edited and said", "blue"),
    "dismissed": ("dismissed", ""),
    "unused": ("unused", ""),
}
_CUTS = {"": "", "length": "cut off at the length limit", "filter": "cut off by a filter"}


@dataclass(frozen=True, slots=True)
class _Legend:
    """Entry of a legend: a small drawing and its text."""

    drawing: Markup
    words: str


def write_html(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Write ``report.html`` into the folder ``out``, or what the researcher's template makes.

    Raises OSError, SessionError, ExportError.
    """
    facts = read_facts(session, lambda fraction: context.progress(0.7 * fraction))
    with SessionTimeline(session) as timeline:
        grid = next((value for value in timeline.state_at(session.ended_ns) if isinstance(value, OccupancyGrid)), None)
    context.progress(0.8)
    report = _report(facts, measure(facts), grid)
    context.progress(0.95)
    if context.template is not None:
        path = write_own_page(out, "report", context.template, report=report)
    else:
        path = write_page(out / "report.html", "report.html.j2", report=report)
    context.progress(1.0)
    return [path]


def _report(facts: SessionData, measures: Measures, grid: OccupancyGrid | None) -> dict[str, Any]:
    session = facts.session
    opened = facts.of(ScenarioOpened)
    scenario = read_scenario(opened[-1]) if opened else None
    coding = _coding(session)
    timeline = _Seen(facts, measures, coding)
    return {
        "title": _title(session),
        "study": session.trial.get("study", ""),
        "facts": _facts(facts),
        "tiles": _tiles(measures, session),
        "missing": data_quality_problems(facts, measures),
        "lasts": duration_text(session.duration_s),
        "time_line": timeline.strips(),
        "legend": timeline.legend(),
        **_trajectory(facts, measures, grid, scenario),
        **_responses(measures),
        **_talk(measures),
        **_driving(measures),
        **_protocol(measures),
        **_marks(facts, measures, coding),
        **_models(facts, measures),
        **_photos(facts),
        **_transcript(facts, measures),
        **_problems(facts),
        **_alarms(facts, measures),
        "footer": (
            f"Created by CARIS Desktop from the session {session.folder.name}. Times are minutes and seconds since the"
            " start of the recording."
        ),
    }


# Head


def _title(session: Session) -> str:
    trial = session.trial
    parts = [
        f"Participant {trial['participant']}" if trial.get("participant") else "",
        trial.get("condition", ""),
        f"trial {trial['trial']}" if trial.get("trial") else "",
    ]
    return ", ".join(part for part in parts if part) or session.folder.name


def _facts(facts: SessionData) -> list[tuple[str, str]]:
    session, trial = facts.session, facts.session.trial
    head = session.header
    robots = facts.of(RobotChosen)
    robot = (robots[-1].title or robots[-1].name) if robots else head.robot.profile
    title = _scenarios(facts) or head.scenario.title
    listed = [
        ("When", when_text(session)),
        ("Participant", trial.get("participant", "")),
        ("Condition", trial.get("condition", "")),
        ("Trial", trial.get("trial", "")),
        ("Recording", trial.get("recording", "")),
        ("Wizard", trial.get("wizard", "")),
        ("Purpose", trial.get("purpose", "")),
        ("Scenario", title),
        ("Robot", robot),
        ("Checked before", _checked(facts)),
        ("Session", session.folder.name),
        ("Program", f"CARIS Desktop {head.program_version}".strip()),
    ]
    return [(name, value) for name, value in listed if value]


def _checked(facts: SessionData) -> str:
    """``12 of 14 checks passed. Not passed: Consent form signed (not checked; ticked later)``; empty without any."""
    preflight = preflight_of(facts.of(PreflightChecked))
    if not preflight.checks:
        return ""
    passed = f"{preflight.passed} of {len(preflight.checks)} checks passed"
    not_so = "; ".join(open_words(preflight))
    return f"{passed}. Not passed: {not_so}" if not_so else passed


def _scenarios(facts: SessionData) -> str:
    """``Tour guide, from 2:22 Mental health check``."""
    titles: list[str] = []
    before = ""
    for opened in facts.of(ScenarioOpened):
        if opened.title != before:
            at_s = max(0, round(facts.session.clock.session_s(opened.stamp_ns)))
            titles.append(f"from {at_s // 60}:{at_s % 60:02} {opened.title}" if titles else opened.title)
        before = opened.title
    return ", ".join(titles)


def when_text(session: Session) -> str:
    """``21 November 2026, 10:00 UTC``."""
    utc_ns = session.clock.anchor.utc_ns_at(session.started_ns)
    moment = datetime.fromtimestamp(utc_ns // 1_000_000_000, UTC)
    return f"{moment.day} {moment:%B %Y, %H:%M} UTC"


def _tiles(measures: Measures, session: Session) -> list[dict[str, str]]:
    response_s, distance_m = measures.values["response_time_s"], measures.values["distance_m"]
    tiles = [("length", duration_text(session.duration_s))]
    if response_s is not None:
        tiles.append(("median response time", f"{response_s:.1f} s"))
    if distance_m is not None:
        tiles.append(("driven", distance_text(distance_m)))
    tiles.append(("robot utterances", str(measures["robot_utterances"])))
    for name, one, many in (
        ("people", "person at once", "people at once"),
        ("wizard_errors", "wizard error", "wizard errors"),
        ("emergency_stops", "emergency stop", "emergency stops"),
    ):
        if measures[name] or name == "wizard_errors":
            tiles.append((one if measures[name] == 1 else many, str(measures[name])))
    return [{"label": label, "value": value} for label, value in tiles]


def distance_text(metres: float) -> str:
    """``0.4 m``, ``12 m``, ``1.3 km``."""
    if metres >= 1000:
        return f"{metres / 1000:.1f} km"
    return f"{metres:.1f} m" if metres < 10 else f"{metres:.0f} m"


def spread_text(spread: SummaryStats) -> str:
    """``1.42 ± 0.31 s``; without ± for a single value."""
    return f"{spread.mean:.2f}{'' if spread.sd is None else f' ± {spread.sd:.2f}'} s"


# Time line


class _Seen:
    """Rows of the time line, and the legend of those present."""

    def __init__(self, facts: SessionData, measures: Measures, coding: AnnotationDocument) -> None:
        self._facts = facts
        self._measures = measures
        self._s = facts.session.clock.session_s
        self._coding = coding
        self._css_classes: set[str] = set()
        self._rows = [row for row in self._all_rows() if row.items]

    def strips(self) -> list[Markup]:
        lasts_s = self._facts.session.duration_s
        shades = [self._item(*pause, "pause", "Recording paused") for pause in self._facts.pauses]
        return drawings.time_line(self._rows, self._curves(), shades, lasts_s)

    def legend(self) -> list[_Legend]:
        entries = [
            ("filler", "bar", "filler"),
            ("driven", "bar", "driven by the wizard"),
            ("navigated", "bar", "driving autonomously"),
            ("late", "bar", "protocol step that took longer than expected"),
            ("mark", "diamond", "mark; with a line: an interval"),
            ("error", "triangle", "wizard error"),
            ("trouble", "dot", "problem"),
            ("pause", "bar", "recording paused"),
        ]
        return [
            _Legend(_sample(shape, css_class), words)
            for css_class, shape, words in entries
            if css_class in self._css_classes
        ]

    def _item(
        self, start_ns: int, end_ns: int | None, css_class: str, title: str, shape: drawings.Shape = "bar"
    ) -> Item:
        self._css_classes.add(css_class)
        start_s = self._s(start_ns)
        span = clock_text(start_s) if end_ns is None else f"{clock_text(start_s)} to {clock_text(self._s(end_ns))}"
        return Item(start_s, None if end_ns is None else self._s(end_ns), css_class, f"{span}  {title}", shape)

    def _curves(self) -> list[Curve]:
        values = sorted(self._facts.of(Odometry), key=attrgetter("stamp_ns"))
        if not values:
            return []
        seconds = np.array([self._s(value.stamp_ns) for value in values])
        speed_mps = np.array([math.hypot(value.twist.forward_mps, value.twist.left_mps) for value in values])
        top_mps = max(0.1, float(np.nanmax(speed_mps)))
        return [Curve(f"Speed, up to {top_mps:.1f} m/s", seconds, speed_mps, top_mps, "speed")]

    def _all_rows(self) -> Iterator[Row]:
        facts = self._facts
        for speaker, name in _SPEAKERS.items():
            yield Row(
                name,
                tuple(
                    self._item(
                        item.start_ns, item.end_ns, "filler" if item.origin == "filler" else _SPEAKER_LOOKS[speaker],
                        item.text,
                    )
                    for item in facts.utterances
                    if item.speaker == speaker and item.said and item.start_ns is not None
                ),
            )  # fmt: skip
        moves = [
            self._item(drive.start_ns, drive.end_ns, "driven", _SOURCES.get(drive.source, drive.source))
            for drive in facts.drives
        ]
        moves += [
            self._item(
                stretch.start_ns, stretch.end_ns, "failed-goal" if stretch.label == "failed" else "navigated",
                f"Navigation, {stretch.label}",
            )
            for stretch in self._measures.navigation
        ]  # fmt: skip
        yield Row(
            "Protocol",
            tuple(
                self._item(visit.start_ns, visit.end_ns, "late" if visit.late_s >= LATE_FROM_S else "step", visit.title)
                for visit in facts.step_visits
            ),
        )
        yield Row("Driving", tuple(moves))
        yield from self._people()
        yield Row("Marks", tuple(self._mark(mark) for mark in facts.marks if mark.kind != "wizard_error"))
        yield Row("Wizard errors", tuple(self._mark(mark) for mark in facts.marks if mark.kind == "wizard_error"))
        for tier in self._coding.tiers:
            yield Row(
                tier.name,
                tuple(
                    self._coded(annotation.start_ms, annotation.end_ms, annotation.value)
                    for annotation in self._coding.of_tier(tier.tier_id)
                ),
            )
        troubles = [
            self._item(stretch.start_ns, stretch.end_ns, "trouble", f"Link: {stretch.label}")
            for stretch in self._measures.link_trouble
        ]
        troubles += [
            self._item(problem.stamp_ns, None, "trouble", f"{problem.what} {problem.meaning}", "dot")
            for problem in facts.of(Problem)
            if problem.severity != "info"
        ]
        yield Row("Link, problems", tuple(troubles))

    def _people(self) -> Iterator[Row]:
        by_person: dict[str, list[Item]] = {}
        for visit in self._facts.visits:
            name = f"Person {visit.number or visit.person_id}"
            item = self._item(visit.start_ns, visit.end_ns, "present", f"{name} is present")
            by_person.setdefault(name, []).append(item)
        people = list(by_person.items())
        for name, items in people[:_MAX_PEOPLE_ROWS]:
            yield Row(name, tuple(items))
        rest = [item for _, items in people[_MAX_PEOPLE_ROWS:] for item in items]
        yield Row(f"{len(people) - _MAX_PEOPLE_ROWS} more identities", tuple(rest))

    def _mark(self, mark: FinalMark) -> Item:
        css_class, shape = ("error", "triangle") if mark.kind == "wizard_error" else ("mark", "diamond")
        if mark.kind == "note":
            css_class, shape = "note", "dot"
        words = ": ".join(part for part in (mark_words(mark), mark.note) if part)
        return self._item(mark.start_ns, mark.end_ns, css_class, words, shape)  # type: ignore[arg-type]  # one of the shapes

    def _coded(self, start_ms: int, end_ms: int, value: str) -> Item:
        started_ns = self._facts.session.started_ns
        return self._item(started_ns + start_ms * 1_000_000, started_ns + end_ms * 1_000_000, "coder", value)


def mark_words(mark: FinalMark) -> str:
    """Label of the mark, or its kind."""
    return mark.label or {"wizard_error": "Wizard error", "note": "Note"}.get(mark.kind, "Mark")


def _coding(session: Session) -> AnnotationDocument:
    try:
        return coding_of(session, on_damaged=lambda what: _log.warning("left out of the report: %s", what))
    except AnnotationError as error:
        _log.warning("left out of the report: %s", error)
        return AnnotationDocument()


def _sample(shape: str, css_class: str) -> Markup:
    inside = {
        "bar": Markup('<rect x="1" y="2" width="20" height="10" rx="3" class="{}"/>'),
        "diamond": Markup('<path d="M11 1l6 6l-6 6l-6 -6z" class="{}"/>'),
        "triangle": Markup('<path d="M11 1l6 11h-12z" class="{}"/>'),
        "dot": Markup('<circle cx="11" cy="7" r="4.5" class="{}"/>'),
        "line": Markup('<line x1="1" x2="21" y1="7" y2="7" class="{}"/>'),
    }[shape].format(css_class)
    return Markup('<svg viewBox="0 0 22 14" aria-hidden="true">{}</svg>').format(inside)


# Trajectory on the map


def _trajectory(
    facts: SessionData, measures: Measures, grid: OccupancyGrid | None, scenario: ScenarioText | None
) -> dict[str, Any]:
    poses = [(value.stamp_ns, value.pose_in_map) for value in facts.of(RobotPose)]
    in_map = bool(poses)
    poses = sorted(poses or [(value.stamp_ns, value.pose_in_odom) for value in facts.of(Odometry)], key=itemgetter(0))
    if not poses:
        return {"way": None, "way_fact": "", "way_legend": []}
    stamps_ns = np.array([stamp_ns for stamp_ns, _ in poses], np.int64)
    points = np.array([(pose.x_m, pose.y_m, pose.heading_rad) for _, pose in poses], np.float64)
    headings_rad = points[:, 2] if in_map else _headings(points[:, :2])
    thin = max(1, stamps_ns.size // _MAX_WAY_POINTS)
    by_itself = np.zeros(stamps_ns.size, bool)
    for stretch in measures.navigation:
        by_itself |= (stamps_ns >= stretch.start_ns) & (stamps_ns <= stretch.end_ns)
    places = [drawings.pose_pin(pose, name) for name, pose in scenario.places] if scenario and in_map else []
    way = Trajectory(
        seconds=((stamps_ns - facts.session.started_ns) / 1e9)[::thin],
        points_m=points[::thin, :2],
        headings_rad=headings_rad[::thin],
        by_itself=by_itself[::thin],
        pins=tuple(_pins(facts, stamps_ns, points)),
    )
    distance_m, speed_mps = measures.values["distance_m"], measures.values["max_speed_mps"]
    fact = [distance_text(distance_m)] if distance_m is not None else []
    if speed_mps is not None:
        fact.append(f"at most {speed_mps:.2f} m/s")
    if not in_map:
        fact.append("from odometry, without a map")
    legend = [_Legend(_sample("line", "way"), "driven by the wizard; the colour gets stronger with time")]
    if by_itself.any():
        legend.append(_Legend(_sample("line", "way itself"), "driving autonomously"))
    css_classes = {pin.css_class for pin in way.pins}
    for css_class, shape, words in (
        ("mark", "diamond", "mark"), ("error", "triangle", "wizard error"), ("trouble", "square", "emergency stop"),
        ("note", "dot", "photo"),
    ):  # fmt: skip
        if css_class in css_classes:
            legend.append(_Legend(_sample("bar" if shape == "square" else shape, css_class), words))
    return {
        "way": drawings.path_on_map(way, grid if in_map else None, places),
        "way_fact": " · ".join(fact),
        "way_legend": legend,
    }


def _headings(points: NDArray[np.float64]) -> NDArray[np.float64]:
    if len(points) < 2:
        return np.zeros(len(points))
    steps = np.diff(points, axis=0, append=points[-1:])
    return np.asarray(np.arctan2(steps[:, 1], steps[:, 0]))


def _pins(facts: SessionData, stamps_ns: NDArray[np.int64], points: NDArray[np.float64]) -> Iterator[Pin]:
    def pin(at_ns: int, css_class: str, words: str, shape: Any) -> Iterator[Pin]:
        index = max(0, int(np.searchsorted(stamps_ns, at_ns, side="right")) - 1)
        when = clock_text(facts.session.clock.session_s(at_ns))
        yield Pin(float(points[index, 0]), float(points[index, 1]), css_class, f"{when}  {words}", "", shape)

    for mark in facts.marks:
        if mark.kind == "mark":
            yield from pin(mark.start_ns, "mark", mark_words(mark), "diamond")
        elif mark.kind == "wizard_error":
            yield from pin(mark.start_ns, "error", f"Wizard error: {mark.label}", "triangle")
    for event in facts.of(EmergencyStopChanged):
        if event.latched:
            yield from pin(event.stamp_ns, "trouble", "Emergency stop", "square")
    for photo in facts.photos:
        yield from pin(photo.stamp_ns, "note", "Photo", "dot")


# Response times and talk


def _responses(measures: Measures) -> dict[str, Any]:
    response = SummaryStats.of(measures.response_times_s)
    rows = [
        ("Robot answers participant", response),
        ("… with more than a filler", SummaryStats.of([reply.delay_s for reply in measures.content_responses])),
        ("Wizard reacts", SummaryStats.of([reply.delay_s for reply in measures.reactions])),
        ("Gap before the first sound", SummaryStats.of(measures.gaps_s)),
        *(
            (means, SummaryStats.of([gap.gap_s for gap in measures.gaps if gap.means == means]))
            for means in dict.fromkeys(gap.means for gap in measures.gaps)
        ),
    ]
    return {
        "responses": None
        if response is None
        else drawings.histogram(
            measures.response_times_s, unit="s", median=response.median, title="Response time", css_class="response"
        ),
        "response_fact": "" if response is None else f"median {response.median:.1f} s",
        "response_limit": f"{RESPONSE_LIMIT_S:g}",
        "gaps_s": measures.gaps_s,
        "response_rows": [
            {
                "label": label,
                "n": spread.n,
                "median": f"{spread.median:.2f} s",
                "mean": spread_text(spread),
                "longest": f"{spread.largest:.1f} s",
            }
            for label, spread in rows
            if spread is not None
        ],
    }


def _talk(measures: Measures) -> dict[str, Any]:
    talk_s, utterances, words = (measures.of(name) for name in ("talk_s", "utterances", "words"))
    talked_s = sum(talk_s.values())
    silence_s = max(0.0, measures["recorded_s"] - talked_s)
    parts = [
        Part(_SPEAKERS[speaker], seconds, _SPEAKER_LOOKS[speaker], duration_text(seconds))
        for speaker, seconds in talk_s.items()
    ]
    parts.append(Part("Nobody", silence_s, "silence", duration_text(silence_s)))
    rows: list[dict[str, Any]] = [
        {
            "label": _SPEAKERS[speaker],
            "css_class": _SPEAKER_LOOKS[speaker],
            "time": duration_text(seconds),
            "utterances": utterances[speaker],
            "words": words[speaker],
        }
        for speaker, seconds in talk_s.items()
    ]
    if rows:
        rows.append(
            {"label": "Nobody", "css_class": "silence", "time": duration_text(silence_s), "utterances": "", "words": ""}
        )
    by_origin = measures.of("robot_utterances")
    origins = [
        Part(name, float(by_origin[origin]), css_class, str(by_origin[origin]))
        for origin, (name, css_class) in _ORIGINS.items()
        if origin in by_origin
    ]
    origin_rows = list(origins)
    for name, label in (
        ("interrupted_utterances", "Interrupted"), ("unsaid_utterances", "Requested but never said"),
    ):  # fmt: skip
        if measures[name]:
            origin_rows.append(Part(label, measures[name], "silence", str(measures[name])))
    robot_s = measures["robot_talk_s"]
    return {
        "talk_fact": f"robot: {robot_s / talked_s:.0%} of speech" if talked_s > 0.0 and robot_s > 0.0 else "",
        "talk_bar": drawings.share_bar(parts, title="Speaking time") if rows else Markup(""),
        "talk_rows": rows,
        "origin_bar": drawings.share_bar(origins, title="Origin of the robot's speech"),
        "origin_rows": origin_rows,
    }


# Driving, marks, language model


def _driving(measures: Measures) -> dict[str, Any]:
    by_source, navigating_s = measures.of("driving_s"), measures["navigating_s"]
    distance_m, speed_mps = measures.values["distance_m"], measures.values["max_speed_mps"]
    parts = [
        Part(_SOURCES.get(source, source), seconds, f"share-{min(number, 5)}", duration_text(seconds))
        for number, (source, seconds) in enumerate(by_source.items())
    ]
    if navigating_s:
        parts.append(Part("Driving autonomously", navigating_s, "share-2", duration_text(navigating_s)))
    rows = [{"label": part.label, "css_class": part.css_class, "shown": part.shown} for part in parts]
    if not by_source:
        rows.insert(0, {"label": "Driven by the wizard", "css_class": "", "shown": "never"})

    def add(label: str, value: str) -> None:
        rows.append({"label": label, "css_class": "", "shown": value})

    if distance_m is not None:
        add("Distance", distance_text(distance_m))
    if speed_mps is not None:
        add("Highest speed", f"{speed_mps:.2f} m/s")
    for outcome, count in measures.of("goals").items():
        add(f"Goals {outcome}", str(count))
    add("Stop pressed", str(measures["stops"]))
    add("Emergency stops", str(measures["emergency_stops"]))
    add("Obstacle guard interventions", str(measures["guard_interventions"]))
    if overridden_s := measures.of("guard_s").get("overridden"):
        add("Obstacle guard turned off", duration_text(overridden_s))
    for reason, count in measures.of("drives_ended").items():
        add(f"Driving ended: {reason}", str(count))
    if measures["link_trouble_s"]:
        add("Connection interrupted", duration_text(measures["link_trouble_s"]))
    return {
        "driving_fact": duration_text(measures["driving_s"]) if measures["driving_s"] else "",
        "driving_bar": drawings.share_bar(parts, title="How the robot was driven"),
        "driving_rows": rows,
    }


def _protocol(measures: Measures) -> dict[str, Any]:
    """Protocol section: each step, planned against actual."""
    steps = measures.steps
    several = len({step.scenario for step in steps}) > 1
    late = sum(step.late_s >= LATE_FROM_S for step in steps)
    skipped = sum(step.skipped > 0 for step in steps)
    fact = f"{sum(step.visits > 0 for step in steps)} of {counted(len(steps), 'step')}"
    fact += (f", {skipped} skipped" if skipped else "") + (f", {late} late" if late else "")
    return {
        "steps_fact": fact,
        "step_rows": [
            {
                "number": step.number,
                "title": f"{step.title} ({step.scenario})" if several else step.title,
                "planned": duration_text(step.expected_s) if step.expected_s else "–",
                "actual": duration_text(step.time_s) if step.visits else "not started",
                "visits": step.visits,
                "late": duration_text(step.late_s) if step.late_s >= LATE_FROM_S else "",
                "skipped": "" if not step.skipped else "skipped" if step.skipped == 1 else f"skipped {step.skipped} ×",
                "ticked": f"{step.ticked} of {step.to_tick}" if step.to_tick else "",
            }
            for step in steps
        ],
    }


def _marks(facts: SessionData, measures: Measures, coding: AnnotationDocument) -> dict[str, Any]:
    rows = [
        {"kind": "", "css_class": "", "label": label or "without a label", "shown": str(count)}
        for label, count in sorted(measures.of("marks").items(), key=lambda entry: -entry[1])
    ]
    for label, count in sorted(measures.of("wizard_errors").items(), key=lambda entry: -entry[1]):
        rate = per_10_min(count, measures["recorded_s"])
        text = f"{count} ({rate:.1f} per 10 min)" if rate is not None else str(count)
        rows.append({"kind": "wizard error", "css_class": "red", "label": label or "not specified", "shown": text})
    when = facts.session.clock.session_s
    return {
        "marks_fact": counted(int(measures["marks"]), "mark"),
        "mark_rows": rows,
        "notes": [
            {"time": clock_text(when(mark.start_ns)), "text": mark.note or mark_words(mark)}
            for mark in facts.marks
            if mark.kind == "note" or mark.note
        ],
        "coder_rows": [
            {
                "tier": tier.name,
                "coder": tier.coder,
                "count": len(made),
                "time": duration_text(sum(item.end_ms - item.start_ms for item in made) / 1000),
            }
            for tier in coding.tiers
            if (made := coding.of_tier(tier.tier_id))
        ],
    }


def _models(facts: SessionData, measures: Measures) -> dict[str, Any]:
    when = facts.session.clock.session_s
    accepted = sum(model.said + model.edited for model in measures.models)
    answered = sum(model.answered for model in measures.models)
    return {
        "models": [
            {
                "name": model_name(model),
                "asked": model.asked,
                "answered": model.answered,
                "said": model.said,
                "edited": model.edited,
                "dismissed": model.dismissed,
                "unused": model.unused,
                "accepted": "–" if model.accepted_fraction is None else f"{model.accepted_fraction:.0%}",
                "first_token": _median_text(model.first_token_s),
                "whole": _median_text(model.answer_s),
            }
            for model in measures.models
        ],
        "model_fact": f"{accepted} of {counted(answered, 'answer')} accepted",
        "exchange_summary": f"All {len(facts.answers)} exchanges" if len(facts.answers) != 1 else "The exchange",
        "exchanges": [
            {
                "time": clock_text(when(exchange.asked_ns)),
                "asked": exchange.messages[-1].content if exchange.messages else "",
                "answer": exchange.answer or exchange.detail,
                "cut": _CUTS[exchange.cut],
                "use": _USES[answer.use][0] or exchange.outcome,
                "css_class": "red" if exchange.outcome == "failed" else _USES[answer.use][1],
            }
            for answer in facts.answers
            for exchange in (answer.exchange,)
        ],
    }


def model_name(model: ModelUse) -> str:
    """``smollm2-135m, q8_0 (embedded, on this computer)``, ``gpt-4o (openai, at api.openai.com)``."""
    named = ", ".join(part for part in (model.model, model.version) if part) or "not specified"
    where = f"on {model.place}" if model.place == THIS_COMPUTER else f"at {model.place}"
    kind = ", ".join(part for part in (model.provider, where if model.place else "server not specified") if part)
    return f"{named} ({kind})"


def _median_text(values_s: Sequence[float]) -> str:
    spread = SummaryStats.of(values_s)
    return "–" if spread is None else f"{spread.median:.2f} s"


# Photos, transcript, problems


def _photos(facts: SessionData) -> dict[str, Any]:
    photos = facts.photos
    when = facts.session.clock.session_s
    photo_rows = [
        {
            "time": clock_text(when(photo.stamp_ns)),
            "data": data,
            "words": photo.file_name if data else "cannot be shown",
        }
        for photo in photos[:_MAX_PHOTOS]
        for data in [_thumbnail(facts.session.folder, photo.file_name)]
    ]
    fact = counted(len(photos), "photo")
    if len(photos) > _MAX_PHOTOS:
        fact += f", the first {_MAX_PHOTOS} are shown"
    return {"photos": photo_rows, "photos_fact": fact}


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


def _transcript(facts: SessionData, measures: Measures) -> dict[str, Any]:
    replies = {reply.utterance_id: reply for reply in measures.responses}
    turns = [*_turns(facts.utterances, replies), *_asides(facts)]
    turns.sort(key=lambda turn: turn["at_ns"])
    when = facts.session.clock.session_s
    for turn in turns:
        turn["time"] = clock_text(when(turn["at_ns"]))
    spoken_count = sum(utterance.said for utterance in facts.utterances)
    return {"turns": turns if facts.utterances else [], "transcript_fact": counted(spoken_count, "utterance")}


def _turns(utterances: Iterable[SpokenUtterance], replies: dict[str, Delay]) -> Iterator[dict[str, Any]]:
    for item in utterances:
        if not item.said and item.origin == "heard" and not item.text:
            continue  # without a speaker
        chips = []
        reply = replies.get(item.utterance_id)
        if reply is not None:
            chips.append({"text": f"after {reply.delay_s:.1f} s", "css_class": "blue"})
        if item.speaker == "robot":
            chips.append({"text": item.origin, "css_class": ""})
        if not item.said:
            chips.append({"text": "never said", "css_class": "amber"})
        elif item.state in ("interrupted", "failed"):
            chips.append({"text": item.state, "css_class": "amber" if item.state == "interrupted" else "red"})
        if item.heard_text is not None:
            chips.append({"text": f"corrected from “{item.heard_text}”", "css_class": ""})
        chips += [{"text": tag, "css_class": ""} for tag in item.tags]
        yield {
            "at_ns": item.start_ns if item.start_ns is not None else item.requested_ns or 0,
            "css_class": f"by-{item.speaker}",
            "who": _SPEAKERS.get(item.speaker, _SOMEBODY),
            "text": item.text,
            "chips": chips,
            "unsaid": not item.said,
        }


def _asides(facts: SessionData) -> Iterator[dict[str, Any]]:
    def aside(at_ns: int, text: str, label: str) -> dict[str, Any]:
        chips = [{"text": label, "css_class": {"wizard error": "red", "mark": "amber"}.get(label, "")}]
        return {"at_ns": at_ns, "css_class": "aside", "who": "", "text": text, "chips": chips, "unsaid": False}

    for mark in facts.marks:
        kind = {"wizard_error": "wizard error", "note": "note"}.get(mark.kind, "mark")
        lasted = "" if mark.end_ns is None else f" ({duration_text((mark.end_ns - mark.start_ns) / 1e9)})"
        note = f": {mark.note}" if mark.note else ""
        yield aside(mark.start_ns, f"{mark_words(mark)}{lasted}{note}", kind)
    for start_ns, end_ns in facts.pauses:
        yield aside(start_ns, f"The recording was paused for {duration_text((end_ns - start_ns) / 1e9)}.", "pause")


def _alarms(facts: SessionData, measures: Measures) -> dict[str, Any]:
    """Alarms section: cause, duration and end of each."""
    when = facts.session.clock.session_s
    alarms = measures.alarms
    ended = {True: "active until the end", False: "ended automatically"}
    return {
        "alarms_fact": f"{counted(len(alarms), 'alarm')}, {duration_text(sum(alarm.stood_s for alarm in alarms))}",
        "alarms": [
            {
                "time": clock_text(when(alarm.start_ns)),
                "severity": alarm.severity,
                "css_class": _SEVERITIES[alarm.severity],
                "text": alarm.what + ("" if alarm.times == 1 else f" ({alarm.times} times)"),
                "stood": duration_text(alarm.stood_s),
                "ended": f"dismissed by {in_words(alarm.seen_to_by)}"
                if alarm.seen_to_by
                else ended[alarm.end_ns is None],
            }
            for alarm in alarms
        ],
    }


def _problems(facts: SessionData) -> dict[str, Any]:
    problems = [problem for problem in facts.of(Problem) if problem.severity != "info"]
    when = facts.session.clock.session_s
    return {
        "problems_fact": counted(len(problems), "problem"),
        "problems": [
            {
                "time": clock_text(when(problem.stamp_ns)),
                "severity": problem.severity,
                "css_class": _SEVERITIES[problem.severity],
                "text": " ".join(part for part in (problem.what, problem.meaning) if part),
            }
            for problem in problems
        ],
    }
