"""Jobs over sessions: in processes of this computer, and on a real Dask cluster of two workers."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import psutil
import pytest

from caris_desktop.live.study_jobs import JobError, Progress, Workers, WorkersError, run_jobs
from tests.support.polling import wait_for

REPOSITORY = Path(__file__).parents[2]


def size(folder: Path, progress: Progress) -> tuple[int, int]:
    """A job that dies, fails or counts, by the name of the folder."""
    progress(0.5, folder.name)
    if folder.name == "deadly":
        os.kill(os.getpid(), signal.SIGKILL)
    if folder.name == "damaged":
        raise JobError("it is damaged")
    if folder.name == "fault":
        raise ZeroDivisionError("divided")
    return len(list(folder.iterdir())), os.getpid()


def wait_in(folder: Path, _progress: Progress) -> None:
    if folder.name == "quick":
        return
    (folder / "partial").touch()
    try:
        time.sleep(600)
    finally:
        (folder / "partial").unlink()


def derive(out: Path, fragile: str, folder: Path, _progress: Progress) -> list[str]:
    """Tables of a session; ``fragile`` kills its worker at the first try."""
    # Late, since each process of the other tests imports this file.
    from caris_desktop.recording.session.session_reader import open_session
    from caris_desktop.recording.table_files import copy_tables

    if folder.name == fragile and not (out / "killed").exists():
        (out / "killed").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    target = out / folder.name
    shutil.rmtree(target, ignore_errors=True)  # of a worker that died before it had told
    target.mkdir()
    return [path.name for path in copy_tables(open_session(folder, repair=False), target)]


def folders(tmp_path: Path, *names: str) -> list[Path]:
    for number, name in enumerate(names):
        (tmp_path / name).mkdir()
        for file in range(number):
            (tmp_path / name / str(file)).touch()
    return [tmp_path / name for name in names]


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.logs("job of .*")
def test_what_fails_is_reported_and_the_rest_goes_on(tmp_path: Path, count: int) -> None:
    steps: list[float] = []
    places = folders(tmp_path, "one", "damaged", "fault", "two")
    results = dict(run_jobs(size, places, lambda fraction, _what: steps.append(fraction), workers=Workers(count)))
    assert {folder.name: str(result) for folder, result in results.items() if isinstance(result, JobError)} == {
        "damaged": "it is damaged",
        "fault": "ZeroDivisionError: divided",
    }
    (ones, one_process), (twos, two_process) = results[places[0]], results[places[3]]  # type: ignore[misc]
    assert (ones, twos) == (0, 3)
    assert (os.getpid() in (one_process, two_process)) == (count == 1)
    assert steps == sorted(steps)
    assert len(steps) == 4


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL there")
def test_a_process_that_dies_costs_only_its_session(tmp_path: Path) -> None:
    places = folders(tmp_path, "one", "deadly", "two", "three")
    results = dict(run_jobs(size, places, workers=Workers(2)))
    assert [folder.name for folder, result in results.items() if isinstance(result, JobError)] == ["deadly"]
    assert "ended unexpectedly" in str(results[places[1]])
    assert set(results) == set(places)


def test_cancelling_lets_the_jobs_clean_up(tmp_path: Path) -> None:
    places = folders(tmp_path, "quick", "slow")

    def cancel(_fraction: float, _what: str) -> None:
        wait_for((tmp_path / "slow" / "partial").exists, "the slow job runs")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(run_jobs(wait_in, places, cancel, workers=Workers(2)))
    assert not (tmp_path / "slow" / "partial").exists()
    assert not [child for child in psutil.Process().children() if "spawn_main" in " ".join(child.cmdline())]


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL there")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_their_command(tmp_path: Path, number: signal.Signals) -> None:
    places = folders(tmp_path, "slow", "slower")
    script = tmp_path / "command.py"
    script.write_text(
        "from pathlib import Path\n"
        "from caris_desktop.live.study_jobs import Workers, run_jobs\n"
        "from tests.live.test_study_jobs import wait_in\n"
        "if __name__ == '__main__':\n"
        f"    list(run_jobs(wait_in, [Path(place) for place in {list(map(str, places))}], workers=Workers(2)))\n"
    )
    command = subprocess.Popen([sys.executable, script], env={**os.environ, "PYTHONPATH": str(REPOSITORY)})
    wait_for(lambda: all((place / "partial").exists() for place in places), "both jobs run")
    workers = psutil.Process(command.pid).children()
    command.send_signal(number)
    command.wait()
    try:
        wait_for(lambda: not any(worker.is_running() for worker in workers), "the workers have ended")
    finally:
        for worker in workers:
            with contextlib.suppress(psutil.NoSuchProcess):
                worker.kill()
    assert not any((place / "partial").exists() for place in places), "they cleaned up"


@pytest.mark.parametrize("address", ["tcp://192.0.2.1:8786", "tls://192.0.2.1:8786", "192.0.2.1:8786"])
def test_a_cluster_elsewhere_needs_certificates_of_both_ends(tmp_path: Path, address: str) -> None:
    with pytest.raises(WorkersError, match="certificates of both ends"):
        list(run_jobs(size, folders(tmp_path, "one"), workers=Workers(scheduler=address)))


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[str]:
    """Address of a scheduler with two workers, each in a process."""
    commands = [
        ("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", "cluster.json"),
        *[("worker", "--scheduler-file", "cluster.json", "--nthreads", "1", "--no-dashboard")] * 2,
    ]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY), "DASK_TEMPORARY_DIRECTORY": str(tmp_path)}
    processes = []
    try:
        for words in commands:
            command = [sys.executable, "-m", "dask", *words]
            processes.append(
                subprocess.Popen(
                    command, cwd=tmp_path, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
                )
            )
            wait_for((tmp_path / "cluster.json").exists, "the scheduler runs")
        yield json.loads((tmp_path / "cluster.json").read_text())["address"]
    finally:
        for process in processes:  # a worker whose scheduler has ended tries for minutes to find it again
            for child in psutil.Process(process.pid).children(recursive=True):
                child.kill()
            process.kill()
            process.wait()


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL there")
@pytest.mark.logs("job of .*", "Couldn.t gather .*")
def test_a_cluster_gives_the_same_results(tmp_path: Path, scheduler: str) -> None:
    names = ("one", "two", "damaged", "three", "deadly")
    places = folders(tmp_path, *names)
    local = {folder.name: result for folder, result in run_jobs(size, places[:4], workers=Workers(1))}
    results = {folder.name: result for folder, result in run_jobs(size, places, workers=Workers(scheduler=scheduler))}
    assert "ended unexpectedly" in str(results["deadly"])
    for name in names[:4]:
        here, there = local[name], results[name]
        assert type(here) is type(there)
        assert str(here) == str(there) if isinstance(here, JobError) else here[0] == there[0]  # type: ignore[index]


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL there")
@pytest.mark.parametrize("fragile", ["", "two"])
@pytest.mark.logs("Couldn.t gather .*")
def test_tables_of_a_cluster_are_equal_to_the_byte(tmp_path: Path, scheduler: str, fragile: str) -> None:
    from tests.recording.minute import everything, make_session

    names = ("one", "two", "three", "four")
    found = []
    for place, workers in (("here", Workers(1)), ("there", Workers(scheduler=scheduler))):
        (tmp_path / place / "out").mkdir(parents=True)
        for name in names:
            if place == "here":
                make_session(tmp_path / place / name, everything)
            else:
                shutil.copytree(
                    tmp_path / "here" / name, tmp_path / place / name, ignore=shutil.ignore_patterns("derived")
                )
        job = partial(derive, tmp_path / place / "out", fragile if place == "there" else "")
        results = dict(run_jobs(job, [tmp_path / place / name for name in names], workers=workers))
        assert not [result for result in results.values() if isinstance(result, JobError)]
        tables = {path: path.read_bytes() for path in (tmp_path / place).rglob("*.parquet")}
        found.append({path.relative_to(tmp_path / place): content for path, content in tables.items()})
    here, there = found
    assert len(here) > 2 * len(names)
    assert here == there
    assert (tmp_path / "there" / "out" / "killed").exists() == bool(fragile)
