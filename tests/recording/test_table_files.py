"""Tables that are derived once, beside the session or in the user's cache."""

import gc
import json
import os
import shutil
import stat
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.recording import table_files
from caris_desktop.recording.pseudonyms import pseudonymised, pseudonyms_of
from caris_desktop.recording.session.folder_lock import hold
from caris_desktop.recording.session.manifest import DERIVED_FOLDER, verify_manifest, write_manifest
from caris_desktop.recording.session.recovery import repair_session
from caris_desktop.recording.session.robot_clock_mapping import RobotClock
from caris_desktop.recording.session.session_header import SessionClock
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.recording.session_export import export_session
from caris_desktop.recording.table_files import copy_tables
from caris_desktop.recording.tables.catalog import RowTimes
from tests.recording.minute import everything, make_session


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "caris-desktop" / "tables"


@pytest.fixture
def passes(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Sessions that were read."""
    names, arrivals = list[str](), Session.arrivals

    def count(session: Session, *streams: str) -> object:
        names.append(session.folder.name)
        return arrivals(session, *streams)

    monkeypatch.setattr(Session, "arrivals", count)
    return names


def make(folder: Path) -> Path:
    make_session(folder, everything, trial={"participant": "P07", "wizard": "Mia"})
    write_manifest(folder)
    return folder


def copied(folder: Path, out: Path, only: tuple[str, ...] = ()) -> dict[str, bytes]:
    out.mkdir(parents=True)
    paths = copy_tables(open_session(folder, repair=False), out, only=only)
    assert set(paths) == set(out.iterdir())
    return {path.name: path.read_bytes() for path in paths}


def stored_in(folder: Path) -> Path:
    return folder / DERIVED_FOLDER / "tables" / "with names"


def test_a_session_is_read_once(tmp_path: Path, passes: list[str]) -> None:
    folder = make(tmp_path / "s")
    first = copied(folder, tmp_path / "1")
    assert passes == ["s"], "the robot's clock is in the same pass"
    assert copied(folder, tmp_path / "2") == first
    some = copied(folder, tmp_path / "3", ("odometry", "utterances"))
    assert set(some) == {"odometry.parquet", "utterances.parquet", "data_dictionary.parquet"}
    assert all(some[name] == first[name] for name in some)
    assert passes == ["s"]


def test_times_are_rounded_to_the_microsecond_as_python_rounds() -> None:
    times = RowTimes(SessionClock(ClockAnchor(0, 0), 7), RobotClock(()))
    ns = [0, 1, 499, 500, 501, 1500, 2500, 999_999_500, 3_600_000_000_499, 86_400_000_000_500, 8 * 10**15 + 1]
    stamps_ns = [7 + sign * each for each in ns for sign in (1, -1)]
    assert list(map(repr, times.session_s(stamps_ns))) == [repr(round((at - 7) / 1e9, 6)) for at in stamps_ns]
    assert times.session_s([None]) == [None]


def test_garbage_is_collected_afterwards_as_before(tmp_path: Path) -> None:
    before = gc.get_threshold()
    export_session(make(tmp_path / "s"), "parquet", tmp_path / "out")
    assert gc.get_threshold() == before


def test_some_tables_are_made_without_the_others(tmp_path: Path) -> None:
    folder = make(tmp_path / "s")
    some = ("odometry", "utterances")
    copied(folder, tmp_path / "1", some)
    assert not (folder / DERIVED_FOLDER).exists()
    copied(folder, tmp_path / "2")
    for name in some:
        alone, among_all = (pq.read_table(tmp_path / out / f"{name}.parquet") for out in "12")
        assert alone.equals(among_all, check_metadata=True)


def test_stored_tables_are_private_and_no_part_of_the_recording(tmp_path: Path) -> None:
    folder = make(tmp_path / "study" / "sessions" / "s")
    before = os.umask(0o022)
    try:
        copied(folder, tmp_path / "1")
    finally:
        os.umask(before)
    assert {path.is_dir(): stat.S_IMODE(path.stat().st_mode) for path in stored_in(folder).parent.rglob("*")} == {
        True: 0o700,
        False: 0o600,
    }
    assert stat.S_IMODE(stored_in(folder).parent.stat().st_mode) == 0o700
    assert verify_manifest(folder) == []
    assert not repair_session(folder).repaired
    for fmt in ("rocrate", "csv", "html"):
        export_session(folder, fmt, tmp_path / fmt)
        assert not list((tmp_path / fmt).rglob(DERIVED_FOLDER))
    assert not list((tmp_path / "rocrate").rglob("*.parquet"))


@pytest.mark.logs(".*mia.json")
@pytest.mark.parametrize("change", ["events", "manifest", "annotations", "header", "version"])
def test_tables_of_another_state_are_not_used(
    tmp_path: Path, passes: list[str], change: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = make(tmp_path / "s")
    copied(folder, tmp_path / "1")
    if change == "events":
        os.utime(folder / "events.mcap", ns=(1, 1))
    elif change == "manifest":
        (folder / "note.txt").write_text("more")
        write_manifest(folder)
    elif change == "annotations":
        (folder / "annotations").mkdir()
        (folder / "annotations" / "mia.json").write_text("damaged")
    elif change == "header":
        header = json.loads((folder / "session.json").read_bytes())
        (folder / "session.json").write_text(json.dumps({**header, "trial": {"participant": "P08"}}))
    else:
        monkeypatch.setattr(table_files, "__version__", "99")
    passes.clear()
    copied(folder, tmp_path / "2")
    copied(folder, tmp_path / "3")
    assert passes == ["s"]
    if change == "header":
        assert set(pq.read_table(tmp_path / "3" / "odometry.parquet")["participant"].to_pylist()) == {"P08"}


@pytest.mark.parametrize("damage", ["cut", "exchanged", "missing", "key", "elsewhere"])
@pytest.mark.logs("the tables in .* are damaged")
def test_damaged_tables_are_not_used(tmp_path: Path, passes: list[str], damage: str) -> None:
    folder = make(tmp_path / "s")
    first = copied(folder, tmp_path / "1")
    path, key = stored_in(folder) / "odometry.parquet", stored_in(folder) / "key.json"
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:-1])
    elif damage == "exchanged":
        shutil.copyfile(stored_in(folder) / "scan.parquet", path)
    elif damage == "missing":
        path.unlink()
    elif damage == "key":
        key.write_text("[" * 100_000)
    else:
        key.write_text(key.read_text().replace('"odometry.parquet"', '"../../../session.json"'))
    passes.clear()
    assert set(copied(folder, tmp_path / "2")) == set(first)
    assert passes == ["s"]
    copied(folder, tmp_path / "3")
    assert passes == ["s"]


@pytest.mark.logs(".*mia.json")
def test_tables_of_a_damaged_coding_say_so_each_time(tmp_path: Path) -> None:
    folder = make(tmp_path / "s")
    (folder / "annotations").mkdir()
    (folder / "annotations" / "mia.json").write_text("damaged")
    told: list[list[str]] = [[], []]
    for number, sentences in enumerate(told):
        (tmp_path / str(number)).mkdir()
        copy_tables(open_session(folder, repair=False), tmp_path / str(number), on_damaged=sentences.append)
    assert told[0] == told[1]
    assert len(told[0]) == 1


def test_names_and_pseudonyms_are_apart(tmp_path: Path, passes: list[str]) -> None:
    folder = make(tmp_path / "study" / "sessions" / "s")
    copied(folder, tmp_path / "1")
    session = pseudonymised(open_session(folder, repair=False), pseudonyms_of([folder]))
    for out in (tmp_path / "2", tmp_path / "3"):
        passes.clear()
        out.mkdir()
        copy_tables(session, out)
        facts = pq.read_table(out / "session.parquet").to_pylist()
        assert {fact["value"] for fact in facts if fact["key"] == "trial.wizard"} == {"W1"}
    assert passes == []
    other = pseudonymised(open_session(folder, repair=False), pseudonyms_of([]))
    passes.clear()
    (tmp_path / "4").mkdir()
    copy_tables(other, tmp_path / "4")
    assert passes == ["s"], "other pseudonyms"
    passes.clear()
    copied(folder, tmp_path / "5")
    assert passes == []


def test_a_recording_in_progress_is_left_alone(tmp_path: Path) -> None:
    folder = make(tmp_path / "s")
    with hold(folder):
        first = copied(folder, tmp_path / "1")
    assert not (folder / DERIVED_FOLDER).exists()
    assert set(copied(folder, tmp_path / "2")) == set(first)
    assert stored_in(folder).exists()


def test_a_read_only_session_uses_the_cache(tmp_path: Path, cache: Path, passes: list[str]) -> None:
    gone, folder = make(tmp_path / "gone"), make(tmp_path / "s")
    for one in (gone, folder):
        (one / DERIVED_FOLDER).touch()  # no folder can be made there, not even by root
    copied(gone, tmp_path / "1")
    shutil.rmtree(gone)
    first = copied(folder, tmp_path / "2")
    passes.clear()
    assert copied(folder, tmp_path / "3") == first
    assert passes == []
    (stored,) = cache.iterdir()
    assert json.loads((stored / "key.json").read_bytes())["folder"] == str(folder), "without those of deleted sessions"
    assert stat.S_IMODE(stored.stat().st_mode) == stat.S_IMODE(cache.stat().st_mode) == 0o700


def test_without_any_place_the_tables_are_made_all_the_same(tmp_path: Path, cache: Path) -> None:
    folder = make(tmp_path / "s")
    (folder / DERIVED_FOLDER).touch()
    cache.parent.mkdir(parents=True)
    cache.touch()
    assert "odometry.parquet" in copied(folder, tmp_path / "1")


def test_a_process_at_work_is_not_disturbed(tmp_path: Path, cache: Path) -> None:
    folder = make(tmp_path / "s")
    base = stored_in(folder).parent
    base.mkdir(parents=True)
    with hold(base):
        copied(folder, tmp_path / "1")
        assert [path.name for path in base.iterdir()] == [".recording"]
    assert cache.exists()


def test_a_cancelled_derivation_leaves_nothing(tmp_path: Path) -> None:
    folder = make(tmp_path / "s")
    (tmp_path / "1").mkdir()

    def cancel(_fraction: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        copy_tables(open_session(folder, repair=False), tmp_path / "1", cancel)
    assert list(stored_in(folder).parent.iterdir()) == []
