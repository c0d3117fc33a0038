"""Second start of the program with the same study."""

import os
import re
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from caris_desktop.app import console_command
from caris_desktop.app.composition import StartError
from tests.support.polling import wait_for

_LOCK = ".console.lock"


class Program:
    """``caris-desktop`` for one user without a robot, which may be started repeatedly."""

    def __init__(self, home: Path) -> None:
        self._home = home
        self._log = (home / "log").open("w+")
        self.started: list[subprocess.Popen[str]] = []

    def start(self, study: str) -> "subprocess.Popen[str]":
        own = {f"XDG_{name}_HOME": str(self._home / name) for name in ("CONFIG", "DATA", "STATE")}
        command = [
            sys.executable,
            "-m",
            "caris_desktop",
            "--verbose",
            "--robot",
            "ws://127.0.0.1:9",
            "--scenario",
            "blank",
        ]
        process = subprocess.Popen(
            [*command, "--study", str(self._home / study)],
            env={**os.environ, **own, "QT_QPA_PLATFORM": "offscreen", "CARIS_MODELS_DIR": str(self._home)},
            stdout=subprocess.PIPE, stderr=self._log, text=True,
        )  # fmt: skip
        self.started.append(process)
        return process

    def logged(self) -> str:
        return Path(self._log.name).read_text("utf-8", "replace")

    def close(self) -> None:
        for process in self.started:
            process.terminate()
        for process in self.started:
            process.communicate(timeout=60)
        self._log.close()


@pytest.fixture
def program() -> Iterator[Program]:
    # A short path: the folder contains sockets, whose paths are limited to about a hundred characters.
    with tempfile.TemporaryDirectory(prefix="s-", ignore_cleanup_errors=True) as folder:
        program = Program(Path(folder))
        yield program
        program.close()


def test_a_second_start_shows_the_window_that_is_there_and_another_study_is_another_console(program: Program) -> None:
    first, second = program.start("a"), program.start("a")  # a second double click during the start
    wait_for(lambda: second.poll() is not None or first.poll() is not None, "one of both goes", timeout_s=60.0)
    gone, stays = (second, first) if second.poll() is not None else (first, second)
    assert gone.returncode == 0 and gone.stdout is not None
    assert re.search(r"is already open: its window was brought to the front\.$", gone.stdout.read().strip())
    assert "another window asked for show_window" in program.logged()
    assert stays.poll() is None
    elsewhere = program.start("b")
    wait_for(lambda: (program._home / "b" / _LOCK).exists(), "another study is open")
    assert elsewhere.poll() is None and stays.poll() is None


def test_a_killed_instance_holds_no_lock(program: Program, tmp_path: Path) -> None:
    killed = program.start("a")
    lock = program._home / "a" / _LOCK
    wait_for(lambda: lock.exists() and lock.read_text(), "the study is held", timeout_s=60.0)
    killed.kill()
    killed.wait()
    with console_command.held(program._home / "a", tmp_path):
        assert lock.exists()
    assert not lock.exists()


def test_a_study_that_another_computer_has_open_stays_with_it(tmp_path: Path) -> None:
    (tmp_path / _LOCK).write_text(f"{os.getpid()}\npython3.11\nlab-2\n\n\n")
    why = r"is open on the computer lab-2\. .* choose another folder with --study"
    with pytest.raises(StartError, match=why), console_command.held(tmp_path, tmp_path / "live"):
        pass


def test_one_that_does_not_answer_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(console_command, "_WAITS_S", 0.0)
    why, there = rf"process {os.getpid()}\), which does not respond", tmp_path / "live"
    with (
        console_command.held(tmp_path, there),
        pytest.raises(StartError, match=why),
        console_command.held(tmp_path, there),
    ):
        pass


def test_one_that_is_about_to_end_is_waited_for(tmp_path: Path) -> None:
    with ExitStack() as ending:
        ending.enter_context(console_command.held(tmp_path, tmp_path / "live"))
        end = threading.Timer(0.3, ending.close)
        end.start()
        with console_command.held(tmp_path, tmp_path / "live"):
            end.join()
            assert (tmp_path / _LOCK).exists()


@pytest.mark.logs(r"is not locked: ")
def test_a_study_that_is_read_only_is_opened_without_a_lock(tmp_path: Path) -> None:
    with console_command.held(tmp_path / "nowhere", tmp_path / "live"):
        assert list(tmp_path.iterdir()) == []
