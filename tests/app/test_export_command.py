"""``caris-desktop export``: single sessions and whole studies, several formats, cancelling, and errors."""

import argparse
import json
import multiprocessing
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from caris_desktop.app import export_command, statistics_command
from caris_desktop.recording.session import events_file
from caris_desktop.recording.session.manifest import write_manifest
from caris_desktop.recording.session_export import (
    ExportContext,
    ExportError,
    ExportFinished,
    ExportProgress,
    ExportRequest,
    export_all,
    export_folders,
    export_session,
    remove_partial_exports,
    run_exports,
    whole_folder,
)
from caris_desktop.recording.studies import sessions_command
from tests.recording.minute import everything, make_session

REPOSITORY = Path(__file__).resolve().parents[2]
TABLES = ("session.csv", "odometry.csv", "utterances.csv", "data_dictionary.csv")
in_own_mounts = pytest.mark.skipif(
    subprocess.run(["sh", "-c", "unshare -m mount -t tmpfs none /mnt"], capture_output=True, check=False).returncode
    != 0,
    reason="needs the right to mount a disk of its own where nobody else sees it (root, and / a mount)",
)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("session") / "one"
    make_session(folder, everything)
    return folder


@pytest.fixture
def study(session: Path, tmp_path: Path) -> Path:
    """Three sessions."""
    for name in ("one", "three", "two"):
        shutil.copytree(session, tmp_path / "study" / "sessions" / name)
    return tmp_path / "study"


def run(*words: str | Path) -> int:
    parser = argparse.ArgumentParser()
    export_command.add_arguments(parser)
    return export_command.run(parser.parse_args(["--workers", "1", *(str(word) for word in words)]))


def is_whole(folder: Path) -> bool:
    return all((folder / name).is_file() for name in TABLES)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_one_session_goes_into_the_folder_that_was_named(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(session, "--to", "csv", tmp_path / "out") == 0
    assert is_whole(tmp_path / "out")
    assert capsys.readouterr().out == f"Exported {session} to {tmp_path / 'out'}\n"
    assert run(session, "--to", "csv,vtt,csv", tmp_path / "both") == 0
    assert names(tmp_path / "both") == ["csv", "vtt"]
    assert is_whole(tmp_path / "both" / "csv")


def test_each_session_of_a_study_gets_a_folder(study: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (study / "sessions" / "empty").mkdir()
    (study / "sessions" / ".hidden").mkdir()
    assert run(study, "--to", "csv", tmp_path / "out") == 0
    assert names(tmp_path / "out") == ["one", "three", "two"]
    assert all(is_whole(folder) for folder in (tmp_path / "out").iterdir())
    assert run(study / "sessions", "--to", "vtt", tmp_path / "out2") == 0
    assert names(tmp_path / "out2") == ["one", "three", "two"]
    output = capsys.readouterr()
    assert "Exported 3 of 3 sessions" in output.out
    assert output.err == "", "no progress where nobody watches"


def test_the_methods_sheet_of_a_study_is_one(study: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(study, "--to", "methods,vtt", tmp_path / "out") == 0
    assert names(tmp_path / "out") == ["methods", "one", "three", "two"]
    assert names(tmp_path / "out" / "methods") == ["methods.html", "methods.md"]
    assert "Exported 3 of 3 sessions and methods for all" in capsys.readouterr().out


def test_a_format_for_all_sessions_is_exported_from_a_study_of_one(
    study: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for folder in sorted((study / "sessions").iterdir())[1:]:
        shutil.rmtree(folder)
    assert run(study, "--to", "methods", tmp_path / "out") == 0
    assert "Exported 1 of 1 sessions to" in capsys.readouterr().out


@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_failed_export_is_reported_and_the_rest_continues(
    study: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], workers: str
) -> None:
    (study / "sessions" / "one" / "events.mcap").unlink()
    (study / "sessions" / "stray").mkdir()
    (study / "sessions" / "stray" / "notes.txt").write_text("no session")
    (tmp_path / "out" / "two").mkdir(parents=True)
    (tmp_path / "out" / "two" / "kept.txt").write_text("mine")
    assert run(study, "--to", "csv", tmp_path / "out", "--workers", workers) == 1
    output = capsys.readouterr()
    assert "one: " in output.err
    assert "does not contain events.mcap" in output.err
    assert "stray: " in output.err
    assert "two exists and is not empty" in output.err
    assert "Exported 1 of 4 sessions" in output.out
    assert names(tmp_path / "out") == ["three", "two"]
    assert names(tmp_path / "out" / "two") == ["kept.txt"]


def test_several_processes_give_the_same_statistics(
    study: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (study / "sessions" / "two" / "events.mcap").unlink()
    for name, at in (("one", 1), ("three", 2)):  # not copies of each other
        header = json.loads((study / "sessions" / name / "session.json").read_text())
        header["trial"]["trial"] = str(at)
        (study / "sessions" / name / "session.json").write_text(json.dumps(header))
    results = []
    for workers in ("1", "2"):
        shutil.copytree(study, tmp_path / workers)
        parser = argparse.ArgumentParser()
        statistics_command.add_arguments(parser)
        assert statistics_command.run(parser.parse_args([str(tmp_path / workers), "--workers", workers])) == 1
        output = capsys.readouterr()
        assert "two: " in output.err
        assert "2 sessions, 2 of them newly read" in output.out
        out = tmp_path / workers / "statistics"
        results.append({path.relative_to(out): path.read_bytes() for path in out.rglob("*") if path.is_file()})
    marker = Path("statistics.json")
    assert {**results[0], marker: b""} == {**results[1], marker: b""}


def test_an_earlier_repair_is_reported(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(session, tmp_path / "cut")
    header = json.loads((tmp_path / "cut" / "session.json").read_text())
    header["ended_ns"] = header["reason"] = None
    (tmp_path / "cut" / "session.json").write_text(json.dumps(header))
    events = (tmp_path / "cut" / "events.mcap").read_bytes()
    (tmp_path / "cut" / "events.mcap").write_bytes(events[: len(events) // 2])
    assert run(tmp_path / "cut", "--to", "csv", tmp_path / "out") == 0
    assert capsys.readouterr().err.startswith("cut: ")
    assert (tmp_path / "out" / "odometry.csv").is_file(), "what was saved is exported"


@pytest.mark.logs(r"recording\.session_export: ")
def test_a_format_that_fails_costs_only_itself(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(_session: object, out: Path, _context: ExportContext) -> list[Path]:
        (out / "half").write_text("written")
        raise ZeroDivisionError("oh")

    monkeypatch.setattr("caris_desktop.recording.exporters.vtt.write_vtt", broken)
    finished = export_all(ExportRequest((session,), ("vtt", "csv"), tmp_path / "out"))
    assert finished.written == (tmp_path / "out" / "one",)
    assert names(tmp_path / "out" / "one") == ["csv"]
    (problem,) = finished.problems
    assert problem.startswith("one: Captions (WebVTT): The export as vtt failed (ZeroDivisionError: oh).")
    assert "Traceback" in caplog.text, "the log has the details"
    finished = export_all(ExportRequest((session,), ("vtt",), tmp_path / "out2"))
    assert (finished.written, len(finished.problems)) == ((), 1)
    assert names(tmp_path / "out2") == []


def test_sessions_of_one_name_do_not_meet(session: Path, tmp_path: Path) -> None:
    folders = [tmp_path / study / "sessions" / "one" for study in ("pilot", "main")]
    for folder in folders:
        shutil.copytree(session, folder)
    request = ExportRequest((*folders, session, session), ("vtt",), tmp_path / "out")
    finished = export_all(request)
    assert finished.problems == ()
    study_name = session.parent.name
    assert names(tmp_path / "out") == sorted(["main_one", "pilot_one", f"{study_name}_one", f"{study_name}_one-2"])
    assert finished.written == export_folders(request)
    again = export_all(ExportRequest(tuple(folders), ("vtt",), tmp_path / "out"))
    assert again.written == ()
    assert all("is not empty" in problem for problem in again.problems)


_INTERRUPTED = """
import signal
import sys
from caris_desktop.recording.terminal import ProgressLine
from tests.app.test_export_command import run

def interrupt(_line, _fraction, what):
    if what.startswith("three: "):
        signal.raise_signal(signal.SIGINT)

ProgressLine.show = interrupt
signal.signal(signal.SIGINT, signal.default_int_handler)  # what runs in the background inherits that it is ignored
sys.exit(run(sys.argv[1], "--to", "csv", sys.argv[2]))
"""


def test_ctrl_c_leaves_whole_exports_only(study: Path, tmp_path: Path) -> None:
    """In a separate process, which an interrupt within library code may end."""
    ended = subprocess.run(
        [sys.executable, "-X", "faulthandler", "-c", _INTERRUPTED, study, tmp_path / "out"],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=90,
        check=False,
    )
    assert ended.returncode == 130, ended.stderr
    assert names(tmp_path / "out") == ["one"]
    assert is_whole(tmp_path / "out" / "one")
    assert "Cancelled. 1 of 3 exports are complete" in ended.stderr


def test_progress_is_shown_in_one_line_of_a_terminal(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    run(study, "--to", "csv,vtt", tmp_path / "out")
    output = capsys.readouterr().err
    assert "\n" not in output
    assert "two: Captions (WebVTT)" in output
    assert output.endswith("\r\033[K"), "nothing is left of it"


def test_checksums_are_compared_first_where_requested(
    study: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sessions = study / "sessions"
    for name in ("one", "two"):
        (sessions / name / "manifest-sha256.txt").unlink(missing_ok=True)
        write_manifest(sessions / name)
    (sessions / "three" / "manifest-sha256.txt").unlink(missing_ok=True)
    assert run(sessions / "one", "--to", "vtt", "--verify", tmp_path / "sound") == 0
    capsys.readouterr()
    (sessions / "two" / "speech.txt").write_text("somebody else said something else")
    assert run(study, "--to", "vtt", "--verify", tmp_path / "out") == 1
    output = capsys.readouterr()
    assert "two: speech.txt was changed after the session closed." in output.err
    assert "three: no checksums" in output.err
    assert "one:" not in output.err
    assert "Exported 3 of 3" in output.out


@pytest.mark.parametrize("words", [("--to", "xls"), ("--to", ""), ("--to", "csv,xls")])
def test_unknown_formats_are_refused(
    session: Path, tmp_path: Path, words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        run(session, *words, tmp_path / "out")
    assert ended.value.code == 2
    assert "allowed: csv, parquet" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda path: None, "cannot be read: No such file or directory"),
        (lambda path: path.write_text("x"), "cannot be read: Not a directory"),
        (lambda path: path.mkdir(), "is not a session or a study"),
        (lambda path: (path / "sessions").mkdir(parents=True), "is not a session or a study"),
    ],
)
def test_a_folder_that_is_no_session_is_reported(
    tmp_path: Path, make: Callable[[Path], object], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    make(tmp_path / "x")
    assert run(tmp_path / "x", tmp_path / "out") == 1
    assert expected in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_nothing_is_written_into_the_record(session: Path, tmp_path: Path) -> None:
    shutil.copytree(session, tmp_path / "s")
    before = names(tmp_path / "s")
    for out in ("annotations", "photos", "export", "export-1/deeper", "."):
        with pytest.raises(ExportError, match=r"inside the recorded session"):
            export_session(tmp_path / "s", "vtt", tmp_path / "s" / out)
    assert names(tmp_path / "s") == before
    export_session(tmp_path / "s", "vtt", tmp_path / "s" / "export-vtt")
    assert names(tmp_path / "s") == sorted([*before, "export-vtt"])


def test_the_process_shows_how_far_it_is_and_what_it_wrote(study: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad"
    bad.mkdir()
    request = ExportRequest((*sorted((study / "sessions").iterdir()), bad), ("csv", "vtt"), tmp_path / "out", "CC0-1.0")
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe(duplex=True)
    process = spawn.Process(target=run_exports, args=(theirs, request), daemon=True)
    process.start()
    theirs.close()
    messages = []
    while not messages or not isinstance(messages[-1], ExportFinished):
        assert ours.poll(30), messages
        messages.append(ours.recv())
    process.join(10)
    assert process.exitcode == 0
    *progress, finished = messages
    fractions = [message.fraction for message in progress]
    assert fractions == sorted(fractions)
    assert (fractions[0], fractions[-1]) == (0.0, 1.0)
    assert {message.what for message in progress} >= {"one: Tables (CSV)", "two: Captions (WebVTT)"}
    assert [path.name for path in finished.written] == ["one", "three", "two"]
    (problem,) = finished.problems
    assert problem.startswith("bad: ")


def test_leftovers_of_a_killed_export_are_removed_and_nothing_else(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))  # of the killed process, which leaves its temporary folder
    request = ExportRequest(tuple(sorted((study / "sessions").iterdir())) * 4, ("csv",), tmp_path / "out")
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe(duplex=True)
    process = spawn.Process(target=run_exports, args=(theirs, request), daemon=True)
    process.start()
    theirs.close()
    out = tmp_path / "out"
    while not (out.is_dir() and len(list(out.glob("*"))) > 1 and any(out.glob(".*.exporting"))):
        assert ours.poll(30)
        assert isinstance(ours.recv(), ExportProgress), "it was over before it could be killed"
    process.kill()
    process.join(10)
    (out / ".mine").mkdir()
    (out / ".mine.exporting").mkdir()
    with whole_folder(out / "running", request.sessions[0]) as running:
        remove_partial_exports(out)
        found = list(out.iterdir())
    left = [path for path in found if path.name.startswith(".")]
    assert sorted(left) == sorted([out / ".mine", out / ".mine.exporting", running])
    whole = [path for path in found if not path.name.startswith(".")]
    assert whole
    assert all(is_whole(path) for path in whole)


def on_disk(script: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a shell script in a separate mount namespace."""
    return subprocess.run(
        ["unshare", "-m", "sh", "-ec", script, "sh", *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        cwd=REPOSITORY,
    )


@in_own_mounts
def test_a_full_disk_keeps_what_is_complete_and_ends_the_rest(study: Path, tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    result = on_disk(
        'mount -t tmpfs -o size=300k none "$1"; status=0\n'
        '"$3" -m caris_desktop export "$2" --workers 1 --to csv "$1/out" || status=$?\n'
        'echo "status $status"; find "$1/out" | sort',
        str(tmp_path / "disk"), str(study), sys.executable,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert "status 1" in result.stdout
    assert "No space left on device. Its partial files were deleted. Free some disk space" in result.stderr
    assert "further session(s) were not exported: the disk is full." in result.stderr
    assert "exporting" not in result.stdout
    assert f"{tmp_path}/disk/out/one/data_dictionary.csv" in result.stdout
    assert "/disk/out/two" not in result.stdout


@in_own_mounts
def test_a_read_only_disk_is_reported(session: Path, tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    result = on_disk(
        'mount -t tmpfs -o ro none "$1"; "$3" -m caris_desktop export "$2" --to csv "$1/out"',
        str(tmp_path / "disk"), str(session), sys.executable,
    )  # fmt: skip
    assert result.returncode == 1
    assert "failed: Read-only file system. Its partial files were deleted." in result.stderr


@in_own_mounts
def test_a_session_on_a_read_only_disk_is_exported(session: Path, tmp_path: Path) -> None:
    result = on_disk(
        'mount --bind "$2" "$2"; mount -o remount,ro,bind "$2"\n'
        '"$3" -m caris_desktop export "$2" --to csv,vtt "$1/out"',
        str(tmp_path), str(session), sys.executable,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert is_whole(tmp_path / "out" / "csv")


@pytest.mark.long
def test_a_header_of_nonsense_is_exported_as_far_as_it_goes(session: Path, tmp_path: Path) -> None:
    shutil.copytree(session, tmp_path / "s")
    path = tmp_path / "s" / "session.json"
    data = json.loads(path.read_text())
    data.update(trial=[1, {"a": None}], videos={"x": []}, files="none", extra=[{"a": [1, 2]}, {"a": {}}], big=10**400)
    path.write_text(json.dumps(data))
    finished = export_all(ExportRequest((tmp_path / "s",), ("csv", "parquet", "vtt", "textgrid"), tmp_path / "out"))
    assert finished.problems == ()


def test_a_finished_session_that_was_cut_is_reported_by_every_export(
    study: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = study / "sessions" / "one"
    recorded = sum(json.loads((folder / "session.json").read_text())["counts"].values())
    path = folder / "events.mcap"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 100])
    for number in (1, 2):
        assert run(folder, "--to", "html,methods,csv", "--verify", tmp_path / f"out{number}") == 1
        output = capsys.readouterr().err
        assert f"of the {recorded - 1} recorded values are missing from events.mcap" in output
        assert "one: events.mcap was changed after the session closed." in output
        assert "were saved are there" not in output
        for name in ("html/report.html", "methods/methods.md", "methods/methods.html", "csv/session.csv"):
            told = (tmp_path / f"out{number}" / name).read_text(encoding="utf-8")
            assert "recorded values are missing from events.mcap" in told, name
            assert "No missing data was recorded" not in told


def test_a_file_that_is_gone_is_reported_by_every_export(
    study: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = study / "sessions" / "one"
    (folder / "speech.txt").unlink()
    assert run(folder, "--to", "html,methods", tmp_path / "out") == 0
    assert "speech.txt is missing" in capsys.readouterr().err
    for name in ("html/report.html", "methods/methods.md"):
        told = (tmp_path / "out" / name).read_text(encoding="utf-8")
        assert "speech.txt is missing" in told, name
        assert "No missing data was recorded" not in told


@pytest.mark.logs(r"session\.session_reader: ")
def test_damaged_values_are_no_silent_part_of_an_export(
    study: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = study / "sessions" / "one" / "events.mcap"
    content = bytearray(path.read_bytes())
    index = events_file.read_index(path)
    content[int(index.offsets[index.count // 2]) + 100] ^= 0xFF
    path.write_bytes(content)
    assert run(path.parent, "--to", "csv", tmp_path / "out") == 1
    assert "recorded values are missing from events.mcap" in capsys.readouterr().err


@pytest.mark.long
def test_copies_count_once_where_sessions_are_counted(
    study: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(study, "--to", "methods", tmp_path / "out") == 0
    text = (tmp_path / "out" / "methods" / "methods.md").read_text(encoding="utf-8")
    assert "in one session" in text
    assert "Two copies of sessions not counted." in text
    parser = argparse.ArgumentParser()
    statistics_command.add_arguments(parser)
    assert statistics_command.run(parser.parse_args([str(study)])) == 0
    output = capsys.readouterr()
    assert "three is a copy of one and is not counted again." in output.err
    assert "two is a copy of one and is not counted again." in output.err
    assert "1 sessions, " in output.out
    parser = argparse.ArgumentParser()
    sessions_command.add_arguments(parser)
    assert sessions_command.run(parser.parse_args([str(study)])) == 0
    assert capsys.readouterr().out.count("copy of one") == 2


def test_remains_of_sessions_are_listed(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sessions = study / "sessions"
    (sessions / "one" / "session.json").unlink()
    (sessions / "two" / "session.json").unlink()
    (sessions / "two" / "events.mcap").unlink()
    (sessions / "three" / "speech.txt").unlink()
    for _ in range(2):
        parser = argparse.ArgumentParser()
        sessions_command.add_arguments(parser)
        assert sessions_command.run(parser.parse_args([str(study)])) == 0
        output = capsys.readouterr()
        assert "one: session.json was missing" in output.out
        assert "three: speech.txt is missing" in output.out
        assert output.out.count("incomplete") == 2
        assert f"{sessions / 'two'} no longer contains session.json or events.mcap" in output.err


def test_the_terminal_gets_sentences_and_the_log_the_details(study: Path, tmp_path: Path) -> None:
    folder = study / "sessions" / "one"
    (folder / "annotations").mkdir(exist_ok=True)
    (folder / "annotations" / "Ann.json").write_text('{"format": "caris-desktop annotations", "format_version": 1}')
    (folder / "session.json").write_text("{")
    environment = {**os.environ, "XDG_STATE_HOME": str(tmp_path / "state")}
    told = subprocess.run(
        [sys.executable, "-m", "caris_desktop", "export", str(folder), "--to", "csv", str(tmp_path / "out")],
        cwd=REPOSITORY, capture_output=True, text=True, env=environment, check=False, timeout=60,
    )  # fmt: skip
    assert told.returncode == 1
    assert "session.json was damaged" in told.stderr
    assert "Ann.json is damaged" in told.stderr
    for raw in ("Traceback", "Error", "are missing", "line 1 column"):
        assert raw not in told.stderr, told.stderr
    log = next((tmp_path / "state").rglob("console.log")).read_text()
    assert "line 1 column" in log
    assert "'coder', 'vocabularies' and 'tiers' are missing" in log
