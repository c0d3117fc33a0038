"""Key press in the console's window to Twist at an independent client, and key release to zero Twist.

Beside it, in the same run and under the same load, the floor: a bare Qt key event to a websocket message over the
same simulated robot's relay. Prints one JSON object.
"""

import argparse
import json
import random
import subprocess
import sys
import time

from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from tests.benchmarks.bare_qt_key_to_websocket import TOPIC as FLOOR_TOPIC
from tests.benchmarks.console_under_load import ConsoleUnderLoad, stop_process
from tests.benchmarks.screen_and_statistics import on_a_screen, percentiles


def _start(*words: str) -> "subprocess.Popen[str]":
    process = subprocess.Popen([sys.executable, "-m", *words], stdout=subprocess.PIPE, text=True)
    if process.stdout is None or "ready" not in process.stdout.readline():
        sys.exit(f"{words[0]} did not start")
    return process


def _moving(message: dict[str, dict[str, float]]) -> bool:
    return any(message["linear"].values()) or any(message["angular"].values())


def measure(presses: int) -> dict[str, object]:
    load = ConsoleUnderLoad()
    chance = random.Random(2)  # noqa: S311 (intervals, not secrets)
    listener = _start(
        "tests.benchmarks.rosbridge_listener",
        load.address,
        "/cmd_vel=geometry_msgs/Twist",
        f"{FLOOR_TOPIC}=std_msgs/String",
    )
    floor = _start("tests.benchmarks.bare_qt_key_to_websocket", load.address)
    pad = load.focus_driving()
    pressed_ns: list[int] = []
    released_ns: list[int] = []
    # Left and right in turn, so that the robot stays where it is.
    for number in range(presses):
        key = Qt.Key.Key_A if number % 2 else Qt.Key.Key_D
        pressed_ns.append(time.monotonic_ns())
        QTest.keyPress(pad, key)
        load.let_qt_run(chance.uniform(0.12, 0.25))
        released_ns.append(time.monotonic_ns())
        QTest.keyRelease(pad, key)
        # The zero is repeated for half a second; the next press must not be mistaken for it.
        load.let_qt_run(chance.uniform(0.15, 0.25))
    load.let_qt_run(0.3)
    report = load.load()
    stop_process(floor)
    lines = [json.loads(line) for line in stop_process(listener).splitlines() if line.startswith("{")]
    load.close()

    twists = [(line["arrived_ns"], _moving(line["msg"])) for line in lines if line["topic"] == "/cmd_vel"]
    floors = [(line["arrived_ns"] - int(line["msg"]["data"])) / 1e6 for line in lines if line["topic"] == FLOOR_TOPIC]
    to_twist = _first_after(pressed_ns, released_ns, twists, moving=True)
    to_zero = _first_after(released_ns, [*pressed_ns[1:], released_ns[-1] + 10**9], twists, moving=False)
    return {
        "benchmark": "teleop_latency",
        "key_to_twist_ms": percentiles(to_twist),
        "release_to_zero_ms": percentiles(to_zero),
        "floor_ms": percentiles(floors),
        "presses": presses,
        "presses_without_twist": presses - len(to_twist),
        "releases_without_zero": presses - len(to_zero),
        "load": report,
    }


def _first_after(
    begins_ns: list[int], ends_ns: list[int], twists: list[tuple[int, bool]], *, moving: bool
) -> list[float]:
    """Milliseconds from each begin to the first matching Twist before the end."""
    delays = []
    for begin_ns, end_ns in zip(begins_ns, ends_ns, strict=True):
        found = next((at for at, is_moving in twists if begin_ns <= at < end_ns and is_moving is moving), None)
        if found is not None:
            delays.append((found - begin_ns) / 1e6)
    return delays


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presses", type=int, default=300)
    arguments = parser.parse_args()
    on_a_screen()
    print(json.dumps(measure(arguments.presses)))
