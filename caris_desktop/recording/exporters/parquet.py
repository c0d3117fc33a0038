"""Parquet export: the tables of the CSV export, typed, in row groups that bound memory.

Every row names its session, so that one query reads a whole study: ``SELECT condition, count(*) FROM
'OUT/*/utterances.parquet' GROUP BY condition``.
"""

import logging
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from caris_desktop.recording.exporters.tables import (
    DICTIONARY_TABLE,
    Column,
    Kind,
    Table,
    dictionary_rows,
    json_text,
    key_columns,
    plain_text,
    scalar_text,
    session_rows,
)
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext

_log = logging.getLogger(__name__)
_ROWS_PER_GROUP = 20_000
_BYTES_PER_GROUP = 16 * 1024 * 1024
_BYTES_PER_CELL = 16


def write_parquet(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Fill the empty folder ``out``. Raises OSError, SessionError."""
    whose = key_columns(session)
    about = {
        "session": session.folder.name,
        "started_utc": session.clock.utc(session.started_ns),
        "program_version": str(session.header.get("program_version", "")),
        "licence": context.licence,
    }
    files: dict[str, _TableFile] = {}
    with ExitStack() as opened:

        def write(table: Table, row: list[Any]) -> None:
            if table.name not in files:
                file = _TableFile(out / f"{table.name}.parquet", table, whose, about)
                opened.callback(file.close)
                files[table.name] = file
            files[table.name].add(row)

        for table, row in session_rows(session, context):
            write(table, row)
        described = [file.table for file in files.values()]
        for row in dictionary_rows([*described, DICTIONARY_TABLE], whose):
            write(DICTIONARY_TABLE, row)
        for file in files.values():
            file.flush()
    return [file.path for file in files.values()]


class _TableFile:
    """One Parquet file being written. Raises OSError."""

    def __init__(self, path: Path, table: Table, whose: tuple[Column, ...], about: dict[str, str]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        self.path = path
        self.table = table
        self._whose = [column.read(None, None) for column in whose]  # type: ignore[arg-type] # constants
        self._schema = pa.schema(
            [_field(column) for column in (*whose, *table.columns)],
            metadata={key: plain_text(value) for key, value in {**about, "description": table.description}.items()},
        )
        self._writer = pq.ParquetWriter(path, self._schema, compression="zstd")
        self._values: list[list[Any]] = [[] for _ in table.columns]
        self._kinds = [column.kind for column in table.columns]
        self._bytes = 0

    def add(self, row: list[Any]) -> None:
        for values, kind, value in zip(self._values, self._kinds, row, strict=True):
            ready = None if value is None else _ready(kind, value)
            values.append(ready)
            self._bytes += _size_bytes(ready)
        if len(self._values[0]) >= _ROWS_PER_GROUP or self._bytes >= _BYTES_PER_GROUP:
            self.flush()

    def flush(self) -> None:
        """Write the buffered rows as a row group."""
        import pyarrow as pa

        count = len(self._values[0])
        if not count:
            return
        types = list(self._schema.types)
        constants = [pa.repeat(pa.scalar(value, pa.string()), count) for value in self._whose]
        arrays = [
            _array(self.path.stem, values, kind)
            for values, kind in zip(self._values, types[len(constants) :], strict=True)
        ]
        self._values = [[] for _ in self._values]
        self._bytes = 0
        self._writer.write_table(pa.Table.from_arrays([*constants, *arrays], schema=self._schema), row_group_size=count)

    def close(self) -> None:
        self._writer.close()


def _field(column: Column) -> Any:
    import pyarrow as pa

    metadata = {"unit": column.unit, "clock": column.clock, "description": column.description}
    return pa.field(column.name, _type(column.kind), metadata={key: value for key, value in metadata.items() if value})


def _type(kind: Kind) -> Any:
    import pyarrow as pa

    match kind:
        case "integer":
            return pa.int64()
        case "number":
            return pa.float64()
        case "true or false":
            return pa.bool_()
        case "utc":
            return pa.timestamp("us", tz="UTC")
        case "integers":
            return pa.list_(pa.int64())
        case "numbers":
            return pa.list_(pa.float32())
        case "texts":
            return pa.list_(pa.string())
        case "points":
            return pa.list_(pa.list_(pa.float32()))
        case "cells":
            return pa.list_(pa.int8())
        case "depths":
            return pa.list_(pa.uint16())
        case "text" | "json":
            return pa.string()


def _ready(kind: Kind, value: Any) -> Any:
    """Value converted for the column's type."""
    match kind:
        case "text":
            return scalar_text(value)
        case "json":
            return json_text(value)
        case "utc":
            return value // 1000
        case "numbers":
            return np.asarray(value, dtype=np.float32).ravel()
        case "points":
            return [point.tolist() for point in value]
        case "cells" | "depths":
            return value.ravel()
        case "texts":
            return [plain_text(str(item)) for item in value]
    return value


def _size_bytes(value: Any) -> int:
    if isinstance(value, np.ndarray):
        return value.nbytes
    if isinstance(value, (str, list)):
        return _BYTES_PER_CELL * (1 + len(value) if isinstance(value, list) else 1) + len(value)
    return _BYTES_PER_CELL


def _array(name: str, values: list[Any], kind: Any) -> Any:
    """Array of ``kind``; values that do not fit (damaged recording) become missing and are logged."""
    import pyarrow as pa

    try:
        return pa.array(values, kind)
    except (pa.ArrowException, OverflowError, TypeError, ValueError):
        fitting = [_fitting(value, kind) for value in values]
        left_out = sum(one is None for one in fitting) - sum(one is None for one in values)
        _log.warning("%s: %d values are left out: no %s", name, left_out, kind)
        return pa.array(fitting, kind)


def _fitting(value: Any, kind: Any) -> Any:
    import pyarrow as pa

    try:
        pa.scalar(value, kind)
    except (pa.ArrowException, OverflowError, TypeError, ValueError):
        return None
    return value
