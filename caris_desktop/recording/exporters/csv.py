"""CSV export: tidy tables, one for each stream and event type that occurs, and a data dictionary.

Every row begins with its session, so that tables of several sessions can be concatenated.
"""

import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from caris_desktop.recording.csv_cells import CsvStyle
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext
from caris_desktop.recording.table_files import copy_tables
from caris_desktop.recording.tables.catalog import json_text, scalar_text

_ROWS_AT_ONCE = 5_000
_UTC_CHARACTERS = len("2026-11-27T13:20:36.000000")


def write_csv(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Fill the empty folder ``out``. Raises OSError, SessionError."""
    with tempfile.TemporaryDirectory() as part:
        tables = copy_tables(session, Path(part), context.progress, context.warn)
        return [csv_of(table, out, context.csv) for table in tables]


def csv_of(table: Path, out: Path, style: CsvStyle) -> Path:
    """Write the Parquet file ``table`` as CSV into the folder ``out``; return its path. Raises OSError."""
    import pyarrow.parquet as pq

    path = out / f"{table.stem}.csv"
    with pq.ParquetFile(table) as rows, path.open("w", encoding=style.encoding, newline="") as file:
        writer = style.writer(file)
        writer.writerow(rows.schema_arrow.names)
        columns = [(field.name, _is_grid(field.type)) for field in rows.schema_arrow]
        for batch in rows.iter_batches(_ROWS_AT_ONCE, columns=[name for name, is_grid in columns if not is_grid]):
            cells = [[""] * len(batch) if is_grid else _cells(name, batch.column(name)) for name, is_grid in columns]
            writer.writerows(zip(*cells, strict=True))
    return path


def _is_grid(kind: Any) -> bool:
    """True for maps and depths, which are left out, as the dictionary says."""
    import pyarrow as pa

    return pa.types.is_list(kind) and kind.value_type in (pa.int8(), pa.uint16())


def _cells(name: str, column: Any) -> Iterable[Any]:
    """Cells that read back as the same values; empty if unknown."""
    import pyarrow as pa

    kind = column.type
    if pa.types.is_timestamp(kind):
        times = np.datetime_as_string(column.cast(pa.timestamp("us")).to_numpy(zero_copy_only=False), unit="us")
        # Missing times, and those outside the calendar, have another length.
        return [f"{time}Z" if len(time) == _UTC_CHARACTERS else "" for time in times.tolist()]
    if pa.types.is_boolean(kind):
        return ["" if value is None else scalar_text(value) for value in column.to_pylist()]
    if not pa.types.is_list(kind):
        # The writer spells numbers so, too, in a tenth of the time.
        cells: list[Any] = column.to_pylist()
        return cells
    if pa.types.is_string(kind.value_type):
        return ["" if value is None else json_text(value) for value in column.to_pylist()]
    if pa.types.is_list(kind.value_type):
        return ["" if row.values is None else ";".join(_numbers(point, " ") for point in row.values) for row in column]
    return [_numbers(row, "x" if name.endswith("_shape") else ";") for row in column]


def _numbers(row: Any, between: str) -> str:
    """Numbers of a list with the digits of their type: a float32 has fewer than the float it would become."""
    return "" if row.values is None else between.join(map(str, row.values.to_numpy(zero_copy_only=False)))
