"""HTML report of a session: one self-contained page for screen and print."""

import base64
import logging
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

import numpy as np

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
from caris_desktop.recording.annotation.annotation_editing import AnnotationError
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument
from caris_desktop.recording.exporters import drawings
from caris_desktop.recording.exporters.drawings import Curve, Item, Pin, Shape, Trajectory
from caris_desktop.recording.exporters.formatting import duration
from caris_desktop.recording.exporters.methods_facts import by_means
from caris_desktop.recording.exporters.templates import write_own_page, write_page
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
    rows = [(name, [_item(session, *each) for each in spans]) for name, spans in _rows(data, measures, coding)]
    shades = [_item(session, *pause, "pause", "Recording paused") for pause in data.pauses]
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
        "time_line": drawings.time_line(rows, _speed(data), shades, session.duration_s),
        "looks": {item.look for _, items in (*rows, ("", shades)) for item in items},
        "map": _map(data, measures, grid),
        "responses_s": measures.response_times_s,
        "content_responses_s": [reply.delay_s for reply in measures.content_responses],
        "reactions_s": [reply.delay_s for reply in measures.reactions],
        "gaps_s": measures.gaps_s,
        "gaps_by_means": by_means(measures.gaps),
        "response_limit_s": RESPONSE_LIMIT_S,
        "histogram": drawings.histogram(measures.response_times_s) if measures.response_times_s else None,
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

_Span = tuple[int, int | None, str, str] | tuple[int, int | None, str, str, Shape]
"""Start, end or None, look, title and shape."""


def _item(  # noqa: PLR0917 - an item as it is drawn
    session: Session, start_ns: int, end_ns: int | None, look: str, title: str, shape: Shape = "bar"
) -> Item:
    start_s, end_s = session.clock.session_s(start_ns), None if end_ns is None else session.clock.session_s(end_ns)
    span = clock_text(start_s) if end_s is None else f"{clock_text(start_s)} to {clock_text(end_s)}"
    return Item(start_s, end_s, look, f"{span}  {title}", shape)


def _speed(data: SessionData) -> Curve | None:
    values = sorted(data.of(Odometry), key=attrgetter("stamp_ns"))
    if not values:
        return None
    seconds = np.array([data.session.clock.session_s(value.stamp_ns) for value in values])
    speed_mps = np.array([math.hypot(value.twist.forward_mps, value.twist.left_mps) for value in values])
    top_mps = max(0.1, float(np.nanmax(speed_mps)))
    return Curve(f"Speed, up to {top_mps:.1f} m/s", seconds, speed_mps, top_mps)


def _rows(data: SessionData, measures: Measures, coding: AnnotationDocument) -> Iterator[tuple[str, list[_Span]]]:
    """Rows of the timeline; some may be empty."""
    for speaker, name in _SPEAKERS.items():
        yield name, [
            (item.start_ns, item.end_ns, "filler" if item.origin == "filler" else _SPEAKER_LOOKS[speaker], item.text)
            for item in data.utterances
            if item.speaker == speaker and item.said and item.start_ns is not None
        ]  # fmt: skip
    visits = ((visit, "late" if visit.late_s >= LATE_FROM_S else "step") for visit in data.step_visits)
    yield "Protocol", [(visit.start_ns, visit.end_ns, look, visit.title) for visit, look in visits]
    goals = ((goal, "failed-goal" if goal.label == "failed" else "navigated") for goal in measures.navigation)
    yield "Driving", [
        *((drive.start_ns, drive.end_ns, "driven", _SOURCES.get(drive.source, drive.source)) for drive in data.drives),
        *((goal.start_ns, goal.end_ns, look, f"Navigation, {goal.label}") for goal, look in goals),
    ]  # fmt: skip
    people: dict[str, list[_Span]] = {}
    for visit in data.visits:
        name = f"Person {visit.number or visit.person_id}"
        people.setdefault(name, []).append((visit.start_ns, visit.end_ns, "present", f"{name} is present"))
    yield from list(people.items())[:_MAX_PEOPLE_ROWS]
    rest = [span for spans in list(people.values())[_MAX_PEOPLE_ROWS:] for span in spans]
    yield f"{len(people) - _MAX_PEOPLE_ROWS} more identities", rest
    yield "Marks", [_mark(mark) for mark in data.marks if mark.kind != "wizard_error"]
    yield "Wizard errors", [_mark(mark) for mark in data.marks if mark.kind == "wizard_error"]
    for tier in coding.tiers:
        coded = ((one, one.start_ms * 1_000_000, one.end_ms * 1_000_000) for one in coding.of_tier(tier.tier_id))
        started_ns = data.session.started_ns
        yield tier.name, [(started_ns + start, started_ns + end, "coder", one.value) for one, start, end in coded]
    yield "Link, problems", [
        *((one.start_ns, one.end_ns, "trouble", f"Link: {one.label}") for one in measures.link_trouble),
        *((one.stamp_ns, None, "trouble", f"{one.what} {one.meaning}", "dot") for one in _problems(data)),
    ]  # fmt: skip


def _mark(mark: FinalMark) -> _Span:
    looks: dict[str, tuple[str, Shape]] = {"wizard_error": ("error", "triangle"), "note": ("note", "dot")}
    look, shape = looks.get(mark.kind, ("mark", "diamond"))
    words = ": ".join(part for part in (mark_words(mark), mark.note) if part)
    return mark.start_ns, mark.end_ns, look, words, shape


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
    drawing = drawings.path_on_map(way, grid if in_map else None, places, pins)
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
