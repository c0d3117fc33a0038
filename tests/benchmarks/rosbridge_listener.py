"""Independent rosbridge client in a separate process that prints the arrival of each message of some topics.

One JSON object a line: topic, arrived_ns (monotonic clock), msg. ``python -m tests.benchmarks.rosbridge_listener
ADDRESS TOPIC=TYPE ...`` runs until it is terminated.
"""

import json
import signal
import sys
import time

from websockets.sync.client import connect


def main(address: str, topics: list[str]) -> None:
    arrivals: list[tuple[int, str]] = []
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    try:
        with connect(address, compression=None, max_size=None) as socket:
            for entry in topics:
                topic, kind = entry.split("=")
                socket.send(json.dumps({"op": "subscribe", "topic": topic, "type": kind}))
            print("ready", flush=True)
            for message in socket:
                arrivals.append((time.monotonic_ns(), str(message)))
    finally:
        for arrived_ns, message in arrivals:
            operation = json.loads(message)
            if operation.get("op") == "publish":
                print(
                    json.dumps({"topic": operation["topic"], "arrived_ns": arrived_ns, "msg": operation["msg"]}),
                    flush=True,
                )


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
