"""Age of a scan (40 Hz) and a 50 kB image (30 Hz) on arrival in the program, compared with unmodified roslibpy.

Four clients alternate on the same server, several rounds each in one run: this program's transport with CBOR and with
JSON, and roslibpy with each of its transports. In addition the real link processes, up to the value in the console: a
scan decoded to an array, an image decoded to pixels in shared memory. Prints one JSON object.
"""

import argparse
import itertools
import json
import random
import statistics
import subprocess
import sys
import time
from dataclasses import replace

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.sensing import FrameRef, LaserScan
from caris_desktop.live.child_process import ChildProcess, ProcessSpec, RingToWrite
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.robot.link import LinkSettings, run_control_link, run_media_link
from caris_desktop.robot.profile_model import CameraTopic, RobotProfile, TopicSource
from tests.benchmarks.rosbridge_source import IMAGE_TOPIC, SCAN_TOPIC
from tests.benchmarks.screen_and_statistics import percentiles

CLIENTS = ("ours-cbor", "ours-json", "stock-asyncio", "stock-twisted")
AIM_P95_MS = 5.0
WARM_UP_S = 1.0


def ages_of_client(kind: str, port: int, seconds: float) -> dict[str, list[float]]:
    command = [sys.executable, "-m", "tests.benchmarks.sensor_client", kind, str(port), str(seconds)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=seconds + 60)
    ages: dict[str, list[float]] = json.loads(done.stdout.splitlines()[-1])
    return ages


def ages_in_the_console(port: int, seconds: float) -> dict[str, list[float]]:
    """Ages with both link processes together, as in the console."""
    profile = RobotProfile(
        name="benchmark",
        title="Benchmark",
        scan=TopicSource(SCAN_TOPIC),
        cameras=(CameraTopic("front", IMAGE_TOPIC, throttle_ms=0),),
    )
    settings = LinkSettings(replace(profile), f"ws://127.0.0.1:{port}")
    ring = FrameRing.create()
    ages: dict[str, list[float]] = {SCAN_TOPIC: [], IMAGE_TOPIC: []}
    from_ns = 0

    def take(value: object, _raw: bytes) -> None:
        if isinstance(value, (LaserScan, FrameRef)) and value.robot_stamp_ns is not None and now_ns() > from_ns > 0:
            topic = SCAN_TOPIC if isinstance(value, LaserScan) else IMAGE_TOPIC
            ages[topic].append((now_ns() - value.robot_stamp_ns) / 1e6)

    children = [
        ChildProcess(ProcessSpec("control", run_control_link, (settings,)), on_message=take),
        ChildProcess(ProcessSpec("media", run_media_link, (settings, RingToWrite(ring.name))), on_message=take),
    ]
    for child in children:
        child.start()
    # A spawned process needs time to import.
    time.sleep(2.0)
    from_ns = now_ns() + int(WARM_UP_S * 1e9)
    time.sleep(seconds + WARM_UP_S)
    for child in children:
        child.ask_to_end()
    for child in children:
        child.stop(grace_s=2.0)
    ring.close()
    return ages


def measure(rounds: int, seconds: float) -> dict[str, object]:
    source = subprocess.Popen(
        [sys.executable, "-m", "tests.benchmarks.rosbridge_source"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    if source.stdout is None:
        sys.exit("the server has no pipe")
    port = int(source.stdout.readline())
    chance = random.Random(4)  # noqa: S311 (an order, not secrets)
    ages: dict[str, dict[str, list[float]]] = {}
    p95_of_rounds_ms: dict[str, list[float]] = {}
    try:
        for _ in range(rounds):
            order = [*CLIENTS, "console"]
            chance.shuffle(order)
            for kind in order:
                found = ages_in_the_console(port, seconds) if kind == "console" else ages_of_client(kind, port, seconds)
                p95_of_rounds_ms.setdefault(kind, []).append(percentiles([*itertools.chain(*found.values())])["p95"])
                for topic, samples in found.items():
                    ages.setdefault(kind, {}).setdefault(topic, []).extend(samples)
    finally:
        source.kill()
        source.wait()
    table = {
        kind: {
            "scan_age_ms": percentiles(by_topic[SCAN_TOPIC]),
            "picture_age_ms": percentiles(by_topic[IMAGE_TOPIC]),
            "both_age_ms": percentiles([*by_topic[SCAN_TOPIC], *by_topic[IMAGE_TOPIC]]),
        }
        for kind, by_topic in sorted(ages.items())
    }
    # A disturbance of a second or two affects the round of one client only: use the median of rounds.
    typical_ms = {kind: statistics.median(rounds_ms) for kind, rounds_ms in p95_of_rounds_ms.items()}
    best_stock_ms = min(typical_ms[kind] for kind in CLIENTS if kind.startswith("stock"))
    return {
        "benchmark": "sensor_age",
        "rounds": rounds,
        "seconds": seconds,
        "aim_p95_ms": AIM_P95_MS,
        "median_of_rounds_p95_ms": {kind: round(typical_ms[kind], 3) for kind in sorted(typical_ms)},
        "p95_above_best_stock_ms": {
            kind: round(typical_ms[kind] - best_stock_ms, 3) for kind in ("ours-cbor", "ours-json")
        },
        **table,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=3.0)
    arguments = parser.parse_args()
    print(json.dumps(measure(arguments.rounds, arguments.seconds)))
