"""Preflight checks in recording, report and methods sheet."""

from pathlib import Path

import pytest

from caris_desktop.domain.actor import CONSOLE, WIZARD
from caris_desktop.domain.events import PreflightChecked
from caris_desktop.recording.session.session_protocol import open_words, preflight_of
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import export_session
from tests.recording.methods_sheets import sheet_of
from tests.recording.told_session import at, tell

STOP = PreflightChecked(at(0.0), "emergency_stop", "Emergency stop is released", "major", at_start=True,
                        accepted=True, actor=CONSOLE)  # fmt: skip
ROBOT = PreflightChecked(at(0.0), "robot", "Robot is connected", "passed", at_start=True, actor=CONSOLE)
FORM = PreflightChecked(at(0.0), "by hand: Form", "Consent form signed", "passed", manual=True, at_start=True,
                        checked_ns=at(-20.0), actor=WIZARD)  # fmt: skip
WAY = PreflightChecked(at(0.0), "by hand: Way", "The way is clear", "not checked", manual=True, at_start=True)
TICKED = PreflightChecked(at(9.0), "by hand: Way", "The way is clear", "passed", manual=True, checked_ns=at(9.0))
QUESTION = "What was checked before each session?"


@pytest.fixture(scope="module")
def sessions_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("preflight") / "sessions"
    tell(folder / "s1", [ROBOT, STOP, FORM, WAY, TICKED], lasts_s=60)
    tell(folder / "s2", [ROBOT, FORM], lasts_s=60, later_s=3600)
    tell(folder / "s3", [], lasts_s=60, later_s=7200)
    return folder


def test_the_record_says_what_was_open_and_that_the_wizard_knew(sessions_dir: Path) -> None:
    told = [value for _, value in open_session(sessions_dir / "s1").values("event/preflight_checked")]
    assert told == [ROBOT, STOP, FORM, WAY, TICKED], "read back as it was written"
    preflight = preflight_of(told)
    assert preflight.passed == 2
    assert open_words(preflight) == [
        "Emergency stop is released (major; the wizard started anyway)",
        "The way is clear (not checked; ticked later)",
    ]


def test_a_tick_that_was_taken_back_is_none() -> None:
    again = PreflightChecked(at(10.0), "by hand: Way", "The way is clear", "not checked", manual=True)
    assert open_words(preflight_of([WAY, TICKED, again])) == ["The way is clear (not checked)"]
    assert preflight_of([TICKED]).checks == (), "a tick between recordings"


def test_the_report_has_it(sessions_dir: Path, tmp_path: Path) -> None:
    export_session(sessions_dir / "s1", "html", tmp_path / "s1")
    page = (tmp_path / "s1" / "report.html").read_text(encoding="utf-8")
    assert "2 of 4 checks passed. Not passed: Emergency stop is released (major; the wizard started anyway)" in page
    export_session(sessions_dir / "s3", "html", tmp_path / "s3")
    assert "checks passed" not in (tmp_path / "s3" / "report.html").read_text(encoding="utf-8")


def test_the_methods_sheet_counts_it_over_the_study(sessions_dir: Path) -> None:
    everything = [open_session(folder) for folder in sorted(sessions_dir.iterdir())]
    assert sheet_of(everything).answers[QUESTION] == (
        "In 1 of 2 sessions, all of the program's checks passed. Ticked by the wizard: Consent form signed:"
        " 2. Not passed: Emergency stop is released (major; the wizard started anyway): 1, The way is clear (not"
        " checked; ticked later): 1."
    )
    assert (
        sheet_of(everything[:1]).answers[QUESTION].startswith("In the session, not all of the program's checks passed.")
    )
    assert QUESTION not in sheet_of(everything[2:]).answers
