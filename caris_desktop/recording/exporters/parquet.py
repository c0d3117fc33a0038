"""Parquet export: the tables of the CSV export, typed, in row groups that bound memory.

Every row names its session, so that one query reads a whole study: ``SELECT condition, count(*) FROM
'OUT/*/utterances.parquet' GROUP BY condition``.
"""

from pathlib import Path

from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext
from caris_desktop.recording.table_files import copy_tables
from caris_desktop.recording.tables.catalog import plain_text


def write_parquet(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Fill the empty folder ``out``. Raises OSError, SessionError."""
    paths = copy_tables(session, out, context.progress, context.warn, context.tables)
    if context.licence:
        for path in paths:
            import pyarrow.parquet as pq

            unlicensed = path.rename(path.with_suffix(".part"))
            with pq.ParquetFile(unlicensed) as file:
                schema = file.schema_arrow
                schema = schema.with_metadata({**schema.metadata, b"licence": plain_text(context.licence)})
                with pq.ParquetWriter(path, schema, compression="zstd") as writer:
                    for number in range(file.num_row_groups):
                        writer.write_table(file.read_row_group(number).replace_schema_metadata(schema.metadata))
            unlicensed.unlink()
    return paths
