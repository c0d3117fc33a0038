"""Measures of others: installed as packages, in all tables of a study, and switched off when they fail."""

import csv
import json
import sys
from pathlib import Path
from typing import Any

import duckdb
import pytest

from caris_desktop.app.plugin_contracts import check_measure, record_sample
from caris_desktop.recording.measures import measure_plugins
from caris_desktop.recording.session_export import ExportRequest, export_all
from caris_desktop.recording.studies.statistics import StudyStatistics, study_statistics
from tests.support.plugins import install


def source(body: str, *, version: int = 1, values: str = "()", description: str = "Number of turns.") -> str:
    return f"""
import os, time
from caris_desktop.recording.tables.build import rows

class Plugin:
    caris_interface = {version}
    description = {description!r}
    empty = "Nobody spoke."
    values = {values}

    def measure(self, session):
        turns = len(list(rows(session, "utterances"))) or None
        {body}
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    for name in ("one", "two"):
        record_sample(tmp_path / "study" / "sessions" / name, talk=name == "one")
    return tmp_path / "study"


def of_csv(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def statistics(study: Path) -> StudyStatistics:
    return study_statistics(study, study / "statistics")


def test_one_is_in_statistics_codebook_and_study_tables(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path / "packages", "measures", "turns", source("return turns", values="range(5)"), monkeypatch)
    made = statistics(study)
    assert not made.problems
    assert {row["session"]: row["turns"] for row in made.measures} == {"one": 2.0, "two": None}
    (summary,) = (row for row in made.summary if row.measure == "turns" and row.condition is None)
    assert (summary.n, summary.mean, summary.description) == (1, 2.0, "Number of turns.")
    assert [row["turns"] for row in of_csv(made.out / "measures.csv")] == ["2.0", ""]
    (entry,) = (row for row in of_csv(made.out / "codebook.csv") if row["column"] == "turns")
    assert (entry["description"], entry["values"], entry["empty"], entry["reference"]) == (
        "Number of turns.", "0; 1; 2; 3; 4", "Nobody spoke.", "lab-turns 2.1",
    )  # fmt: skip
    monkeypatch.chdir(made.out)
    with duckdb.connect() as database:
        database.execute((made.out / "queries.sql").read_text("utf-8"))
        assert database.execute("SELECT turns FROM measures ORDER BY session").fetchall() == [(2.0,), (None,)]
    sessions = tuple(sorted((study / "sessions").iterdir()))
    finished = export_all(ExportRequest(sessions, ("tables",), tmp_path / "out"))
    assert not finished.problems
    rows = of_csv(tmp_path / "out" / "tables" / "csv" / "measures.csv")
    assert [row["turns"] for row in rows] == ["2.0", ""]
    codebook = json.loads((tmp_path / "out" / "tables" / "codebook.json").read_text("utf-8"))
    (column,) = (one for one in codebook["tables"][0]["columns"] if one["name"] == "turns")
    assert (column["description"], column["values"], column["reference"]) == (
        "Number of turns.", ["0", "1", "2", "3", "4"], "lab-turns 2.1",
    )  # fmt: skip
    assert "lab_turns" not in sys.modules, "this process does not run it"


def test_unchanged_sessions_are_measured_once_and_again_with_another_plug_in(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path / "packages", "measures", "turns", source("return turns"), monkeypatch)
    assert [statistics(study).exported for _ in range(2)] == [2, 0]
    monkeypatch.syspath_prepend(str(tmp_path / "none"))
    monkeypatch.setattr(sys, "path", [path for path in sys.path if "packages" not in path])
    made = statistics(study)
    assert made.exported == 2 and "turns" not in made.measures[0]


@pytest.mark.logs("the plug-in turns of lab-turns failed")
@pytest.mark.long("*it returned nan", "*it returned 7", "*printed*", "*its description is not a sentence")
@pytest.mark.parametrize(
    ("module", "reason"),
    [
        (source("raise ValueError('no idea')"), "it raised ValueError: no idea"),
        (source("print('hello')"), "it printed “hello”"),
        (source("os._exit(3)"), "it ended its process"),
        (source("time.sleep(3600)"), "it did not return within 2 s"),
        (source("return 'many'"), "it returned 'many'"),
        (source("return float('nan')"), "it returned nan"),
        (source("return 7", values="(1, 2)"), "it returned 7"),
        (source("return 7", version=9), "it is written for version 9 of the interface"),
        (source("return 7", description="turns"), "its description is not a sentence"),
    ],
)
def test_one_that_fails_is_named_and_costs_only_itself(
    module: str, reason: str, study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path / "packages", "measures", "turns", module, monkeypatch)
    monkeypatch.setattr(measure_plugins, "MEASURED_WITHIN_S", 2.0)
    made = statistics(study)
    assert made.sessions == 2 and made.measures[0]["robot_utterances"] == 1
    assert f"The measure turns (lab-turns 2.1) was switched off: {reason}" in made.problems[0]
    assert not any(row.get("turns") for row in made.measures)


_OWN_ERROR = """

class NoGaze(OSError):
    def __init__(self, session, why):
        super().__init__(f"{session.folder.name} has no gaze: {why}")
"""


def test_one_with_an_error_of_its_own_is_named_and_not_run_in_this_process(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = source("raise NoGaze(session, 'no glasses')") + _OWN_ERROR
    install(tmp_path / "packages", "measures", "turns", module, monkeypatch)
    made = statistics(study)
    assert made.problems == tuple(f"{name}: turns: {name} has no gaze: no glasses" for name in ("one", "two"))
    assert "lab_turns" not in sys.modules


def test_a_name_of_the_program_cannot_be_replaced(study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path / "packages", "measures", "gaps", source("return 7"), monkeypatch)
    made = statistics(study)
    assert made.problems == (
        "The measure gaps (lab-gaps 2.1) was switched off: its name cannot be that of a column.",
    )  # fmt: skip
    assert made.measures[0]["gaps"] == 1


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("return 'many'", "it returned 'many'"),
        ("print('hello')", "prints"),
        ("(session.folder / 'a').touch()", "nothing into the folder"),
        ("return time.monotonic()", "the same value each time"),
    ],
)
def test_the_contract_refuses(body: str, message: str) -> None:
    made: dict[str, Any] = {}
    exec(source(body), made)  # noqa: S102 - of this test
    with pytest.raises(AssertionError, match=message):
        check_measure(made["Plugin"], name="turns")
