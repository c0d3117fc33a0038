"""Tables of a session, in batches of rows from one pass over the recording."""

import dataclasses
import logging
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from caris_desktop.recording.session.robot_clock_mapping import robot_clock
from caris_desktop.recording.session.session_data import FOLDED, SessionData
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.tables.catalog import Column, Moment, RowTimes, Table, tables_of
from caris_desktop.recording.tables.derived import ANNOTATIONS, DERIVED, SESSION_TABLE, annotations, session_facts

_log = logging.getLogger(__name__)
# Damaged stamps: nothing is recorded a century away from its session, and calendars have limits.
_FARTHEST_NS = 100 * 365 * 86_400 * 1_000_000_000
_PROGRESS_EVERY_ROWS = 500
_BATCH_ROWS, _BATCH_BYTES = 5_000, 16 * 1024 * 1024
_ARRAYS = ("cells", "depths", "points", "numbers")
_DERIVED_TABLES = (SESSION_TABLE, *(one.table for one in DERIVED), ANNOTATIONS.table)


class Batch(NamedTuple):
    """Rows of one table, by column. The first batch of a table is empty and marks its first row."""

    table: Table
    columns: list[list[Any]]


class _Waiting:
    """Rows of a table that are not yet in a batch."""

    def __init__(self, table: Table) -> None:
        self.table = table
        self._has_arrays = any(column.kind in _ARRAYS for column in table.own_columns)
        self.clear()

    def add(self, moment: Moment, item: Any) -> None:
        self.rows.append((moment, item))
        if self._has_arrays and dataclasses.is_dataclass(item):
            arrays = (getattr(item, field.name) for field in dataclasses.fields(item))
            self._bytes += sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))

    def clear(self) -> None:
        self.rows: list[tuple[Moment, Any]] = []
        self._bytes = 0

    @property
    def is_full(self) -> bool:
        return len(self.rows) >= _BATCH_ROWS or self._bytes >= _BATCH_BYTES


def session_batches(
    session: Session,
    progress: Callable[[float], None] = lambda _: None,
    on_damaged: Callable[[str], None] = _log.warning,
) -> Iterator[Batch]:
    """All rows of all tables except the dictionary; rows of a table in recording order.

    Tables without rows do not occur. ``on_damaged`` gets a sentence on each coder's file that was left out. Raises
    SessionError, OSError.
    """
    times = RowTimes(session.clock, robot_clock(session))
    data, folded = SessionData(session), frozenset(FOLDED)
    waiting: dict[str, _Waiting] = {}
    tables: dict[str, tuple[Table, ...]] = {}
    whole_ns = max(1, session.ended_ns - session.started_ns)
    for number, (arrival_ns, spec, value) in enumerate(session.arrivals()):
        if type(value) in folded:
            data.add(value)
        if not isinstance(value.stamp_ns, int) or abs(value.stamp_ns - session.started_ns) > _FARTHEST_NS:
            _log.warning("a value of %s has no usable stamp and is left out", spec.name)
            continue
        if spec.name not in tables:
            tables[spec.name] = tables_of(spec)
        moment = Moment(value.stamp_ns, arrival_ns)
        for table in tables[spec.name]:
            for item in table.items(value):
                if table.name not in waiting:
                    waiting[table.name] = _Waiting(table)
                    yield Batch(table, [[] for _ in table.columns])
                of_table = waiting[table.name]
                of_table.add(moment, item)
                if of_table.is_full:
                    yield Batch(table, table.cells(of_table.rows, times))
                    of_table.clear()
        if number % _PROGRESS_EVERY_ROWS == 0:
            progress(min(0.99, max(0.0, (value.stamp_ns - session.started_ns) / whole_ns)))
    derived = [(SESSION_TABLE, [(Moment(0), fact) for fact in session_facts(session, times.robot)])]
    derived += [(one.table, one.rows(data)) for one in DERIVED]
    coded = [(Moment(one.start_ns), one) for one in annotations(session, on_damaged)]
    rest = [(of_table.table, of_table.rows) for of_table in waiting.values()]
    for table, rows in (*rest, *derived, (ANNOTATIONS.table, coded)):
        if rows:
            yield Batch(table, table.cells(rows, times))


def dictionary_columns(tables: Iterable[Table], whose: tuple[Column, ...] = ()) -> list[list[str]]:
    """Cells of DICTIONARY_TABLE for these tables, by column; ``whose`` are their common leading columns.

    Derived tables come first.
    """
    number = {table.name: number for number, table in enumerate(_DERIVED_TABLES)}
    rows: list[tuple[str, ...]] = []
    for table in sorted(tables, key=lambda table: number.get(table.name, len(number))):
        rows.append((table.name, "", "", "table", "", table.description))
        for column in (*whose, *table.columns):
            rows.append((table.name, column.name, column.unit, column.kind, column.clock, column.description))
    return [list(cells) for cells in zip(*rows, strict=True)]


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
