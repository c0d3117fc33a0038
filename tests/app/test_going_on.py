"""Crash of the whole program during a recording, or termination: the offer at the next start."""

import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import get_args

import psutil
import pytest

from caris_desktop.domain import intents
from caris_desktop.domain.events import ConfirmedAsBefore, SessionEnded, TrialResumed
from caris_desktop.recording.session.session_header import read_header
from caris_desktop.recording.session.session_reader import open_session
from tests.app.test_bad_input import HIDE_OFFLINE_DETECTOR
from tests.support.console_process import ConsoleProcess
from tests.support.polling import wait_for
from tests.support.simulated_robot import SimulatedRobot

pytestmark = pytest.mark.alone


@pytest.fixture
def start() -> Iterator[Callable[..., ConsoleProcess]]:
    """Each call starts the program for the same user, robot and study."""
    # A short path: the folder contains sockets, whose paths are limited to about a hundred characters.
    with tempfile.TemporaryDirectory(prefix="s-", ignore_cleanup_errors=True) as name, SimulatedRobot() as robot:
        folder, started = Path(name), list[ConsoleProcess]()
        environment = {name: str(folder / name) for name in ("XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_STATE_HOME")}
        # Without person detection, which would slow down all else.
        (folder / "sitecustomize.py").write_text(HIDE_OFFLINE_DETECTOR, "utf-8")
        environment["PYTHONPATH"] = f"{folder}{os.pathsep}{Path(__file__).parents[2]}"
        environment |= {"CARIS_MODELS_DIR": str(folder / "models"), "YOLO_OFFLINE": "1"}

        def run(**screen: str) -> ConsoleProcess:
            of_this_run = environment | screen
            console = ConsoleProcess(robot.address, folder / "study", module="tests.app.safety_child", **of_this_run)
            started.append(console)
            return console

        yield run
        for console in started:
            console.kill()


def _recording(console: ConsoleProcess) -> Path:
    console.wait_until_shown(timeout_s=120.0, link="connected", going_on="")
    console.send_command("record")
    console.wait_until_shown(recording="recording")
    return Path(console.shown["session"])


def _stored(console: ConsoleProcess, session: Path) -> None:
    """Wait until the recording has been saved as unfinished trial."""
    trials = session.parents[2] / "XDG_STATE_HOME" / "caris-desktop" / "trials"
    wait_for(lambda: list(trials.glob("*.json")), "what is under way is written down")


def _begin_anyway(console: ConsoleProcess) -> None:
    """Start the recording again with "Record anyway" if checks are open, which is known only after a while."""

    def begun() -> bool:
        if console.shown["recording"] != "idle":
            return True
        console.send_command("click_if_there start_dialog_begin")
        return False

    wait_for(begun, "a recording", timeout_s=60.0, every_s=1.0)


def test_a_killed_program_offers_to_continue_and_records_nothing_before_all_is_confirmed(
    start: Callable[..., ConsoleProcess],
) -> None:
    killed = start()
    first = _recording(killed)
    _stored(killed, first)
    killed.send_command("say Welcome to our lab.")
    killed.wait_until_shown(conversation=["Welcome to our lab."])
    time.sleep(2.0)  # the record is saved each second
    killed.kill()

    console = start()
    console.wait_until_shown(
        timeout_s=120.0, link="connected", going_on="offered", going_on_card=True, held=False, conversation=[]
    )
    console.send_command("click going_on_yes")
    console.wait_until_shown(
        going_on="unconfirmed", going_on_card=True, held=True, drive_allowed=False,
        conversation=["Welcome to our lab."],
    )  # fmt: skip
    refusal = "Starting a recording is not possible before this is confirmed again"
    for way in ("click record_button", "record"):
        told = len(console.shown["problems"])
        console.send_command(way)
        # A missing detector may be reported meanwhile.
        wait_for(lambda told=told: any(refusal in said for said in console.shown["problems"][told:]), refusal)  # type: ignore[misc]
        assert console.shown["recording"] == "idle"
    for what in get_args(intents.AsBefore):
        console.send_command(f"click going_on_{what}")
    console.wait_until_shown(going_on="confirmed", held=True)
    console.send_command("click going_on_start")
    _begin_anyway(console)
    console.wait_until_shown(
        recording="recording", going_on_card=False, held=True, conversation=["Welcome to our lab."]
    )
    second = Path(console.shown["session"])
    assert console.close() == 0

    assert second != first
    trials = [read_header(folder).trial for folder in (first, second)]
    assert trials[0]["participant"] == trials[1]["participant"] == "P1"
    assert trials[1]["recording"] == "2"
    happened = [value for _, value in open_session(second).values()]
    assert [value.folder for value in happened if isinstance(value, TrialResumed)] == [first.name]
    confirmed = [value.what for value in happened if isinstance(value, ConfirmedAsBefore)]
    assert confirmed == list(get_args(intents.AsBefore))


@pytest.fixture
def screen() -> Iterator[tuple["subprocess.Popen[bytes]", dict[str, str]]]:
    """A screen that can be removed, and its environment."""
    read_end, write_end = os.pipe()
    command = ["Xvfb", "-displayfd", str(write_end), "-screen", "0", "1400x900x24"]
    server = subprocess.Popen(command, pass_fds=(write_end,), stderr=subprocess.DEVNULL)
    os.close(write_end)
    with os.fdopen(read_end) as pipe:
        yield server, {"DISPLAY": f":{pipe.readline().strip()}", "QT_QPA_PLATFORM": "xcb"}
    server.kill()
    server.wait()


@pytest.mark.skipif(shutil.which("Xvfb") is None, reason="needs Xvfb")
@pytest.mark.parametrize("told_to_end", [False, pytest.param(True, marks=pytest.mark.long)])
@pytest.mark.long
def test_losing_the_screen_ends_the_program_and_a_trial_is_resumed_unless_terminated(
    start: Callable[..., ConsoleProcess],
    screen: tuple["subprocess.Popen[bytes]", dict[str, str]],
    told_to_end: bool,
) -> None:
    server, environment = screen
    seen = start(**environment)
    folder = _recording(seen)
    _stored(seen, folder)
    children = [pid for pid in seen.shown["children"].values() if pid]
    server.kill()
    if told_to_end:
        os.kill(seen.pid, signal.SIGTERM)
    status = seen.wait()
    assert status == 1 or told_to_end, "where it is told before it sees what happened, it ends in order"
    wait_for(lambda: not any(map(psutil.pid_exists, children)), "nothing of it is left", timeout_s=60.0)
    ended = [value.reason for _, value in open_session(folder).values() if isinstance(value, SessionEnded)]
    assert ended == ["console_closed"]

    console = start()
    console.wait_until_shown(timeout_s=120.0, link="connected", going_on="" if told_to_end else "offered")
    assert console.close() == 0


@pytest.mark.parametrize("told", [signal.SIGTERM, pytest.param(signal.SIGHUP, marks=pytest.mark.long)])
@pytest.mark.long
def test_a_terminated_program_saves_its_recording_and_offers_nothing(
    start: Callable[..., ConsoleProcess], told: signal.Signals
) -> None:
    """Termination while driving, without closing a window."""
    ended = start()
    session = _recording(ended)
    _stored(ended, session)
    ended.hold("A", lambda: ended.shown["moving"], "the robot is driven")
    assert ended.terminate(told) == 0
    (end,) = [value for _, value in open_session(session).values() if isinstance(value, SessionEnded)]
    assert end.reason == "console_closed"

    console = start()
    console.wait_until_shown(timeout_s=120.0, link="connected", going_on="", going_on_card=False)
    assert console.close() == 0
    assert not any(report["going_on"] for report in console.history)
