"""Files of the program are private to the user, including existing ones."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from caris_desktop.domain.file_replacement import SHARE_VARIABLE, narrow
from caris_desktop.study.study_folder import open_study_folder
from tests.recording.told_session import tell

pytestmark = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="permissions are those of POSIX systems")


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def opened(folder: Path) -> list[Path]:
    """Two files, one of them in a subfolder, as an earlier version left them."""
    (folder / "sessions" / "one").mkdir(parents=True)
    files = [folder / "people.sqlite", folder / "sessions" / "one" / "video.mp4"]
    for file in files:
        file.write_bytes(b"x")
        file.chmod(0o644)
    for path in (folder / "sessions", folder / "sessions" / "one"):
        path.chmod(0o755)
    return files


def test_a_study_of_an_earlier_version_is_narrowed_once_and_its_surroundings_are_not(tmp_path: Path) -> None:
    files = opened(tmp_path)
    other = tmp_path / "thesis.odt"
    other.write_bytes(b"x")
    other.chmod(0o644)
    (tmp_path / "sessions" / "elsewhere").symlink_to(other)
    assert open_study_folder(tmp_path).narrowed == 4
    assert [mode(file) for file in files] == [0o600, 0o600]
    assert mode(tmp_path / "sessions") == mode(tmp_path / "sessions" / "one") == 0o700
    assert mode(other) == 0o644, "no file of this program, also where a link of ours leads to it"
    assert open_study_folder(tmp_path).narrowed == 0


def test_an_executable_stays_one_and_a_missing_file_does_not_matter(tmp_path: Path) -> None:
    script = tmp_path / "script"
    script.touch(0o755)
    assert narrow([script, tmp_path / "nothing"]) == 1
    assert mode(script) == 0o700


def test_a_shared_study_stays_open_to_the_group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SHARE_VARIABLE, "1")
    files = opened(tmp_path)
    (tmp_path / "sessions").chmod(0o775)
    open_study_folder(tmp_path)
    assert mode(tmp_path / "sessions") == 0o770
    assert [mode(file) for file in files] == [0o640, 0o640]


@pytest.mark.parametrize(("shared", "folders", "files"), [("", 0o700, 0o600), ("1", 0o770, 0o660)])
@pytest.mark.long("1-*")
def test_files_of_a_command_and_its_children_are_private_unless_shared(
    tmp_path: Path, shared: str, folders: int, files: int
) -> None:
    """The search index (SQLite, with its log) next to the sessions, and an export of several formats."""
    study = tmp_path / "study"
    tell(study / "sessions" / "one", [], lasts_s=2.0)
    before = set(tmp_path.rglob("*"))
    environment = {**os.environ, "XDG_STATE_HOME": str(tmp_path / "state"), SHARE_VARIABLE: shared}
    for words in (["export", str(study), str(tmp_path / "out"), "--to", "csv,parquet"], ["sessions", str(study)]):
        command = [sys.executable, "-m", "caris_desktop", *words]
        done = subprocess.run(command, env=environment, umask=0o022, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    written = set(tmp_path.rglob("*")) - before
    assert {".sqlite", ".parquet", ".csv", ".log"} <= {path.suffix for path in written}
    assert {mode(path) for path in written if path.is_dir()} == {folders}
    assert {mode(path) for path in written if path.is_file()} == {files}
