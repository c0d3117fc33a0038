"""Unconfirmed file: none of its references is opened, read or connected to before the user's confirmation."""

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from PySide6.QtCore import QSettings
from PySide6.QtWidgets import QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.app import command_table
from caris_desktop.app.console_command import ConsoleRun, default_arguments
from caris_desktop.live.console import Console
from caris_desktop.live.services.robot_service import RobotConnection

pytestmark = pytest.mark.logs(r"live\.bus: ")


class Listener:
    """Counts connections to all addresses that a file may contain."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self.connected = 0
        self._thread = threading.Thread(target=self._accept)
        self._thread.start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._server.accept()
                self.connected += 1
                connection.close()

    def close(self) -> None:
        self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        self._thread.join()


@pytest.fixture
def listener() -> Iterator[Listener]:
    made = Listener()
    yield made
    made.close()


@pytest.fixture
def hostile(tmp_path: Path, listener: Listener) -> Path:
    host = f"127.0.0.1:{listener.port}"
    path = tmp_path / "shared.yaml"
    path.write_text(
        f"version: 1\ntitle: Shared\nlayout: {{panel: video}}\nrobot: ws://{host}\n"
        f"permissions: {{transcription: true}}\ncameras: [{{source: 'http://{host}/cam'}}]\n"
        f"perception: {{server: 'ws://{host}'}}\nlistening: {{engine: server, server: 'http://{host}/v1'}}\n",
        encoding="utf-8",
    )
    return path


@pytest.mark.parametrize("words", [["check", "--scenario"], ["rehearse", "--out", "OUT"]])
def test_a_command_without_a_window_lists_what_is_named_and_stops(
    words: list[str], tmp_path: Path, hostile: Path, listener: Listener, capsys: pytest.CaptureFixture[str]
) -> None:
    given = [str(tmp_path / "out") if word == "OUT" else word for word in words]
    assert command_table.run([*given, str(hostile)]) != 0
    shown = "".join(capsys.readouterr())
    assert f"ws://127.0.0.1:{listener.port}" in shown
    assert f"http://127.0.0.1:{listener.port}/cam" in shown
    assert "--accept-named" in shown
    assert listener.connected == 0 or words[0] == "check"  # which continues with the parts of the tour guide


def test_a_profile_is_not_connected_to_either(
    tmp_path: Path, listener: Listener, capsys: pytest.CaptureFixture[str]
) -> None:
    profile = tmp_path / "robot.yaml"
    profile.write_text(
        f"version: 1\nros: 1\nvelocity: {{topic: /cmd_vel}}\naddress: ws://127.0.0.1:{listener.port}\n"
        "security: {rosauth_secret_env: HOME}\n",
        encoding="utf-8",
    )
    assert command_table.run(["robots", "--listen", str(profile), "--seconds", "0.1"]) == 1
    assert "HOME" in capsys.readouterr().err
    assert (
        command_table.run(["check", "--scenario", "blank", "--robot", str(profile), "--study", str(tmp_path / "s")])
        == 1
    )
    assert "--accept-named" in capsys.readouterr().out
    assert listener.connected == 0
    command_table.run(["robots", "--listen", str(profile), "--seconds", "0.1", "--accept-named"])
    assert listener.connected > 0


Start = Callable[..., ConsoleRun]


@pytest.fixture
def start(qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Start]:
    runs: list[ConsoleRun] = []
    monkeypatch.setattr(Console, "start", lambda _console: None)
    settings = QSettings(str(tmp_path / "settings.ini"), QSettings.Format.IniFormat)

    def start(**arguments: object) -> ConsoleRun:
        run = ConsoleRun(default_arguments(study=tmp_path / "study", **arguments), settings=settings)
        runs.append(run)
        qtbot.addWidget(run.window)
        run.window.show()
        run._start_rest()
        return run

    yield start
    for run in runs:
        run.close()


@pytest.mark.parametrize("accepted", [True, False])
@pytest.mark.long("True")
def test_the_console_starts_without_the_file_and_asks(
    start: Start, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, hostile: Path, listener: Listener, *, accepted: bool
) -> None:
    robots: list[str] = []

    def use_robot(console: Console, _find: Callable[[], RobotConnection], *_by: object, **_told: object) -> None:
        robots.append(console.scenario.robot)

    monkeypatch.setattr(Console, "use_robot", use_robot)
    run = start(scenario=str(hostile))
    assert run.console.scenario.title == "Tour guide"
    qtbot.waitUntil(lambda: run.window.findChild(QWidget, "confirm_file_dialog") is not None)
    assert robots == []
    button = run.window.findChild(QWidget, "confirm_file_allow" if accepted else "confirm_file_cancel")
    assert button is not None
    button.click()  # type: ignore[attr-defined]
    qtbot.waitUntil(lambda: bool(robots))
    if accepted:
        assert robots == [f"ws://127.0.0.1:{listener.port}"]
        assert run.console.scenario.title == "Shared"
        again = start(scenario=str(hostile))
        assert again.console.scenario.title == "Shared", "it is asked once"
    else:
        assert robots == ["simulated"]
        assert run.console.scenario.title == "Tour guide"
        assert listener.connected == 0
