"""Planned and actual protocol: from events, in tables, report and methods sheet."""

import csv
from pathlib import Path

import pytest

from caris_desktop.domain.events import (
    PlannedStep,
    ProtocolEnded,
    ProtocolOpened,
    RecordingPaused,
    ScenarioOpened,
    StepEntered,
    StepTicked,
)
from caris_desktop.recording.annotation.session_tiers import session_tiers
from caris_desktop.recording.annotation.timeline_builder import build_overview
from caris_desktop.recording.measures.session_measures import measure, read_facts
from caris_desktop.recording.session.session_data import read_data
from caris_desktop.recording.session.session_protocol import StepRecord, step_visits_of, steps_of
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import ExportContext, export_session
from tests.recording.told_session import STEPS, at, stepped, tell


def test_each_interval_shows_how_it_was_entered_and_left_and_how_late_it_was() -> None:
    events = [
        *stepped((0, "greet", "started"), (14, "ask", "next"), (17, "show", "skipped"), (40, "close", "branch")),
        ProtocolEnded(at(70), "close", actor="wizard"),
    ]
    visits = step_visits_of(events, ended_ns=at(100))
    assert [(visit.step_id, visit.how, visit.left, visit.time_s, visit.late_s) for visit in visits] == [
        ("greet", "started", "next", 14.0, 4.0),
        ("ask", "next", "skipped", 3.0, 0.0),
        ("show", "skipped", "branch", 23.0, 0.0),
        ("close", "branch", "ended", 30.0, 10.0),
    ]
    steps = steps_of(events, visits)
    assert [(step.title, step.visits, step.skipped, step.late_s) for step in steps] == [
        ("Greet", 1, 0, 4.0), ("Ask", 1, 1, 0.0), ("Show", 1, 0, 0.0), ("Close", 1, 0, 10.0),
    ]  # fmt: skip


def test_a_step_resumed_after_a_slip_begins_nothing_again() -> None:
    moves = stepped(
        (0, "greet", "started"), (8, "ask", "next"), (9, "greet", "back"), (13, "ask", "next"), (15, "greet", "chosen")
    )
    visits = step_visits_of(moves, ended_ns=at(20))
    greet, ask, *_ = steps_of(moves, visits)
    assert [visit.late_s for visit in visits if visit.step_id == "greet"] == [0.0, 2.0, 0.0]
    assert (greet.visits, greet.time_s, greet.late_s) == (2, 17.0, 2.0), "twice, the second time as chosen"
    assert (ask.visits, ask.time_s) == (2, 3.0)
    assert visits[-1].left == "", "the session ended in it"


def test_a_pause_takes_no_time_and_what_was_ticked_off_last_counts() -> None:
    events = [
        *stepped((0, "greet", "started"), (30, "ask", "next")),
        StepTicked(at(1), "greet", "Consent"),
        StepTicked(at(2), "greet", "Coat"),
        StepTicked(at(3), "greet", "Coat", on=False),
    ]
    visits = step_visits_of(events, ended_ns=at(40), pauses=[(at(10), at(25)), (at(35), at(60))])
    assert [(visit.time_s, visit.late_s) for visit in visits] == [(15.0, 5.0), (5.0, 0.0)]
    assert [(step.ticked, step.to_tick) for step in steps_of(events, visits)][:2] == [(1, 2), (0, 0)]


def test_an_edited_protocol_and_another_one_keep_what_was_visited() -> None:
    other = (PlannedStep("wave", "Wave", 3.0),)
    events = [
        *stepped((0, "greet", "started"), (4, "ask", "next")),
        ProtocolOpened(at(6), other),
        StepEntered(at(7), "wave", "Wave", 1, "started"),
    ]
    visits = step_visits_of(events, ended_ns=at(10))
    assert [(visit.step_id, visit.left, visit.time_s) for visit in visits] == [
        ("greet", "next", 4.0), ("ask", "", 2.0), ("wave", "", 3.0),
    ]  # fmt: skip
    assert [(step.title, step.visits) for step in steps_of(events, visits)] == [("Greet", 1), ("Wave", 1), ("Ask", 1)]


def test_without_a_plan_visits_are_reported_as_they_are() -> None:
    events = [StepEntered(at(1), "greet", "Greet", 1, "started")]
    visits = step_visits_of(events, ended_ns=at(5))
    assert steps_of(events, visits) == (StepRecord("greet", "Greet", 1, 0.0, 1, 4.0, 0.0, 0, 0, 0, at(1)),)
    assert step_visits_of([], ended_ns=at(5)) == () and steps_of([ProtocolOpened(at(0))], ()) == ()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scenario = ScenarioOpened(at(0), "visit.yaml", "Visit", "0" * 64, "title: Visit\n")
    values = [
        scenario,
        *stepped((0, "greet", "started"), (14, "ask", "next"), (17, "close", "skipped")),
        StepTicked(at(1), "greet", "Consent"),
        RecordingPaused(at(20), True),
        RecordingPaused(at(30), False),
    ]
    return tell(tmp_path_factory.mktemp("protocol") / "s", values, lasts_s=60)


def test_a_session_reports_its_protocol_as_measures_and_as_a_tier(folder: Path) -> None:
    session = open_session(folder)
    data = read_data(session)
    visits, steps = data.step_visits, data.steps
    assert measure(read_facts(session)).steps == steps
    assert [(step.title, step.visits) for step in steps] == [("Greet", 1), ("Ask", 1), ("Show", 0), ("Close", 1)]
    assert visits[-1].time_s == 33.0
    assert build_overview(session).steps == steps
    tiers = session_tiers(session)
    tier = next(tier for tier in tiers.tiers if tier.name == "Protocol")
    assert [(item.start_ms, item.end_ms, item.value) for item in tiers.of_tier(tier.tier_id)] == [
        (0, 14_000, "Greet"), (14_000, 17_000, "Ask (skipped)"), (17_000, 60_000, "Close"),
    ]  # fmt: skip


def test_tables_hold_it_by_step_and_by_visit(folder: Path, tmp_path: Path) -> None:
    export_session(folder, "csv", tmp_path / "csv", ExportContext())

    def rows(table: str, *columns: str) -> list[tuple[str, ...]]:
        with (tmp_path / "csv" / f"{table}.csv").open(encoding="utf-8", newline="") as file:
            return [tuple(row[column] for column in columns) for row in csv.DictReader(file)]

    assert rows(
        "protocol", "step_number", "title", "visits", "expected_s", "time_s", "late_s", "skipped", "ticked"
    ) == [
        ("1", "Greet", "1", "10.0", "14.0", "4.0", "0", "1"),
        ("2", "Ask", "1", "5.0", "3.0", "0.0", "1", "0"),
        ("3", "Show", "0", "0.0", "0.0", "0.0", "0", "0"),
        ("4", "Close", "1", "20.0", "33.0", "13.0", "0", "0"),
    ]
    assert rows("step_visits", "session_s", "title", "how", "left", "actor") == [
        ("0.0", "Greet", "started", "next", "wizard"),
        ("14.0", "Ask", "next", "skipped", "wizard"),
        ("17.0", "Close", "skipped", "", "wizard"),
    ]
    assert rows("event_protocol_opened_steps", "step_id", "expected_s") == [
        (step.step_id, str(step.expected_s)) for step in STEPS
    ]


def test_the_report_and_the_methods_sheet_say_how_closely_it_was_followed(folder: Path, tmp_path: Path) -> None:
    export_session(folder, "html", tmp_path / "html", ExportContext())
    page = " ".join((tmp_path / "html" / "report.html").read_text(encoding="utf-8").split())
    assert "Protocol, planned and actual" in page and "3 of 4 steps, 1 skipped, 2 late" in page
    assert '<td>Show</td><td class="number">–</td><td class="number">not started</td>' in page
    export_session(folder, "methods", tmp_path / "methods", ExportContext())
    sheet = (tmp_path / "methods" / "methods.md").read_text(encoding="utf-8")
    assert "Which protocol did the wizard follow, and how closely?" in sheet
    assert "Ask (5.0 s planned, median 3.0 s actual, skipped in 1 of 1)" in sheet
    assert "Show (never started)" in sheet
