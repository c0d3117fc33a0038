"""Alarms of a recording in measures, report, tables and methods sheet."""

import csv
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.domain.events import AlarmChanged, RecordingPaused
from caris_desktop.recording.measures.session_measures import measure, read_facts
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session.session_robot import alarms_of
from caris_desktop.recording.session_export import export_session
from tests.recording.methods_sheets import sheet_of
from tests.recording.told_session import at, tell


def alarm(s: float, name: str, state: str, times: int = 1, actor: str = "", **more: Any) -> AlarmChanged:
    what = f"The {name} is wrong."
    return AlarmChanged(at(s), name, name, state, "error", what, "", "", times, actor=actor, **more)  # type: ignore[arg-type]


HAPPENED = [
    alarm(2.0, "link", "raised"), alarm(5.0, "link", "ended", actor="console"),
    alarm(20.0, "link", "raised", 2), alarm(21.5, "link", "ended", 2, "console"),
    alarm(30.0, "disk", "raised"), alarm(34.0, "disk", "ended", actor="wizard:Ada"),
    alarm(50.0, "battery", "raised"),
]  # fmt: skip
QUESTION = "What went wrong during the sessions?"


def test_a_returning_alarm_is_one_and_an_open_one_lasts_to_the_end() -> None:
    found = {one.cause: one for one in alarms_of(HAPPENED, ended_ns=at(60.0))}
    assert {cause: (one.stood_s, one.times, one.seen_to_by) for cause, one in found.items()} == {
        "link": (4.5, 2, ""), "disk": (4.0, 1, "wizard:Ada"), "battery": (10.0, 1, ""),
    }  # fmt: skip
    assert [one.end_ns for one in found.values()] == [at(21.5), at(34.0), None]


def test_an_alarm_that_ended_in_a_pause_did_not_last() -> None:
    """Alarms that persist are raised again after the pause, and count once."""
    pauses = [(at(10.0), at(40.0))]
    both = [alarm(5.0, "link", "raised"), alarm(6.0, "disk", "raised"), alarm(40.1, "disk", "raised")]
    link, disk = alarms_of(both, ended_ns=at(60.0), pauses=pauses)
    assert (link.stood_s, link.end_ns) == (5.0, at(10.0))
    assert (disk.stood_s, disk.end_ns, disk.times) == (pytest.approx(4.0 + 19.9), None, 1)
    began = alarms_of([alarm(0.0, "link", "raised"), alarm(0.1, "link", "raised")], ended_ns=at(3.0))
    assert [one.stood_s for one in began] == [pytest.approx(3.0)], "told twice at the start"


@pytest.fixture(scope="module")
def sessions_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("alarms") / "sessions"
    tell(folder / "s1", HAPPENED, lasts_s=60)
    tell(folder / "s2", [alarm(1.0, "link", "raised"), alarm(2.0, "link", "ended")], lasts_s=60, later_s=3600)
    tell(folder / "s3", [RecordingPaused(at(10.0), True)], lasts_s=60, later_s=7200)
    return folder


def test_report_tables_and_measures_have_them(sessions_dir: Path, tmp_path: Path) -> None:
    figures = measure(read_facts(open_session(sessions_dir / "s1")))
    assert [one.cause for one in figures.alarms] == ["link", "disk", "battery"]
    export_session(sessions_dir / "s1", "html", tmp_path / "s1")
    page = " ".join((tmp_path / "s1" / "report.html").read_text(encoding="utf-8").split())
    for told in ("3 alarms, 18.5 s", "The link is wrong. (2 times)", "dismissed by ", "active until the end"):
        assert told in page, told
    export_session(sessions_dir / "s3", "html", tmp_path / "s3")
    assert "<h2>Alarms" not in (tmp_path / "s3" / "report.html").read_text(encoding="utf-8")
    export_session(sessions_dir / "s1", "csv", tmp_path / "csv")
    with (tmp_path / "csv" / "alarms.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["cause"], float(row["stood_s"]), row["seen_to_by"]) for row in rows] == [
        ("link", 4.5, ""), ("disk", 4.0, "wizard:another"), ("battery", 10.0, ""),
    ]  # fmt: skip


def test_the_methods_sheet_sums_them_up(sessions_dir: Path) -> None:
    sessions = [open_session(folder) for folder in sorted(sessions_dir.iterdir())]
    assert sheet_of(sessions).answers[QUESTION] == (
        "Four alarms in 2 of 3 sessions; 1 dismissed, 2 ended automatically, 1 active when a session ended."
        " The link is wrong: two alarms, 5.5 s in total. The disk is wrong: one alarm, 4.0 s in total."
        " The battery is wrong: one alarm, 10.0 s in total."
    )
    assert QUESTION not in sheet_of(sessions[2:]).answers
