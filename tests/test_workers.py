"""Tests of tests/support/workers.py: a run with a killed worker, and one that hangs and is interrupted."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

_REPOSITORY = Path(__file__).resolve().parents[1]
_HOOKS = """
import pytest
from tests.support.workers import LoadFileOnceScheduling, RunningTests, exit_description

def pytest_configure(config):
    config.pluginmanager.register(RunningTests())

@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    return LoadFileOnceScheduling(config, log, split_files=["test_apart.py"])

@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node, error):
    if error:
        print("ended by", exit_description(node))
"""
_SHORT = """
import time
import pytest

@pytest.mark.parametrize("number", range(4))
def test_short(number):
    time.sleep(0.02)
    open(f"short-{number}", "w").close()
"""
_FATAL = """
import os
import time

def test_before():
    time.sleep(0.5)  # until the other worker is through with most files, which are handed on to it when this one dies

def test_fatal():
    os.kill(os.getpid(), 9)

def test_after():
    pass
"""
_HANGING = """
import os
import time

def test_hanging():
    while not os.path.exists("short-3"):
        time.sleep(0.02)
    time.sleep(0.5)
    open("hangs", "w").close()
    time.sleep(100)
"""
_APART = """
import os
import pytest

@pytest.mark.parametrize("number", range(6))
def test_one_of_many(number):
    open(f"{os.environ['PYTEST_XDIST_WORKER']}-{number}", "w").close()
"""


_OPTIONS = ("-p", "xdist.plugin", "-p", "no:cacheprovider", "-n", "2", "--dist", "loadfile")


def start(folder: Path, files: dict[str, str]) -> "subprocess.Popen[str]":
    for name, text in {"conftest.py": _HOOKS, "pytest.ini": "[pytest]", **files}.items():
        (folder / name).write_text(text)
    return subprocess.Popen(
        [sys.executable, "-m", "pytest", *_OPTIONS],
        cwd=folder,
        # Other plugins import Qt and more, which would dominate the start of each process.
        env={**os.environ, "PYTHONPATH": str(_REPOSITORY), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


@pytest.mark.long
def test_a_worker_that_dies_costs_the_test_it_died_in_and_no_other(tmp_path: Path) -> None:
    files = {f"test_{name}.py": _SHORT for name in "abcdefgh"}
    run = start(tmp_path, {**files, "test_m.py": _FATAL, **{f"test_{name}.py": _SHORT for name in "nopq"}})
    printed, _ = run.communicate(timeout=90)
    assert run.returncode == pytest.ExitCode.TESTS_FAILED, printed
    assert "1 failed, 50 passed" in printed
    assert "crashed while running 'test_m.py::test_fatal'" in printed
    assert "ended by signal 9" in printed


@pytest.mark.long
def test_the_tests_of_a_file_that_shares_nothing_are_done_by_all(tmp_path: Path) -> None:
    run = start(tmp_path, {"test_apart.py": _APART})
    printed, _ = run.communicate(timeout=90)
    assert run.returncode == pytest.ExitCode.OK, printed
    done_by = sorted(path.name.split("-") for path in tmp_path.glob("gw*"))
    assert {worker for worker, _ in done_by} == {"gw0", "gw1"}
    assert sorted(number for _, number in done_by) == list("012345")


@pytest.mark.long
def test_hanging_tests_are_named_when_the_run_is_stopped(tmp_path: Path) -> None:
    run = start(tmp_path, {"test_short.py": _SHORT, "test_long.py": _HANGING})
    try:
        while not (tmp_path / "hangs").exists():
            assert run.poll() is None, run.communicate()
        run.send_signal(signal.SIGINT)
        printed, _ = run.communicate(timeout=90)
    finally:
        run.kill()
    assert run.returncode == pytest.ExitCode.INTERRUPTED, printed
    [under_way] = [part for part in printed.split("===") if "test_long.py::test_hanging" in part]
    assert "test_short[0]" not in under_way
