"""Exports of the fixture sessions equal the golden files."""

from pathlib import Path

import pytest

from tests.recording.golden_exports import GOLDEN, SESSIONS, exported


@pytest.mark.long("people", "killed", "titles", "seldom", "creeping", "whole")
@pytest.mark.parametrize("name", SESSIONS)
@pytest.mark.logs(r".*")
def test_exports_are_as_before(name: str, tmp_path: Path) -> None:
    now = exported(name, tmp_path)
    before = {path.name: path.read_text("utf-8") for path in GOLDEN.glob(f"{name}.*")}
    assert set(now) == set(before)
    for file in sorted(now):
        assert now[file] == before[file], (
            f"{file}: if wanted, python -m tests.recording.golden_exports and look at the diff"
        )
