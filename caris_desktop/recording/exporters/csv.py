"""CSV export: tidy tables, one for each stream and event type that occurs, and a data dictionary.

Every row begins with its session, so that tables of several sessions can be concatenated.
"""

from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from caris_desktop.recording.csv_cells import CsvStyle
from caris_desktop.recording.data_dictionary import DICTIONARY_TABLE, dictionary_columns
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext
from caris_desktop.recording.tables.build import session_batches
from caris_desktop.recording.tables.catalog import Column, Table, json_text, key_columns, scalar_text


def write_csv(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Fill the empty folder ``out``. Raises OSError, SessionError."""
    whose = key_columns(session)
    with CsvTables(out, context.csv, whose) as files:
        for batch in session_batches(session, context.progress, context.warn):
            files.write(*batch)
        files.write(DICTIONARY_TABLE, dictionary_columns([*files.tables, DICTIONARY_TABLE], whose))
    return [out / f"{table.name}.csv" for table in files.tables]


class CsvTables:
    """Tables being written into a folder, one file each. ``whose`` are leading columns with a constant each.

    ``tables`` are those that have a file. Raises OSError.
    """

    def __init__(self, out: Path, style: CsvStyle, whose: tuple[Column, ...] = ()) -> None:
        self.tables: list[Table] = []
        self._out, self._style, self._whose = out, style, whose
        self._of_all = [_cell(column, column.read(None, None)) for column in whose]  # type: ignore[arg-type] # constants
        self._files, self._writers = ExitStack(), dict[str, Any]()

    def __enter__(self) -> "CsvTables":
        return self

    def __exit__(self, *_: object) -> None:
        self._files.close()

    def write(self, table: Table, columns: list[list[Any]]) -> None:
        """Add rows, given by column."""
        if table.name not in self._writers:
            path = self._out / f"{table.name}.csv"
            file = self._files.enter_context(path.open("w", encoding=self._style.encoding, newline=""))
            self._writers[table.name] = self._style.writer(file)
            self._writers[table.name].writerow([column.name for column in (*self._whose, *table.columns)])
            self.tables.append(table)
        each = zip(table.columns, columns, strict=True)
        cells = [[_cell(column, value) for value in values] for column, values in each]
        self._writers[table.name].writerows([*self._of_all, *row] for row in zip(*cells, strict=True))


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
