"""Study tables: one tidy set over all sessions of a study, with codebook, R script and notebook, and SPSS files."""

import glob
import importlib.util
import itertools
import json
import logging
import re
import shutil
import textwrap
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from caris_desktop import __version__
from caris_desktop.domain.shipped import resources_dir
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.recording.annotation.annotation_editing import AnnotationError
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument
from caris_desktop.recording.annotation.coder_agreement import UNNAMED, compare_coders
from caris_desktop.recording.data_dictionary import (
    DICTIONARY_TABLE,
    MEASURES_TABLE,
    allowed_values,
    dictionary_columns,
    measure_rows,
)
from caris_desktop.recording.exporters.csv import csv_of
from caris_desktop.recording.exporters.templates import write_page
from caris_desktop.recording.measures.measure_definitions import MEASURES, TABLES, THRESHOLDS, Measure
from caris_desktop.recording.measures.measure_plugins import PLUGIN_TABLE, plugin_measures, plugin_values
from caris_desktop.recording.measures.session_measures import sql
from caris_desktop.recording.pseudonyms import coding_of
from caris_desktop.recording.session.session_header import SessionError
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext, attempt
from caris_desktop.recording.studies.study_index import without_copies
from caris_desktop.recording.table_files import ParquetTables, copy_tables
from caris_desktop.recording.tables.build import DERIVED_TABLES, all_tables, table_sql
from caris_desktop.recording.tables.catalog import Column, Kind, Table, key_columns, key_values, unit_of

_MOST_TEXT_BYTES = 4_000
"""Longer texts are cut off: all cells of a column have the width of its longest one."""
_MOST_LABEL_BYTES = 255
_NOTE_LINE = 70
_RESERVED = frozenset(["all", "and", "by", "eq", "ge", "gt", "le", "lt", "ne", "not", "or", "to", "with"])
_NUMBERS = ("integer", "number")


def write_tables(parquet: Path, out: Path, tables: Iterable[Table], notify: Callable[[str], None]) -> bool:
    """Write one file for each of these tables, from its Parquet file; False if the packages for it are missing.

    Raises OSError.
    """
    if not all(map(importlib.util.find_spec, ("pyreadstat", "pandas"))):
        notify(
            QT_TR_NOOP(
                "The study tables have no SPSS files: the packages pyreadstat and pandas are not installed. Install "
                "them with pip install 'caris-desktop[spss]', and export again. CSV and Parquet files are complete."
            )
        )
        return False
    import pyreadstat

    out.mkdir()
    for table in tables:
        columns = table.columns
        pyreadstat.write_sav(
            _frame(parquet / f"{table.name}.parquet", columns),
            out / f"{table.name}.sav",
            file_label=table.name,
            note=textwrap.wrap(table.description, _NOTE_LINE),
            row_compress=True,
            column_labels={_name(column): _label(column) for column in columns},
            variable_value_labels={
                _name(column): {code: value for value, code in codes.items()}
                for column in columns
                if (codes := _codes(column))
            },
            variable_measure={_name(column): _level(column) for column in columns},
        )
    return True


def about(column: Column) -> dict[str, Any]:
    """Name, codes and measurement level of the variable that a column becomes."""
    return {"name": _name(column), "codes": _codes(column), "level": _level(column)}


def _name(column: Column) -> str:
    """Name that SPSS accepts: it reserves some words."""
    return f"{column.name}_" if column.name.casefold() in _RESERVED else column.name


def _label(column: Column) -> str:
    unit = f" [{column.unit}]" if column.unit else ""
    text = column.description.encode()[: _MOST_LABEL_BYTES - len(unit.encode())].decode(errors="ignore")
    return f"{text}{unit}"


def _codes(column: Column) -> dict[str, float]:
    """Number of each allowed value; true is 1, false is 0. Numbers are their own."""
    if column.kind in _NUMBERS:
        return {value: float(value) for value in column.values}
    if column.kind == "true or false":
        return {"false": 0.0, "true": 1.0}
    return {value: float(code) for code, value in enumerate(allowed_values(column), start=1)}


def _level(column: Column) -> str:
    return "scale" if column.kind in (*_NUMBERS, "utc") else "nominal"


def _frame(path: Path, columns: tuple[Column, ...]) -> Any:
    import pandas as pd
    import pyarrow.parquet as pq

    rows = pq.read_table(path)
    cells = {}
    for column in columns:
        values = rows.column(column.name)
        if column.kind == "utc":
            cells[_name(column)] = values.to_pandas().dt.tz_localize(None)
        elif column.kind in _NUMBERS:
            cells[_name(column)] = values.to_pandas().astype("float64")
        elif codes := _codes(column):
            coded = (codes.get(_text(value)) for value in values.to_pylist())
            cells[_name(column)] = pd.Series(list(coded), dtype="float64")
        else:
            texts = [_text(value).encode()[:_MOST_TEXT_BYTES].decode(errors="ignore") for value in values.to_pylist()]
            cells[_name(column)] = pd.Series(texts, dtype="object")
    return pd.DataFrame(cells)


def _text(value: Any) -> str:
    match value:
        case None:
            return ""
        case bool():
            return "true" if value else "false"
        case list():
            return ";".join(map(str, value))
    return str(value).replace("\0", "\N{REPLACEMENT CHARACTER}")


_log = logging.getLogger(__name__)
_FORMAT, _FORMAT_VERSION = "caris-desktop study tables", 1


def write_tables_of_study(sessions: Sequence[Session], out: Path, context: ExportContext) -> list[Path]:
    """Fill the empty folder ``out``. ``context.warn`` gets a sentence on each session that was left out.

    Raises OSError, and SessionError if no session could be read.
    """
    sessions = without_copies(sessions, context.notify)
    with _StudyTables(out, context) as study:

        def add(session: Session) -> None:
            number = sessions.index(session)
            study.add(session, lambda share: context.progress((number + share) / len(sessions)))

        added = [session for session in sessions if attempt(session, add, context.warn)]
    if not added:
        raise SessionError(QT_TR_NOOP("No session could be read, so there are no study tables."))
    return study.finish(added)


class _StudyTables:
    """Tables being written, session by session: each is first written apart, so that one that fails leaves no rows.

    Raises OSError.
    """

    def __init__(self, out: Path, context: ExportContext) -> None:
        self._csv, self._parquet, self._part = out / "csv", out / "parquet", out / ".part"
        for folder in (self._csv, self._parquet):
            folder.mkdir()
        self._out, self._context = out, context
        self._about = {"program_version": __version__, "licence": context.licence}
        self._tables: dict[str, Table] = {}
        self._rows: dict[str, int] = {}
        self._files = ParquetTables(self._parquet, self._about)
        self._plugins = plugin_measures(context.warn)
        self._plugin_values: list[tuple[str, str, float]] = []

    def __enter__(self) -> "_StudyTables":
        return self

    def __exit__(self, *_: object) -> None:
        self._files.__exit__()
        shutil.rmtree(self._part, ignore_errors=True)

    def add(self, session: Session, progress: Callable[[float], None]) -> None:
        """Add the rows of a session. Raises SessionError, and then adds none."""
        shutil.rmtree(self._part, ignore_errors=True)
        self._part.mkdir()
        whose = key_columns(session)
        for path in copy_tables(session, self._part, progress, self._context.warn):
            if path.stem != DICTIONARY_TABLE.name:
                table = all_tables()[path.stem]
                table = self._tables.setdefault(
                    path.stem, Table(table.name, table.description, (*whose, *table.columns))
                )
                self._rows[table.name] = self._rows.get(table.name, 0) + self._files.append(table, path)
        name = session.folder.name

        def warn(failure: str) -> None:
            self._context.warn(localized(QT_TR_NOOP("{session}: {why}"), session=name, why=failure))

        values = plugin_values(self._plugins, session.folder, self._context.pseudonyms, warn)
        self._plugin_values += [(name, *value) for value in values.items()]

    def finish(self, sessions: Sequence[Session]) -> list[Path]:
        """Write what is computed from all sessions, and the descriptions; return all files."""
        documents = [(session, coding_of(session, on_damaged=_log.info)) for session in sessions]
        coded = [(session, document) for session, document in documents if document.annotations]
        measures = [*MEASURES, *(one.definition for one in self._plugins)]
        computed: list[_Computed] = [_measures(self._parquet, measures, self._plugin_values)]
        computed += [_by_coder(coded), _agreement(coded)] if coded else []
        with ParquetTables(self._parquet, self._about) as of_parquet:
            for table, rows in computed:
                columns = [list(cells) for cells in zip(*rows, strict=True)] or [[] for _ in table.columns]
                of_parquet.write(table, columns)
                self._tables[table.name], self._rows[table.name] = table, len(rows)
            of_parquet.write(DICTIONARY_TABLE, dictionary_columns([*self._tables.values(), DICTIONARY_TABLE]))
        for path in self._parquet.iterdir():
            csv_of(path, self._csv, self._context.csv)
        of_events = [
            table
            for table in self._tables.values()
            if table.name.startswith("event_") or table in (one for one, _ in computed) or table.name in _DERIVED
        ]
        in_spss = write_tables(self._parquet, self._out / "spss", of_events, self._context.notify)
        codebook = self._codebook(sessions, in_spss)
        (self._out / "codebook.json").write_text(json.dumps(codebook, indent=1, ensure_ascii=False), encoding="utf-8")
        plain = self._context.csv.plain
        write_page(self._out / "codebook.md", "codebook.md.j2", **codebook, plain=plain)
        write_page(self._out / "load_tables.R", "load_tables.R.j2", plain=plain)
        shutil.copyfile(resources_dir() / "templates" / "load_tables.ipynb", self._out / "load_tables.ipynb")
        return sorted(path for path in self._out.rglob("*") if path.is_file())

    def _codebook(self, sessions: Sequence[Session], in_spss: bool) -> dict[str, Any]:
        described = list(zip(*dictionary_columns(self._tables.values()), strict=True))
        names = [column.name for column in DICTIONARY_TABLE.columns]
        described_measures = measure_rows(one.definition for one in self._plugins)
        of_measures = {row["column"]: row for row in described_measures if row["table"] == MEASURES_TABLE}
        tables: list[dict[str, Any]] = []
        for table in self._tables.values():
            columns = []
            for column, row in zip(
                table.columns, (row for row in described if row[0] == table.name and row[1]), strict=True
            ):
                entry: dict[str, Any] = {"name": column.name, **dict(zip(names[2:], row[2:], strict=True))}
                measure = of_measures.get(column.name, {}) if table.name == MEASURES_TABLE else {}
                entry |= {name: measure.get(name, "") for name in ("formula", "reference")}
                entry["values"] = list(column.values)
                if in_spss:
                    entry["spss"] = about(column)
                columns.append(entry)
            tables.append(
                {
                    "name": table.name,
                    "description": table.description,
                    "rows": self._rows[table.name],
                    "in_spss": in_spss and (self._out / "spss" / f"{table.name}.sav").exists(),
                    "columns": columns,
                }
            )
        thresholds = [
            {"name": one.name, "value": one.value, "unit": one.unit, "description": one.description}
            for one in THRESHOLDS
        ]
        first = [MEASURES_TABLE, "annotations_by_coder", "agreement", *(table.name for table in DERIVED_TABLES)]
        order = {name: number for number, name in enumerate(first)}
        named = sorted(tables, key=lambda table: order.get(table["name"], len(order) + (table["name"][:6] != "event_")))
        return {
            "format": _FORMAT,
            "format_version": _FORMAT_VERSION,
            "program_version": __version__,
            "licence": self._context.licence,
            "sessions": [session.folder.name for session in sessions],
            "tables": named,
            "thresholds": thresholds,
        }


_DERIVED = frozenset(table.name for table in DERIVED_TABLES)


# Tables that are computed from all sessions

Coded = Sequence[tuple[Session, AnnotationDocument]]
_Computed = tuple[Table, list[tuple[Any, ...]]]


def _column(name: str, kind: Kind, description: str, empty: str = "") -> Column:
    return Column(name, unit_of(name), kind, description, lambda row: row, empty=empty)


def _measures(parquet: Path, measures: Sequence[Measure], plugin_values: Sequence[tuple[str, str, float]]) -> _Computed:
    import duckdb

    # One thread, so that sums are the same to the last digit in each run.
    with duckdb.connect(":memory:", config={"threads": 1}) as database:
        for name, columns in TABLES.items():
            path = parquet / f"{name}.parquet"
            database.execute(table_sql(name, columns, glob.escape(str(path)) if path.exists() else ""))
        database.execute(f"CREATE TABLE {PLUGIN_TABLE} (session VARCHAR, measure VARCHAR, value DOUBLE)")
        if plugin_values:
            database.executemany(f"INSERT INTO {PLUGIN_TABLE} VALUES (?, ?, ?)", plugin_values)  # noqa: S608 - ours
        database.execute(sql([one.name for one in measures[len(MEASURES) :]]))
        names = [f'"{name}"' for name in (*(one.name for one in _ABOUT_SESSION), *(one.name for one in measures))]
        rows = database.execute(f"SELECT {', '.join(names)} FROM measures ORDER BY session").fetchall()  # noqa: S608
    described = {row["column"]: row for row in measure_rows(measures[len(MEASURES) :])}
    of_measures = [
        Column(
            one.name,
            one.unit,
            "number" if one.unit or one not in MEASURES else "integer",
            one.description,
            lambda row: row,
            values=one.values,
            empty=described[one.name]["empty"],
        )
        for one in measures
    ]
    table = Table(
        MEASURES_TABLE,
        "One row for each session, practice sessions included (purpose), with all measures.",
        (*_ABOUT_SESSION, *of_measures),
    )
    return table, rows


_KEYS = 4
_ABOUT_SESSION = (
    _column("session", "text", "Name of the recording's folder."),
    _column("participant", "text", "Code of the participant, as entered at the start.", "Nothing was entered."),
    _column("condition", "text", "Experimental condition, as entered at the start.", "Nothing was entered."),
    _column("trial", "text", "Number or name of the trial, as entered at the start.", "Nothing was entered."),
    _column("wizard", "text", "Wizard of the session, as a pseudonym in exports.", "Nothing was entered."),
    _column("purpose", "text", "What the session was for, such as practice.", "Nothing was entered."),
    _column("scenario", "text", "Heading of the scenario file.", "Not recorded."),
)


def _by_coder(coded: Coded) -> _Computed:
    """Annotations of all coders side by side: a row for each stretch of time in which no coder's code changes."""
    coders = sorted({tier.coder for _, document in coded for tier in document.tiers})
    rows = []
    for session, document in coded:
        keys = key_values(session).values()
        for tier in dict.fromkeys(tier.name for tier in document.tiers):
            of_coder = {one.coder: document.of_tier(one.tier_id) for one in document.tiers if one.name == tier}
            bounds_ms = sorted(
                {at for items in of_coder.values() for one in items for at in (one.start_ms, one.end_ms)}
            )
            for start_ms, end_ms in itertools.pairwise(bounds_ms):
                codes = {
                    coder: one.value or UNNAMED
                    for coder, items in of_coder.items()
                    for one in items
                    if one.start_ms <= start_ms < one.end_ms
                }
                if codes:
                    times_s = (start_ms / 1000, end_ms / 1000, (end_ms - start_ms) / 1000)
                    rows.append((*keys, tier, "; ".join(of_coder), *times_s, *(codes.get(one) for one in coders)))
    columns = [
        _column("tier", "text", "Layer of the annotations, by its name; the same for all coders."),
        _column("coders", "text", "Coders who have this tier, separated by semicolons."),
        _column("start_session_s", "number", "Start of the stretch of time, since the start of the session."),
        _column("end_session_s", "number", "End of the stretch of time, since the start of the session."),
        _column("duration_s", "number", "Length of the stretch of time."),
    ]
    names = _column_names(coders)
    columns += [
        _column(name, "text", f"Code that {coder} gave to this time.", "Nothing, or the coder has no such tier.")
        for name, coder in zip(names, coders, strict=True)
    ]
    description = (
        "The annotations side by side, with a column for each coder. One row is a stretch of time in which no code "
        "changes; times that nobody annotated have none. The table annotations has one row for each annotation."
    )
    return Table("annotations_by_coder", description, (*_ABOUT_SESSION[:_KEYS], *columns)), rows


def _column_names(coders: Sequence[str]) -> list[str]:
    names: dict[str, str] = {}
    for coder in coders:
        name = plain = "coder_" + re.sub(r"\W+", "_", coder)
        while name.casefold() in names:
            name = f"{plain}_{len(names) + 1}"
        names[name.casefold()] = name
    return list(names.values())


def _agreement(coded: Coded) -> _Computed:
    """Agreement of each pair of coders on each tier."""
    rows: list[tuple[Any, ...]] = []
    for session, document in coded:
        try:
            results = compare_coders(document)
        except AnnotationError as error:
            _log.info("%s: %s", session.folder.name, error)
            continue
        keys = key_values(session).values()
        for result in results:
            for pair in result.pairs:
                items, units, offsets = pair.per_annotation, pair.per_unit, pair.offsets
                rows.append((
                    *keys, pair.tier, *pair.coders, len(result.coders), result.alpha, pair.unit_ms, units.count,
                    units.kappa, units.observed, pair.tolerance_ms, items.count,
                    0 if offsets is None else offsets.matched, items.kappa, items.observed,
                    *((None, None) if offsets is None else (offsets.start_mean_ms, offsets.end_mean_ms)),
                ))  # fmt: skip
    undefined = "Undefined: the same code throughout, or no codes."
    columns = (
        _column("tier", "text", "Layer of the annotations, by its name; the same for both coders."),
        _column("coder_1", "text", "One coder of the pair, as a pseudonym in exports."),
        _column("coder_2", "text", "The other coder of the pair."),
        _column("coders", "integer", "How many coders have this tier."),
        _column("alpha", "number", "Krippendorff's alpha (nominal) of all these coders per unit of time.", undefined),
        _column("unit_ms", "integer", "Length of a unit of time."),
        _column("units", "integer", "Compared units of time, those without an annotation included."),
        _column("kappa_per_unit", "number", "Cohen's kappa of the pair per unit of time.", undefined),
        _column("equal_units_fraction", "number", "Share of units with the same code.", "There are no units."),
        _column("tolerance_ms", "integer", "Greatest distance between boundaries of matching annotations."),
        _column("compared_annotations", "integer", "Annotations that were matched, or have no counterpart."),
        _column("matched_annotations", "integer", "Annotations of both coders that belong together."),
        _column("kappa_per_annotation", "number", "Cohen's kappa of the pair per annotation.", undefined),
        _column("equal_annotations_fraction", "number", "Share of annotations with the same code.", "There are none."),
        _column("start_offset_ms", "number", "Mean start by coder_2 minus that by coder_1.", "None were matched."),
        _column("end_offset_ms", "number", "Mean end by coder_2 minus that by coder_1.", "None were matched."),
    )
    return Table(
        "agreement", "Agreement of two coders on a tier of a session.", (*_ABOUT_SESSION[:_KEYS], *columns)
    ), rows
