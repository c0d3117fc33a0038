"""Robot with latched topics: the console gets every value, in any order and after stalls."""

import contextlib
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from PySide6.QtCore import QCoreApplication
from pytestqt.qtbot import QtBot

from caris_desktop.app import composition
from caris_desktop.live.console import Console
from caris_desktop.live.state import LiveState
from tests.support import latched_robot
from tests.support.polling import wait_for

pytestmark = pytest.mark.alone

WAIT_S = 60.0


def until(observe: Callable[[], object], what: str) -> None:
    """Run the console until ``observe`` is true."""

    def look() -> object:
        QCoreApplication.processEvents()
        return observe()

    wait_for(look, what, timeout_s=WAIT_S)


@contextlib.contextmanager
def running(*command: str) -> Iterator["subprocess.Popen[str]"]:
    process = subprocess.Popen([sys.executable, *command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.communicate()


def lacking(state: LiveState, lenses_before: int) -> list[str]:
    there = {
        "map": state.map.value is not None,
        "odometry": state.odometry.value is not None,
        "pose": state.pose.value is not None,
        "lens": state.stream("lens").arrivals > lenses_before,
        "link": state.link.value.state == "connected",
    }
    return [name for name, is_there in there.items() if not is_there]


@pytest.mark.logs(r"live\.bus: ")
@pytest.mark.parametrize("times", [2, pytest.param(50, marks=[pytest.mark.long, pytest.mark.timeout(3600)])])
@pytest.mark.long
def test_latched_robot_topics_arrive_after_every_connection_and_stall(qtbot: QtBot, tmp_path: Path, times: int) -> None:
    profile = tmp_path / "once.yaml"
    profile.write_text(latched_robot.PROFILE)
    scenario = composition.find_scenario("tour-guide")
    parts = composition.parts(study=composition.open_study(tmp_path / "study"))
    with contextlib.ExitStack() as stack:
        robot = stack.enter_context(running("-m", "tests.support.latched_robot"))
        address = (robot.stdout.readline() if robot.stdout else "").removeprefix(latched_robot.READY).strip()
        for _ in range(2 if times > 2 else 0):
            stack.enter_context(running("-c", "while True: pass"))
        console = Console(replace(parts, people=replace(parts.people, inference=None)), scenario)
        stack.callback(console.shutdown)
        state = console.state
        troubles: list[str] = []
        state.link.changed.connect(lambda link: troubles.append(link.state))
        for number in range(times):
            lenses = state.stream("lens").arrivals
            composition.confirm_robot(str(profile), accept_named=True)
            console.connect_robot(composition.robot_connection(str(profile), address=address))
            assert "map" in lacking(state, lenses), "another connection begins with nothing"

            until(lambda before=lenses: not lacking(state, before), f"all of connection {number}")
            # A stall is reported as trouble, and under load perhaps as a loss: neither may lose data permanently.
            robot.send_signal(signal.SIGSTOP)
            troubles.clear()
            until(lambda: "trouble" in troubles or "lost" in troubles, "trouble")
            robot.send_signal(signal.SIGCONT)
            until(lambda before=lenses: not lacking(state, before), f"all of connection {number} after the stall")
            for _ in range(20):
                until(lambda: True, "what is under way")
            assert lacking(state, lenses) == []
