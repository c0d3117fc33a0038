"""Tables of records that follow from several events, such as utterances, and the guide page of all tables."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any

from caris_desktop.domain.shipped import resources_dir
from caris_desktop.domain.streams import STREAMS
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.pseudonyms import coding_of
from caris_desktop.recording.session.robot_clock_mapping import RobotClock
from caris_desktop.recording.session.session_conversation import LlmAnswer, Response, ShownReply, SpokenUtterance
from caris_desktop.recording.session.session_data import SessionData
from caris_desktop.recording.session.session_marks import FinalMark
from caris_desktop.recording.session.session_protocol import StepRecord, StepVisit
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session.session_robot import AlarmRecord, Drive, NavigationGoal
from caris_desktop.recording.session.session_visits import Visit
from caris_desktop.recording.tables import catalog
from caris_desktop.recording.tables.catalog import TIME_COLUMNS, Column, Moment, Table, derived_columns
from caris_desktop.recording.tables.meanings import split_docstring


class Annotation(Value):
    """One label that a coder gave to an interval of the session, in session time."""

    start_ns: int
    end_ns: int
    coder: str
    tier: str
    value: str
    vocabulary: str
    tier_id: str
    annotation_id: str

    @property
    def duration_s(self) -> float:
        return (self.end_ns - self.start_ns) / 1e9


class _Fact(Value):
    """One line about the session as a whole."""

    key: str
    value: str


class DerivedTable(Value):
    """Table of derived records. ``records`` gives them; ``stamp_ns`` is the time of one for the time columns."""

    table: Table
    records: Callable[[SessionData], Iterable[Any]]
    stamp_ns: Callable[[Any, Session], int]

    def rows(self, data: SessionData) -> list[tuple[Moment, Any]]:
        return [(Moment(self.stamp_ns(record, data.session)), record) for record in self.records(data)]


def _derived(
    name: str,
    value_type: type[Any],
    columns: str,
    description: str,
    records: Callable[[SessionData], Iterable[Any]],
    *,
    stamp_ns: Callable[[Any, Session], int] = lambda record, _: int(record.start_ns),
) -> DerivedTable:
    general, docs = split_docstring(description, [column.partition("=")[0] for column in columns.split()])
    table = Table(name, general, derived_columns(value_type, columns, docs), time_columns=TIME_COLUMNS)
    return DerivedTable(table, records, stamp_ns)


def _utterance_ns(utterance: SpokenUtterance, session: Session) -> int:
    known = (utterance.start_ns, utterance.requested_ns, session.started_ns)
    return next(stamp_ns for stamp_ns in known if stamp_ns is not None)


DERIVED: tuple[DerivedTable, ...] = (
    _derived(
        "utterances",
        SpokenUtterance,
        "utterance_id speaker text origin said state duration_s requested_ns start_ns end_ns voice detail actor"
        " person_id heard_text tags confidence language estimated person_by person_confidence",
        """One utterance with the times of its request, start and end. The time columns give its start, or its request
        if it was never spoken. Text, speaker and person include corrections.
        ``heard_text`` is the transcript before a correction, else empty. An empty speaker: not sure. ``estimated``:
        start or end is inexact. ``person_by`` identified the participant: a wizard, the console, or ``record``, if the
        record shows that nobody else was present. ``person_confidence`` is the likelihood, 0 to 1, empty if a wizard
        identified them.""",
        lambda data: data.utterances,
        stamp_ns=_utterance_ns,
    ),
    _derived(
        "responses",
        Response,
        "turn_id reply_id means first gap_s voice_ended_ns text_ns suggested_ns asked_ns first_sound_ns person_id",
        """One response to a turn of the participant, at most response_limit_s after it. The time columns give the
        robot's first sound. ``gap_s`` is from
        the end of the participant's voice, negative if the robot spoke over it. ``first``: nothing preceded it, such
        as a filler.""",
        lambda data: data.responses,
        stamp_ns=lambda response, _: int(response.first_sound_ns),
    ),
    _derived(
        "marks",
        FinalMark,
        "mark_id label kind note end_ns duration_s marked_ns open_at_end actor tags rewritten",
        """One mark in its final state; withdrawn ones are only in event_marked. The time columns give the moment
        meant. ``open_at_end``: an interval without an end, which ends with the session. ``tags`` are the words of the
        note that begin with #. ``rewritten``: the note was changed; earlier texts are in event_marked.""",
        lambda data: data.marks,
    ),
    _derived(
        "drives",
        Drive,
        "source end_ns duration_s",
        """One interval of manual driving from one source. The time columns give its start. A velocity command counts
        if any component is nonzero, however slow, until the next command, a pause or the end of the recording, at most
        command_holds_s.""",
        lambda data: data.drives,
    ),
    _derived(
        "goals",
        NavigationGoal,
        "goal_id place target_in_map state end_ns duration_s actor",
        """One navigation goal of the recording. The time columns give its request. ``end_ns`` is empty if it was still
        active; ``state`` is the last one.""",
        lambda data: data.goals,
    ),
    _derived(
        "alarms",
        AlarmRecord,
        "alarm_id cause severity what end_ns stood_s times seen_to_by",
        """One alarm: a problem that needed attention. The time columns give when it was first raised, or the start of
        the recording. ``end_ns`` is its last end, empty if it was active to the end. ``stood_s`` is its active time
        without pauses, ``times`` how often it was raised. ``seen_to_by`` resolved it, empty if it ended
        automatically.""",
        lambda data: data.alarms,
    ),
    _derived(
        "answers",
        LlmAnswer,
        "exchange_id=exchange.exchange_id provider=exchange.provider model=exchange.model"
        " model_version=exchange.model_version outcome=exchange.outcome use cut=exchange.cut asked_ns=exchange.asked_ns"
        " first_token_ns=exchange.first_token_ns actor=exchange.actor purpose=exchange.purpose turn_id=exchange.turn_id"
        " shown latency_ms edit_distance",
        """Use of what a language model wrote: the answer to a question of the wizard, or suggested replies to a turn
        (``purpose``). The time columns give the end of the exchange. An answer or reply silenced before it was audible
        is unused. An exchange for replies may be cancelled after some were shown. The table suggestions has each of
        them.""",
        lambda data: data.exchanges,
        stamp_ns=lambda answer, _: int(answer.exchange.stamp_ns),
    ),
    _derived(
        "suggestions",
        ShownReply,
        "suggestion_id turn_id revision rank text model latency_ms fate told ended_ns edit_distance utterance_id actor",
        """One suggested reply that was shown to the wizard. The time columns give when. ``fate`` is what became of it:
        taken (said unchanged), edited (and said), dismissed, superseded by others, or expired; ``told`` is false if the
        recording ended or paused before. ``latency_ms`` is from the end of the participant's voice until it was
        shown. ``edit_distance`` counts the characters that the wizard changed.""",
        lambda data: data.suggestions,
        stamp_ns=lambda reply, _: int(reply.shown_ns),
    ),
    _derived(
        "protocol",
        StepRecord,
        "scenario_file=scenario step_id title step_number=number "
        "visits expected_s time_s late_s skipped ticked to_tick",
        """One step of a scenario file's protocol, planned against actual. The time columns give its first start, or
        that of the session if it never started. ``visits`` counts its starts, without returns to it. ``expected_s`` is
        the planned time of each, 0 if none. ``time_s`` is the total time without pauses, ``late_s`` the total overrun.
        ``skipped`` is a count, too. ``ticked`` of ``to_tick`` items were ticked off.""",
        lambda data: data.steps,
        stamp_ns=lambda step, session: session.started_ns if step.first_ns is None else step.first_ns,
    ),
    _derived(
        "step_visits",
        StepVisit,
        "scenario_file=scenario step_id title step_number=number end_ns how left branch time_s expected_s late_s actor",
        """One interval in a step of the protocol. The time columns give its start. ``how`` it was entered and
        ``left``, which is empty if the session ended in it. ``time_s`` excludes pauses. ``late_s`` is the time beyond
        what was expected, with the earlier time in the step if the wizard came back to it.""",
        lambda data: data.step_visits,
    ),
    _derived(
        "visits",
        Visit,
        "person_id person_number end_ns duration_s last_seen_ns seen_s",
        """Interval during which a person was present. The time columns give its start. ``person_number`` is that of
        "Person 3" on the screen. One person who was lost and found again may have several ids. ``end_ns`` is when the
        person counted as gone, some seconds after the last detection (``last_seen_ns``; empty if not recorded).""",
        lambda data: data.visits,
    ),
)
"""The derived tables, apart from those that need more than the values: SESSION_TABLE and ANNOTATIONS."""

ANNOTATIONS = _derived(
    "annotations",
    Annotation,
    "coder tier value end_ns duration_s vocabulary tier_id annotation_id",
    "One label that a coder gave to an interval of the session. The time columns give its start.",
    lambda _: (),
)
SESSION_TABLE = Table(
    "session",
    "The session as a whole: header, duration, videos, audio and the robot's clock.",
    (
        Column(
            "key",
            "",
            "text",
            "Name of a property of the session, in dotted form as in session.json.",
            attrgetter("key"),
        ),
        Column(
            "value",
            "",
            "text",
            "The property's value; its unit is in the name of the key.",
            attrgetter("value"),
            empty="Not recorded, or nothing was entered.",
        ),
    ),
)


def annotations(session: Session, on_damaged: Callable[[str], None]) -> Iterator[Annotation]:
    """Annotations of all coders, in the order of their files."""
    document = coding_of(session, on_damaged=on_damaged)
    tiers = {tier.tier_id: tier for tier in document.tiers}
    for one in document.annotations:
        tier = tiers[one.tier_id]
        start_ns, end_ns = (session.started_ns + at_ms * 1_000_000 for at_ms in (one.start_ms, one.end_ms))
        yield Annotation(
            start_ns, end_ns, tier.coder, tier.name, one.value, tier.vocabulary, one.tier_id, one.annotation_id
        )


def session_facts(session: Session, robot: RobotClock) -> Iterator[_Fact]:
    """Rows of SESSION_TABLE."""
    yield _Fact("folder", session.folder.name)
    lost = {"lost": dict(session.lost)} if session.lost else {}
    for key, value in _flat({**session.header.to_json(), **lost}):
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


_HEAD = """<!-- Generated by `python -m caris_desktop.app.generated_reference` from recording/tables/. -->
# Tables

The exports `csv` and `parquet` write these tables, one file each; the command `statistics` those that its measures
are computed from. A table without rows is not written. Each export has the same list as `data_dictionary.csv`.

Every row starts with the session, participant, condition and trial. Every table except `session` has columns for the
time of the row, on the session's clock and in UTC. Column names end in their unit. Cells are never empty where the
last column gives no meaning for it. Words such as `command_holds_s` are thresholds, and `codebook.csv` of the command
`statistics` has their values.
"""


_COMPOSED = (SESSION_TABLE, *(one.table for one in DERIVED), ANNOTATIONS.table)


def reference_files() -> dict[Path, str]:
    """The page with its text."""
    parts = [_HEAD, _columns(catalog.STREAM_TIME_COLUMNS), "## Tables that combine events\n", *map(_section, _COMPOSED)]
    parts.append("## Tables of streams and events\n")
    parts += [_section(table) for spec in STREAMS for table in catalog.tables_of(spec)]
    return {resources_dir() / "guide" / "tables.md": "\n".join(parts)}


def _section(table: catalog.Table) -> str:
    return f"### {table.name}\n\n{_cell(table.description)}\n\n{_columns(table.own_columns)}"


def _columns(columns: Iterable[catalog.Column]) -> str:
    rows = [
        f"| `{column.name}` | {column.kind} | {column.unit} | {_meaning(column)} | {column.empty} |"
        for column in columns
    ]
    return "\n".join(
        ["| column | type | unit | meaning | an empty cell |", "| --- | --- | --- | --- | --- |", *rows, ""]
    )


def _meaning(column: catalog.Column) -> str:
    values = f" One of: {', '.join(column.values)}." if column.values else ""
    return _cell(f"{column.description}{values}")


def _cell(text: str) -> str:
    return text.replace("``", "`").replace("|", "\\|").replace("<", "\\<")
