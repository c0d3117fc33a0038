"""Tables of a session, in batches of rows from one pass over the recording, with their columns as Arrow arrays."""

import contextlib
import dataclasses
import functools
import logging
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from caris_desktop.domain.events import LinkQuality
from caris_desktop.domain.streams import STREAMS
from caris_desktop.recording.session.robot_clock_mapping import RobotClock, robot_clock
from caris_desktop.recording.session.session_data import FOLDED, SessionData
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.tables.catalog import (
    Column,
    Kind,
    Moment,
    RowTimes,
    Table,
    json_text,
    key_values,
    plain_text,
    scalar_text,
    tables_of,
)
from caris_desktop.recording.tables.derived import ANNOTATIONS, DERIVED, SESSION_TABLE, annotations, session_facts

_log = logging.getLogger(__name__)


def array(table: str, column: Column, values: list[Any]) -> Any:
    """Arrow array of a column; values that do not fit (damaged recording) become missing and are logged."""
    import pyarrow as pa

    kind = arrow_type(column.kind)
    if column.kind == "text":
        with contextlib.suppress(*_not_fitting()):
            return pa.array(values, kind)
    if ready := _READY.get(column.kind):
        values = [None if value is None else ready(value) for value in values]
    try:
        return pa.array(values, kind)
    except _not_fitting():
        fitting = [_fitting(value, kind) for value in values]
        left_out = sum(one is None for one in fitting) - sum(one is None for one in values)
        _log.warning("%s: %d values are left out: no %s", table, left_out, kind)
        return pa.array(fitting, kind)


@functools.cache
def arrow_type(kind: Kind) -> Any:
    import pyarrow as pa

    types: dict[Kind, Any] = {
        "integer": pa.int64(),
        "number": pa.float64(),
        "text": pa.string(),
        "true or false": pa.bool_(),
        "json": pa.string(),
        "utc": pa.timestamp("us", tz="UTC"),
        "integers": pa.list_(pa.int64()),
        "numbers": pa.list_(pa.float32()),
        "texts": pa.list_(pa.string()),
        "points": pa.list_(pa.list_(pa.float32())),
        "cells": pa.list_(pa.int8()),
        "depths": pa.list_(pa.uint16()),
    }
    return types[kind]


_READY: dict[Kind, Callable[[Any], Any]] = {
    "text": scalar_text,
    "json": json_text,
    "utc": lambda value: value // 1000,
    "numbers": lambda value: np.asarray(value, dtype=np.float32).ravel(),
    "points": lambda value: [point.tolist() for point in value],
    "cells": np.ravel,
    "depths": np.ravel,
    "texts": lambda value: [plain_text(str(item)) for item in value],
}
"""Conversion for the column's type, of values that Arrow does not take as they are."""


def _fitting(value: Any, kind: Any) -> Any:
    import pyarrow as pa

    try:
        pa.scalar(value, kind)
    except _not_fitting():
        return None
    return value


def _not_fitting() -> tuple[type[Exception], ...]:
    import pyarrow as pa

    return pa.ArrowException, OverflowError, TypeError, ValueError


# Damaged stamps: nothing is recorded a century away from its session, and calendars have limits.
_FARTHEST_NS = 100 * 365 * 86_400 * 1_000_000_000
_PROGRESS_EVERY_VALUES = 500
_BATCH_ROWS = 5_000
# Values wait for the robot's clock, which the end of the recording determines: some 150 MB, or 20 minutes. In a longer
# recording the clock is read ahead, in a pass of its own.
_VALUES_AT_ONCE, _BYTES_AT_ONCE = 70_000, 64 * 1024 * 1024
_SQL_TYPES = {"integer": "BIGINT", "number": "DOUBLE", "true or false": "BOOLEAN"}
_ARRAYS = ("cells", "depths", "points", "numbers")
DERIVED_TABLES = (SESSION_TABLE, *(one.table for one in DERIVED), ANNOTATIONS.table)


class Batch(NamedTuple):
    """Rows of one table, by column. The first batch of a table is empty and marks its first row."""

    table: Table
    columns: list[list[Any]]


class _Waiting:
    """Values of a stream whose rows are not yet in a batch. ``begun`` are the tables that have a row."""

    def __init__(self, tables: Sequence[Table]) -> None:
        self._tables = tables
        self._has_arrays = any(column.kind in _ARRAYS for table in tables for column in table.own_columns)
        self.begun: list[Table] = []
        self.clear()

    def add(self, moment: Moment, value: Any) -> Iterable[Table]:
        """Add a value; return the tables of which it makes the first row."""
        if self._tables:
            self.values.append((moment, value))
        if self._has_arrays:
            arrays = (getattr(value, field.name) for field in dataclasses.fields(value))
            self.bytes += sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))
        if len(self.begun) == len(self._tables):
            return ()
        new = [table for table in self._tables if table not in self.begun and any(True for _ in table.items(value))]
        self.begun += new
        return new

    def batches(self, times: RowTimes) -> Iterator[Batch]:
        for table in self.begun:
            rows = [(moment, item) for moment, value in self.values for item in table.items(value)]
            for start in range(0, len(rows), _BATCH_ROWS):
                yield Batch(table, table.cells(rows[start : start + _BATCH_ROWS], times))

    def clear(self) -> None:
        self.values: list[tuple[Moment, Any]] = []
        self.bytes = 0


def session_batches(
    session: Session,
    progress: Callable[[float], None] = lambda _: None,
    on_damaged: Callable[[str], None] = _log.warning,
    only: Collection[str] = (),
) -> Iterator[Batch]:
    """All rows of all tables (or ``only`` these) except the dictionary; rows of a table in recording order.

    Tables without rows do not occur. ``on_damaged`` gets a sentence on each coder's file that was left out. Raises
    SessionError, OSError.
    """
    data, folded = SessionData(session), frozenset(FOLDED)
    waiting: dict[str, _Waiting] = {}
    qualities: list[LinkQuality] = []
    times: RowTimes | None = None
    started_ns = session.started_ns
    whole_ns = max(1, session.ended_ns - started_ns)
    needed = [
        spec.name
        for spec in STREAMS
        if spec.value_type in folded or spec.value_type is LinkQuality or spec.name.replace("/", "_") in only
    ]
    for number, (arrival_ns, spec, value) in enumerate(session.arrivals(*(needed if only else ()))):
        if type(value) in folded:
            data.add(value)
        if type(value) is LinkQuality:
            qualities.append(value)
        if not _is_usable(value.stamp_ns, started_ns):
            _log.warning("a value of %s has no usable stamp and is left out", spec.name)
            continue
        if spec.name not in waiting:
            waiting[spec.name] = _Waiting([table for table in tables_of(spec) if not only or table.name in only])
        for table in waiting[spec.name].add(Moment(value.stamp_ns, arrival_ns), value):
            yield Batch(table, [[] for _ in table.columns])
        if number % _PROGRESS_EVERY_VALUES == 0:
            progress(min(0.99, max(0.0, (value.stamp_ns - started_ns) / whole_ns)))
            if (
                sum(len(one.values) for one in waiting.values()) >= _VALUES_AT_ONCE
                or sum(one.bytes for one in waiting.values()) >= _BYTES_AT_ONCE
            ):
                times = times or RowTimes(session.clock, robot_clock(session))
                for of_table in waiting.values():
                    yield from of_table.batches(times)
                    of_table.clear()
    times = times or RowTimes(session.clock, RobotClock(qualities))
    for of_table in waiting.values():
        yield from of_table.batches(times)
    derived: list[tuple[Table, list[tuple[Moment, Any]]]]
    derived = [(SESSION_TABLE, [(Moment(0), fact) for fact in session_facts(session, times.robot)])]
    derived += [(one.table, one.rows(data)) for one in DERIVED]
    coded = [(Moment(one.start_ns), one) for one in annotations(session, on_damaged)]
    derived.append((ANNOTATIONS.table, coded))
    for table, rows in derived:
        if rows and (not only or table.name in only):
            yield Batch(table, table.cells(rows, times))


@functools.cache
def all_tables() -> dict[str, Table]:
    """Every table that a session may have, by name, except the dictionary."""
    of_streams = (table for spec in STREAMS for table in tables_of(spec))
    return {table.name: table for table in (*of_streams, *DERIVED_TABLES)}


def rows(session: Session, table: str, progress: Callable[[float], None] = lambda _: None) -> Iterator[dict[str, Any]]:
    """Rows of a table by column name, without the key columns. Raises SessionError, OSError."""
    for found, columns in session_batches(session, progress, only=(table,)):
        names = [column.name for column in found.columns]
        yield from (dict(zip(names, cells, strict=True)) for cells in zip(*columns, strict=True))


def sql_types(name: str, columns: Iterable[str]) -> dict[str, str]:
    """SQL types of the key columns and these columns of a table."""
    kinds = {column.name: _SQL_TYPES.get(column.kind, "VARCHAR") for column in all_tables()[name].columns}
    keys = dict.fromkeys(("session", "participant", "condition", "trial"), "VARCHAR")
    return keys | {column: kinds[column] for column in columns}


def table_sql(name: str, columns: Iterable[str], files: str = "") -> str:
    """SQL that creates a table with its key columns and these columns from the Parquet ``files`` (a pattern), or an
    empty one.

    A table rather than a view, so that the files of 200 sessions are opened once and not by each query.
    """
    kinds = sql_types(name, columns)
    if not files:
        empty = ", ".join(f'NULL::{kind} AS "{one}"' for one, kind in kinds.items())
        return f"CREATE TABLE {name} AS SELECT {empty} LIMIT 0;"
    chosen = ", ".join(f'"{one}"' for one in kinds)
    return f"CREATE TABLE {name} AS SELECT {chosen} FROM {parquet_sql(files)};"  # noqa: S608 - ours


def parquet_sql(files: str) -> str:
    """Source of these Parquet files in SQL, with their own columns only.

    DuckDB would replace a column by what a folder such as ``condition=A`` on the way to them says.
    """
    return f"read_parquet({quoted(files)}, union_by_name = true, hive_partitioning = false)"


def quoted(text: str) -> str:
    """Text in SQL."""
    return "'" + text.replace("'", "''") + "'"


def data_tables(data: SessionData, wanted: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """Arrow tables in memory of a session whose values were read: these tables, with their key columns and these
    columns.
    """
    import pyarrow as pa

    session = data.session
    times = RowTimes(session.clock, RobotClock(()))
    rows: dict[str, tuple[Table, list[tuple[Moment, Any]]]] = {
        SESSION_TABLE.name: (SESSION_TABLE, [(Moment(0), fact) for fact in session_facts(session, times.robot)]),
        ANNOTATIONS.table.name: (ANNOTATIONS.table, []),
        **{one.table.name: (one.table, one.rows(data)) for one in DERIVED if one.table.name in wanted},
    }
    for spec in STREAMS:
        if (name := spec.name.replace("/", "_")) in wanted:
            usable = (one for one in data.of(spec.value_type) if _is_usable(one.stamp_ns, session.started_ns))
            rows[name] = (tables_of(spec)[0], [(Moment(value.stamp_ns), value) for value in usable])
    keys = key_values(session)
    tables = {}
    for name, columns in wanted.items():
        table, of_table = rows[name]
        some = table.only(columns)
        arrays = [array(name, *each) for each in zip(some.columns, some.cells(of_table, times), strict=True)]
        whose = [pa.repeat(pa.scalar(value, pa.string()), len(of_table)) for value in keys.values()]
        names = [*keys, *(column.name for column in some.columns)]
        tables[name] = pa.Table.from_arrays([*whose, *arrays], names=names)
    return tables


def _is_usable(stamp_ns: int, started_ns: int) -> bool:
    return abs(stamp_ns - started_ns) <= _FARTHEST_NS
