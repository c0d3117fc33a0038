"""Statistics over the sessions of a study: each is exported to Parquet once and queried with DuckDB.

The output folder contains the tables, the results as CSV, and the SQL that produced them, for further analysis.
"""

import glob
import io
import json
import logging
import shutil
from functools import partial
from pathlib import Path
from typing import Any

from caris_desktop import __version__
from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.csv_cells import SHOWN, CsvStyle
from caris_desktop.recording.data_dictionary import measure_rows
from caris_desktop.recording.measures.measure_definitions import MEASURES, TABLES
from caris_desktop.recording.measures.measure_plugins import (
    PLUGIN_TABLE,
    PluginMeasure,
    plugin_measures,
    plugin_values,
)
from caris_desktop.recording.measures.session_measures import sql
from caris_desktop.recording.pseudonyms import Pseudonyms, pseudonyms_of
from caris_desktop.recording.session.session_header import SessionError
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.recording.session_export import (
    ExportContext,
    ExportError,
    Progress,
    Runner,
    export_session,
    run_here,
)
from caris_desktop.recording.studies.study_index import (
    content_signature,
    copies_among,
    session_folders,
    sessions_dir_of,
)
from caris_desktop.recording.tables.build import parquet_sql, quoted, table_sql

_log = logging.getLogger(__name__)
_FORMAT, _FORMAT_VERSION = "caris-desktop statistics", 10
_MARKER = "statistics.json"
_MAX_MARKER_BYTES = 64 * 1024 * 1024
Plugins = tuple[PluginMeasure, ...]
_OTHER_VIEWS = {
    "labels": "labels", "codes": "codes", "models": "models", "model_functions": "model_functions",
    "gaps": "gaps_by_means", "steps": "steps", "alarms": "alarm_causes",
}  # fmt: skip
"""The file of each view that has one, except measures and summary."""

_UNITS = {
    **{figure.name: (figure.unit, figure.description) for figure in MEASURES},
    "each_response_time_s": ("s", "Every response time in all sessions."),
    "each_gap_s": ("s", "Every gap before an answer in all sessions; negative for overlaps."),
    "each_reaction_time_s": ("s", "Every reaction time of the wizard in all sessions."),
}


class StatisticsError(Exception):
    """Statistics that were not computed; the text is for people."""


class SummaryRow(Value):
    """One measure over the sessions of a condition, or over all if ``condition`` is None.

    ``n`` counts the sessions that have it. ``sd`` is the sample standard deviation, None for a single value.
    """

    condition: str | None
    measure: str
    unit: str
    description: str
    n: int
    mean: float
    sd: float | None
    median: float
    smallest: float
    largest: float


class StudyStatistics(Value):
    """Result: ``measures`` has a row per session, ``problems`` a sentence per excluded one.

    ``notices`` list copies, which count once, and missing data of the sessions that count.
    """

    out: Path
    sessions: int
    exported: int
    summary: tuple[SummaryRow, ...]
    measures: tuple[dict[str, Any], ...]
    problems: tuple[str, ...]
    notices: tuple[str, ...] = ()


def study_statistics(
    study: Path,
    out: Path,
    progress: Progress = lambda _fraction, _what: None,
    *,
    csv: CsvStyle = SHOWN,
    run: Runner = run_here,
) -> StudyStatistics:
    """Update the tables in ``out`` and compute everything.

    ``progress`` gets the fraction 0..1 and the present item as text; it may raise to cancel.

    Sessions without changes since the last run are not exported again. ``run`` decides where the others are.

    Raises
    ------
    StatisticsError
        If the study has no sessions, or ``out`` holds something else or cannot be written.
    """
    try:
        folders = session_folders(sessions_dir_of(study))
    except OSError as error:
        raise StatisticsError(f"{study} cannot be read: {error.strerror or error}.") from error
    if not folders:
        raise StatisticsError(f"{study} contains no sessions: nothing to compute.")
    failures: list[str] = []
    plugins = plugin_measures(failures.append)
    try:
        known = _prepare(out, plugins)
        folders, notices = _counting(folders)
        exported, problems = _export(folders, out, known, plugins, progress, run)
        progress(0.95, "computing")
        summary, measures = _compute(out, csv, plugins)
    except OSError as error:
        raise StatisticsError(f"The statistics in {out} failed: {error.strerror or error}.") from error
    if not measures:
        raise StatisticsError(f"No session of {study} could be read. {' '.join(problems)}")
    progress(1.0, "done")
    return StudyStatistics(out, len(measures), exported, summary, measures, (*failures, *problems), tuple(notices))


# The tables


def _counting(folders: list[Path]) -> tuple[list[Path], list[str]]:
    """Sessions without copies, and notices on copies and missing data. Unreadable ones are included: the export reports
    them.
    """
    sessions: dict[str, Session] = {}
    for folder in folders:
        try:
            sessions[folder.name] = open_session(folder)
        except SessionError as error:
            _log.info("%s", error)
    copies = copies_among({name: (one.identity, one.losses) for name, one in sessions.items()})
    notices = [f"{name} is a copy of {original} and is not counted again." for name, original in copies.items()]
    for name, session in sessions.items():
        if name not in copies:
            notices += [f"{name}: {sentence}" for sentence in dict.fromkeys((*session.notices, *session.losses))]
    return [folder for folder in folders if folder.name not in copies], notices


def _prepare(out: Path, plugins: Plugins) -> dict[str, str]:
    """Signatures of the sessions that ``out`` has tables of, with the measures of these plug-ins."""
    if any((folder / "session.json").exists() for folder in (out.absolute(), *out.absolute().parents)):
        raise StatisticsError(f"{out} is inside a recorded session. Nothing was written; choose another folder.")
    if not out.exists():
        out.mkdir(parents=True)
    elif not out.is_dir():
        raise StatisticsError(f"{out} is a file. Nothing was written; choose another folder.")
    marker = out / _MARKER
    if not marker.exists():
        if any(out.iterdir()):
            raise StatisticsError(f"{out} contains other files. Nothing was written; choose another folder.")
        _save(out, {}, plugins)
        return {}
    try:
        with marker.open("rb") as file:
            data = parse_json(file.read(_MAX_MARKER_BYTES))
        ours = data["format"] == _FORMAT
        known = {str(name): str(signature) for name, signature in data["sessions"].items()}
    except (ValueError, KeyError, TypeError, AttributeError):
        _log.exception("%s", marker)
        ours = False
    if not ours:
        raise StatisticsError(f"{marker} is damaged. Nothing was written; choose another folder, or delete this one.")
    if {name: data.get(name) for name in ("format_version", "program_version", "plugins")} != _made_by(plugins):
        # Another version may produce other columns.
        return dict.fromkeys(known, "")
    return known


def _made_by(plugins: Plugins) -> dict[str, Any]:
    packages = {one.plugin.name: one.plugin.package for one in plugins}
    return {"format_version": _FORMAT_VERSION, "program_version": __version__, "plugins": packages}


def _save(out: Path, known: dict[str, str], plugins: Plugins) -> None:
    head = {"format": _FORMAT, **_made_by(plugins)}
    text = json.dumps({**head, "sessions": dict(sorted(known.items()))}, indent=1) + "\n"
    replace_file(out / _MARKER, text.encode(), durable=False)


def _export(  # noqa: PLR0917 - all of one run
    folders: list[Path], out: Path, known: dict[str, str], plugins: Plugins, progress: Progress, run: Runner
) -> tuple[int, list[str]]:
    """Update ``out/tables`` and ``known``; return the number of exports, and problems."""
    tables = out / "tables"
    tables.mkdir(exist_ok=True)
    names = {folder.name for folder in folders}
    changed = [
        folder
        for folder in folders
        if known.get(folder.name) != content_signature(folder) or not (tables / folder.name).is_dir()
    ]
    for name in [name for name in known if name not in names]:
        _remove(tables / name)
        del known[name]
    for folder in changed:
        known.pop(folder.name, None)
    # Before anything can interrupt.
    _save(out, known, plugins)
    unreadable, problems = 0, dict[Path, list[str]]()
    job = partial(_export_tables, tables, pseudonyms_of(folders), plugins)
    for folder, result in run(job, changed, lambda fraction, what: progress(0.95 * fraction, what)):
        if isinstance(result, Exception):
            unreadable += 1
            problems[folder] = [f"{folder.name}: {result}"]
        else:
            signature, failures = result
            problems[folder] = [f"{folder.name}: {failure}" for failure in failures]
            # What a plug-in has failed to measure is tried again by the next run.
            known[folder.name] = "" if failures else signature
            _save(out, known, plugins)
    return len(changed) - unreadable, [one for folder in folders for one in problems.get(folder, ())]


def _export_tables(
    tables: Path, pseudonyms: Pseudonyms, plugins: Plugins, folder: Path, progress: Progress
) -> tuple[str, list[str]] | ExportError:
    """Write the tables of one session; return its signature, since opening may have repaired it, and what plug-ins
    failed to measure.
    """
    progress(0.0, what := f"{folder.name} to tables")
    _remove(tables / folder.name)
    context = ExportContext(lambda fraction: progress(fraction, what), pseudonyms=pseudonyms, tables=TABLES)
    try:
        export_session(folder, "parquet", tables / folder.name, context)
    except ExportError as error:
        return error
    failures: list[str] = []
    values = plugin_values(plugins, folder, pseudonyms, failures.append)
    if plugins:
        import pyarrow as pa
        import pyarrow.parquet as pq

        kinds = pa.schema({"session": pa.string(), "measure": pa.string(), "value": pa.float64()})
        rows = {"session": [folder.name] * len(values), "measure": list(values), "value": list(values.values())}
        pq.write_table(pa.table(rows, kinds), (tables / folder.name / f"{PLUGIN_TABLE}.parquet"))
    return content_signature(folder), failures


def _remove(folder: Path) -> None:
    if folder.is_dir():
        shutil.rmtree(folder)


# The queries


def queries(out: Path, plugins: Plugins = (), *, tables: str = "tables") -> str:
    """SQL text: the tables, then the queries. ``tables`` is the path of their folder in it, as a pattern."""
    lines = ["-- The tables. Those that no session has are empty."]
    for name, columns in TABLES.items():
        files = f"{tables}/*/{name}.parquet" if any((out / "tables").glob(f"*/{name}.parquet")) else ""
        lines.append(table_sql(name, columns, files))
    added = []
    if any((out / "tables").glob(f"*/{PLUGIN_TABLE}.parquet")):
        files = f"{tables}/*/{PLUGIN_TABLE}.parquet"
        lines.append(f"CREATE TABLE {PLUGIN_TABLE} AS FROM {parquet_sql(files)};")
        added = [one.plugin.name for one in plugins]
    return "\n".join([*lines, "", sql(added)])


def _compute(out: Path, style: CsvStyle, plugins: Plugins) -> tuple[tuple[SummaryRow, ...], tuple[dict[str, Any], ...]]:
    import duckdb

    try:
        # One thread: several would add in another order in each run, and are no faster in opening thousands of files.
        with duckdb.connect(":memory:", config={"threads": 1}) as database:
            # Restrict DuckDB to the tables, whatever a query says: it checks the pattern, then each file.
            tables = str((out / "tables").resolve())
            allowed = [quoted(f"{folder}/") for folder in (tables, glob.escape(tables))]
            database.execute(f"SET allowed_directories = [{', '.join(allowed)}]")
            database.execute("SET enable_external_access = false")
            database.execute("SET lock_configuration = true")
            database.execute(queries(out, plugins, tables=glob.escape(tables)))
            measures = _rows(database, "SELECT * FROM measures ORDER BY session")
            rows = _rows(database, "SELECT * FROM summary")
            others = {name: _rows(database, f"SELECT * FROM {view}") for name, view in _OTHER_VIEWS.items()}  # noqa: S608
    except duckdb.Error as error:
        _log.exception("the statistics of %s", out)
        raise StatisticsError(f"Computing with the tables in {out} failed: {error}") from error
    units = _UNITS | {one.plugin.name: (one.definition.unit, one.definition.description) for one in plugins}
    order = {name: number for number, name in enumerate(units)}
    summary, of_csv = list[SummaryRow](), list[dict[str, Any]]()
    for row in sorted(rows, key=lambda row: (row["of"] != "study", row["condition"] or "", order[row["measure"]])):
        condition = None if row["of"] == "study" else str(row["condition"] or "")
        unit, description = units[row["measure"]]
        numbers = {name: row[name] for name in ("n", "mean", "sd", "median", "min", "max")}
        summary.append(SummaryRow(condition, row["measure"], unit, description, *numbers.values()))
        about = {"of": row["of"], "condition": condition, "measure": row["measure"], "unit": unit}
        of_csv.append(about | numbers | {"description": description})
    _write_csv(out / "measures.csv", measures, style)
    _write_csv(out / "codebook.csv", measure_rows(one.definition for one in plugins), style)
    for name, found in others.items():
        _write_csv(out / f"{name}.csv", found, style)
    _write_csv(out / "summary.csv", of_csv, style)
    replace_file(out / "queries.sql", queries(out, plugins).encode(), durable=False)
    return tuple(summary), tuple(measures)


def _rows(database: Any, query: str) -> list[dict[str, Any]]:
    cursor = database.execute(query)
    names = [column[0] for column in cursor.description]
    return [dict(zip(names, row, strict=True)) for row in cursor.fetchall()]


def _write_csv(path: Path, rows: list[dict[str, Any]], style: CsvStyle) -> None:
    text = io.StringIO(newline="")
    if rows:
        writer = style.writer(text)
        writer.writerow(rows[0])
        writer.writerows(row.values() for row in rows)
    replace_file(path, text.getvalue().encode(style.encoding), durable=False)
