"""Latency from a key press in the console's window to a Twist at an independent client, and from release to zero.

For comparison, in the same run and under the same load: a bare Qt key event to a websocket message over the same
simulated robot's relay, alternating with the console's keys. The load is that of a session: video, people recognition,
recording, and a language model that streams continuously; and, optionally, foreign programs that use every core. Those
may also delay the simulated robot and its client, by a tenth of a second at worst, unlike a real robot:
``--robot-elsewhere`` excludes this. Prints one JSON object; for several runs also the median of each percentile.
"""

import argparse
import json
import os
import random
import statistics
import subprocess
import sys
import time
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from caris_desktop.domain.events import CommandSent
from tests.benchmarks.bare_qt_key_to_websocket import TOPIC as FLOOR_TOPIC
from tests.benchmarks.burners import Burners
from tests.benchmarks.console_under_load import ConsoleUnderLoad, stop_process
from tests.benchmarks.screen_and_statistics import above, on_a_screen, percentiles

P95_ABOVE_FLOOR_MS = 5.0
P99_ABOVE_FLOOR_MS = 10.0
P95_ABSOLUTE_MS = 8.0
P99_ABSOLUTE_MS = 15.0


def start_program(*words: str) -> "subprocess.Popen[str]":
    process = subprocess.Popen([sys.executable, "-m", *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    if process.stdout is None or "ready" not in process.stdout.readline():
        sys.exit(f"{words[0]} did not start")
    return process


def moving(message: dict[str, dict[str, float]]) -> bool:
    return any(message["linear"].values()) or any(message["angular"].values())


def _run_only_when_idle(pid: int) -> None:
    """Give every thread of a process the lowest scheduling class."""
    for thread in Path(f"/proc/{pid}/task").iterdir():
        os.sched_setscheduler(int(thread.name), os.SCHED_IDLE, os.sched_param(0))


def _run_at_once(pid: int) -> None:
    """Give every thread of a process real-time priority, as if on a separate computer."""
    for thread in Path(f"/proc/{pid}/task").iterdir():
        os.sched_setscheduler(int(thread.name), os.SCHED_RR, os.sched_param(1))


def measure(
    presses: int,
    *,
    language_model: bool,
    idle_perception: bool,
    burners: int,
    cameras: list[str] | None,
    robot_elsewhere: bool = False,
) -> dict[str, object]:
    load = ConsoleUnderLoad(language_model=language_model, cameras=cameras)
    if idle_perception:
        _run_only_when_idle(load.console.child_pids["inference"])
    chance = random.Random(2)  # noqa: S311 (intervals, not secrets)
    listener = start_program(
        "tests.benchmarks.rosbridge_listener",
        load.address,
        "/cmd_vel=geometry_msgs/Twist",
        f"{FLOOR_TOPIC}=std_msgs/String",
    )
    floor = start_program("tests.benchmarks.bare_qt_key_to_websocket", load.address)
    if robot_elsewhere:
        robot = load.run.demo_robot
        for pid in (listener.pid, None if robot is None else robot.process.processId()):
            if pid is not None:
                _run_at_once(pid)
    sent: list[CommandSent] = []
    load.state.event_happened.connect(lambda event: sent.append(event) if isinstance(event, CommandSent) else None)
    foreign = Burners(burners)
    pad = load.focus_driving()
    pressed_ns: list[int] = []
    released_ns: list[int] = []
    handled_ms: list[float] = []

    def press_floor() -> None:
        if floor.stdin is not None:
            floor.stdin.write("\n")
            floor.stdin.flush()

    # Left and right alternate, so that the robot stays in place.
    for number in range(presses):
        key = Qt.Key.Key_A if number % 2 else Qt.Key.Key_D
        pressed_ns.append(time.monotonic_ns())
        QTest.keyPress(pad, key)
        handled_ms.append((time.monotonic_ns() - pressed_ns[-1]) / 1e6)
        load.let_qt_run(chance.uniform(0.06, 0.12))
        press_floor()
        load.let_qt_run(chance.uniform(0.06, 0.12))
        released_ns.append(time.monotonic_ns())
        QTest.keyRelease(pad, key)
        # Zero is repeated for half a second; the next press must not be confused with it.
        load.let_qt_run(chance.uniform(0.07, 0.12))
        press_floor()
        load.let_qt_run(chance.uniform(0.07, 0.12))
    load.let_qt_run(0.3)
    report = load.load()
    foreign.end()
    stop_process(floor)
    lines = [json.loads(line) for line in stop_process(listener).splitlines() if line.startswith("{")]
    load.close()

    ends_ns = [*pressed_ns[1:], released_ns[-1] + 10**9]
    twists = [(line["arrived_ns"], moving(line["msg"])) for line in lines if line["topic"] == "/cmd_vel"]
    at_socket = [(event.stamp_ns, event.twist.moving) for event in sent]
    floors = [(line["arrived_ns"] - int(line["msg"]["data"])) / 1e6 for line in lines if line["topic"] == FLOOR_TOPIC]
    to_twist = first_after(pressed_ns, released_ns, twists, moves=True)
    to_zero = first_after(released_ns, ends_ns, twists, moves=False)
    return {
        "benchmark": "teleop_latency",
        "key_to_twist_ms": percentiles(to_twist),
        "release_to_zero_ms": percentiles(to_zero),
        "floor_ms": percentiles(floors),
        "key_above_floor_ms": above(to_twist, floors),
        "release_above_floor_ms": above(to_zero, floors),
        "aims_ms": {
            "p95_above_floor": P95_ABOVE_FLOOR_MS,
            "p99_above_floor": P99_ABOVE_FLOOR_MS,
            "p95": P95_ABSOLUTE_MS,
            "p99": P99_ABSOLUTE_MS,
        },
        "parts_ms": {
            "key_event_in_the_window": percentiles(handled_ms),
            "key_to_socket": percentiles(first_after(pressed_ns, released_ns, at_socket, moves=True)),
            "release_to_socket": percentiles(first_after(released_ns, ends_ns, at_socket, moves=False)),
        },
        "burners": burners,
        "robot_elsewhere": robot_elsewhere,
        "presses": presses,
        "presses_without_twist": presses - len(to_twist),
        "releases_without_zero": presses - len(to_zero),
        "load": report,
    }


def medians(runs: list[dict[str, object]]) -> dict[str, dict[str, float]]:
    """Median over the runs of each value above the lower bound."""
    found: dict[str, dict[str, float]] = {}
    for name in ("key_above_floor_ms", "release_above_floor_ms"):
        figures = [run[name] for run in runs]
        assert all(isinstance(each, dict) for each in figures)
        found[name] = {
            at: round(statistics.median(each[at] for each in figures if isinstance(each, dict)), 3)
            for at in ("p50", "p95", "p99")
        }
    return found


def first_after(
    begins_ns: list[int], ends_ns: list[int], twists: list[tuple[int, bool]], *, moves: bool
) -> list[float]:
    """Milliseconds from each begin to the first matching Twist before the end."""
    delays = []
    for begin_ns, end_ns in zip(begins_ns, ends_ns, strict=True):
        found = next((at for at, is_moving in twists if begin_ns <= at < end_ns and is_moving is moves), None)
        if found is not None:
            delays.append((found - begin_ns) / 1e6)
    return delays


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presses", type=int, default=500)
    parser.add_argument("--no-language-model", action="store_true")
    parser.add_argument("--idle-perception", action="store_true", help="try what a still lower priority of it gives")
    parser.add_argument("--burners", type=int, default=0, help="foreign programs that burn a core each")
    parser.add_argument(
        "--robot-elsewhere",
        action="store_true",
        help="the simulated robot and who listens to it get the processor first: what is measured is the console alone",
    )
    parser.add_argument("--runs", type=int, default=1, help="how often all of it, each time in a console of its own")
    parser.add_argument(
        "--camera", action="append", metavar="SOURCE", help="as that of the console; may be given several times"
    )
    arguments = parser.parse_args()
    on_a_screen()
    reports = [
        measure(
            arguments.presses,
            language_model=not arguments.no_language_model,
            idle_perception=arguments.idle_perception,
            burners=arguments.burners,
            cameras=arguments.camera,
            robot_elsewhere=arguments.robot_elsewhere,
        )
        for _ in range(arguments.runs)
    ]
    if arguments.runs == 1:
        print(json.dumps(reports[0]))
    else:
        print(json.dumps({"benchmark": "teleop_latency", "median": medians(reports), "runs": reports}))
