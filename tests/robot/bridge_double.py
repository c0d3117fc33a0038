"""Scripted rosbridge server for link tests, run as a script so that it can be killed and stopped.

It prints one JSON line for each connection and each received operation (``at`` on the monotonic clock), except for the
liveness checks of the link. On standard input it reads one JSON line for each thing to send: ``{"text": ...}``,
``{"hex": ...}``, ``{"size": N}``, ``{"frame": N}`` or ``{"flood": N}``; ``{"drop": true}`` closes every connection.
Published messages go to subscribers of the topic, other operations to the clients that subscribe to a topic of the
robot. Service calls listed in ``answers`` are answered, other rosapi calls refused; scans and odometry are published
while a client subscribes to them.
"""

import asyncio
import contextlib
import json
import struct
import sys
import time
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed

HEADER = {"seq": 0, "stamp": {"secs": 12, "nsecs": 5}, "frame_id": "laser"}
PROBES = ("/caris_desktop/handled", "/caris_desktop/no_such_service")
POSE = {"position": {"x": 1.0, "y": 2.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
SCAN = {
    "header": HEADER,
    "angle_min": -1.0,
    "angle_max": 1.0,
    "angle_increment": 0.5,
    "range_min": 0.1,
    "range_max": 10.0,
    "ranges": [1.0, 2.0, None, 3.0, 4.0],
    "intensities": [],
}
ODOMETRY = {
    "header": HEADER,
    "child_frame_id": "base_link",
    "pose": {"pose": POSE, "covariance": []},
    "twist": {"twist": {"linear": {"x": 0, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}, "covariance": []},
}
ANSWERS: dict[str, dict[str, Any]] = {
    "/rosapi/topics": {
        "topics": ["/cmd_vel", "/scan", "/odom"],
        "types": ["geometry_msgs/Twist", "sensor_msgs/LaserScan", "nav_msgs/Odometry"],
    },
    "/rosapi/services": {"services": ["/emergency_stop/set"]},
    "/emergency_stop/set": {"success": True, "message": ""},
}

_PIECE_BYTES = 1_000_000
CLOCK_OFFSET_S = 1_700_000_000


def answers() -> dict[str, dict[str, Any]]:
    """Answers with a robot clock ahead of the monotonic clock by a round number of seconds."""
    seconds, nanoseconds = divmod(time.monotonic_ns(), 1_000_000_000)
    return {**ANSWERS, "/rosapi/get_time": {"time": {"secs": CLOCK_OFFSET_S + seconds, "nsecs": nanoseconds}}}


clients: dict[ServerConnection, set[str]] = {}


def note(**fields: Any) -> None:
    print(json.dumps({"at": time.monotonic(), **fields}), flush=True)


async def handle(client: ServerConnection) -> None:
    clients[client] = set()
    note(event="connected")
    with contextlib.suppress(Exception):
        async for message in client:
            operation = json.loads(message)
            if operation.get("topic", operation.get("service")) not in PROBES:
                note(**operation)
            if operation["op"] == "publish":
                for other in subscribers(operation["topic"]):
                    await other.send(json.dumps({**operation, "id": None}))
            elif operation["op"] == "subscribe":
                clients[client].add(operation["topic"])
            elif operation["op"] == "call_service":
                known = answers().get(operation["service"])
                answer = {"op": "service_response", "id": operation["id"], "result": known is not None}
                if known is not None or operation["service"].startswith("/rosapi/"):
                    await client.send(json.dumps({**answer, "values": known or "there is no such service"}))
    del clients[client]
    note(event="disconnected")


def subscribers(topic: str) -> list[ServerConnection]:
    return [client for client, topics in clients.items() if topic in topics]


def recipients(order: dict[str, Any]) -> list[ServerConnection]:
    """Clients that an ordered message is sent to: its subscribers, or all clients without any subscription."""
    with contextlib.suppress(ValueError, KeyError, TypeError, AttributeError, RecursionError):
        operation = json.loads(order["text"])
        if operation["op"] == "publish" and (found := subscribers(operation["topic"])):
            return found
    return [client for client, topics in clients.items() if topics and not topics & set(PROBES)] or list(clients)


async def publish() -> None:
    while True:
        for client, topics in list(clients.items()):
            for topic, message in (("/scan", SCAN), ("/odom", ODOMETRY)):
                if topic in topics:
                    with contextlib.suppress(Exception):
                        await client.send(json.dumps({"op": "publish", "topic": topic, "msg": message}))
        await asyncio.sleep(0.1)


async def obey() -> None:
    reader = asyncio.StreamReader(limit=2**24)
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    while line := await reader.readline():
        order = json.loads(line)
        for client in list(clients) if "drop" in order else recipients(order):
            # A flooded client may disconnect.
            with contextlib.suppress(ConnectionClosed):
                await send_ordered(client, order)


async def send_ordered(client: ServerConnection, order: dict[str, Any]) -> None:
    if "drop" in order:
        client.transport.abort()
    elif "text" in order:
        await client.send(order["text"])
    elif "hex" in order:
        await client.send(bytes.fromhex(order["hex"]))
    elif "flood" in order:
        for number in range(order["flood"]):
            fragment = {"op": "fragment", "id": f"flood {number}", "num": 0, "total": 2, "data": "x" * 2000}
            await client.send(json.dumps(fragment))
            # As a server does that has other clients.
            await asyncio.sleep(0)
    elif "frame" in order:
        # In pieces, as over a network; the double must keep answering meanwhile.
        client.transport.write(b"\x81\x7f" + struct.pack(">Q", order["frame"]))
        for _ in range(order["frame"] // _PIECE_BYTES):
            if client.transport.is_closing():
                break
            client.transport.write(b"x" * _PIECE_BYTES)
            await asyncio.sleep(0)
    elif "size" in order:
        await client.send('{"op":"publish","topic":"/map","msg":{"data":"' + "x" * order["size"] + '"}}')


async def main() -> None:
    async with serve(handle, "127.0.0.1", int(sys.argv[1]), max_size=None) as server:
        note(event="ready", port=server.sockets[0].getsockname()[1])
        publishing = asyncio.create_task(publish())
        await obey()
        publishing.cancel()


if __name__ == "__main__":
    asyncio.run(main())
