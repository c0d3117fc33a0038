"""Stops, emergency stops and key releases at random times in all robot states, through the real console.

Assertions on the robot's own log: after the key, or the return of the bridge, the last velocity is zero within 0.2 s,
at most four older velocities are executed, and the emergency stop is called as soon. The displayed state never
contradicts the odometry.
"""

import json
import math
import os
import random
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Protocol

import pytest

from caris_desktop.domain.control_definitions import CallService, RobotControl, SendActionGoal
from caris_desktop.robot.profile import load_profile, save_profile
from caris_desktop.robot.unread import MOST_UNREAD
from tests.app.test_bad_input import HIDE_OFFLINE_DETECTOR
from tests.support.console_process import ConsoleProcess
from tests.support.native_robot import NativeRobot, RustBridge, bridges_below, needs_rclpy, wait_for_bridge
from tests.support.polling import wait_for
from tests.support.simulated_robot import RosbridgeClient, SimulatedRobot

pytestmark = pytest.mark.alone

MS = 1_000_000
SITUATIONS = ("goal", "refused", "never", "slow", "say", "plain", "frozen", "killed")
ACTS = ("stop", "estop", "release")
WITHIN_MS, SHOWN_WRONG_MS = 200, 300


@dataclass(frozen=True, slots=True)
class Obeyed:
    """Executed velocity, or emergency stop if ``moving`` is None."""

    at_ns: int
    moving: bool | None


class Robot(Protocol):
    """Robot of the trials, whose bridge may be stopped and killed."""

    targets: dict[str, str]
    """Command of the console process for each situation."""
    discovery_ms: float

    def begins(self, console_pid: int) -> None:
        """The console runs."""

    @property
    def bridge_pid(self) -> int: ...

    def obeyed(self) -> list[Obeyed]:
        """All executed commands so far."""

    def make_ready(self) -> None:
        """Prepare the robot for a round."""

    def restart_bridge(self) -> None:
        """Restart the bridge after a kill."""

    def came_back_ns(self, since_ns: int) -> int | None:
        """Time of the first client connection since then, or of the first command where that is unknown."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a round; times count from the key, or the return of the bridge, in milliseconds."""

    number: int
    situation: str
    act: str
    drove: bool
    zero_ms: float | None = None
    old: int = 0
    estop_ms: float | None = None
    shown_wrong: list[dict[str, Any]] = field(default_factory=list)

    def misses(self, within_ms: float, shown_wrong_ms: float, discovery_ms: float) -> bool:
        """``discovery_ms``: how much later a restarted bridge may reach one part of the robot than another."""
        if self.situation == "killed":
            within_ms += discovery_ms
        expects_zero = self.drove or self.act != "release"
        return (
            (expects_zero and (self.zero_ms is None or self.zero_ms > within_ms))
            or self.old > MOST_UNREAD
            or (self.act == "estop" and (self.estop_ms is None or self.estop_ms > within_ms))
            or any(wrong["lasted_ms"] > shown_wrong_ms for wrong in self.shown_wrong)
        )


class Rounds:
    """Console of a wizard and one robot."""

    def __init__(self, robot: Robot, profile: Path, folder: Path, *, seed: int) -> None:
        self.robot = robot
        self._chance = random.Random(seed)  # noqa: S311 (moments, not secrets)
        # Without person detection, which would slow down all else.
        (folder / "sitecustomize.py").write_text(HIDE_OFFLINE_DETECTOR, "utf-8")
        environment = {name: str(folder / name) for name in ("XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_STATE_HOME")}
        environment["PYTHONPATH"] = f"{folder}{os.pathsep}{Path(__file__).parents[2]}"
        environment |= {"CARIS_MODELS_DIR": str(folder / "models"), "YOLO_OFFLINE": "1"}
        self.console = ConsoleProcess(profile, folder / "study", module="tests.robot.stops_child", **environment)
        self.console.wait_until_shown(timeout_s=120.0, link="connected")
        robot.begins(self.console.pid)

    def _pass(self, seconds: float) -> None:
        until_s = time.monotonic() + seconds
        wait_for(lambda: time.monotonic() >= until_s, "a moment")

    def round(self, number: int, situation: str, act: str) -> Outcome:
        self._release()
        self.robot.make_ready()
        wrong = len(self.console.shown["contradictions"])
        if situation in self.robot.targets:
            self.console.send_command(self.robot.targets[situation])
        self._pass(self._chance.uniform(0.05, 0.8))
        drove = act == "release" or situation in ("plain", "frozen", "killed") or self._chance.random() < 0.5
        if drove:
            self._drive()
            self._pass(self._chance.uniform(0.0, 0.6))
        before = len(self.robot.obeyed())
        if situation == "frozen":
            os.kill(self.robot.bridge_pid, signal.SIGSTOP)
            self._pass(self._chance.uniform(0.0, 0.4))
        elif situation == "killed":
            os.kill(self.robot.bridge_pid, signal.SIGKILL)
        acts = self.console.shown["acted"][0]
        self.console.send_command(f"act {act} A")
        wait_for(lambda: self.console.shown["acted"][0] > acts, "the key")
        from_ns: int = self.console.shown["acted"][1]
        if situation == "frozen":
            self._pass(self._chance.choice([0.1, 0.4, 1.5, 3.0]))
            from_ns = time.monotonic_ns()
            os.kill(self.robot.bridge_pid, signal.SIGCONT)
        elif situation == "killed":
            from_ns = time.monotonic_ns()
            self.robot.restart_bridge()
            started_ns = from_ns
            from_ns = wait_for(lambda: self.robot.came_back_ns(started_ns), "it is back") or 0
        outcome = self._judge(Outcome(number, situation, act, drove), before, from_ns)
        self.console.send_command("release A")
        self.console.send_command("act stop")
        wait_for(lambda: not self.console.shown["contradicts"], "what is on show agrees with the odometry")
        return replace(outcome, shown_wrong=self.console.shown["contradictions"][wrong:])

    def _release(self) -> None:
        """Release the emergency stop until driving is possible; repeat a release lost with an overloaded link."""

        def released() -> bool:
            self.console.send_command("clear")
            self._pass(0.2)
            shown = self.console.shown
            return shown["link"] == "connected" and shown["drive_allowed"] and not shown["held"]

        wait_for(released, "the emergency stop is released", timeout_s=60.0)

    def _drive(self) -> None:
        """Drive until the robot moves; a busy machine may stall the window, which ends a drive."""
        for _attempt in range(10):
            before = len(self.robot.obeyed())
            self.console.send_command("press A")
            try:
                wait_for(lambda: any(each.moving for each in self.robot.obeyed()[before:]), "a drive", timeout_s=3.0)  # noqa: B023
            except AssertionError:
                self.console.send_command("release A")
            else:
                return
            self._release()
        raise AssertionError(f"it never drove; last: {self.console.shown}")

    def _judge(self, outcome: Outcome, before: int, from_ns: int) -> Outcome:
        act, drove = outcome.act, outcome.drove
        velocities_before = [each for each in self.robot.obeyed()[:before] if each.moving is not None]
        stood = not (velocities_before and velocities_before[-1].moving)

        def zero_ns() -> int | None:
            """Time of the first zero after the last velocity."""
            velocities = [each for each in self.robot.obeyed()[before:] if each.moving is not None]
            last = max((at for at, each in enumerate(velocities) if each.moving), default=-1)
            if last < 0 and act == "release" and stood:
                return from_ns  # a busy machine had ended the drive
            zeros = [each.at_ns for each in velocities[last + 1 :] if last >= 0 or each.at_ns >= from_ns]
            return zeros[0] if zeros else None

        def estop_ns() -> int | None:
            return next((each.at_ns for each in self.robot.obeyed()[before:] if each.moving is None), None)

        def complete() -> bool:
            return (zero_ns() is not None or (act == "release" and not drove)) and (act != "estop" or bool(estop_ns()))

        limit_s = time.monotonic() + 15.0
        wait_for(lambda: complete() or time.monotonic() > limit_s, "zero, and the emergency stop")
        # Late commands would have arrived by now.
        self._pass(0.7)
        zero, estop = zero_ns(), estop_ns()
        old = sum(bool(each.moving) and each.at_ns >= from_ns for each in self.robot.obeyed()[before:])
        return replace(
            outcome,
            zero_ms=None if zero is None else max(0.0, round((zero - from_ns) / MS, 1)),
            old=old,
            estop_ms=None if estop is None else max(0.0, round((estop - from_ns) / MS, 1)),
        )

    def run(self, count: int) -> list[Outcome]:
        situations = [SITUATIONS[number % len(SITUATIONS)] for number in range(count)]
        self._chance.shuffle(situations)
        outcomes = []
        for number, situation in enumerate(situations):
            outcomes.append(self.round(number, situation, self._chance.choice(ACTS)))
            print(outcomes[-1], flush=True)
        return outcomes


class Simulated:
    """Simulated robot with the operation queue of its rosbridge version; another client offers a service that hangs."""

    targets: ClassVar = {
        "goal": "go 3.0 4.0", "refused": "go -50 -50", "never": "use never true", "slow": "use slow true",
        "say": "speak Hello, and welcome to our laboratory",
    }  # fmt: skip
    discovery_ms = 0.0

    def __init__(self, ros: int, folder: Path) -> None:
        self._log = folder / "obeyed.jsonl"
        (folder / "maps").mkdir()
        self._arguments = ("--empty", "--obeyed-log", str(self._log), "--maps-folder", str(folder / "maps"))
        self._ros = ros
        self._robot = SimulatedRobot(*self._arguments, ros=ros)
        self._position = 0
        self._obeyed: list[Obeyed] = []
        self._let_in_ns: list[int] = []
        self._hangs: RosbridgeClient | None = None
        profile = load_profile("simulated-ros2" if ros == 2 else "simulated")
        trigger, fibonacci = "std_srvs/Trigger", "example_interfaces/Fibonacci"
        controls = (
            RobotControl("slow", "Slow", "button", CallService("/slow", trigger, {})),
            RobotControl("never", "Never", "button", SendActionGoal("/nobody", fibonacci, {"order": 1})),
        )
        save_profile(replace(profile, address=self._robot.address, controls=controls), folder / "robot.yaml")

    def begins(self, console_pid: int) -> None: ...

    @property
    def bridge_pid(self) -> int:
        return self._robot.pid

    def make_ready(self) -> None:
        self._robot.call("/simulator/reset_pose", x=9.0, y=5.0, heading_deg=0.0)
        if self._hangs is None or self._hangs.closed:
            self._hangs = RosbridgeClient(self._robot.address)
            kind = "std_srvs/srv/Trigger" if self._ros == 2 else "std_srvs/Trigger"
            self._hangs.send(op="advertise_service", service="/slow", type=kind)

    def restart_bridge(self) -> None:
        self._robot.kill()
        if self._hangs is not None:
            self._hangs.close()
        self._robot = SimulatedRobot(*self._arguments, ros=self._ros, port=self._robot.port)

    def came_back_ns(self, since_ns: int) -> int | None:
        self.obeyed()
        return next((at_ns for at_ns in self._let_in_ns if at_ns >= since_ns), None)

    def obeyed(self) -> list[Obeyed]:
        if not self._log.exists():
            return []
        with self._log.open("rb") as stream:
            stream.seek(self._position)
            for raw in stream:
                if not raw.endswith(b"\n"):
                    break
                self._position += len(raw)
                line = json.loads(raw)
                if line.get("topic") == "/cmd_vel":
                    linear, angular = line["message"]["linear"], line["message"]["angular"]
                    self._obeyed.append(Obeyed(line["at_ns"], any((linear["x"], linear["y"], angular["z"]))))
                elif line.get("service") == "/emergency_stop/set" and line["request"]["data"]:
                    self._obeyed.append(Obeyed(line["at_ns"], None))
                elif "connected" in line:
                    self._let_in_ns.append(line["at_ns"])
        return self._obeyed

    def close(self) -> None:
        os.kill(self._robot.pid, signal.SIGCONT)
        if self._hangs is not None:
            self._hangs.close()
        self._robot.kill()


class Native:
    """Robot on the real rclpy, reached without rosbridge: the bridge is a process of the console's own link."""

    targets: ClassVar = {
        "goal": "use goal true", "refused": "use refused true", "never": "use never true", "slow": "use slow true",
        "say": "speak Hello, and welcome to our laboratory",
    }  # fmt: skip
    # A DDS participant announces itself every three seconds.
    discovery_ms = 3_200.0

    def __init__(self, folder: Path) -> None:
        self._robot = NativeRobot(folder)
        self._console_pid = self._restarted_ns = 0
        self._bridges: list[int] = []
        save_profile(self._robot.profile(), folder / "robot.yaml")

    def begins(self, console_pid: int) -> None:
        self._console_pid = console_pid

    @property
    def bridge_pid(self) -> int:
        return wait_for_bridge(self._console_pid)

    def make_ready(self) -> None:
        wait_for(lambda: self._robot.goals == 0, "every goal was cancelled")
        self._bridges = bridges_below(self._console_pid)

    def restart_bridge(self) -> None:
        """Wait until the link has restarted it: commands of the killed one may arrive after its end."""

        def restarted() -> bool:
            bridges = bridges_below(self._console_pid)
            return len(bridges) == len(self._bridges) and bridges != self._bridges

        wait_for(restarted, "another bridge", timeout_s=60.0)
        self._restarted_ns = time.monotonic_ns()

    def came_back_ns(self, _since_ns: int) -> int | None:
        return next((each.at_ns for each in self.obeyed() if each.at_ns >= self._restarted_ns), None)

    def obeyed(self) -> list[Obeyed]:
        lines = [line for line in self._robot.lines() if "velocity" in line or line.get("stop")]
        return [Obeyed(line["at_ns"], any(line["velocity"]) if "velocity" in line else None) for line in lines]

    def close(self) -> None:
        self._robot.close()


class Bridged(Native):
    """The same robot through rosbridge-server-rs, which does not queue and has no rosapi."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self._bridge = RustBridge(folder, self._robot.domain)
        profile = replace(self._robot.profile(), address=f"ws://127.0.0.1:{self._bridge.port}")
        save_profile(profile, folder / "robot.yaml")

    @property
    def bridge_pid(self) -> int:
        return self._bridge.pid

    def make_ready(self) -> None:
        wait_for(lambda: self._robot.goals == 0, "every goal was cancelled")

    def restart_bridge(self) -> None:
        self._bridge.kill()
        self._bridge.start()
        self._restarted_ns = time.monotonic_ns()

    def close(self) -> None:
        self._bridge.close()
        super().close()


# Both with --long; app/test_stops_and_kills covers the other one in each run.
@pytest.fixture(
    params=[
        pytest.param(1, marks=pytest.mark.long), 2,
        pytest.param(Native, marks=needs_rclpy), pytest.param(Bridged, marks=needs_rclpy),
    ],
    ids=["ROS 1", "ROS 2", "native ROS 2", "rosbridge-server-rs"],
)  # fmt: skip
def rounds(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Rounds]:
    simulated = isinstance(request.param, int)
    robot = Simulated(request.param, tmp_path) if simulated else request.param(tmp_path)
    rounds = Rounds(robot, tmp_path / "robot.yaml", tmp_path, seed=25 + request.param if simulated else 28)
    yield rounds
    rounds.console.close()
    robot.close()


def test_a_stop_at_any_moment_is_the_last_word(rounds: Rounds) -> None:
    """Without time limits, which a busy machine may exceed."""
    outcomes = rounds.run(len(SITUATIONS))
    assert not [outcome for outcome in outcomes if outcome.misses(math.inf, math.inf, math.inf)]


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_a_hundred_and_fifty_stops(rounds: Rounds) -> None:
    outcomes = rounds.run(150)
    assert not [outcome for outcome in outcomes if outcome.misses(WITHIN_MS, SHOWN_WRONG_MS, rounds.robot.discovery_ms)]
