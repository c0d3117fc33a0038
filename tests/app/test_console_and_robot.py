"""Whole console with the simulated robot, each in a separate process, observed from outside."""

import json
import os
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from mcap.reader import make_reader

from caris_desktop.robot.control_link import ZERO_AGAIN_S
from tests.support.console_process import ConsoleProcess
from tests.support.leak_checks import share_in_module
from tests.support.polling import wait_for
from tests.support.processes import alive
from tests.support.simulated_robot import SimulatedRobot
from tests.support.twist_listener import TwistListener

pytestmark = pytest.mark.alone

S = 1_000_000_000
LINK_LOST = "The connection to the robot is lost."


@dataclass
class Bench:
    """One robot and one console for all tests; each test continues with the state left by the previous one."""

    robot: SimulatedRobot
    console: ConsoleProcess

    def start_robot_again(self) -> SimulatedRobot:
        """Start a robot at the address of the killed one."""
        self.robot = SimulatedRobot(port=self.robot.port)
        share_in_module(self.robot.pid, self.robot.folder.name)
        return self.robot


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    robot = SimulatedRobot()
    shared = Bench(robot, ConsoleProcess(robot.address, tmp_path_factory.mktemp("console") / "study"))
    yield shared
    shared.console.close()
    shared.robot.kill()


@pytest.fixture
def bench(shared: Bench) -> Bench:
    shared.console.wait_until_shown(link="connected", drive_allowed=True, video="fresh", scan="fresh")
    return shared


@pytest.fixture
def robot(bench: Bench) -> SimulatedRobot:
    return bench.robot


@pytest.fixture
def console(bench: Bench) -> ConsoleProcess:
    return bench.console


def _drive(console: ConsoleProcess, listener: TwistListener) -> None:
    # Turning on the spot: no wall can end it.
    console.hold("A", lambda: [twist for twist in listener.seen if twist.moving], "the robot is driven")


@pytest.mark.long  # people/test_presence tests departures
def test_black_pictures_empty_the_people_panel(robot: SimulatedRobot, console: ConsoleProcess) -> None:
    console.wait_until_shown(perception="ready", timeout_s=90)
    wait_for(lambda: console.shown["people_here"] > 0, "a person is here", timeout_s=60)
    robot.fault("black_camera")
    # The duration depends on the detection time under the present load.
    console.wait_until_shown(people_here=0, timeout_s=20)
    robot.fault("clear")


def test_each_twist_that_the_robot_gets_is_one_recorded_event(robot: SimulatedRobot, console: ConsoleProcess) -> None:
    # A new connection begins with zeros, the last of them after a while.
    connected_ns = next(report["at_ns"] for report in console.history if report["link"] == "connected")
    wait_for(lambda: time.monotonic_ns() - connected_ns > (ZERO_AGAIN_S[-1] + 0.5) * S, "silence on the wire")
    listener = TwistListener(robot.address)
    console.send_command("record")
    console.wait_until_shown(recording="recording")
    for key in ("W", "A", "D", "S"):
        before = len(listener.seen)
        console.send_command(f"press {key}")
        wait_for(lambda: len(listener.seen) > before + 5, f"{key} drives")  # noqa: B023 (called at once)
        console.send_command(f"release {key}")
        wait_for(lambda: not listener.seen[-1].moving, f"{key} released")
    # The zeros continue for half a second; then nothing is sent, and every command is in the file.
    quiet_since = [len(listener.seen), time.monotonic_ns()]

    def quiet() -> bool:
        if len(listener.seen) != quiet_since[0]:
            quiet_since[:] = [len(listener.seen), time.monotonic_ns()]
        return time.monotonic_ns() - quiet_since[1] > 0.6 * S

    wait_for(quiet, "silence after the last zero")
    console.send_command("end_recording")
    folder = Path(console.wait_until_shown(recording="idle")["session"])
    recorded = [
        (message["twist"]["forward_mps"], message["twist"]["turn_radps"])
        for message in _messages(folder, "/event/command_sent")
    ]
    assert recorded == [(twist.forward_mps, twist.turn_radps) for twist in listener.seen]
    assert len(recorded) > 20
    listener.close()


def test_a_stopped_console_stops_the_robot(robot: SimulatedRobot, console: ConsoleProcess) -> None:
    listener = TwistListener(robot.address)
    _drive(console, listener)
    wait_for(lambda: robot.state()["speed_radps"] > 0.2, "the robot turns")
    stopped_ns = time.monotonic_ns()
    os.kill(console.pid, signal.SIGSTOP)
    try:
        # Nothing else would stop it; 0.3 s is the time on an idle computer.
        zero = wait_for(
            lambda: next((twist for twist in listener.seen if twist.at_ns > stopped_ns and not twist.moving), None),
            "zero was sent",
        )
        assert zero is not None and zero.at_ns - stopped_ns < S
        wait_for(lambda: robot.state()["speed_radps"] == 0, "the robot stands still")
    finally:
        os.kill(console.pid, signal.SIGCONT)
    time_of_stop_ns = time.monotonic_ns()
    console.wait_until_shown(drive_allowed=True)
    wait_for(lambda: time.monotonic_ns() - time_of_stop_ns > S, "a second has passed")
    assert not [twist for twist in listener.seen if twist.moving and twist.at_ns > stopped_ns + S]
    listener.close()


def test_a_killed_robot_is_noticed_and_nothing_old_is_sent_when_it_is_back(
    bench: Bench, robot: SimulatedRobot, console: ConsoleProcess
) -> None:
    listener = TwistListener(robot.address)
    _drive(console, listener)
    killed_ns = time.monotonic_ns()
    robot.kill()
    listener.close()
    lost = console.wait_until_shown(link="lost", drive_allowed=False)
    assert lost["at_ns"] - killed_ns < 2.0 * S
    again = bench.start_robot_again()
    back_ns = time.monotonic_ns()
    listener = TwistListener(again.address)
    back = console.wait_until_shown(link="connected")
    assert back["at_ns"] - back_ns < 6.0 * S
    console.wait_until_shown(link="connected", video="fresh", scan="fresh", map="fresh", drive_allowed=True)
    assert not [twist for twist in listener.seen if twist.moving], "a key held from before does not drive"
    console.send_command("release A")
    console.hold("D", lambda: [twist for twist in listener.seen if twist.moving], "a new key press drives")
    assert all(twist.turn_radps <= 0 for twist in listener.seen), "only what was pressed anew"
    console.send_command("release D")
    listener.close()


def test_one_lost_link_raises_one_alarm_that_ends_automatically(
    bench: Bench, robot: SimulatedRobot, console: ConsoleProcess
) -> None:
    raised_before = console.wait_until_shown(link="connected", alarms=[])["alarms_raised"]
    console.send_command("go 1.0 1.0")
    robot.kill()
    console.wait_until_shown(link="lost", alarms=[LINK_LOST])
    # Actions that need the robot are requested nevertheless.
    for line in ("go 1.0 1.0", "photo", "save_map lab", "use wave true"):
        console.send_command(line)
    console.wait_until_shown(link="lost", video="none", alarms=[LINK_LOST])
    bench.start_robot_again()
    console.wait_until_shown(link="connected", video="fresh", scan="fresh", alarms=[])
    assert console.shown["alarms_raised"][len(raised_before) :] == [LINK_LOST]
    assert len(console.shown["problems"]) > 3, "told, all of it, below that one"


def test_a_killed_console_leaves_a_session_that_opens(robot: SimulatedRobot, console: ConsoleProcess) -> None:
    """Last test, as it ends the console."""
    console.send_command("record")
    folder = Path(console.wait_until_shown(recording="recording")["session"])
    console.send_command("press A")
    children = console.shown["children"]
    wait_for(lambda: (folder / "events.mcap").stat().st_size > 20_000, "something is recorded")
    killed_utc_ns = time.time_ns()
    console.kill()
    wait_for(lambda: not alive(children.values()), "the children end with the console", timeout_s=15)
    stamps = []
    with (folder / "events.mcap").open("rb") as stream:
        for _schema, _channel, message in make_reader(stream).iter_messages():
            stamps.append(message.log_time)
    assert killed_utc_ns - max(stamps) < 1.0 * S
    assert json.loads((folder / "session.json").read_text("utf-8"))
    wait_for(lambda: robot.state()["speed_radps"] == 0, "the robot stands still")


def _messages(folder: Path, topic: str) -> list[dict]:
    with (folder / "events.mcap").open("rb") as stream:
        return [json.loads(message.data) for _s, _c, message in make_reader(stream).iter_messages(topics=[topic])]
