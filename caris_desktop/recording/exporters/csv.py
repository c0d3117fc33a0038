"""CSV export: tidy tables, one for each stream and event type that occurs, and a data dictionary.

Every row begins with its session, so that tables of several sessions can be concatenated.
"""

from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext
from caris_desktop.recording.tables.build import session_batches
from caris_desktop.recording.tables.catalog import Column, Table, json_text, key_columns, scalar_text
from caris_desktop.recording.tables.dictionary import DICTIONARY_TABLE, dictionary_columns


def write_csv(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Fill the empty folder ``out``. Raises OSError, SessionError."""
    writers: dict[str, tuple[Table, Any]] = {}
    whose = key_columns(session)
    of_this = [_cell(column, column.read(None, None)) for column in whose]  # type: ignore[arg-type] # constants
    with ExitStack() as files:

        def write(table: Table, columns: list[list[Any]]) -> None:
            if table.name not in writers:
                path = out / f"{table.name}.csv"
                file = files.enter_context(path.open("w", encoding=context.csv.encoding, newline=""))
                writers[table.name] = (table, context.csv.writer(file))
                writers[table.name][1].writerow([column.name for column in (*whose, *table.columns)])
            each = zip(table.columns, columns, strict=True)
            cells = [[_cell(column, value) for value in values] for column, values in each]
            writers[table.name][1].writerows([*of_this, *row] for row in zip(*cells, strict=True))

        for batch in session_batches(session, context.progress, context.warn):
            write(*batch)
        described = [table for table, _ in writers.values()]
        write(DICTIONARY_TABLE, dictionary_columns([*described, DICTIONARY_TABLE], whose))
    return [out / f"{name}.csv" for name in writers]


def _cell(column: Column, value: Any) -> str:
    """Text that reads back as the same value; empty if unknown."""
    if value is None:
        return ""
    match column.kind:
        case "utc":
            return _utc(value)
        case "json" | "texts":
            return json_text(value)
        case "points":
            return ";".join(" ".join(map(str, point)) for point in value)
        case "cells" | "depths":
            return ""
        case "integers" if column.name.endswith("_shape"):
            return "x".join(map(str, value))
        case "numbers" | "integers":
            # The digits of the array's type: a float32 has fewer than the float it would become.
            return ";".join(map(str, value.ravel()) if isinstance(value, np.ndarray) else map(scalar_text, value))
    return scalar_text(value)


def _utc(utc_ns: int) -> str:
    """ISO 8601 with microseconds; empty if outside the calendar."""
    seconds, nanoseconds = divmod(utc_ns, 1_000_000_000)
    try:
        return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{nanoseconds // 1000:06d}Z"
    except (ValueError, OverflowError, OSError):
        return ""
