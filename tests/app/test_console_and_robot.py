"""The whole console against the simulated robot, each in its own process, watched from outside."""

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader

from caris_desktop.robot.control_link import ZERO_AGAIN_S
from tests.support.console_process import ConsoleProcess
from tests.support.polling import wait_for
from tests.support.processes import alive
from tests.support.simulated_robot import SimulatedRobot
from tests.support.twist_listener import TwistListener

pytestmark = pytest.mark.alone

S = 1_000_000_000


@pytest.fixture
def robot() -> Iterator[SimulatedRobot]:
    with SimulatedRobot() as robot:
        yield robot


@pytest.fixture
def console(robot: SimulatedRobot, tmp_path: Path) -> Iterator[ConsoleProcess]:
    console = ConsoleProcess(robot.address, tmp_path / "study")
    console.wait_until_shown(link="connected", drive_allowed=True, video="fresh", scan="fresh")
    yield console
    console.close()


def _drive(console: ConsoleProcess, listener: TwistListener) -> None:
    # Turning on the spot: no wall can end it.
    console.hold("A", lambda: [twist for twist in listener.seen if twist.moving], "the robot is driven")


def test_a_killed_robot_is_noticed_and_nothing_old_is_sent_when_it_is_back(
    robot: SimulatedRobot, console: ConsoleProcess
) -> None:
    listener = TwistListener(robot.address)
    _drive(console, listener)
    killed_ns = time.monotonic_ns()
    robot.kill()
    listener.close()
    lost = console.wait_until_shown(link="lost", drive_allowed=False)
    assert lost["at_ns"] - killed_ns < 1.0 * S
    with SimulatedRobot(port=robot.port) as again:
        back_ns = time.monotonic_ns()
        listener = TwistListener(again.address)
        back = console.wait_until_shown(link="connected")
        assert back["at_ns"] - back_ns < 3.0 * S
        console.wait_until_shown(link="connected", video="fresh", scan="fresh", map="fresh", drive_allowed=True)
        assert not [twist for twist in listener.seen if twist.moving], "a key held from before does not drive"
        console.say("release A")
        console.hold("D", lambda: [twist for twist in listener.seen if twist.moving], "a new key press drives")
        assert all(twist.turn_radps <= 0 for twist in listener.seen), "only what was pressed anew"
        console.say("release D")
        listener.close()


def test_a_stopped_console_stops_the_robot(robot: SimulatedRobot, console: ConsoleProcess) -> None:
    listener = TwistListener(robot.address)
    _drive(console, listener)
    wait_for(lambda: robot.state()["speed_radps"] > 0.2, "the robot turns")
    stopped_ns = time.monotonic_ns()
    os.kill(console.pid, signal.SIGSTOP)
    try:
        wait_for(lambda: listener.seen[-1].moving is False, "zero was sent", timeout_s=1.0)
        assert listener.seen[-1].at_ns - stopped_ns < 0.3 * S
        stood_ns = wait_for(
            lambda: time.monotonic_ns() if robot.state()["speed_radps"] == 0 else 0, "the robot stands", timeout_s=1.0
        )
        assert stood_ns - stopped_ns < 0.3 * S + 0.1 * S, "0.3 s, and what it takes to ask"
    finally:
        os.kill(console.pid, signal.SIGCONT)
    time_of_stop_ns = time.monotonic_ns()
    console.wait_until_shown(drive_allowed=True)
    wait_for(lambda: time.monotonic_ns() - time_of_stop_ns > S, "a second has passed")
    assert not [twist for twist in listener.seen if twist.moving and twist.at_ns > stopped_ns + S // 2]
    listener.close()


def test_each_twist_that_the_robot_gets_is_one_recorded_event(robot: SimulatedRobot, console: ConsoleProcess) -> None:
    # A new connection begins with zeros, the last of them a while later.
    connected_ns = next(report["at_ns"] for report in console.history if report["link"] == "connected")
    wait_for(lambda: time.monotonic_ns() - connected_ns > (ZERO_AGAIN_S[-1] + 0.5) * S, "silence on the wire")
    listener = TwistListener(robot.address)
    console.say("record")
    console.wait_until_shown(recording="recording")
    for key in ("W", "A", "D", "S"):
        before = len(listener.seen)
        console.say(f"press {key}")
        wait_for(lambda: len(listener.seen) > before + 5, f"{key} drives")  # noqa: B023 (called at once)
        console.say(f"release {key}")
        wait_for(lambda: not listener.seen[-1].moving, f"{key} released")
    # The zeros go on for half a second; then there is silence, and every command is in the file.
    quiet_since = [len(listener.seen), time.monotonic_ns()]

    def quiet() -> bool:
        if len(listener.seen) != quiet_since[0]:
            quiet_since[:] = [len(listener.seen), time.monotonic_ns()]
        return time.monotonic_ns() - quiet_since[1] > 0.6 * S

    wait_for(quiet, "silence after the last zero")
    console.say("end_recording")
    folder = Path(console.wait_until_shown(recording="idle")["session"])
    recorded = [
        (message["twist"]["forward_mps"], message["twist"]["turn_radps"])
        for message in _messages(folder, "/event/command_sent")
    ]
    assert recorded == [(twist.forward_mps, twist.turn_radps) for twist in listener.seen]
    assert len(recorded) > 20
    listener.close()


def test_a_killed_console_leaves_a_session_that_opens(robot: SimulatedRobot, console: ConsoleProcess) -> None:
    console.say("record")
    folder = Path(console.wait_until_shown(recording="recording")["session"])
    console.say("press A")
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
    wait_for(lambda: robot.state()["speed_radps"] == 0, "the robot stands")


def test_black_pictures_empty_the_people_panel(robot: SimulatedRobot, console: ConsoleProcess) -> None:
    console.wait_until_shown(perception="ready", timeout_s=90)
    wait_for(lambda: console.shown["people_here"] > 0, "a person is here", timeout_s=60)
    robot.fault("black_camera")
    # How soon depends on how long one look takes beside whatever else the machine does.
    console.wait_until_shown(people_here=0, timeout_s=20)


def _messages(folder: Path, topic: str) -> list[dict]:
    with (folder / "events.mcap").open("rb") as stream:
        return [json.loads(message.data) for _s, _c, message in make_reader(stream).iter_messages(topics=[topic])]
