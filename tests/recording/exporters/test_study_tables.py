"""Study tables, read by the programs of analysts: pandas, polars, DuckDB, SPSS files, R."""

import json
import shutil
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import duckdb
import pandas as pd
import pyarrow.parquet as pq
import pytest

from caris_desktop.domain.events import AnswerUsed, EmergencyStopChanged, Marked
from caris_desktop.recording import table_files
from caris_desktop.recording.annotation.annotation_model import Annotation, AnnotationDocument, Tier
from caris_desktop.recording.annotation.annotation_store import save_coder
from caris_desktop.recording.annotation.coder_agreement import compare_coders
from caris_desktop.recording.csv_cells import CsvStyle
from caris_desktop.recording.exporters import study_tables
from caris_desktop.recording.session.session_header import SessionError
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.recording.session_export import ExportFinished, ExportRequest, export_all
from caris_desktop.recording.tables.build import Batch, session_batches
from tests.recording.told_session import TRIAL, at, drive, exchange, heard, said, tell

_FORMULA = "=HYPERLINK(evil)"
_GAZE_OF_ANN = ((0, 4000, "robot"), (4000, 9000, "away"), (12000, 14000, ""))
_GAZE_OF_BEA = ((0, 5000, "robot"), (5000, 9000, "robot"))


def _values() -> list[Any]:
    return [
        *heard(1, 2.0, 3.0, _FORMULA),
        *said(1, 3.5, 4.0, 6.0, "Hello."),
        *drive(7.0, 9.0, 0.3),
        EmergencyStopChanged(at(9.5), True, "wizard", "wizard"),
        exchange(1, 10.0, 11.0, "An arm."),
        AnswerUsed(at(12.0), "x-1", "dismissed", ""),
        Marked(at(13.0), "Laughs", mark_id="m-1", actor="wizard:Zoe"),
    ]


def _document(coder: str, gaze: tuple[tuple[int, int, str], ...]) -> AnnotationDocument:
    tier_id = f"t-{len(coder)}"
    annotations = tuple(
        Annotation(f"{tier_id}-{number}", tier_id, start_ms, end_ms, value)
        for number, (start_ms, end_ms, value) in enumerate(gaze)
    )
    return AnnotationDocument((Tier(tier_id, "Gaze", coder),), (), annotations, 20_000)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three sessions: two coders, no coder, and one that cannot be read."""
    sessions = tmp_path_factory.mktemp("study") / "sessions"
    sessions.mkdir()
    trial = {**TRIAL, "trial": "03"}
    tell(sessions / "one", _values(), lasts_s=20.0, trial={**trial, "participant": "P1", "condition": "A"})
    later: dict[str, Any] = {"trial": {**trial, "participant": "P2", "condition": "B"}, "later_s": 3600.0}
    tell(sessions / "two", _values(), lasts_s=20.0, **later)
    shutil.copytree(sessions / "two", sessions / "zz damaged")
    header = json.loads((sessions / "zz damaged" / "session.json").read_text("utf-8"))
    (sessions / "zz damaged" / "session.json").write_text(json.dumps({**header, "format_version": 999}))
    for coder, gaze in (("Annika", _GAZE_OF_ANN), ("Beatrix", _GAZE_OF_BEA)):
        save_coder(sessions / "one", _document(coder, gaze), coder)
    return sessions.parent


def _export(study: Path, out: Path, **options: Any) -> ExportFinished:
    folders = tuple(sorted((study / "sessions").iterdir()))
    return export_all(ExportRequest(folders, ("tables",), out, **options))


@pytest.fixture(scope="module")
def exported(study: Path, tmp_path_factory: pytest.TempPathFactory) -> ExportFinished:
    return _export(study, tmp_path_factory.mktemp("out"))


@pytest.fixture(scope="module")
def out(exported: ExportFinished) -> Path:
    (folder,) = exported.written
    return folder


def _rows(out: Path, name: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = pq.read_table(out / "parquet" / f"{name}.parquet").to_pylist()
    return rows


def test_each_table_has_the_rows_of_all_sessions(out: Path) -> None:
    names = {path.stem for path in (out / "parquet").iterdir()}
    assert names == {path.stem for path in (out / "csv").iterdir()}
    assert {"measures", "utterances", "marks", "agreement", "annotations_by_coder", "event_marked"} <= names
    for name in names - {"data_dictionary", "annotations", "annotations_by_coder", "agreement"}:
        rows = _rows(out, name)
        keys = {(row["session"], row["participant"], row["condition"], row["trial"]) for row in rows}
        assert keys == {("one", "P1", "A", "03"), ("two", "P2", "B", "03")}, name
    assert [row["robot_utterances"] for row in _rows(out, "measures")] == [1, 1]
    assert [row["llm_exchanges"] for row in _rows(out, "measures")] == [1, 1]


def test_the_name_of_a_folder_changes_nothing(study: Path, out: Path, tmp_path: Path) -> None:
    # DuckDB would read brackets as a pattern, and the condition of all sessions from condition=Z.
    (again,) = _export(study, tmp_path / "Study [2026]" / "condition=Z").written
    assert _rows(again, "measures") == _rows(out, "measures")


def test_a_damaged_session_is_named_and_the_rest_goes_on(exported: ExportFinished) -> None:
    (problem,) = exported.problems
    assert "zz damaged" in problem


def test_a_session_that_fails_leaves_no_rows(study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(session: Session, *rest: Any) -> Iterator[Batch]:
        for number, batch in enumerate(session_batches(session, *rest)):
            if session.folder.name == "one" and number == 5:
                raise SessionError("it ends here")
            yield batch

    copied = tmp_path / "study"
    shutil.copytree(study, copied, ignore=shutil.ignore_patterns("derived"))
    monkeypatch.setattr(table_files, "session_batches", failing)
    finished = _export(copied, tmp_path / "out")
    assert [sentence for sentence in finished.problems if "one is left out:" in sentence and "ends here" in sentence]
    tables = [path.stem for path in (tmp_path / "out" / "tables" / "parquet").iterdir()]
    found = {row["session"] for name in tables if name != "data_dictionary" for row in _rows(finished.written[0], name)}
    assert found == {"two"}


def test_a_copy_of_a_session_is_not_counted_again(study: Path, tmp_path: Path) -> None:
    copied = tmp_path / "study"
    shutil.copytree(study, copied)
    shutil.rmtree(copied / "sessions" / "zz damaged")
    shutil.copytree(copied / "sessions" / "one", copied / "sessions" / "one again")
    finished = _export(copied, tmp_path / "out")
    assert any("one again is a copy of one" in sentence for sentence in finished.notices)
    assert [row["session"] for row in _rows(finished.written[0], "measures")] == ["one", "two"]


def test_the_coders_are_side_by_side_and_their_agreement_beside_them(study: Path, out: Path) -> None:
    wide = [
        (row["tier"], row["start_session_s"], row["end_session_s"], row["coder_C1"], row["coder_C2"])
        for row in _rows(out, "annotations_by_coder")
    ]
    assert wide == [
        ("Gaze", 0.0, 4.0, "robot", "robot"),
        ("Gaze", 4.0, 5.0, "away", "robot"),
        ("Gaze", 5.0, 9.0, "away", "robot"),
        ("Gaze", 12.0, 14.0, "(no value)", None),
    ]
    assert len(_rows(out, "annotations")) == 5
    (agreed,) = _rows(out, "agreement")
    document = AnnotationDocument(
        *(
            tuple(
                item
                for one in (_document("Annika", _GAZE_OF_ANN), _document("Beatrix", _GAZE_OF_BEA))
                for item in part(one)
            )
            for part in (lambda one: one.tiers, lambda one: one.vocabularies, lambda one: one.annotations)
        ),
        20_000,
    )
    (expected,) = compare_coders(document)
    assert (agreed["coder_1"], agreed["coder_2"], agreed["alpha"]) == ("C1", "C2", expected.alpha)
    assert agreed["kappa_per_unit"] == expected.pairs[0].per_unit.kappa
    assert agreed["kappa_per_annotation"] == expected.pairs[0].per_annotation.kappa


def test_names_stay_in_the_study_and_formulas_are_text(out: Path) -> None:
    for path in (path for path in out.rglob("*") if path.is_file() and path.suffix != ".parquet"):
        content = path.read_bytes()
        assert not [name for name in (b"Mia", b"Zoe", b"Annika", b"Beatrix") if name in content], path
    for name in (path.stem for path in (out / "parquet").iterdir()):
        cells = [str(value) for row in _rows(out, name) for value in row.values()]
        assert not [cell for cell in cells if cell in ("Mia", "wizard:Zoe", "Annika", "Beatrix")], name
    assert f",'{_FORMULA}," in (out / "csv" / "utterances.csv").read_text("utf-8")
    assert _FORMULA in [row["text"] for row in _rows(out, "utterances")]


def test_the_codebook_describes_each_column_of_each_table(out: Path) -> None:
    codebook = json.loads((out / "codebook.json").read_text("utf-8"))
    assert codebook["sessions"] == ["one", "two"]
    page = (out / "codebook.md").read_text("utf-8")
    for table in codebook["tables"]:
        schema = pq.read_schema(out / "parquet" / f"{table['name']}.parquet")
        assert [column["name"] for column in table["columns"]] == schema.names
        assert table["rows"] == pq.read_metadata(out / "parquet" / f"{table['name']}.parquet").num_rows
        assert all(column["description"] and column["empty"] for column in table["columns"])
        assert f"\n## {table['name']}\n" in page
        values = {column["name"]: column["values"] for column in table["columns"] if column["values"]}
        for row in _rows(out, table["name"]):
            assert {name for name in values if row[name] and str(row[name]) not in values[name]} == set()
    measures = {column["name"]: column for column in codebook["tables"][0]["columns"]}
    assert measures["response_time_s"]["threshold"] == "response_limit_s = 30 s"
    assert measures["response_time_s"]["reference"].startswith("Shiwa")


def test_rows_are_written_in_groups_that_bound_memory(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table_files, "_ROWS_AT_ONCE", 3)
    folder = study_tables.write_tables_of_study(
        [open_session(study / "sessions" / "one")], _folder(tmp_path), study_tables.ExportContext()
    )[0].parent
    data = pq.read_metadata(folder / "parquet" / "event_command_sent.parquet")
    assert data.num_rows > 10
    assert max(data.row_group(number).num_rows for number in range(data.num_row_groups)) <= 3
    assert not (folder / ".part").exists()


def _folder(tmp_path: Path) -> Path:
    (tmp_path / "out").mkdir()
    return tmp_path / "out"


def test_pandas_polars_and_duckdb_read_the_same(out: Path) -> None:
    polars = pytest.importorskip("polars")
    for name in ("utterances", "event_command_sent", "measures", "session"):
        path = out / "parquet" / f"{name}.parquet"
        of_pandas, of_csv = pd.read_parquet(path), pd.read_csv(out / "csv" / f"{name}.csv")
        assert list(of_pandas.columns) == list(of_csv.columns)
        (count,) = duckdb.sql(f"SELECT count(*) FROM '{path}'").fetchall()[0]  # noqa: S608 - the path is of this test
        assert len(of_pandas) == len(of_csv) == polars.read_parquet(path).height == count
    measures = pd.read_csv(out / "csv" / "measures.csv")
    assert measures["driving_s"].tolist() == [row["driving_s"] for row in _rows(out, "measures")]


def test_spss_files_have_labels_codes_and_levels(out: Path) -> None:
    pyreadstat = pytest.importorskip("pyreadstat", reason="pyreadstat is not installed: pip install '.[spss]'")
    utterances = _rows(out, "utterances")
    rows, about = pyreadstat.read_sav(out / "spss" / "utterances.sav", apply_value_formats=True)
    assert rows["speaker"].tolist() == [row["speaker"] for row in utterances]
    assert rows["text"].tolist() == [row["text"] for row in utterances]
    assert rows["duration_s"].tolist() == [row["duration_s"] for row in utterances]
    assert about.variable_value_labels["said"] == {0.0: "false", 1.0: "true"}
    assert about.column_names_to_labels["duration_s"].endswith("[s]")
    assert (about.variable_measure["speaker"], about.variable_measure["duration_s"]) == ("nominal", "scale")
    codebook = json.loads((out / "codebook.json").read_text("utf-8"))
    for table in (one for one in codebook["tables"] if one["in_spss"]):
        _, about = pyreadstat.read_sav(out / "spss" / f"{table['name']}.sav", metadataonly=True)
        assert about.column_names == [column["spss"]["name"] for column in table["columns"]]
        assert all(about.column_labels)
    stops, _ = pyreadstat.read_sav(out / "spss" / "event_emergency_stop_changed.sav")
    assert "by_" in stops.columns, "BY is a reserved word"
    assert not (out / "spss" / "odometry.sav").exists()


def test_without_the_package_for_spss_the_rest_is_there_and_it_says_so(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    finished = _export(study, tmp_path / "out")
    assert any("caris-desktop[spss]" in sentence for sentence in finished.notices)
    assert "no SPSS files" in (finished.written[0] / "codebook.md").read_text("utf-8")
    assert not (finished.written[0] / "spss").exists()


@pytest.mark.parametrize("style", [CsvStyle(), CsvStyle(plain=True, byte_order_mark=True)], ids=["shown", "plain"])
def test_the_r_script_loads_all_tables_and_prints_a_first_one(study: Path, tmp_path: Path, style: CsvStyle) -> None:
    if shutil.which("Rscript") is None:
        pytest.skip("R is not installed")
    (folder,) = _export(study, tmp_path / "out", csv=style).written
    (folder / "check.R").write_text(
        'source("load_tables.R")\n'
        f'stopifnot("{_FORMULA}" %in% study$utterances$text)\n'
        'stopifnot(identical(levels(study$utterances$speaker), c("robot", "participant", "wizard")))\n'
        "stopifnot(is.logical(study$utterances$said), is.numeric(study$utterances$duration_s))\n"
        # All trials are numbers: as codes they keep their zeros.
        'stopifnot(identical(unique(study$measures$trial), "03"), is.numeric(study$measures$stops))\n'
    )
    run = subprocess.run(["Rscript", "check.R"], cwd=folder, capture_output=True, text=True, timeout=500, check=False)
    assert run.returncode == 0, run.stderr
    assert "Means by condition" in run.stdout


def test_the_notebook_loads_all_tables_and_prints_a_first_one(out: Path) -> None:
    cells = json.loads((out / "load_tables.ipynb").read_text("utf-8"))["cells"]
    code = "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    command = [sys.executable, "-W", "error::FutureWarning", "-c", code]
    run = subprocess.run(command, cwd=out, capture_output=True, text=True, timeout=500, check=False)
    assert run.returncode == 0, run.stderr
    assert "robot_utterances" in run.stdout
    assert "Warning" not in run.stderr


def test_the_command_writes_private_files(study: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "caris_desktop", "export", str(study), "--to", "tables", str(tmp_path / "out")]
    run = subprocess.run(command, cwd=Path(__file__).parents[3], capture_output=True, text=True, check=False)
    assert "Exported tables for all" in run.stdout
    written = list((tmp_path / "out").rglob("*"))
    assert len(written) > 20
    assert not [path for path in written if stat.S_IMODE(path.stat().st_mode) & 0o077]
