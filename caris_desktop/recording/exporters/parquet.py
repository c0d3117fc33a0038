"""Parquet export: the tables of the CSV export, typed, in row groups that bound memory.

Every row names its session, so that one query reads a whole study: ``SELECT condition, count(*) FROM
'OUT/*/utterances.parquet' GROUP BY condition``.
"""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext
from caris_desktop.recording.tables.arrow import array, arrow_type
from caris_desktop.recording.tables.build import session_batches
from caris_desktop.recording.tables.catalog import Column, Table, key_columns, plain_text
from caris_desktop.recording.tables.dictionary import DICTIONARY_TABLE, allowed_values, dictionary_columns, empty_of


def write_parquet(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Fill the empty folder ``out``. Raises OSError, SessionError."""
    whose = key_columns(session)
    about = {
        "session": session.folder.name,
        "started_utc": session.clock.utc(session.started_ns),
        "program_version": session.header.program_version,
        "licence": context.licence,
    }
    files: dict[str, _TableFile] = {}
    with ExitStack() as opened:

        def write(table: Table, columns: list[list[Any]]) -> None:
            if table.name not in files:
                file = _TableFile(out / f"{table.name}.parquet", table, whose, about)
                opened.callback(file.close)
                files[table.name] = file
            files[table.name].add(columns)

        for batch in session_batches(session, context.progress, context.warn, context.tables):
            write(*batch)
        described = [file.table for file in files.values()]
        write(DICTIONARY_TABLE, dictionary_columns([*described, DICTIONARY_TABLE], whose))
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

    def add(self, columns: list[list[Any]]) -> None:
        """Write rows, by column, as a row group."""
        import pyarrow as pa

        count = len(columns[0])
        if not count:
            return
        constants = [pa.repeat(pa.scalar(value, pa.string()), count) for value in self._whose]
        arrays = [
            array(self.path.stem, column, values) for column, values in zip(self.table.columns, columns, strict=True)
        ]
        self._writer.write_table(pa.Table.from_arrays([*constants, *arrays], schema=self._schema), row_group_size=count)

    def close(self) -> None:
        self._writer.close()


def _field(column: Column) -> Any:
    import pyarrow as pa

    about = {"unit": column.unit, "clock": column.clock, "description": column.description, "empty": empty_of(column)}
    about["values"] = "; ".join(allowed_values(column))
    metadata = {key: value for key, value in about.items() if value}
    return pa.field(column.name, arrow_type(column.kind), metadata=metadata)
