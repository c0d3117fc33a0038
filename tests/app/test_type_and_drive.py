"""Typing, speaking and driving at the same time, with real keys in a real window."""

import json
import math
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from caris_desktop.domain.geometry import Pose2D, wrap_angle
from tests.support.polling import wait_for
from tests.support.simulated_robot import RosbridgeClient, SimulatedRobot
from tests.support.virtual_desktop import MISSING_TOOLS, VirtualDesktop

pytestmark = [
    pytest.mark.alone,
    pytest.mark.skipif(bool(MISSING_TOOLS), reason=f"needs {', '.join(MISSING_TOOLS)}"),
]

# 200 characters with every drive letter many times, and with capitals, digits and punctuation.
TEXT = (
    "We saw a wasp; was it a sad one? Add water & wait: 2 swords, 4 wads, 8 seeds, 6 dads! "
    "Q: who eases Zack's head? A: Ada does, as always. I joke, OK, look ahead... Kill cars? "
    "No, cows saw wax! Was it 1?"
)
SIDE_M = 0.3


class Tour:
    """Console on its screen, robot, and a driver who sees its position."""

    def __init__(self, robot: SimulatedRobot, desktop: VirtualDesktop) -> None:
        self.desktop = desktop
        self._odometry = RosbridgeClient(robot.address)
        self._odometry.subscribe("/odom")
        self._read = 0
        wait_for(lambda: self._odometry.received, "the robot tells where it is")

    def close(self) -> None:
        self._odometry.close()

    def _newest(self) -> Any:
        return next(item for item in reversed(self._odometry.received) if isinstance(item, dict) and "msg" in item)[
            "msg"
        ]

    def pose(self) -> Pose2D:
        pose = self._newest()["pose"]["pose"]
        turn = pose["orientation"]
        return Pose2D(pose["position"]["x"], pose["position"]["y"], 2.0 * math.atan2(turn["z"], turn["w"]))

    def standing(self) -> bool:
        twist = self._newest()["twist"]["twist"]
        return abs(twist["linear"]["x"]) < 0.005 and abs(twist["angular"]["z"]) < 0.01

    def hold_until(self, hold: Callable[[bool], None], done: Callable[[], bool], what: str) -> None:
        """Hold until ``done``, release, and wait until the robot stands.

        Presses again when the drive ends, as a machine too busy for the motion lease causes.
        """
        pressed_s = 0.0

        def step() -> bool:
            nonlocal pressed_s
            if done():
                return True
            if self.standing() and time.monotonic() - pressed_s > 0.8:
                hold(False)
                time.sleep(0.05)  # a gamepad must first report its rest position
                hold(True)
                pressed_s = time.monotonic()
            return False

        wait_for(step, what, timeout_s=40.0, every_s=0.004)
        hold(False)
        wait_for(self.standing, "the robot stands still")

    def square(self, *, forward: Callable[[bool], None], left: Callable[[bool], None]) -> tuple[float, float]:
        """Drive a square; returns the distance and the rotation (rad) from the start."""
        start = self.pose()
        for corner in range(1, 5):
            begun = self.pose()
            # It moves on for a moment: command latency and braking.
            self.hold_until(forward, lambda: _distance(begun, self.pose()) > SIDE_M - 0.06, "one side")  # noqa: B023
            target_rad = start.heading_rad + corner * math.pi / 2
            self.hold_until(left, lambda: wrap_angle(target_rad - self.pose().heading_rad) < 0.1, "one corner")  # noqa: B023
        end = self.pose()
        return _distance(start, end), abs(wrap_angle(end.heading_rad - start.heading_rad))

    def report(self) -> dict[str, Any]:
        """Last displayed state."""
        return next((json.loads(line) for line in reversed(self.desktop.lines()) if line.startswith("{")), {})

    def start_typing(self) -> "subprocess.Popen[bytes]":
        return subprocess.Popen(["xdotool", "type", "--delay", "35", TEXT], env=self.desktop.environment)

    def say_typed(self) -> None:
        self.desktop.do("key", "Return")

    def recorded(self, start: Callable[[], None]) -> Path:
        """Session folder of a recording of ``start``."""
        self.desktop.send_command("record")
        wait_for(lambda: self.report().get("recording") == "recording", "recording")
        start()
        folder = Path(self.report()["session"])
        self.desktop.send_command("end_recording")
        wait_for(lambda: self.report().get("recording") == "idle", "recorded")
        return folder


def _distance(first: Pose2D, second: Pose2D) -> float:
    return math.hypot(second.x_m - first.x_m, second.y_m - first.y_m)


@pytest.fixture(scope="module")
def tour(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tour]:
    folder = tmp_path_factory.mktemp("tour")
    with SimulatedRobot("--empty") as robot:
        desktop = VirtualDesktop(
            folder, "tests.app.desktop_child", robot.address, str(folder / "study"), size="1366x768"
        )
        tour = None
        try:
            desktop.wait_for("{", timeout_s=60)
            tour = Tour(robot, desktop)
            expected = {"link": "connected", "drive_allowed": True, "video": "fresh", "scan": "fresh"}
            wait_for(lambda: expected.items() <= tour.report().items(), "the console is ready", timeout_s=60)
            desktop.wait_for("KEYS driving")
            desktop.do("key", "e")  # the highest of the three speeds
            yield tour
        finally:
            if tour is not None:
                tour.close()
            desktop.close()


def _typing_and_driving(tour: Tour, *, forward: Callable[[bool], None], left: Callable[[bool], None]) -> None:
    """Type and drive at the same time, and check the recording."""
    assert len(TEXT) == 200
    times: dict[str, int] = {}
    closed: list[tuple[float, float]] = []

    def both() -> None:
        times["typing"] = time.monotonic_ns()
        typing = tour.start_typing()
        closed.append(tour.square(forward=forward, left=left))
        assert typing.wait(timeout=60) == 0
        seen = len(tour.desktop.lines())
        tour.desktop.wait_for(f"TEXT {TEXT}")
        tour.say_typed()
        tour.desktop.wait_for("TEXT", after=seen)

    folder = tour.recorded(both)
    gap_m, turned_rad = closed[0]
    assert gap_m < 0.12, "the square closes"
    assert turned_rad < math.radians(8)
    commands, utterances = [], []
    with (folder / "events.mcap").open("rb") as stream:
        for _schema, channel, message in make_reader(stream).iter_messages():
            if channel.topic == "/event/command_sent":
                commands.append(json.loads(message.data))
            elif channel.topic == "/event/utterance_changed":
                utterances.append(json.loads(message.data))
    typed = next(event for event in utterances if event["origin"] == "typed" and event["state"] == "requested")
    assert typed["text"] == TEXT, "every character, and no other"
    moving = [command for command in commands if any(command["twist"].values())]
    while_typing = [c for c in moving if times["typing"] < c["stamp_ns"] < typed["stamp_ns"]]
    assert len(while_typing) > 40, "commands and utterance on one clock"
    assert {bool(command["twist"]["turn_radps"]) for command in while_typing} == {True, False}


@pytest.mark.long
def test_by_keypad(tour: Tour) -> None:
    tour.desktop.do("key", "ctrl+l")
    tour.desktop.wait_for("KEYS typing")

    def holder(key: str) -> Callable[[bool], None]:
        return lambda down: tour.desktop.do("keydown" if down else "keyup", key)

    _typing_and_driving(tour, forward=holder("KP_Up"), left=holder("KP_Left"))


@pytest.mark.long  # ui/test_desktop and test_safety cover gamepads, too
def test_by_gamepad(tour: Tour) -> None:
    tour.desktop.send_command("plug")
    tour.desktop.wait_for("GAMEPAD Virtual Controller")
    tour.desktop.send_command("pad 5 1.0")  # the right trigger: full speed
    tour.desktop.do("key", "ctrl+l")
    tour.desktop.wait_for("KEYS typing")

    def pusher(axis: int) -> Callable[[bool], None]:
        return lambda down: tour.desktop.send_command(f"pad {axis} {-1.0 if down else 0.0}")

    _typing_and_driving(tour, forward=pusher(1), left=pusher(0))
    tour.desktop.send_command("unplug")
