"""Independent rosbridge client that records every velocity command on the robot's topic."""

import contextlib
import json
import threading
import time
from dataclasses import dataclass

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect


@dataclass(frozen=True, slots=True)
class ReceivedTwist:
    at_ns: int
    forward_mps: float
    turn_radps: float

    @property
    def moving(self) -> bool:
        return bool(self.forward_mps or self.turn_radps)


class TwistListener:
    """Plain websocket and JSON client without code of the package."""

    def __init__(self, address: str, topic: str = "/cmd_vel") -> None:
        self.seen: list[ReceivedTwist] = []
        self._open = contextlib.ExitStack()
        self._socket = self._open.enter_context(connect(address, compression=None, max_size=None))
        self._socket.send(json.dumps({"op": "subscribe", "topic": topic, "type": "geometry_msgs/Twist"}))
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    @property
    def closed(self) -> bool:
        """True if the connection has been closed by the server."""
        return not self._thread.is_alive()

    def close(self) -> None:
        self._open.close()
        self._thread.join(5)

    def _listen(self) -> None:
        with contextlib.suppress(ConnectionClosed):
            for text in self._socket:
                at_ns = time.monotonic_ns()
                operation = json.loads(text)
                if operation.get("op") == "publish":
                    message = operation["msg"]
                    self.seen.append(ReceivedTwist(at_ns, message["linear"]["x"], message["angular"]["z"]))
