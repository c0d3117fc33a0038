"""Shipped references and schemas of files agree with their declarations."""

from pathlib import Path

import pytest

from caris_desktop.app import generated_reference
from caris_desktop.domain.shipped import resources_dir

WRITE_ANEW = "run: python -m caris_desktop.app.generated_reference"


def test_every_schema_and_every_page_is_the_declared_one() -> None:
    declared = generated_reference.reference_files()
    assert set((resources_dir() / "schemas").iterdir()) <= set(declared)
    assert {path.name for path in declared} >= {"scenario-file.md", "robot-profiles.md"}
    for path, text in declared.items():
        assert path.read_text(encoding="utf-8") == text, f"{path.name}: {WRITE_ANEW}"


def test_the_command_writes_them_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = {tmp_path / path.name: text for path, text in generated_reference.reference_files().items()}
    monkeypatch.setattr(generated_reference, "reference_files", lambda: files)
    generated_reference.main()
    assert {path: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()} == files
