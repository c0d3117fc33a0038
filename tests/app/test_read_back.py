"""Verification of a rehearsal's session: complete, or with a list of differences."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.app.rehearse_command import read_back
from caris_desktop.recording.exporters import html
from caris_desktop.recording.session import session_reader
from caris_desktop.recording.session_export import FORMATS
from tests.support.recorded_session import make_session


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return make_session(tmp_path / "session", seconds=4.0, cameras=("front",)).folder


def test_a_whole_session_is_read_replayed_and_exported_to_every_format(folder: Path, tmp_path: Path) -> None:
    back = read_back(folder, tmp_path / "exports")
    assert back.problems == ()
    counts = json.loads((folder / "session.json").read_text("utf-8"))["counts"]
    assert back.found[0].startswith(f"{sum(counts.values())} values from {len(counts)} streams read back, 4 s replayed")
    assert {path.name for path in (tmp_path / "exports").iterdir()} == {each.name for each in FORMATS}
    assert all(any(path.iterdir()) for path in (tmp_path / "exports").iterdir())


@pytest.mark.logs(r"values of scan are left out")
def test_a_value_that_does_not_come_back_is_a_problem(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Same failure as with libraries that declare types in an unknown way."""
    whole: Callable[..., Any] = session_reader.from_message

    def half(spec: Any, message: Any) -> Any:
        if spec.name == "scan":
            raise ValueError("no array")
        return whole(spec, message)

    monkeypatch.setattr(session_reader, "from_message", half)
    scans = json.loads((folder / "session.json").read_text("utf-8"))["counts"]["scan"]
    problems = read_back(folder, tmp_path / "exports").problems
    assert f"0 of {scans} values of scan can be read." in problems


@pytest.mark.logs(r"export of .* as html")
def test_a_format_that_fails_is_a_problem_and_the_others_are_written(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> list[Path]:
        raise AttributeError("'dict' object has no attribute 'shape'")

    monkeypatch.setattr(html, "write_html", fail)
    back = read_back(folder, tmp_path / "exports")
    (problem,) = back.problems
    assert problem.startswith("Export as html: ") and "no attribute 'shape'" in problem
    assert len(list((tmp_path / "exports").iterdir())) == len(FORMATS) - 1


def test_a_session_that_cannot_be_read_is_a_problem(folder: Path, tmp_path: Path) -> None:
    (folder / "session.json").write_text("{}")
    back = read_back(folder, tmp_path / "exports")
    assert len(back.problems) == 1 and back.found == ()


def test_a_session_that_was_cut_off_is_a_problem(tmp_path: Path) -> None:
    folder = make_session(tmp_path / "session", seconds=4.0, cameras=("front",), killed=True).folder
    assert read_back(folder, tmp_path / "exports").problems
