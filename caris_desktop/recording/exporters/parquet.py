"""Parquet export: the tables of the CSV export, typed, in row groups that bound memory.

Every row names its session, so that one query reads a whole study: ``SELECT condition, count(*) FROM
'OUT/*/utterances.parquet' GROUP BY condition``.
"""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

from caris_desktop.recording.data_dictionary import DICTIONARY_TABLE, allowed_values, dictionary_columns, empty_of
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext
from caris_desktop.recording.tables.arrow import array, arrow_type
from caris_desktop.recording.tables.build import session_batches
from caris_desktop.recording.tables.catalog import Column, Table, key_columns, plain_text


def write_parquet(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Fill the empty folder ``out``. Raises OSError, SessionError."""
    whose = key_columns(session)
    about = {
        "session": session.folder.name,
        "started_utc": session.clock.utc(session.started_ns),
        "program_version": session.header.program_version,
        "licence": context.licence,
    }
    with ParquetTables(out, about, whose) as files:
        for batch in session_batches(session, context.progress, context.warn, context.tables):
            files.write(*batch)
        files.write(DICTIONARY_TABLE, dictionary_columns([*files.tables, DICTIONARY_TABLE], whose))
    return [out / f"{table.name}.parquet" for table in files.tables]


class ParquetTables:
    """Tables being written into a folder, one file each; ``about`` is in the metadata of each. ``whose`` are leading
    columns with a constant each.

    ``tables`` are those that have a file. Raises OSError.
    """

    def __init__(self, out: Path, about: dict[str, str], whose: tuple[Column, ...] = ()) -> None:
        self.tables: list[Table] = []
        self._out, self._about, self._whose = out, about, whose
        self._of_all = [column.read(None, None) for column in whose]  # type: ignore[arg-type] # constants
        self._files, self._writers = ExitStack(), dict[str, Any]()

    def __enter__(self) -> "ParquetTables":
        return self

    def __exit__(self, *_: object) -> None:
        self._files.close()

    def write(self, table: Table, columns: list[list[Any]]) -> None:
        """Add rows, given by column, as a row group."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        if table.name not in self._writers:
            schema = pa.schema(
                [_field(column) for column in (*self._whose, *table.columns)],
                metadata={
                    key: plain_text(value) for key, value in {**self._about, "description": table.description}.items()
                },
            )
            writer = pq.ParquetWriter(self._out / f"{table.name}.parquet", schema, compression="zstd")
            self._writers[table.name] = self._files.enter_context(writer)
            self.tables.append(table)
        writer = self._writers[table.name]
        if count := len(columns[0]):
            constants = [pa.repeat(pa.scalar(value, pa.string()), count) for value in self._of_all]
            arrays = [array(table.name, column, values) for column, values in zip(table.columns, columns, strict=True)]
            rows = pa.Table.from_arrays([*constants, *arrays], schema=writer.schema)
            writer.write_table(rows, row_group_size=count)


def _field(column: Column) -> Any:
    import pyarrow as pa

    about = {"unit": column.unit, "clock": column.clock, "description": column.description, "empty": empty_of(column)}
    about["values"] = "; ".join(allowed_values(column))
    metadata = {key: value for key, value in about.items() if value}
    return pa.field(column.name, arrow_type(column.kind), metadata=metadata)
