"""Parquet files of a session's tables, derived once: beside the session, or in the user's cache if that is read-only.

A stored set is used only if its key and the checksums of its files match; else it is made again. It is not part of the
recording: no export, manifest or repair looks at it, and erasing a person deletes it.
"""

import hashlib
import json
import logging
import os
import shutil
from collections.abc import Callable, Collection, Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import platformdirs

from caris_desktop import __version__
from caris_desktop.domain.file_replacement import narrow
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.recording.annotation.annotation_store import annotation_files
from caris_desktop.recording.data_dictionary import DICTIONARY_TABLE, allowed_values, dictionary_columns, empty_of
from caris_desktop.recording.session.folder_lock import hold, is_held
from caris_desktop.recording.session.manifest import DERIVED_FOLDER, MANIFEST_NAME, digest_of
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.tables.build import array, arrow_type, session_batches
from caris_desktop.recording.tables.catalog import Column, Table, key_columns, plain_text

_log = logging.getLogger(__name__)
# To be raised when the same recording gives other tables than before.
_VERSION = 3
_FOLDER, _KEY_FILE, _PART = "tables", "key.json", ".part"
_TRANSCRIPTS = "transcripts"
DELETED_BY_ERASURE = frozenset((_FOLDER, _TRANSCRIPTS))
"""Folders in the derived folder that the erasure of a person deletes."""
_ROWS_AT_ONCE = 5_000
_MODE = 0o770  # narrowed to what this user shares


def copy_tables(
    session: Session,
    out: Path,
    progress: Callable[[float], None] = lambda _: None,
    on_damaged: Callable[[str], None] = _log.warning,
    only: Collection[str] = (),
) -> list[Path]:
    """Fill the empty folder ``out`` with a Parquet file for each table (or ``only`` these) and the data dictionary.

    With ``only``, stored tables are used, but none are stored: those that the measures read take a seventh of the time
    of all. Stored ones come with the dictionary of all.
    ``on_damaged`` gets a sentence on each coder's file that was left out. Raises SessionError, OSError.
    """
    wanted = frozenset((*only, DICTIONARY_TABLE.name) if only else ())
    if not is_held(session.folder):
        for place in _places(session):
            stored = _valid(place, session, wanted) or (None if only else _derived(place, session, progress))
            if stored is not None:
                for sentence in stored["damaged"]:
                    on_damaged(sentence)
                return [Path(shutil.copyfile(place / name, out / name)) for name in stored["files"]]
    return _write(session, out, progress, on_damaged, only)


def delete_tables(sessions: Iterable[Path]) -> None:
    """Delete stored tables and later transcripts of these sessions, and all in the user's cache. Raises OSError."""
    folders = [base for folder in sessions for base in (folder / DERIVED_FOLDER / _FOLDER, transcripts_folder(folder))]
    for base in (*folders, _cache()):
        if base.is_dir():
            with hold(base):
                shutil.rmtree(base)


def transcripts_folder(session: Path) -> Path:
    """Folder of later transcripts: other words for what was said, which an erasure would not find."""
    return session / DERIVED_FOLDER / _TRANSCRIPTS


# The stored files


def _cache() -> Path:
    return platformdirs.user_cache_path("caris-desktop", appauthor=False) / _FOLDER


def _places(session: Session) -> tuple[Path, Path]:
    """Beside the session, and in the cache."""
    whose = "pseudonymised" if session.pseudonymised else "with names"
    elsewhere = hashlib.sha256(os.fsencode(session.folder.resolve())).hexdigest()
    return session.folder / DERIVED_FOLDER / _FOLDER / whose, _cache() / f"{elsewhere[:32]} {whose}"


def _key(session: Session) -> str:
    """Digest of everything that the tables follow from. Raises OSError."""
    events = (session.folder / "events.mcap").stat()
    manifest = session.folder / MANIFEST_NAME
    files = [*([manifest] if manifest.exists() else []), *annotation_files(session.folder)]
    parts = [
        (__version__, _VERSION),
        (session.folder.name, session.header.to_json(), dict(session.lost), session.ended_ns, session.closed_properly),
        session.names,
        (events.st_size, events.st_mtime_ns),
        [(path.name, digest_of(path)) for path in files],
    ]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _valid(place: Path, session: Session, wanted: frozenset[str]) -> dict[str, Any] | None:
    """Content of the key file, with the wanted files; None if the stored set must not be used."""
    try:
        stored = parse_json((place / _KEY_FILE).read_bytes())
        if stored["key"] != _key(session):
            return None
        files = {str(name): digest for name, digest in stored["files"].items()}
        files = {name: digest for name, digest in files.items() if not wanted or Path(name).stem in wanted}
        if any(Path(name).name != name or digest_of(place / name) != digest for name, digest in files.items()):
            _log.warning("the tables in %s are damaged and are made again", place)
            return None
        return {"damaged": [str(sentence) for sentence in stored["damaged"]], "files": files}
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        _log.info("the tables in %s are not used: %s", place, error)
        return None


def _derived(place: Path, session: Session, progress: Callable[[float], None]) -> dict[str, Any] | None:
    """Derive and store all tables; None if they cannot be stored there, or the session changed meanwhile."""
    base, part = place.parent, place.with_name(f"{_PART} {place.name}")
    try:
        base.mkdir(mode=_MODE, parents=True, exist_ok=True)
        narrow([base])
        with hold(base):
            for left in (part, *_left_in_cache(base)):
                shutil.rmtree(left, ignore_errors=True)
            part.mkdir(mode=_MODE)
            try:
                key, damaged = _key(session), list[str]()
                files = {path.name: digest_of(path) for path in _write(session, part, progress, damaged.append)}
                stored = {"key": key, "folder": str(session.folder.resolve()), "damaged": damaged, "files": files}
                (part / _KEY_FILE).write_text(json.dumps(stored, indent=1), encoding="utf-8")
                narrow([part, *part.iterdir()])
                if is_held(session.folder) or _key(session) != key:
                    return None
                if place.exists():
                    shutil.rmtree(place)
                part.rename(place)
            finally:
                shutil.rmtree(part, ignore_errors=True)
    except OSError as error:
        # Read-only, full, or at work for somebody else.
        _log.info("the tables of %s are not stored in %s: %s", session.folder, base, error)
        return None
    return stored


def _left_in_cache(base: Path) -> list[Path]:
    """Tables in the cache whose session is gone."""
    left = []
    for key_file in base.glob(f"*/{_KEY_FILE}") if base == _cache() else ():
        try:
            gone = not Path(parse_json(key_file.read_bytes())["folder"]).exists()
        except (OSError, ValueError, KeyError, TypeError):
            gone = True
        if gone:
            left.append(key_file.parent)
    return left


# Writing


def _write(
    session: Session,
    out: Path,
    progress: Callable[[float], None],
    on_damaged: Callable[[str], None],
    only: Collection[str] = (),
) -> list[Path]:
    whose = key_columns(session)
    about = {
        "session": session.folder.name,
        "started_utc": session.clock.utc(session.started_ns),
        "program_version": session.header.program_version,
        "licence": "",
    }
    with ParquetTables(out, about, whose) as files:
        for batch in session_batches(session, progress, on_damaged, only):
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
        self._of_all = [column.read(None) for column in whose]
        self._files, self._writers = ExitStack(), dict[str, Any]()

    def __enter__(self) -> "ParquetTables":
        return self

    def __exit__(self, *_: object) -> None:
        self._files.close()

    def write(self, table: Table, columns: list[list[Any]]) -> None:
        """Add rows, given by column, as a row group."""
        import pyarrow as pa

        writer = self._writers.get(table.name) or self._begin(
            table, pa.schema([_field(column) for column in (*self._whose, *table.columns)])
        )
        if count := len(columns[0]):
            constants = [pa.repeat(pa.scalar(value, pa.string()), count) for value in self._of_all]
            arrays = [array(table.name, column, values) for column, values in zip(table.columns, columns, strict=True)]
            rows = pa.Table.from_arrays([*constants, *arrays], schema=writer.schema)
            writer.write_table(rows, row_group_size=count)

    def append(self, table: Table, path: Path) -> int:
        """Add the rows of a file of this table; return their number."""
        import pyarrow.parquet as pq

        with pq.ParquetFile(path) as part:
            writer = self._writers.get(table.name) or self._begin(table, part.schema_arrow)
            for rows in part.iter_batches(_ROWS_AT_ONCE):
                writer.write_batch(rows)
            return int(part.metadata.num_rows)

    def _begin(self, table: Table, schema: Any) -> Any:
        import pyarrow as pa
        import pyarrow.parquet as pq

        about = {key: plain_text(value) for key, value in {**self._about, "description": table.description}.items()}
        # Times and measurements seldom repeat: their dictionaries would take a quarter of the time, and space.
        repeating = [column.name for column in (*self._whose, *table.columns) if column.kind in ("text", "json")]
        path, schema = self._out / f"{table.name}.parquet", schema.with_metadata(about)
        # Arrow's own allocator returns large blocks to the system at once: a tenth of the time of an export.
        pool = pa.system_memory_pool()
        writer = pq.ParquetWriter(path, schema, compression="zstd", use_dictionary=repeating or False, memory_pool=pool)
        self._writers[table.name] = self._files.enter_context(writer)
        self.tables.append(table)
        return writer


def _field(column: Column) -> Any:
    import pyarrow as pa

    about = {"unit": column.unit, "clock": column.clock, "description": column.description, "empty": empty_of(column)}
    about["values"] = "; ".join(allowed_values(column))
    metadata = {key: value for key, value in about.items() if value}
    return pa.field(column.name, arrow_type(column.kind), metadata=metadata)
