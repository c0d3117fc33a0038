"""Tidy tables of a session: table list, columns with meanings, and rows in one pass over the recording.

Tables of streams and events derive from the stream table; those combined from several events (utterances, marks,
annotations) are listed here.

Long because it holds every table with its columns.
"""

import dataclasses
import json
import logging
import math
import re
import typing
from collections.abc import Callable, Iterable, Iterator
from enum import Enum
from typing import Any, Literal, get_args, get_origin

import numpy as np

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.schema import array_dtype, to_jsonable
from caris_desktop.domain.streams import StreamSpec
from caris_desktop.domain.type_hints import union_members, without_alias
from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.session.answers import answer_uses, questions_of
from caris_desktop.recording.session.goals import navigation_goals
from caris_desktop.recording.session.pauses import pauses_of
from caris_desktop.recording.session.responses import Response, responses
from caris_desktop.recording.session.robot_clock_mapping import Measured, RobotClock, robot_clock
from caris_desktop.recording.session.session_alarms import alarms_of
from caris_desktop.recording.session.session_clock import SessionClock
from caris_desktop.recording.session.session_marks import FinalMark, final_marks
from caris_desktop.recording.session.session_protocol import read_protocol
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session.session_visits import VISIT_STREAMS, visits_of
from caris_desktop.recording.session.utterances import SpokenUtterance, spoken
from caris_desktop.recording.session_export import ExportContext

_log = logging.getLogger(__name__)

Kind = Literal[
    "integer",
    "number",
    "text",
    "true or false",
    "json",
    "utc",
    "integers",
    "numbers",
    "texts",
    "points",
    "cells",
    "depths",
]
"""What the values of a column are in Python: utc is nanoseconds since 1970; numbers, points, cells (int8) and depths
(uint16) are arrays.
"""
ClockName = Literal["", "session", "UTC", "robot"]

_UNITS = {
    "ns": "nanoseconds",
    "ms": "milliseconds",
    "s": "seconds",
    "m": "metres",
    "mm": "millimetres",
    "mps": "metres per second",
    "rad": "radians",
    "radps": "radians per second",
    "px": "pixels",
    "hz": "hertz",
    "bytes": "bytes",
    "fraction": "0 to 1",
}
# Columns before or after those of a value's own fields, here or in one of the formats.
_RESERVED = (
    "session",
    "participant",
    "condition",
    "trial",
    "session_s",
    "utc",
    "stamp_ns",
    "arrived_session_s",
    "number",
)
_MEANINGS = {
    "actor": (
        "Actor: wizard (of this computer), wizard:NAME (another wizard), console, model or script. Empty: "
        "another actor, or not recorded, as before version 3."
    ),
    "bytes_per_s": "Bytes per second.",
    "cut": "Why the answer is incomplete; empty if it is complete.",
    "edit_distance": "Number of characters that the wizard changed.",
    "expected_s": "Expected time.",
    "fps": "Frames per second.",
    "from_person_id": "Id of the person to whom the visit belonged before.",
    "gap_s": "Time from the end of the participant's voice to the robot's first sound.",
    "heard_text": "Transcript before a correction.",
    "how": "How the step was entered.",
    "inference_ms": "Time of the detection.",
    "into_person_id": "Id of the person into whom the other was merged.",
    "is_person_id": "Id of the known person.",
    "late_s": "Time beyond the expected time.",
    "left": "How the step was left.",
    "left_step_id": "Id of the step that was left.",
    "means": "How the reply was made.",
    "number": "Number of the person or step.",
    "on": "True: ticked off; false: unticked.",
    "open_at_end": "The interval was not ended before the end of the session.",
    "person_by": "Who identified the person.",
    "rewritten": "The note was changed.",
    "runner_up": "Confidence of the next best match.",
    "runner_up_id": "Id of the next best match.",
    "seen_s": "Time from the start of the visit to the last detection.",
    "seen_to_by": "Actor who resolved the alarm.",
    "sha256": "SHA-256 checksum of the file.",
    "stood_s": "Time for which the alarm was active, without pauses.",
    "tick": "Checklist items.",
    "ticked": "Number of checklist items that were ticked off.",
    "times": "How often the alarm was raised.",
    "to_tick": "Number of checklist items.",
    "told": "A problem was reported before.",
    "took_s": "Time that the step took.",
    "turn_over": "Probability that the turn is over.",
    "until": "What ends the problem.",
    "use": "What became of the answer.",
}
# Damaged stamps: nothing is recorded a century away from its session, and calendars have limits.
_FARTHEST_NS = 100 * 365 * 86_400 * 1_000_000_000
_HALVES = re.compile("[\ud800-\udfff]")
_PROGRESS_EVERY_ROWS = 500


@dataclass(frozen=True, slots=True)
class RowTimes:
    """Turns stamps into what the time columns show. ``arrival_ns`` is when the value of the row reached the console."""

    clock: SessionClock
    robot: RobotClock
    arrival_ns: int | None = None

    def session_s(self, stamp_ns: int | None) -> float | None:
        return None if stamp_ns is None else round(self.clock.session_s(stamp_ns), 6)

    def measured(self, value: Any) -> Measured | None:
        return self.robot.measured(value.robot_stamp_ns, arrival_ns=value.stamp_ns)


@dataclass(frozen=True, slots=True)
class Column:
    """One column. ``read`` takes the dataclass of a row; ``clock`` is the one that a time is told by."""

    name: str
    unit: str
    kind: Kind
    description: str
    read: Callable[[Any, RowTimes], Any]
    clock: ClockName = ""


@dataclass(frozen=True, slots=True)
class Table:
    """One table. ``items`` gives the rows, as dataclasses for ``columns``, that one recorded value makes.

    ``time_columns`` precede them, and tell when that value was.
    """

    name: str
    description: str
    own_columns: tuple[Column, ...]
    items: Callable[[Any], Iterable[Any]] = lambda value: (value,)
    time_columns: tuple[Column, ...] = ()

    @property
    def columns(self) -> tuple[Column, ...]:
        return self.time_columns + self.own_columns

    def rows(self, value: Any, times: RowTimes) -> Iterator[list[Any]]:
        head = [column.read(value, times) for column in self.time_columns]
        for item in self.items(value):
            yield [*head, *(column.read(item, times) for column in self.own_columns)]


def key_columns(session: Session) -> tuple[Column, ...]:
    """Leading columns of every row, in formats whose files are joined across sessions."""
    trial = session.trial
    columns = (
        ("session", "Name of the session folder.", session.folder.name),
        ("participant", "The participant, as entered at the start.", trial.get("participant", "")),
        ("condition", "The condition, as entered at the start.", trial.get("condition", "")),
        ("trial", "The trial, as entered at the start.", trial.get("trial", "")),
    )
    return tuple(_constant(name, description, plain_text(value)) for name, description, value in columns)


def _constant(name: str, description: str, value: str) -> Column:
    return Column(name, "", "text", description, lambda _row, _times: value)


TIME_COLUMNS = (
    Column(
        "session_s",
        "seconds",
        "number",
        "Time since the start of the session; negative: known before the start.",
        lambda value, times: times.session_s(value.stamp_ns),
        "session",
    ),
    Column(
        "utc",
        "",
        "utc",
        "The same time in UTC, from the clock of this computer at the start of the session.",
        lambda value, times: times.clock.anchor.utc_ns_at(value.stamp_ns),
        "UTC",
    ),
    Column(
        "stamp_ns",
        "nanoseconds",
        "integer",
        "The same time on the session's monotonic clock, for joining tables.",
        lambda value, _times: value.stamp_ns,
        "session",
    ),
)
STREAM_TIME_COLUMNS = (
    *TIME_COLUMNS,
    Column(
        "arrived_session_s",
        "seconds",
        "number",
        "Arrival time at the console, since the start of the session; rows are in this order.",
        lambda _value, times: times.session_s(times.arrival_ns),
        "session",
    ),
)


def session_rows(session: Session, context: ExportContext) -> Iterator[tuple[Table, list[Any]]]:
    """All rows of all tables except the dictionary, in one pass; rows of a table in recording order.

    Tables without rows do not occur. Raises SessionError, OSError.
    """
    times = RowTimes(session.clock, robot_clock(session))
    for value in _about(session, times.robot):
        yield from _rows_of(SESSION_TABLE, value, times)
    for utterance in spoken(session):
        yield from _rows_of(UTTERANCES_TABLE, _UtteranceRow.of(utterance, session), times)
    for response in responses(session):
        yield from _rows_of(RESPONSES_TABLE, _ResponseRow.of(response), times)
    for mark in final_marks(session):
        yield from _rows_of(MARKS_TABLE, _MarkRow.of(mark), times)
    for goal in _goal_rows(session):
        yield from _rows_of(GOALS_TABLE, goal, times)
    for alarm in _alarm_rows(session):
        yield from _rows_of(ALARMS_TABLE, alarm, times)
    for answer in _answer_rows(session):
        yield from _rows_of(ANSWERS_TABLE, answer, times)
    for step in _step_rows(session):
        yield from _rows_of(PROTOCOL_TABLE if isinstance(step, _StepRow) else STEP_VISITS_TABLE, step, times)
    for visit in _visit_rows(session):
        yield from _rows_of(VISITS_TABLE, visit, times)
    for annotation in _annotation_rows(session, context):
        yield from _rows_of(ANNOTATIONS_TABLE, annotation, times)
    whole_ns = max(1, session.ended_ns - session.started_ns)
    tables: dict[str, tuple[Table, ...]] = {}
    for number, (arrival_ns, spec, value) in enumerate(session.arrivals()):
        if not isinstance(value.stamp_ns, int) or abs(value.stamp_ns - session.started_ns) > _FARTHEST_NS:
            _log.warning("a value of %s has no usable stamp and is left out", spec.name)
            continue
        if spec.name not in tables:
            tables[spec.name] = tables_of(spec)
        times = dataclasses.replace(times, arrival_ns=arrival_ns)
        for table in tables[spec.name]:
            yield from _rows_of(table, value, times)
        if number % _PROGRESS_EVERY_ROWS == 0:
            context.progress(min(0.99, max(0.0, (value.stamp_ns - session.started_ns) / whole_ns)))


def dictionary_rows(tables: Iterable[Table], whose: tuple[Column, ...] = ()) -> Iterator[list[Any]]:
    """Rows of DICTIONARY_TABLE for these tables; ``whose`` are their common leading columns."""
    for table in tables:
        yield [table.name, "", "", "table", "", table.description]
        for column in (*whose, *table.columns):
            yield [table.name, column.name, column.unit, column.kind, column.clock, column.description]


def tables_of(spec: StreamSpec) -> tuple[Table, ...]:
    """Table of one stream, and one for each of its fields that holds a list of records."""
    name = spec.name.replace("/", "_")
    columns = tuple(_columns(spec.value_type))
    tables = [Table(name, _doc(spec.value_type), columns, time_columns=STREAM_TIME_COLUMNS)]
    for field, hint in _fields(spec.value_type):
        item_type = _record_list(hint)
        if item_type is not None:
            tables.append(_list_table(name, field, item_type))
    return tuple(tables)


def plain_text(text: str) -> str:
    """``text`` without lone surrogates, which JSON can hold and UTF-8 cannot."""
    return text if text.isascii() else _HALVES.sub("\N{REPLACEMENT CHARACTER}", text)


# Combined tables


@dataclass(frozen=True, slots=True)
class _Fact:
    """One line about the session as a whole."""

    key: str
    value: str


@dataclass(frozen=True, slots=True)
class _UtteranceRow:
    """One utterance with the times of its request, start and end. The time columns give its start, or its request if it
    was never spoken. ``said``: at least a part was audible. Text, speaker and person include corrections.
    ``heard_text`` is the transcript before a correction, else empty. An empty speaker: not sure. ``estimated``: start
    or end is inexact. ``person_by`` identified the participant: a wizard, the console, or ``record``, if the record
    shows that nobody else was present. ``person_confidence`` is the likelihood, 0 to 1, empty if a wizard identified
    them.
    """

    stamp_ns: int
    utterance_id: str
    speaker: str
    text: str
    origin: str
    said: bool
    state: str
    duration_s: float | None
    requested_ns: int | None
    start_ns: int | None
    end_ns: int | None
    voice: str
    detail: str
    actor: Actor
    person_id: str
    heard_text: str | None
    tags: tuple[str, ...]
    confidence: float | None
    language: str
    estimated: bool
    person_by: str
    person_confidence: float | None

    @classmethod
    def of(cls, utterance: SpokenUtterance, session: Session) -> "_UtteranceRow":
        known = (utterance.start_ns, utterance.requested_ns, session.started_ns)
        lasted = utterance.start_ns is not None and utterance.end_ns is not None
        return cls(
            stamp_ns=next(stamp_ns for stamp_ns in known if stamp_ns is not None),
            utterance_id=utterance.utterance_id,
            speaker=utterance.speaker,
            text=utterance.text,
            origin=utterance.origin,
            said=utterance.said,
            state=utterance.state,
            duration_s=round(((utterance.end_ns or 0) - (utterance.start_ns or 0)) / 1e9, 6) if lasted else None,
            requested_ns=utterance.requested_ns,
            start_ns=utterance.start_ns,
            end_ns=utterance.end_ns,
            voice=utterance.voice,
            detail=utterance.detail,
            actor=utterance.actor,
            person_id=utterance.person_id,
            heard_text=utterance.heard_text,
            tags=utterance.tags,
            confidence=utterance.confidence,
            language=utterance.language,
            estimated=utterance.estimated,
            person_by=utterance.person_by,
            person_confidence=utterance.person_confidence,
        )


@dataclass(frozen=True, slots=True)
class _ResponseRow:
    """One response to a turn of the participant. The time columns give the robot's first sound. ``gap_s`` is from the
    end of the participant's voice, negative if the robot spoke over it. ``first``: nothing preceded it, such as a
    filler.
    """

    stamp_ns: int
    turn_id: str
    reply_id: str
    means: str
    first: bool
    gap_s: float
    voice_ended_ns: int
    text_ns: int | None
    suggested_ns: int | None
    asked_ns: int | None
    first_sound_ns: int
    person_id: str

    @classmethod
    def of(cls, response: Response) -> "_ResponseRow":
        return cls(
            response.first_sound_ns, response.turn_id, response.reply_id, response.means, response.first,
            response.gap_s, response.voice_ended_ns, response.text_ns, response.suggested_ns,
            response.asked_ns, response.first_sound_ns, response.person_id,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _MarkRow:
    """One mark in its final state; withdrawn ones are only in event_marked. The time columns give the moment meant.
    ``open_at_end``: an interval without an end, which ends with the session. ``tags`` are the words of the note that
    begin with #. ``rewritten``: the note was changed; earlier texts are in event_marked.
    """

    stamp_ns: int
    mark_id: str
    label: str
    kind: str
    note: str
    end_ns: int | None
    duration_s: float | None
    marked_ns: int
    open_at_end: bool
    actor: Actor
    tags: tuple[str, ...]
    rewritten: bool

    @classmethod
    def of(cls, mark: FinalMark) -> "_MarkRow":
        duration_s = None if mark.end_ns is None else round((mark.end_ns - mark.start_ns) / 1e9, 6)
        return cls(
            mark.start_ns, mark.mark_id, mark.label, mark.kind, mark.note, mark.end_ns, duration_s, mark.marked_ns,
            mark.open_at_end, mark.actor, mark.tags, mark.rewritten,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _GoalRow:
    """One navigation goal of the recording. The time columns give its request. ``end_ns`` is empty if it was still
    active; ``state`` is the last one.
    """

    stamp_ns: int
    goal_id: str
    place: str | None
    target_in_map: Pose2D
    state: str
    end_ns: int | None
    duration_s: float | None
    actor: Actor


@dataclass(frozen=True, slots=True)
class _AlarmRow:
    """One alarm: a problem that needed attention. The time columns give when it was first raised, or the start of the
    recording. ``end_ns`` is its last end, empty if it was active to the end. ``stood_s`` is its active time without
    pauses, ``times`` how often it was raised. ``seen_to_by`` resolved it, empty if it ended automatically.
    """

    stamp_ns: int
    alarm_id: str
    cause: str
    severity: str
    what: str
    end_ns: int | None
    stood_s: float
    times: int
    seen_to_by: Actor


@dataclass(frozen=True, slots=True)
class _AnswerRow:
    """Use of the answer to one question to a language model. The time columns give the end of the exchange. ``use`` is
    said, edited (and said), dismissed or unused; an answer silenced before it was audible is unused. ``cut``: the
    answer is incomplete: length limit, or the server's filter.
    """

    stamp_ns: int
    exchange_id: str
    provider: str
    model: str
    model_version: str
    outcome: str
    use: str
    cut: str
    asked_ns: int
    first_token_ns: int | None
    actor: Actor


@dataclass(frozen=True, slots=True)
class _VisitRow:
    """Interval during which a person was present. The time columns give its start. ``person_number`` is that of "Person
    3" on the screen. One person who was lost and found again may have several ids. ``end_ns`` is when the person
    counted as gone, some seconds after the last detection (``last_seen_ns``; empty if not recorded).
    """

    stamp_ns: int
    person_id: str
    person_number: int | None
    end_ns: int
    duration_s: float
    last_seen_ns: int | None
    seen_s: float | None


@dataclass(frozen=True, slots=True)
class _StepRow:
    """One step of the protocol, planned against actual. The time columns give its first start, or that of the session
    if it never started. ``visits`` counts its starts, without returns to it. ``expected_s`` is the planned time of
    each, 0 if none. ``time_s`` is the total time without pauses, ``late_s`` the total overrun. ``skipped`` is a count,
    too. ``ticked`` of ``to_tick`` items were ticked off.
    """

    stamp_ns: int
    step_id: str
    title: str
    step_number: int
    visits: int
    expected_s: float
    time_s: float
    late_s: float
    skipped: int
    ticked: int
    to_tick: int


@dataclass(frozen=True, slots=True)
class _StepVisitRow:
    """One interval in a step of the protocol. The time columns give its start. ``how`` it was entered and ``left``,
    which is empty if the session ended in it. ``time_s`` excludes pauses. ``late_s`` is the time beyond what was
    expected, with the earlier time in the step if the wizard came back to it.
    """

    stamp_ns: int
    step_id: str
    title: str
    step_number: int
    end_ns: int
    how: str
    left: str
    branch: str
    time_s: float
    expected_s: float
    late_s: float
    actor: Actor


def _step_rows(session: Session) -> Iterator[_StepRow | _StepVisitRow]:
    visits, steps = read_protocol(session)
    for step in steps:
        began_ns = session.started_ns if step.first_ns is None else step.first_ns
        yield _StepRow(
            began_ns, step.step_id, step.title, step.number, step.visits, step.expected_s, round(step.time_s, 6),
            round(step.late_s, 6), step.skipped, step.ticked, step.to_tick,
        )  # fmt: skip
    for one in visits:
        yield _StepVisitRow(
            one.start_ns, one.step_id, one.title, one.number, one.end_ns, one.how, one.left, one.branch,
            round(one.time_s, 6), one.expected_s, round(one.late_s, 6), one.actor,
        )  # fmt: skip


def _goal_rows(session: Session) -> Iterator[_GoalRow]:
    events = [value for _, value in session.values("event/goal_changed")]
    for goal in navigation_goals(events, started_ns=session.started_ns, pauses=_pauses(session)):
        duration_s = None if goal.end_ns is None else round((goal.end_ns - goal.start_ns) / 1e9, 6)
        yield _GoalRow(
            goal.start_ns, goal.goal_id, goal.place, goal.target_in_map, goal.state, goal.end_ns, duration_s, goal.actor
        )


def _alarm_rows(session: Session) -> Iterator[_AlarmRow]:
    events = [value for _, value in session.values("event/alarm_changed")]
    for one in alarms_of(events, ended_ns=session.ended_ns, pauses=_pauses(session)):
        yield _AlarmRow(
            one.start_ns, one.alarm_id, one.cause, one.severity, one.what, one.end_ns, round(one.stood_s, 6), one.times,
            one.seen_to_by,
        )  # fmt: skip


def _answer_rows(session: Session) -> Iterator[_AnswerRow]:
    exchanges = questions_of(value for _, value in session.values("event/llm_exchange"))
    uses = [value for _, value in session.values("event/answer_used")]
    became = answer_uses(exchanges, uses, spoken(session)) if exchanges else {}
    for one in exchanges:
        yield _AnswerRow(
            one.stamp_ns, one.exchange_id, one.provider, one.model, one.model_version, one.outcome,
            became[one.exchange_id] if one.outcome == "answered" else "", one.cut, one.asked_ns, one.first_token_ns,
            one.actor,
        )  # fmt: skip


def _visit_rows(session: Session) -> Iterator[_VisitRow]:
    events = [value for _, value in session.values(*VISIT_STREAMS)]
    for visit in visits_of(events, started_ns=session.started_ns, ended_ns=session.ended_ns, pauses=_pauses(session)):
        duration_s = round((visit.end_ns - visit.start_ns) / 1e9, 6)
        seen_s = None if visit.last_seen_ns is None else round((visit.last_seen_ns - visit.start_ns) / 1e9, 6)
        yield _VisitRow(
            visit.start_ns, visit.person_id, visit.number or None, visit.end_ns, duration_s, visit.last_seen_ns, seen_s
        )  # fmt: skip


def _pauses(session: Session) -> list[tuple[int, int]]:
    return pauses_of((value for _, value in session.values("event/recording_paused")), ended_ns=session.ended_ns)


@dataclass(frozen=True, slots=True)
class _AnnotationRow:
    """One label that a coder gave to an interval of the session. The time columns give its start."""

    stamp_ns: int
    coder: str
    tier: str
    value: str
    end_ns: int
    duration_s: float
    vocabulary: str
    tier_id: str
    annotation_id: str


def _annotation_rows(session: Session, context: ExportContext) -> Iterator[_AnnotationRow]:
    from caris_desktop.recording.pseudonyms import coding_of

    document = coding_of(session, on_damaged=context.warn)
    tiers = {tier.tier_id: tier for tier in document.tiers}
    for one in document.annotations:
        tier = tiers[one.tier_id]
        yield _AnnotationRow(
            stamp_ns=session.started_ns + one.start_ms * 1_000_000,
            coder=tier.coder,
            tier=tier.name,
            value=one.value,
            end_ns=session.started_ns + one.end_ms * 1_000_000,
            duration_s=(one.end_ms - one.start_ms) / 1e3,
            vocabulary=tier.vocabulary,
            tier_id=one.tier_id,
            annotation_id=one.annotation_id,
        )


def _about(session: Session, robot: RobotClock) -> Iterator[_Fact]:
    yield _Fact("folder", session.folder.name)
    for key, value in _flat(session.header):
        yield _Fact(key, _in_one_line(value))
    yield _Fact("closed_properly", _in_one_line(session.closed_properly))
    yield _Fact("recorded_s", _in_one_line(round(session.duration_s, 3)))
    summary = robot.summary(utc_ns_at=session.clock.anchor.utc_ns, session_ns_at=session.clock.anchor.monotonic_ns)
    if summary is None:
        yield _Fact("robot_clock.estimates", "0")
    else:
        for field in dataclasses.fields(summary):
            value = getattr(summary, field.name)
            yield _Fact(f"robot_clock.{field.name}", str(round(value, 6)))


def _flat(data: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in data.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        elif isinstance(value, list) and all(isinstance(item, dict) for item in value):
            # For its own files, the session's folder is the better source.
            for number, item in enumerate(value if key != "files" else [], start=1):
                yield from _flat(item, f"{prefix}{key}.{number}.")
        elif not isinstance(value, list):
            yield f"{prefix}{key}", value
        elif key != "files":
            yield f"{prefix}{key}", ";".join(map(str, value))


def _in_one_line(value: Any) -> str:
    if value is None:
        return ""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _rows_of(table: Table, value: Any, times: RowTimes) -> Iterator[tuple[Table, list[Any]]]:
    for row in table.rows(value, times):
        yield table, row


# Columns from the fields of dataclasses


def _columns(value_type: type[Any], path: tuple[str, ...] = (), *, item: bool = False) -> Iterator[Column]:
    """Columns of the fields of ``value_type``, found under ``path`` in a row.

    An ``item`` of a list also gets columns for its time and its own lists.
    """
    for name, hint in _fields(value_type):
        if path or item or name != "stamp_ns":
            yield from _columns_of_field((*path, name), hint, item=item)


def _columns_of_field(path: tuple[str, ...], hint: Any, *, item: bool) -> Iterator[Column]:
    name = "_".join(path)
    if name in _RESERVED:
        name = f"value_{name}"
    read = _reader(path)
    hint, optional = _without_none(hint)
    unit = _unit(path[-1])
    words = _MEANINGS.get(path[-1]) or _in_words(name, unit)
    unknown = " Empty if unknown." if optional else ""
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        yield from _columns(hint, path, item=item)
    elif _record_list(hint) is not None and len(path) == 1 and not item:
        yield Column(
            f"{name}_count", "", "integer", f"Number of entries; each is a row of the table of {name}.{unknown}",
            lambda row, _: None if (records := read(row)) is None else len(records),
        )  # fmt: skip
    elif dtype := array_dtype(hint):
        yield from _columns_of_array(name, unit, dtype, read)
    elif name == "robot_stamp_ns" and not item:
        yield from _columns_of_robot_stamp(unit, read)
    else:
        kind, description = _kind(hint)
        clock: ClockName = "" if unit != _UNITS["ns"] else "robot" if path[-1].startswith("robot_") else "session"
        convert = to_jsonable if kind == "json" else _plain
        yield Column(
            name, unit, kind, f"{words} {description}".strip() + unknown, lambda row, _: convert(read(row)), clock
        )
        if clock == "session":
            yield Column(
                f"{name.removesuffix('_ns')}_session_s",
                "seconds",
                "number",
                f"{name} as time since the start of the session.{unknown}",
                lambda row, times: times.session_s(read(row)),
                clock,
            )


def _columns_of_robot_stamp(unit: str, read: Callable[[Any], Any]) -> Iterator[Column]:
    yield Column(
        "robot_stamp_ns",
        unit,
        "integer",
        "The robot's own timestamp, on the robot's clock; empty if it sent none.",
        lambda row, _: read(row),
        "robot",
    )
    yield Column(
        "measured_session_s",
        "seconds",
        "number",
        (
            "Measurement time, since the start of the session: the robot's timestamp minus the offset of its "
            "clock. Empty if the offset is unknown; session_s gives the arrival time."
        ),
        lambda row, times: None if (found := times.measured(row)) is None else times.session_s(found.stamp_ns),
        "session",
    )
    yield Column(
        "measured_uncertainty_s",
        "seconds",
        "number",
        "Uncertainty of measured_session_s (plus or minus).",
        lambda row, times: None if (found := times.measured(row)) is None else round(found.uncertainty_ns / 1e9, 6),
        "session",
    )


def _columns_of_array(name: str, unit: str, dtype: "np.dtype[Any]", read: Callable[[Any], Any]) -> Iterator[Column]:
    points = name.startswith("points_") or "_points_" in name
    plain_kind: Kind = "cells" if dtype.itemsize == 1 else "depths"
    kind: Kind = plain_kind if dtype.kind in "iu" else "points" if points else "numbers"
    yield Column(
        f"{name}_shape", "", "integers", "Number of values; for a grid rows and columns, for points their number "
            "and coordinates.",
        lambda row, _: None if (array := read(row)) is None else list(array.shape),
    )  # fmt: skip
    yield Column(
        f"{name}_min", unit, "number", "The smallest finite value.", lambda row, _: _smallest(read(row))
    )  # fmt: skip
    description = {
        "cells": "The grid row by row, from its origin. Not in CSV files, because it is large.",
        "depths": "The depths row by row, from the upper left; 0 if unknown. Not in CSV files.",
        "points": "The points, as x and y.",
        "numbers": "The values; inf: no return.",
    }[kind]
    yield Column(name, unit, kind, description, lambda row, _: read(row))


def _fields(value_type: type[Any]) -> list[tuple[str, Any]]:
    hints = typing.get_type_hints(value_type)
    return [(field.name, without_alias(hints[field.name])) for field in dataclasses.fields(value_type)]


def _record_list(hint: Any) -> type[Any] | None:
    if get_origin(hint) not in (tuple, list):
        return None
    item = without_alias(get_args(hint)[0])
    return item if isinstance(item, type) and dataclasses.is_dataclass(item) else None


def _list_table(parent: str, field: str, item_type: type[Any]) -> Table:
    """Table of a list field; its rows are (number, item)."""
    columns = [_of_item(column) for column in _columns(item_type, item=True)]
    index = Column("number", "", "integer", f"Position among the {field} at this time, from 1.", lambda row, _: row[0])
    return Table(
        f"{parent}_{field}",
        f"One row per entry of {field} in {parent}. {_doc(item_type)}".strip(),
        (index, *columns),
        lambda value: enumerate(getattr(value, field) or (), start=1),
        STREAM_TIME_COLUMNS,
    )


def _of_item(column: Column) -> Column:
    read = column.read
    return dataclasses.replace(column, read=lambda row, times: read(row[1], times))


def _without_none(hint: Any) -> tuple[Any, bool]:
    """``hint`` without None, and whether it was optional."""
    some = [member for member in union_members(hint) if member is not type(None)]
    return some[0] if len(some) == 1 else hint, type(None) in union_members(hint)


def _reader(path: tuple[str, ...]) -> Callable[[Any], Any]:
    """Reader of a nested field; columns of a missing record are empty."""

    def read(value: Any) -> Any:
        for name in path:
            if value is None:
                return None
            value = getattr(value, name)
        return value

    return read


def _unit(name: str) -> str:
    match name.split("_"):
        case [*_, amount, "per", "s"]:
            return f"{_UNITS[amount]} per second"
        case [_, *_, last]:
            return _UNITS.get(last, "")
    return ""


def _in_words(name: str, unit: str) -> str:
    """``pose_in_map_x_m`` as ``Pose in map, x.``"""
    words = name.rpartition("_")[0] if unit else name
    frame = words.find("_in_")
    if frame > 0:
        end = words.find("_", frame + 4)
        words = words if end < 0 else f"{words[:end]},{words[end:]}"
    return f"{words.replace('_', ' ').capitalize()}."


def _kind(hint: Any) -> tuple[Kind, str]:
    """Kind of a column, and its allowed values or how to read it. Mappings and untyped values are JSON.

    Raises TypeError for types without a column kind.
    """
    origin = get_origin(hint)
    if origin is Literal:
        return "text", f"One of: {', '.join(map(str, get_args(hint)))}."
    if isinstance(hint, type) and issubclass(hint, Enum):
        return "text", f"One of: {', '.join(str(member.value) for member in hint)}."
    if members := set(union_members(hint)) - {type(None)}:
        if members == {int, float}:
            return "number", ""
        if members <= {int, float, bool, str}:
            return "text", "A number, true or false, or text."
    if origin in (tuple, list):
        item = without_alias(get_args(hint)[0])
        kinds: dict[Any, Kind] = {int: "integers", float: "numbers", str: "texts"}
        if item in kinds:
            written = "as JSON" if item is str else "separated by semicolons"
            return kinds[item], f"A list; in CSV files {written}."
    if origin in (dict, tuple, list) or hint is Any:
        return "json", "As JSON."
    plain: dict[Any, Kind] = {int: "integer", float: "number", bool: "true or false", str: "text"}
    if hint not in plain:
        raise TypeError(f"no column type is defined for {hint}")
    return plain[hint], ""


def _plain(value: Any) -> Any:
    return value.value if isinstance(value, Enum) else value


def _smallest(array: Any) -> float | None:
    if array is None:
        return None
    finite = array[np.isfinite(array)]
    # By its digits: a float32 has fewer than the float it would become.
    return None if finite.size == 0 else float(str(finite.min()))


def _doc(value_type: type[Any]) -> str:
    return " ".join((value_type.__doc__ or "").split())


def _described(row_type: type[Any], name: str) -> Table:
    return Table(name, _doc(row_type), tuple(_columns(row_type)), time_columns=TIME_COLUMNS)


UTTERANCES_TABLE = _described(_UtteranceRow, "utterances")
RESPONSES_TABLE = _described(_ResponseRow, "responses")
MARKS_TABLE = _described(_MarkRow, "marks")
GOALS_TABLE = _described(_GoalRow, "goals")
ALARMS_TABLE = _described(_AlarmRow, "alarms")
ANSWERS_TABLE = _described(_AnswerRow, "answers")
PROTOCOL_TABLE = _described(_StepRow, "protocol")
STEP_VISITS_TABLE = _described(_StepVisitRow, "step_visits")
VISITS_TABLE = _described(_VisitRow, "visits")
ANNOTATIONS_TABLE = _described(_AnnotationRow, "annotations")
SESSION_TABLE = Table(
    "session",
    "The session as a whole: header, duration, videos, audio and the robot's clock.",
    (
        Column("key", "", "text", "Name of the value.", lambda fact, _: fact.key),
        Column("value", "", "text", "The value; units are in the names of the keys.", lambda fact, _: fact.value),
    ),
)
DICTIONARY_TABLE = Table(
    "data_dictionary",
    "Every table and every column.",
    tuple(
        Column(name, "", "text", description, lambda row, _: row)
        for name, description in (
            ("table", "The table."),
            ("column", "The column; empty in the row that describes the table itself."),
            ("unit", "The unit; empty if there is none."),
            (
                "type",
                (
                    "The type of the values. In CSV files, utc is ISO 8601, texts are JSON, and numbers are "
                    "separated by semicolons. An apostrophe precedes text that spreadsheets would read as a "
                    "formula (not with --plain-csv)."
                ),
            ),
            (
                "clock",
                (
                    "The clock of a time: session (monotonic), UTC (of this computer at the start), or robot (the "
                    "robot's own)."
                ),
            ),
            ("description", "The meaning."),
        )
    ),
)


def scalar_text(value: Any) -> str:
    """Number, true or false, or text, in spellings that stay distinguishable."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and math.isfinite(value) and value == int(value) and abs(value) < 1e15:
        return f"{value:.1f}"
    return plain_text(str(value))


def json_text(value: Any) -> str:
    """Canonical JSON: equal text for equal content."""
    return plain_text(json.dumps(value, ensure_ascii=False, sort_keys=True))
