"""Measures of one session, computed by the SQL from its tables in memory."""

from collections.abc import Callable, Sequence
from typing import Any

from caris_desktop.domain.events import (
    DriveEnded,
    EmergencyStopChanged,
    Gap,
    GuardChanged,
    LinkChanged,
    LinkQuality,
    PreflightChecked,
    Problem,
    RobotChosen,
    ScenarioOpened,
    StopRequested,
)
from caris_desktop.domain.sensing import Odometry, RobotPose
from caris_desktop.domain.shipped import resources_dir
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.measures.measure_definitions import TABLES, THRESHOLDS
from caris_desktop.recording.measures.measure_plugins import added_columns
from caris_desktop.recording.session.session_conversation import Response
from caris_desktop.recording.session.session_data import FOLDED, SessionData, read_data
from caris_desktop.recording.session.session_protocol import StepRecord
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session.session_robot import AlarmRecord
from caris_desktop.recording.tables.build import data_tables

THIS_COMPUTER = "this computer"
_MEASURED = (
    *FOLDED, DriveEnded, EmergencyStopChanged, Gap, GuardChanged, LinkChanged, LinkQuality, Odometry, PreflightChecked,
    Problem, RobotChosen, RobotPose, ScenarioOpened, StopRequested,
)  # fmt: skip


class Delay(Value):
    """Delay of an answer of the robot or a request of the wizard, until ``at_ns``."""

    at_ns: int
    delay_s: float
    utterance_id: str


class Interval(Value):
    """Labelled interval of the session."""

    start_ns: int
    end_ns: int
    label: str


class ModelUse(Value):
    """Exchanges with one language model, and the use of its answers.

    ``place`` is the host of its server, or this computer; empty if not recorded. ``settings`` are the parameters of
    each exchange, as JSON.
    """

    provider: str
    model: str
    version: str
    place: str
    asked: int
    answered: int
    cancelled: int
    failed: int
    said: int
    edited: int
    dismissed: int
    unused: int
    first_token_s: tuple[float, ...]
    answer_s: tuple[float, ...]
    settings: tuple[str, ...]

    @property
    def accepted_fraction(self) -> float | None:
        """Share of answers that were said, unchanged or edited. None without answers."""
        return (self.said + self.edited) / self.answered if self.answered else None


class Measures(Value, eq=False):
    """Measures of one session: ``values`` by name, None if not recorded, and what they consist of.

    ``parts`` are by measure and label, in order of first occurrence.
    """

    values: dict[str, float | None]
    parts: dict[str, dict[str, float]]
    responses: tuple[Delay, ...]
    content_responses: tuple[Delay, ...]
    reactions: tuple[Delay, ...]
    gaps: tuple[Response, ...]
    models: tuple[ModelUse, ...]
    link_trouble: tuple[Interval, ...]
    navigation: tuple[Interval, ...]
    alarms: tuple[AlarmRecord, ...]
    steps: tuple[StepRecord, ...]

    def __getitem__(self, name: str) -> float:
        """Measure that every session has; 0 without a value."""
        return self.values[name] or 0

    def of(self, measure: str) -> dict[str, float]:
        """Parts of a measure."""
        return self.parts.get(measure, {})

    @property
    def gaps_s(self) -> tuple[float, ...]:
        """Gaps of all answered turns, negative for overlaps."""
        return tuple(response.gap_s for response in self.gaps if response.first)

    @property
    def response_times_s(self) -> tuple[float, ...]:
        return tuple(delay.delay_s for delay in self.responses)


def read_facts(session: Session, progress: Callable[[float], None] = lambda _: None) -> SessionData:
    """Read what the measures need in one pass. ``progress`` may raise to cancel. Raises SessionError."""
    return read_data(session, _MEASURED, progress)


def measure(data: SessionData) -> Measures:
    """Compute all measures of a session."""
    import duckdb

    with duckdb.connect(":memory:", config={"threads": 1}) as database:
        for name, table in data_tables(data, TABLES).items():
            database.register(name, table)
        database.execute(sql())

        def rows(query: str) -> list[tuple[Any, ...]]:
            found: list[tuple[Any, ...]] = database.execute(query).fetchall()
            return found

        def delays(view: str) -> tuple[Delay, ...]:
            found = rows(f"SELECT at_ns, delay_s, reply_id FROM {view} ORDER BY at_ns")  # noqa: S608 - ours
            return tuple(Delay(*row) for row in found)

        cursor = database.execute("SELECT * FROM measures")
        values = dict(zip((column[0] for column in cursor.description), cursor.fetchone() or (), strict=True))
        parts: dict[str, dict[str, float]] = {}
        for name, label, value in rows("SELECT measure, label, value FROM parts"):
            parts.setdefault(name, {})[label] = value if name.endswith("_s") else int(value)
        models = rows("SELECT * EXCLUDE (session) FROM model_uses")
        return Measures(
            values=values,
            parts=parts,
            responses=delays("response_times"),
            content_responses=delays("content_responses"),
            reactions=delays("reactions"),
            gaps=data.responses,
            models=tuple(ModelUse(*row[:-3], *map(tuple, row[-3:])) for row in models),
            link_trouble=_intervals(rows("SELECT start_ns, end_ns, state FROM link_trouble ORDER BY start_ns")),
            navigation=_intervals(
                rows(
                    "SELECT start_ns, end_ns, outcome FROM goal_spans WHERE end_ns > start_ns OR outcome = 'unfinished'"
                    " ORDER BY start_ns"
                )
            ),
            alarms=data.alarms,
            steps=data.steps,
        )


def _intervals(rows: list[tuple[Any, ...]]) -> tuple[Interval, ...]:
    return tuple(Interval(*row) for row in rows)


def sql(added: Sequence[str] = ()) -> str:
    """The queries, and before them the thresholds; both need the tables. ``added``: measures of plug-ins."""
    thresholds = [f"SET VARIABLE {one.name} = {one.value}::DOUBLE;  -- {one.description}" for one in THRESHOLDS]
    text = (resources_dir() / "queries" / "statistics.sql").read_text(encoding="utf-8")
    return "\n".join(["-- The thresholds.", *thresholds, "", f"{text.rstrip()}\n", added_columns(added)])
