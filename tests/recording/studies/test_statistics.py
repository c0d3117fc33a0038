"""Statistics of a study by DuckDB, compared with each session and with Python's statistics."""

import argparse
import csv
import json
import math
import re
import shutil
import statistics
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.app import statistics_command
from caris_desktop.domain.events import (
    AlarmChanged,
    AnswerUsed,
    GoalChanged,
    PersonAppeared,
    PersonLeft,
    ResponseTimed,
    Speaker,
    UtteranceChanged,
    UtteranceCorrected,
    UtteranceOrigin,
)
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.recording.annotation.annotation_model import Annotation, AnnotationDocument, Tier
from caris_desktop.recording.annotation.annotation_store import save_coder
from caris_desktop.recording.measures.measure_definitions import MEASURES, TABLES, THRESHOLDS
from caris_desktop.recording.measures.session_measures import Measures, measure, read_facts
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.studies.statistics import StatisticsError, StudyStatistics, queries, study_statistics
from tests.recording.told_session import TRIAL, at, exchange, silenced, stepped, tell, tour


def interrupted_turns() -> list[Any]:
    """The robot interrupts a participant, a filler precedes an answer, and the robot hears itself."""

    def said(turn_id: str, speaker: Speaker, origin: UtteranceOrigin, from_s: float, to_s: float) -> list[Any]:
        begun = UtteranceChanged(at(from_s), turn_id, speaker, "Words.", origin, "started")
        return [begun, replace(begun, stamp_ns=at(to_s), state="finished")]

    return [
        *said("o-1", "participant", "heard", 60.0, 62.0), *said("o-2", "robot", "phrase", 61.4, 63.0),
        *said("o-3", "participant", "heard", 64.0, 65.0), *said("o-4", "robot", "filler", 65.6, 66.0),
        *said("o-5", "robot", "suggestion", 67.0, 68.0),
        ResponseTimed(at(67.1), "o-3", "o-5", "edited_suggestion", at(65.0), at(65.5), at(65.8), at(66.9), at(67.0)),
        *said("o-6", "participant", "heard", 67.1, 68.1), *said("o-7", "robot", "typed", 68.4, 69.0),
        UtteranceCorrected(at(70.0), "o-6", speaker="robot"),
    ]  # fmt: skip


def hard_to_count() -> list[Any]:
    """An unspoken answer, an earlier goal, and one person under two identities."""
    goal = GoalChanged(at(-0.5), "g-before", "reached", Pose2D(1.0, 1.0, 0.0))
    return [
        exchange(700, 80.0, 81.0, "Nobody hears this."),
        *silenced(700, 82.0, "Nobody hears this."),
        AnswerUsed(at(82.0), "x-700", "said", "Nobody hears this.", "u-700"),
        goal,
        PersonAppeared(at(83.0), "p-7", 9, 9),
        PersonAppeared(at(86.0), "p-8", 10, 10),
        PersonLeft(at(87.4), "p-7", 9),
    ]


def wrong(number: int) -> list[Any]:
    """The link twice as one alarm, a full disk that was acknowledged, and alarms that persist to the end."""

    def alarm(s: float, name: str, state: str, times: int = 1, actor: str = "") -> AlarmChanged:
        return AlarmChanged(at(s), name, name, state, "error", f"{name} {s:.0f}", "", "", times, actor=actor)  # type: ignore[arg-type]

    return [
        alarm(2.0, "link", "raised"), alarm(5.0 + number, "link", "ended", actor="console"),
        alarm(20.0, "link", "raised", 2), alarm(21.0, "link", "ended", 2, "console"),
        alarm(30.0, "disk", "raised"), alarm(34.5, "disk", "ended", actor="wizard:Ada"),
        alarm(80.0, "battery", "raised"),
    ]  # fmt: skip


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    study = tmp_path_factory.mktemp("study")
    for number, (condition, purpose) in enumerate((("A", ""), ("B", ""), ("A", ""), ("A", "practice"))):
        trial = {**TRIAL, "participant": f"P{number}", "condition": condition, "purpose": purpose}
        values = tour(number, minutes=1.5 + number / 4, state_hz=4.0, building=False) if number != 1 else []
        if number == 0:
            values += hard_to_count()
        if number == 1:
            values = interrupted_turns()
        if number != 1:
            values += wrong(number)
        if number != 2:
            values += stepped((0.0, "greet", "started"), (12.0 + number, "ask", "next"), (15.0, "close", "skipped"))
        tell(study / "sessions" / f"it's s{number}", values, lasts_s=90 + number * 15, trial=trial)
    gaze = (Annotation("a", "t", 0, 1000, "away"), Annotation("b", "t", 2000, 2500, "away"))
    save_coder(study / "sessions" / "it's s0", AnnotationDocument((Tier("t", "Gaze", "Ann"),), (), gaze), "Ann")
    return study


@pytest.fixture(scope="module")
def measures(study: Path) -> dict[str, Measures]:
    return {folder.name: measure(read_facts(open_session(folder))) for folder in (study / "sessions").iterdir()}


@pytest.fixture(scope="module")
def made(study: Path) -> StudyStatistics:
    return study_statistics(study, study / "statistics")


def test_a_session_has_the_same_measures_alone_and_within_its_study(
    made: StudyStatistics, measures: dict[str, Measures]
) -> None:
    assert (made.sessions, made.exported, made.problems) == (4, 4, ())
    for row in made.measures:
        told = measures[row["session"]].values
        assert list(told) == list(row)
        for figure in MEASURES:
            assert row[figure.name] == pytest.approx(told[figure.name]), figure.name
    assert sum(row["responses"] or 0 for row in made.measures) > 10


# Thresholds by which tables are made.
_OF_TABLES = {"command_holds_s", "heard_from_s", "present_share_fraction"}


def test_the_definitions_name_what_the_queries_compute_and_read(made: StudyStatistics) -> None:
    computed = list(made.measures[0])
    assert computed[computed.index("recorded_s") :] == [figure.name for figure in MEASURES]
    text = queries(made.out)
    assert set(re.findall(r"getvariable\('(\w+)'\)", text)) | _OF_TABLES == {one.name for one in THRESHOLDS}
    for name in TABLES:
        assert len(re.findall(rf"\b{name}\b", text)) > 1, f"{name} is not read"


def test_the_summary_is_that_of_the_sessions_that_count(made: StudyStatistics, measures: dict[str, Measures]) -> None:
    groups = {None: ["it's s0", "it's s1", "it's s2"], "A": ["it's s0", "it's s2"], "B": ["it's s1"]}
    rows = {(row.condition, row.measure): row for row in made.summary}
    compared = 0
    for condition, names in groups.items():
        for figure in MEASURES:
            values = [value for name in names if (value := measures[name].values[figure.name]) is not None]
            row = rows.pop((condition, figure.name), None)
            if not values:
                assert row is None
                continue
            assert row is not None
            assert (row.n, row.unit) == (len(values), figure.unit)
            assert row.mean == pytest.approx(statistics.fmean(values))
            assert row.median == pytest.approx(statistics.median(values))
            assert (row.smallest, row.largest) == pytest.approx((min(values), max(values)))
            assert row.sd == (pytest.approx(statistics.stdev(values), abs=1e-9) if len(values) > 1 else None)
            compared += 1
    assert compared > 60
    each = rows.pop((None, "each_response_time_s"))
    delays_s = [delay_s for name in groups[None] for delay_s in measures[name].response_times_s]
    assert (each.n, each.median) == (len(delays_s), pytest.approx(statistics.median(delays_s)))
    assert {measure for _, measure in rows} == {"each_response_time_s", "each_reaction_time_s", "each_gap_s"}
    each = rows.pop((None, "each_gap_s"))
    gaps_s = [gap_s for name in groups[None] for gap_s in measures[name].gaps_s]
    assert (each.n, each.smallest) == (len(gaps_s), pytest.approx(min(gaps_s)))
    assert each.smallest < 0, "the robot spoke over somebody"


def test_gaps_are_reported_by_what_the_robot_answered_with(
    made: StudyStatistics, measures: dict[str, Measures]
) -> None:
    with (made.out / "gaps.csv").open(encoding="utf-8", newline="") as file:
        rows = {(row["of"], row["condition"], row["means"]): row for row in csv.DictReader(file)}
    mine = measures["it's s1"].gaps
    assert [(one.turn_id, one.reply_id, one.means, round(one.gap_s, 3), one.first) for one in mine] == [
        ("o-1", "o-2", "phrase", -0.6, True),
        ("o-3", "o-4", "filler", 0.6, True),
        ("o-3", "o-5", "edited_suggestion", 2.0, False),
    ]
    edited = rows["study", "", "edited_suggestion"]
    assert (edited["n"], float(edited["median_s"]), float(edited["under_1_s_fraction"])) == ("1", 2.0, 0.0)
    phrases = [
        one.gap_s for name, of in measures.items() for one in of.gaps if one.means == "phrase" and name != "it's s3"
    ]
    row = rows["study", "", "phrase"]
    assert (int(row["n"]), int(row["overlaps"])) == (len(phrases), sum(gap_s < 0 for gap_s in phrases))
    quartiles = statistics.quantiles(phrases, n=4, method="inclusive")
    told = [float(row[name]) for name in ("lower_quartile_s", "median_s", "upper_quartile_s")]
    assert told == pytest.approx(quartiles, abs=1e-6)


def test_results_are_files_to_continue_from(made: StudyStatistics) -> None:
    with (made.out / "summary.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(made.summary)
    assert {row["of"] for row in rows} == {"study", "condition"}
    with (made.out / "measures.csv").open(encoding="utf-8", newline="") as file:
        assert [row["purpose"] for row in csv.DictReader(file)] == ["", "", "", "practice"]
    with (made.out / "labels.csv").open(encoding="utf-8", newline="") as file:
        labels = list(csv.DictReader(file))
    counting = [row for row in made.measures if row["purpose"] != "practice"]
    assert sum(int(row["n"]) for row in labels if row["kind"] == "mark") == sum(row["marks"] for row in counting)
    for name in ("models", "model_functions"):
        with (made.out / f"{name}.csv").open(encoding="utf-8", newline="") as file:
            asked = sum(int(row["asked"]) for row in csv.DictReader(file))
        assert asked == sum(row["llm_exchanges"] for row in counting), name
    with (made.out / "codebook.csv").open(encoding="utf-8", newline="") as file:
        codebook = list(csv.DictReader(file))
    assert [row["column"] for row in codebook if row["table"] == "measures"] == [figure.name for figure in MEASURES]
    (holds,) = (row for row in codebook if row["column"] == "command_holds_s")
    assert (holds["table"], holds["threshold"], holds["unit"]) == ("thresholds", "0.5", "s")
    (late,) = (row for row in codebook if row["column"] == "steps_late")
    assert (late["threshold"], late["empty"]) == ("late_from_s = 1 s", "There was no protocol.")
    with (made.out / "codes.csv").open(encoding="utf-8", newline="") as file:
        (code,) = csv.DictReader(file)
    assert (code["coder"], code["tier"], code["value"], code["n"], code["lasted_s"]) == (
        "C1",
        "Gaze",
        "away",
        "2",
        "1.5",
    )


def test_the_sql_runs_as_it_stands(made: StudyStatistics, monkeypatch: pytest.MonkeyPatch) -> None:
    import duckdb

    monkeypatch.chdir(made.out)
    text = Path("queries.sql").read_text(encoding="utf-8")
    assert text == queries(made.out)
    with duckdb.connect() as database:
        database.execute(text)
        found = database.execute("SELECT count(*), sum(n) FROM summary WHERE of = 'study'").fetchone()
        # Usable as input for further analysis.
        spoken = database.execute("SELECT count(*) FROM utterances WHERE said AND length(text) > 3").fetchone()
    study_rows = [row for row in made.summary if row.condition is None]
    assert found == (len(study_rows), sum(row.n for row in study_rows))
    assert spoken == (sum(row["robot_utterances"] + (row["participant_utterances"] or 0) for row in made.measures),)


@pytest.mark.parametrize("name", ["Study [2026]", "condition=Z", "a*b?", "it's"])
def test_the_name_of_a_folder_changes_nothing(name: str, study: Path, tmp_path: Path, made: StudyStatistics) -> None:
    # DuckDB would read brackets and stars as patterns, and a condition from condition=Z.
    again = study_statistics(study, tmp_path / name)
    assert (again.measures, again.summary) == (made.measures, made.summary)


def test_a_study_in_which_nothing_happened_has_statistics_too(tmp_path: Path) -> None:
    tell(tmp_path / "sessions" / "s", [], lasts_s=10, trial={})
    made = study_statistics(tmp_path, tmp_path / "statistics")
    (row,) = [row for row in made.summary if (row.condition, row.measure) == (None, "recorded_s")]
    assert (row.n, row.mean, row.sd) == (1, 10.0, None)
    assert {row.condition for row in made.summary} == {None, ""}


def test_only_what_changed_is_exported_again(made: StudyStatistics, study: Path, tmp_path: Path) -> None:
    copy = tmp_path / "study"
    shutil.copytree(study, copy)
    again = study_statistics(copy, copy / "statistics")
    assert (again.exported, again.summary) == (0, made.summary)
    shutil.rmtree(copy / "sessions" / "it's s0")
    head = copy / "sessions" / "it's s2" / "session.json"
    head.write_text(json.dumps({**json.loads(head.read_text()), "trial": {**TRIAL, "condition": "C"}}))
    changed = study_statistics(copy, copy / "statistics")
    assert changed.exported == 1
    assert [row["session"] for row in changed.measures] == ["it's s1", "it's s2", "it's s3"]
    assert {row.condition for row in changed.summary} == {None, "B", "C"}
    assert not (copy / "statistics" / "tables" / "it's s0").exists()


def test_a_session_that_cannot_be_read_is_reported_and_the_others_count(study: Path, tmp_path: Path) -> None:
    copy = tmp_path / "study"
    shutil.copytree(study, copy)
    (copy / "sessions" / "bad").mkdir()
    (copy / "sessions" / "bad" / "session.json").write_text("{}")
    made = study_statistics(copy, copy / "statistics")
    assert made.sessions == 4
    (problem,) = made.problems
    assert problem.startswith("bad: ")


@pytest.mark.logs(r"studies\.statistics: ")
def test_other_folders_are_left_alone(study: Path, tmp_path: Path) -> None:
    with pytest.raises(StatisticsError, match="no sessions"):
        study_statistics(tmp_path, tmp_path / "out")
    with pytest.raises(StatisticsError, match="cannot be read"):
        study_statistics(tmp_path / "nowhere", tmp_path / "out")
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.docx").write_text("years of work")
    with pytest.raises(StatisticsError, match="contains other files"):
        study_statistics(study, other)
    (other / "statistics.json").write_text('{"format": "mine"}')
    with pytest.raises(StatisticsError, match="choose another folder"):
        study_statistics(study, other)
    (tmp_path / "file").write_text("")
    inside = study / "sessions" / "it's s0" / "statistics"
    with pytest.raises(StatisticsError, match="inside a recorded session"):
        study_statistics(study, inside)
    assert not inside.exists()
    with pytest.raises(StatisticsError, match="is a file"):
        study_statistics(study, tmp_path / "file")
    assert sorted(path.name for path in other.iterdir()) == ["statistics.json", "thesis.docx"]


def test_the_command_prints_a_table(made: StudyStatistics, study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    parser = argparse.ArgumentParser()
    statistics_command.add_arguments(parser)
    assert statistics_command.run(parser.parse_args([str(study / "sessions")])) == 0
    out = capsys.readouterr().out
    assert "4 sessions, 0 of them newly read" in out
    line = next(line for line in out.splitlines() if line.startswith("response_time_s"))
    row = next(row for row in made.summary if (row.condition, row.measure) == (None, "response_time_s"))
    name, unit, n, mean, *_ = line.split()
    assert (name, unit, int(n)) == ("response_time_s", "s", row.n)
    assert math.isclose(float(mean), row.mean, abs_tol=0.006)
    assert "Condition A" in out
    assert statistics_command.run(parser.parse_args([str(study / "nowhere")])) == 1


def test_each_step_is_reported_planned_against_actual_over_the_sessions_that_count(made: StudyStatistics) -> None:
    with (made.out / "steps.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    study = [row for row in rows if row["of"] == "study"]
    assert [(row["step_number"], row["title"], row["sessions"], row["visited_in"]) for row in study] == [
        ("1", "Greet", "2", "2"), ("2", "Ask", "2", "2"), ("3", "Show", "2", "0"), ("4", "Close", "2", "2"),
    ]  # fmt: skip
    greet, ask, show, close = study
    assert [float(greet[name]) for name in ("expected_s", "mean_s", "min_s", "max_s")] == [10.0, 12.5, 12.0, 13.0]
    assert (greet["late_in"], ask["skipped_in"], show["mean_s"], close["late_in"]) == ("2", "2", "", "2")
    assert {row["condition"] for row in rows if row["of"] == "condition"} == {"A", "B"}
    assert made.summary and {row.measure: row.mean for row in made.summary if row.condition is None} | {
        "protocol_steps": 4.0, "steps_visited": 3.0, "steps_skipped": 1.0, "steps_late": 2.0,
    } == {row.measure: row.mean for row in made.summary if row.condition is None}  # fmt: skip


def test_failures_are_reported_by_their_cause_over_the_sessions_that_count(made: StudyStatistics) -> None:
    with (made.out / "alarms.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    study = {row["cause"]: row for row in rows if row["of"] == "study"}
    assert {cause: (row["sessions"], row["alarms"], row["times"], row["seen_to"]) for cause, row in study.items()} == {
        "link": ("2", "2", "4", "0"), "disk": ("2", "2", "2", "2"), "battery": ("2", "2", "2", "0"),
    }  # fmt: skip
    assert [float(study["link"][name]) for name in ("stood_s", "longest_s")] == [4.0 + 6.0, 6.0]
    assert float(study["disk"]["stood_s"]) == 9.0
    means = {row.measure: row.mean for row in made.summary if row.condition == "A"}
    assert (means["alarms"], means["alarms_seen_to"]) == (3.0, 1.0)
