"""A replay stops the robot of a console on the same machine, or reports that it cannot."""

import os
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from PySide6.QtNetwork import QLocalSocket
from pytestqt.qtbot import QtBot

from caris_desktop.live import robot_connections
from caris_desktop.live.robot_connections import LiveRobots, RobotConnections
from caris_desktop.live.status import LinkStatus, LiveRobotsStatus
from tests.ui import samples
from tests.ui.fake_console import FakeConsole


class Replay:
    """The replay's end of the connection, and its reports to the wizard."""

    def __init__(self, folder: Path) -> None:
        self.told: list[str] = []
        self.robots = LiveRobots(folder, lambda severity, *words: self.told.append(f"{severity}: {' '.join(words)}"))
        self.robots.start()

    @property
    def status(self) -> LiveRobotsStatus:
        status: LiveRobotsStatus = self.robots.status.value
        return status


@pytest.fixture
def folder() -> Iterator[Path]:
    """With a short path, as of a user's home."""
    with tempfile.TemporaryDirectory(prefix="live-") as state:
        yield Path(state) / "live"


@pytest.fixture
def console(qtbot: QtBot) -> FakeConsole:
    console = FakeConsole(samples.TOUR)
    console.state.link.set(LinkStatus("connected", "Simulated robot", "ws://127.0.0.1:9090"))
    return console


@pytest.fixture
def host(console: FakeConsole, folder: Path) -> Iterator[RobotConnections]:
    host = RobotConnections(console, folder)  # type: ignore[arg-type]
    host.start()
    yield host
    host.shutdown()


@pytest.fixture
def replay(qtbot: QtBot, folder: Path) -> Iterator[Replay]:
    replay = Replay(folder)
    yield replay
    replay.robots.shutdown()


def test_without_a_console_there_is_nothing_to_stop(qtbot: QtBot, replay: Replay) -> None:
    assert replay.status == LiveRobotsStatus()
    nobody: list[str] = []
    replay.robots.stop(lambda: nobody.append("stop"))
    replay.robots.emergency_stop(lambda: nobody.append("emergency stop"))
    qtbot.waitUntil(lambda: nobody == ["stop", "emergency stop"])
    assert replay.told == []


def test_a_replay_knows_whose_robot_it_stops(
    qtbot: QtBot, host: RobotConnections, replay: Replay, console: FakeConsole
) -> None:
    qtbot.waitUntil(lambda: replay.status == LiveRobotsStatus(("Simulated robot",)))
    replay.robots.stop(pytest.fail)
    qtbot.waitUntil(lambda: console.calls == [("stop", None)])
    replay.robots.emergency_stop(pytest.fail)
    qtbot.waitUntil(lambda: console.calls[1:] == [("emergency_stop", None)])
    qtbot.waitUntil(lambda: replay.status == LiveRobotsStatus(("Simulated robot",), emergency_stop=True))
    qtbot.waitUntil(lambda: not replay.robots._patience.isActive())
    assert replay.told == [], "both were confirmed"
    console.state.link.set(LinkStatus("closed", "Simulated robot"))
    qtbot.waitUntil(lambda: replay.status == LiveRobotsStatus())


def test_a_console_that_starts_later_is_found_and_one_that_ends_is_gone(
    qtbot: QtBot, folder: Path, replay: Replay, console: FakeConsole
) -> None:
    host = RobotConnections(console, folder)  # type: ignore[arg-type]
    host.start()
    qtbot.waitUntil(lambda: replay.status.robots == ("Simulated robot",))
    host.shutdown()
    qtbot.waitUntil(lambda: replay.status.robots == ())
    assert list(folder.iterdir()) == [], "the socket goes with the console"
    nobody: list[bool] = []
    replay.robots.stop(lambda: nobody.append(True))
    qtbot.waitUntil(lambda: nobody == [True])


def test_it_is_reported_where_the_robot_is_out_of_reach(
    qtbot: QtBot, host: RobotConnections, replay: Replay, console: FakeConsole
) -> None:
    console.state.link.set(replace(console.state.link.value, state="lost"))
    qtbot.waitUntil(lambda: replay.status.robots == ("Simulated robot",))
    replay.robots.emergency_stop()
    qtbot.waitUntil(lambda: bool(replay.told))
    assert replay.told[0].startswith(
        "error: The live console cannot currently reach the robot. Simulated robot may not"
    )


_SILENT = """
import os, socket, sys, time
listening = socket.socket(socket.AF_UNIX)
listening.bind(os.path.join(sys.argv[1], str(os.getpid())))
listening.listen()
print("listens", flush=True)
connection, _ = listening.accept()
connection.sendall(b'{"robot": "Lab robot", "reached": true, "emergency_stop": false}\\n')
time.sleep(60)
"""


def test_a_console_that_does_not_answer_or_is_killed_is_reported(
    qtbot: QtBot, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robot_connections, "CONFIRMED_WITHIN_MS", 50)
    folder.mkdir(parents=True)
    silent = subprocess.Popen([sys.executable, "-c", _SILENT, str(folder)], stdout=subprocess.PIPE)
    replay = Replay(folder)
    try:
        assert silent.stdout is not None
        assert silent.stdout.readline() == b"listens\n"
        qtbot.waitUntil(lambda: replay.status.robots == ("Lab robot",))
        replay.robots.stop(pytest.fail)
        qtbot.waitUntil(lambda: bool(replay.told))
        assert replay.told[0].startswith(
            "error: The live console does not respond. Lab robot may not have been stopped"
        )
        replay.robots._patience.setInterval(60_000)
        replay.robots.stop()
        os.kill(silent.pid, signal.SIGKILL)
        qtbot.waitUntil(lambda: len(replay.told) == 2)
        assert "closed before it responded" in replay.told[1]
        assert replay.status.robots == ()
    finally:
        replay.robots.shutdown()
        silent.kill()
        silent.wait()
        silent.stdout.close()


def test_leftovers_of_a_killed_console_are_removed_and_private(
    qtbot: QtBot, folder: Path, console: FakeConsole
) -> None:
    folder.mkdir(parents=True, mode=0o755)
    ended = subprocess.Popen(["true"])
    ended.wait()
    left = socket.socket(socket.AF_UNIX)
    left.bind(str(folder / str(ended.pid)))
    left.close()
    host = RobotConnections(console, folder)  # type: ignore[arg-type]
    host.start()
    assert [path.name for path in folder.iterdir()] == [str(os.getpid())]
    assert folder.stat().st_mode & 0o777 == 0o700
    host.shutdown()


def test_only_stops_can_be_requested(qtbot: QtBot, folder: Path, host: RobotConnections, console: FakeConsole) -> None:
    caller = QLocalSocket()
    caller.connectToServer(str(folder / str(os.getpid())))
    caller.write(b'{"do": "clear_emergency_stop"}\n{"do": ["stop"]}\n[]\n{{{\n' + b'{"do": "drive"}\n')
    caller.write(b'{"do": "stop"}\n')
    qtbot.waitUntil(lambda: console.calls == [("stop", None)])
    caller.write(b"x" * 10_000)
    qtbot.waitUntil(lambda: caller.state() == QLocalSocket.LocalSocketState.UnconnectedState)
    assert console.calls == [("stop", None)]


def test_a_long_path_has_a_short_one(qtbot: QtBot, tmp_path: Path, console: FakeConsole) -> None:
    folder = tmp_path / ("long" * 40)
    host = RobotConnections(console, folder)  # type: ignore[arg-type]
    host.start()
    replay = Replay(folder)
    qtbot.waitUntil(lambda: replay.status.robots == ("Simulated robot",))
    replay.robots.shutdown()
    host.shutdown()
    robot_connections._meeting_place(folder).rmdir()
