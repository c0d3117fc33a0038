"""ROS 1 recording served over rosbridge with its recorded stamps, as a separate program.

``python -m tests.support.bag_server BAG [--from SECONDS] [--pace FACTOR]`` prints its address when it is ready and
plays all topics from there to the end in a loop. It exits at the end of its standard input.
"""

import argparse
import asyncio
import dataclasses
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_typestore

from caris_desktop.ros.dialect import Dialect
from caris_desktop.simulator.ros_context import RobotClock, offer_rosapi
from caris_desktop.simulator.server import BridgeServer, Topic

TYPESTORE = get_typestore(Stores.ROS1_NOETIC)
READY = "Recording ready at "


def ros1_name(type_name: str) -> str:
    """ROS 1 type name: ``sensor_msgs/LaserScan`` for ``sensor_msgs/msg/LaserScan`` of rosbags."""
    return type_name.replace("/msg/", "/")


def plain(value: Any) -> Any:
    """Convert a rosbags message to plain dicts as in rosbridge JSON; arrays stay arrays."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclasses.fields(value) if not field.name.startswith("__")]
        fields = {name: plain(getattr(value, name)) for name in names}
        if set(fields) == {"sec", "nanosec"}:
            return {"secs": fields["sec"], "nsecs": fields["nanosec"]}
        return fields
    if isinstance(value, list):
        return [plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value


def messages(bag: Path, *, from_s: float = 0.0) -> Iterator[tuple[str, str, int, Any]]:
    """Topic, type, recording time in nanoseconds and rosbags message of each recorded message."""
    with Reader(bag) as reader:
        connection: Connection
        for connection, at_ns, raw in reader.messages(start=reader.start_time + round(from_s * 1e9)):
            message = TYPESTORE.deserialize_ros1(raw, connection.msgtype)
            yield connection.topic, ros1_name(connection.msgtype), at_ns, message


async def serve(bag: Path, *, from_s: float, pace: float) -> None:
    clock = RobotClock()
    server = BridgeServer()
    offer_rosapi(server, Dialect.ROS1, clock=clock)
    with Reader(bag) as reader:
        for connection in reader.connections:
            server.topics[connection.topic] = Topic(ros1_name(connection.msgtype))
    port = await server.start("127.0.0.1", 0)
    sys.stdout.write(f"{READY}ws://127.0.0.1:{port}\n")
    sys.stdout.flush()
    playing = asyncio.create_task(play(server, clock, bag, from_s=from_s, pace=pace))
    reading = asyncio.create_task(asyncio.to_thread(sys.stdin.read))
    await asyncio.wait([playing, reading], return_when=asyncio.FIRST_COMPLETED)
    playing.cancel()
    await server.stop()


async def play(server: BridgeServer, clock: RobotClock, bag: Path, *, from_s: float, pace: float) -> None:
    loop = asyncio.get_running_loop()
    while True:
        begun_s, first_ns = loop.time(), 0
        for topic, _, at_ns, message in messages(bag, from_s=from_s):
            if not first_ns:
                first_ns = at_ns
                # the robot clock shows recording time
                clock.disagree(offset_s=(at_ns - time.time_ns()) * 1e-9)
            await asyncio.sleep(max(0.0, begun_s + (at_ns - first_ns) * 1e-9 / pace - loop.time()))
            server.publish(topic, plain(message))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bag", type=Path)
    parser.add_argument("--from", dest="from_s", type=float, default=0.0)
    parser.add_argument("--pace", type=float, default=1.0)
    arguments = parser.parse_args()
    asyncio.run(serve(arguments.bag, from_s=arguments.from_s, pace=arguments.pace))


if __name__ == "__main__":
    main()
