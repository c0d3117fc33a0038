"""rosbridge stopped and killed, and the control link killed, at random times while the whole console drives.

Assertions on the simulated robot's log of executed velocities with times: after each fault at most four old velocities,
and zero within 0.2 s of the continuation or the first new connection. The robot does not move until the wizard presses
a key again.
"""

import contextlib
import json
import math
import os
import random
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import pytest

from caris_desktop.robot.unread import MOST_UNREAD
from tests.app.test_bad_input import HIDE_OFFLINE_DETECTOR
from tests.support.console_process import ConsoleProcess
from tests.support.leak_checks import share_in_module
from tests.support.polling import wait_for
from tests.support.simulated_robot import SimulatedRobot

pytestmark = pytest.mark.alone

S = 1_000_000_000
Fault = Literal["stop", "kill", "kill link"]
SHORT, LONG = 3, 100
ZERO_WITHIN_S = 0.2
# Under load of other tests the robot itself may be delayed between two messages.
ZERO_WITHIN_S_ON_A_BUSY_MACHINE = 1.0


@dataclass(frozen=True, slots=True)
class Read:
    """Velocity read by the robot, or an accepted client if ``moving`` is None."""

    at_ns: int
    client: str
    moving: bool | None


@dataclass(frozen=True, slots=True)
class Outcome:
    """Velocities after a fault; ``zero_after_s`` counts from the continuation or the first new connection."""

    fault: str
    old: int
    zero_after_s: float
    driven_after: bool


class Bench:
    """Robot that may be killed and restarted on its port, and the console that drives it."""

    def __init__(self, folder: Path) -> None:
        self.log = folder / "obeyed.jsonl"
        # A killed robot cannot remove its temporary folder for maps.
        self._arguments = ("--empty", "--obeyed-log", str(self.log), "--maps-folder", str(folder / "maps"))
        (folder / "maps").mkdir()
        self.robot = SimulatedRobot(*self._arguments)
        # Without person detection, which would slow down all else.
        (folder / "sitecustomize.py").write_text(HIDE_OFFLINE_DETECTOR, "utf-8")
        environment = {name: str(folder / name) for name in ("XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_STATE_HOME")}
        environment["PYTHONPATH"] = f"{folder}{os.pathsep}{Path(__file__).parents[2]}"
        environment |= {"CARIS_MODELS_DIR": str(folder / "models"), "YOLO_OFFLINE": "1"}
        self.console = ConsoleProcess(self.robot.address, folder / "study", **environment)
        self._position = 0
        self._read: list[Read] = []

    def close(self) -> None:
        os.kill(self.robot.pid, signal.SIGCONT)
        self.console.close()
        self.robot.kill()

    def read(self) -> list[Read]:
        """All velocities read by the robot so far."""
        with self.log.open("rb") as stream:
            stream.seek(self._position)
            for raw in stream:
                if not raw.endswith(b"\n"):
                    break
                self._position += len(raw)
                if (read := _read(json.loads(raw))) is not None:
                    self._read.append(read)
        return self._read

    def drive(self, commands: int) -> None:
        """Hold a key, turning on the spot, until the robot has executed so many commands in a row."""
        self.console.wait_until_shown(link="connected", drive_allowed=True)
        self.robot.call("/simulator/reset_pose", x=9.0, y=5.0, heading_deg=0.0)
        for _attempt in range(30):
            self.console.send_command("press A")
            with contextlib.suppress(AssertionError):
                wait_for(lambda: self._driving_since() >= commands, "a drive", timeout_s=2.0)
                return
            # A busy machine stalled the window, which ends a drive.
            self.console.send_command("release A")
        raise AssertionError(f"never {commands} commands in a row; last: {self.console.shown}")

    def _driving_since(self) -> int:
        """Number of commands read since the last zero."""
        reads = [read for read in self.read() if read.moving is not None]
        return next((back for back, read in enumerate(reversed(reads)) if not read.moving), len(reads))

    def suffer(self, fault: Fault, seconds: float) -> Outcome:
        """Cause a fault, and wait until the robot has been back for a while with the key still held."""
        before = len(self.console.history)
        if fault == "kill link":
            os.kill(self.console.shown["children"]["control"], signal.SIGKILL)
            from_ns = time.monotonic_ns()
        elif fault == "kill":
            self.robot.kill()
            from_ns = time.monotonic_ns()
            self.robot = SimulatedRobot(*self._arguments, port=self.robot.port)
            share_in_module(self.robot.pid, self.robot.folder.name)
        else:
            os.kill(self.robot.pid, signal.SIGSTOP)
            until_s = time.monotonic() + seconds
            wait_for(lambda: time.monotonic() >= until_s, "the end of the stop")
            from_ns = time.monotonic_ns()
            os.kill(self.robot.pid, signal.SIGCONT)
        wait_for(
            lambda: (
                any(report["link"] != "connected" for report in self.console.history[before:])
                and self.console.shown["link"] == "connected"
                and self.console.shown["drive_allowed"]
            ),
            f"connected again, have {self.console.shown}",
            timeout_s=40.0,
        )
        # Late commands would have arrived by now.
        again_s = time.monotonic() + 0.7
        wait_for(lambda: time.monotonic() >= again_s, "a moment")
        outcome = _outcome(f"{fault} {seconds:.2f} s", fault, self.read(), from_ns)
        self.console.send_command("release A")
        return outcome


def _read(line: dict[str, Any]) -> Read | None:
    if "connected" in line:
        return Read(line["at_ns"], line["connected"], None)
    if line.get("topic") != "/cmd_vel":
        return None
    axes = (line["message"]["linear"]["x"], line["message"]["linear"]["y"], line["message"]["angular"]["z"])
    return Read(line["at_ns"], line["client"], any(axes))


def _outcome(name: str, fault: Fault, every: list[Read], from_ns: int) -> Outcome:
    reads = [read for read in every if read.at_ns >= from_ns]
    velocities = [read for read in reads if read.moving is not None]
    if not velocities and not [read for read in every if read.moving is not None][-1].moving:
        return Outcome(f"{name}, and the zero was read just before", 0, 0.0, driven_after=False)
    old = next((at for at, read in enumerate(velocities) if not read.moving), len(velocities))
    assert old < len(velocities), f"{name}: no zero at all, {velocities}"
    zero = velocities[old]
    if fault == "stop":
        # By the robot's own clock, as the machine may delay its continuation.
        since_ns = reads[0].at_ns
    else:
        came_ns = (read.at_ns for read in reads if read.moving is None and read.client == zero.client)
        # It may have come over the old connection.
        since_ns = next(came_ns, zero.at_ns)
    return Outcome(name, old, (zero.at_ns - since_ns) / S, any(read.moving for read in velocities[old:]))


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    made = Bench(tmp_path_factory.mktemp("bench"))
    yield made
    made.close()


@pytest.fixture
def bench(shared: Bench) -> Bench:
    """One bench for all tests; each test continues with the robot left by the previous one."""
    shared.console.wait_until_shown(timeout_s=120.0, link="connected", drive_allowed=True)
    return shared


def _suffer(bench: Bench, count: int, seed: int, longest_stop_s: float) -> list[Outcome]:
    chance = random.Random(seed)  # noqa: S311 - a test, not cryptography
    kinds: tuple[Fault, ...] = ("stop", "kill", "kill link")
    faults = [kinds[number % len(kinds)] for number in range(count)]
    chance.shuffle(faults)
    outcomes = []
    for fault in faults:
        bench.drive(chance.randint(1, 12))
        outcomes.append(bench.suffer(fault, chance.uniform(0.65, longest_stop_s)))
        print(outcomes[-1])
    return outcomes


def _judge(outcomes: list[Outcome], zero_within_s: float) -> None:
    assert not [outcome for outcome in outcomes if outcome.driven_after]
    assert not [outcome for outcome in outcomes if outcome.old > MOST_UNREAD]
    assert not [outcome for outcome in outcomes if outcome.zero_after_s > zero_within_s]


def test_stops_and_kills_leave_a_zero_as_the_last_word(bench: Bench) -> None:
    _judge(_suffer(bench, SHORT, seed=8, longest_stop_s=2.5), ZERO_WITHIN_S_ON_A_BUSY_MACHINE)


def test_a_link_killed_under_a_goal_leaves_a_robot_that_stands_and_a_console_that_drives(bench: Bench) -> None:
    console = bench.console
    for _ in range(2):
        console.wait_until_shown(link="connected", drive_allowed=True)
        bench.robot.call("/simulator/reset_pose", x=9.0, y=5.0, heading_deg=0.0)
        console.send_command("go 3.0 4.0")
        console.wait_until_shown(goal="active")
        wait_for(lambda: bench.robot.state()["speed_mps"] > 0.1, "it drives to its goal")
        killed = console.shown["children"]["control"]
        os.kill(killed, signal.SIGKILL)
        stood = wait_for(
            lambda: (state := bench.robot.state())["goal_id"] == "" and state["speed_mps"] == 0.0 and state, "it stands"
        )
        wait_for(lambda: console.shown["goal"] in ("cancelled", "failed"), f"the end of it, have {console.shown}")
        wait_for(lambda: console.shown["link"] == "connected" and console.shown["drive_allowed"], "another link")
        assert console.shown["children"]["control"] != killed
        assert math.dist((stood["pose"]["x_m"], stood["pose"]["y_m"]), (3.0, 4.0)) > 1.0, "it was stopped on its way"
        bench.drive(3)
        console.send_command("release A")
        console.send_command("go 3.0 4.0")
        console.wait_until_shown(goal="active")
        console.send_command("stop")
        wait_for(lambda: console.shown["goal"] == "cancelled", "and Stop stops the next")


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_a_hundred_stops_and_kills(bench: Bench) -> None:
    outcomes = _suffer(bench, LONG, seed=100, longest_stop_s=6.0)
    print(f"most old velocities read: {max(outcome.old for outcome in outcomes)}")
    print(f"longest time to zero: {max(outcome.zero_after_s for outcome in outcomes):.3f} s")
    _judge(outcomes, ZERO_WITHIN_S)
