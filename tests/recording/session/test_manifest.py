"""Checksums of a closed session, also verified with ``sha256sum``."""

import shutil
import subprocess
from pathlib import Path

import pytest

from caris_desktop.recording.session.manifest import MANIFEST_NAME, HashingStopped, verify_manifest, write_manifest


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "photos").mkdir()
    (tmp_path / "annotations").mkdir()
    (tmp_path / "export-csv-2").mkdir()
    (tmp_path / "export-csv-2" / "scan.csv").write_text("")
    (tmp_path / "session.json").write_text("{}")
    (tmp_path / "photos" / "0001.png").write_bytes(bytes(3_000_000))
    (tmp_path / "a\\b\nc.txt").write_text("a name that needs care")
    (tmp_path / "größe.txt").write_text("ö")
    (tmp_path / "annotations" / "coder.json").write_text("{}")
    (tmp_path / ".recording").write_text("")
    return tmp_path


def test_an_untouched_session_has_no_problems(folder: Path) -> None:
    text = write_manifest(folder).read_text(encoding="utf-8")
    assert [line.split("  ", 1)[1] for line in text.splitlines()] == [
        "a\\\\b\\nc.txt",
        "größe.txt",
        "photos/0001.png",
        "session.json",
    ]
    assert verify_manifest(folder) == []
    if shutil.which("sha256sum"):
        subprocess.run(["sha256sum", "--strict", "--quiet", "-c", MANIFEST_NAME], cwd=folder, check=True)


def test_changes_are_reported(folder: Path) -> None:
    write_manifest(folder)
    (folder / "annotations" / "another.json").write_text("{}")
    assert verify_manifest(folder) == []
    (folder / "session.json").write_text("{ }")
    (folder / "größe.txt").unlink()
    (folder / "new.txt").write_text("new")
    manifest = folder / MANIFEST_NAME
    manifest.write_text(manifest.read_text() + f"{'0' * 64}  ../secret\nnonsense\n")
    assert verify_manifest(folder) == [
        "größe.txt is missing.",
        "session.json was changed after the session closed.",
        "../secret is outside the session folder.",
        f"Line 6 of {MANIFEST_NAME} is not a checksum.",
        "new.txt was added after the session closed.",
    ]
    manifest.unlink()
    with pytest.raises(FileNotFoundError):
        verify_manifest(folder)


def test_hashing_can_be_stopped_and_leaves_nothing(folder: Path) -> None:
    before = sorted(folder.rglob("*"))
    with pytest.raises(HashingStopped):
        write_manifest(folder, may_go_on=lambda: False)
    assert sorted(folder.rglob("*")) == before
