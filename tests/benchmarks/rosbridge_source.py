"""rosbridge server for benchmarks that publishes requested topics, stamped with the monotonic clock.

``python -m tests.benchmarks.rosbridge_source --scan-hz 40 --image-hz 30`` prints its port. Each message is encoded as
by the real server: CBOR with typed arrays if the subscription asks for it, JSON with lists and base64 otherwise;
``--json-only`` disables CBOR. For each line on standard input a map of ``--map-cells`` squared is published; when the
system has accepted its last byte, the monotonic time is printed.
"""

import argparse
import asyncio
import contextlib
import json
import sys
import time
from typing import Any

import cv2
import numpy as np
from websockets.asyncio.server import ServerConnection, serve

from caris_desktop.ros.rosbridge import encode_cbor, encode_json

SCAN_TOPIC = "/scan"
IMAGE_TOPIC = "/camera/image_raw/compressed"
MAP_TOPIC = "/map"
BEAMS = 720
IMAGE_BYTES = 50_000


def stamp() -> dict[str, int]:
    seconds, nanoseconds = divmod(time.monotonic_ns(), 1_000_000_000)
    return {"secs": seconds, "nsecs": nanoseconds}


def picture() -> bytes:
    """JPEG of about 50 kB, 640x480."""
    chance = np.random.default_rng(1)
    coarse = chance.integers(0, 255, (60, 80, 3), dtype=np.uint8)
    image_bgr = cv2.resize(coarse, (640, 480), interpolation=cv2.INTER_CUBIC)
    image_bgr = cv2.add(image_bgr, chance.integers(0, 24, image_bgr.shape, dtype=np.uint8))
    pictures = (cv2.imencode(".jpg", image_bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])[1] for quality in range(5, 96, 3))
    return min((content.tobytes() for content in pictures), key=lambda content: abs(len(content) - IMAGE_BYTES))


class Source:
    def __init__(self, arguments: argparse.Namespace) -> None:
        self._clients: dict[ServerConnection, dict[str, bool]] = {}
        self._ranges_m = np.random.default_rng(2).uniform(0.2, 12.0, BEAMS).astype(np.float32)
        self._jpeg = picture()
        self._map_cells = arguments.map_cells
        self._json_only = arguments.json_only

    def scan(self) -> dict[str, Any]:
        return {
            "header": {"seq": 0, "stamp": stamp(), "frame_id": "laser"},
            "angle_min": -3.14,
            "angle_max": 3.14,
            "angle_increment": 6.28 / BEAMS,
            "time_increment": 0.0,
            "scan_time": 0.025,
            "range_min": 0.1,
            "range_max": 12.0,
            "ranges": self._ranges_m,
            "intensities": [],
        }

    def image(self) -> dict[str, Any]:
        return {
            "header": {"seq": 0, "stamp": stamp(), "frame_id": "camera"},
            "format": "jpeg",
            "data": self._jpeg,
        }

    def map(self) -> dict[str, Any]:
        cells = np.zeros((self._map_cells, self._map_cells), np.int8)
        cells[::50, :] = 100
        cells[:, ::50] = -1
        pose = {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
        info = {"resolution": 0.05, "width": self._map_cells, "height": self._map_cells, "origin": pose}
        header = {"seq": 0, "stamp": stamp(), "frame_id": "map"}
        return {
            "header": header,
            "info": {"map_load_time": stamp(), **info},
            "data": cells.ravel(),
        }

    async def handle(self, client: ServerConnection) -> None:
        topics = self._clients[client] = {}
        with contextlib.suppress(Exception):
            async for content in client:
                operation = json.loads(content)
                if operation["op"] == "subscribe":
                    topics[operation["topic"]] = operation.get("compression") == "cbor" and not self._json_only
                elif operation["op"] == "unsubscribe":
                    topics.pop(operation["topic"], None)
                elif operation["op"] == "call_service":
                    answer = {"op": "service_response", "id": operation.get("id"), "values": {}, "result": False}
                    await client.send(json.dumps(answer))
        del self._clients[client]

    async def publish(self, topic: str, message: dict[str, Any]) -> None:
        operation = {"op": "publish", "topic": topic, "msg": message}
        encoded: dict[bool, str | bytes] = {}
        for client, topics in list(self._clients.items()):
            if topic not in topics:
                continue
            binary = topics[topic]
            if binary not in encoded:
                encoded[binary] = encode_cbor(operation) if binary else encode_json(operation)
            with contextlib.suppress(Exception):
                await client.send(encoded[binary])

    async def publish_often(self, topic: str, rate_hz: float) -> None:
        due_s = time.monotonic()
        while rate_hz:
            due_s += 1.0 / rate_hz
            await asyncio.sleep(max(0.0, due_s - time.monotonic()))
            await self.publish(topic, self.scan() if topic == SCAN_TOPIC else self.image())

    async def obey(self) -> None:
        lines = asyncio.StreamReader()
        await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
        while await lines.readline():
            await self.publish(MAP_TOPIC, self.map())
            while any(client.transport.get_write_buffer_size() for client in self._clients):  # noqa: ASYNC110
                await asyncio.sleep(0.001)
            print(time.monotonic_ns(), flush=True)


async def main(arguments: argparse.Namespace) -> None:
    source = Source(arguments)
    async with serve(source.handle, "127.0.0.1", 0, compression=None, max_size=None) as server:
        print(server.sockets[0].getsockname()[1], flush=True)
        publishing = [
            asyncio.create_task(source.publish_often(topic, rate_hz))
            for topic, rate_hz in ((SCAN_TOPIC, arguments.scan_hz), (IMAGE_TOPIC, arguments.image_hz))
        ]
        await source.obey()
        for task in publishing:
            task.cancel()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scan-hz", type=float, default=40.0)
    parser.add_argument("--image-hz", type=float, default=30.0)
    parser.add_argument("--map-cells", type=int, default=4000)
    parser.add_argument("--json-only", action="store_true")
    asyncio.run(main(parser.parse_args()))
