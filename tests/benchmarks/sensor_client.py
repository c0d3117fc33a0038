"""Client of the age benchmark: age of each scan and image on arrival in user code.

``python -m tests.benchmarks.sensor_client KIND PORT SECONDS``, KIND being ours-cbor, ours-json, stock-asyncio or
stock-twisted. Both topics use one connection, as with roslibpy. Prints one JSON object: ages in milliseconds by topic.
"""

import asyncio
import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any

import roslibpy

from caris_desktop.robot.transport import RosbridgeClient, RosbridgeTopic
from tests.benchmarks.rosbridge_source import IMAGE_TOPIC, SCAN_TOPIC

WARM_UP_S = 1.0
TYPES = {SCAN_TOPIC: "sensor_msgs/LaserScan", IMAGE_TOPIC: "sensor_msgs/CompressedImage"}


class Ages:
    def __init__(self) -> None:
        self.by_topic_ms: dict[str, list[float]] = {topic: [] for topic in TYPES}
        self._from_ns = time.monotonic_ns() + int(WARM_UP_S * 1e9)

    def note(self, topic: str) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            now_ns = time.monotonic_ns()
            stamp = message["header"]["stamp"]
            if now_ns > self._from_ns:
                age_ns = now_ns - (stamp["secs"] * 1_000_000_000 + stamp["nsecs"])
                self.by_topic_ms[topic].append(age_ns / 1e6)

        return take


class Silent:
    """Observer that ignores connection events."""

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *_: None


async def ours(port: int, seconds: float, compression: str) -> Ages:
    ages = Ages()
    ros = RosbridgeClient(f"ws://127.0.0.1:{port}", Silent())
    for topic, kind in TYPES.items():
        RosbridgeTopic(ros, topic, kind, compression=compression).subscribe(ages.note(topic))
    ros.connect()
    await asyncio.sleep(seconds + WARM_UP_S)
    await ros.aclose(0.5)
    return ages


def stock(port: int, seconds: float, transport: str) -> Ages:
    ages = Ages()
    ros = roslibpy.Ros("127.0.0.1", port, transport=transport)
    ros.run()
    for topic, kind in TYPES.items():
        roslibpy.Topic(ros, topic, kind, queue_length=1).subscribe(ages.note(topic))
    time.sleep(seconds + WARM_UP_S)
    return ages


def main(kind: str, port: int, seconds: float) -> None:
    origin, _, variant = kind.partition("-")
    if origin == "ours":
        ages = asyncio.run(ours(port, seconds, "cbor" if variant == "cbor" else "none"))
    else:
        ages = stock(port, seconds, variant)
    print(json.dumps(ages.by_topic_ms), flush=True)
    # The stock transports do not exit.
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]))
