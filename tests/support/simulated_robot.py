"""Simulated robot as a separate program, and a plain rosbridge client without roslibpy."""

import contextlib
import itertools
import json
import os
import shutil
import ssl
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tests.support.polling import wait_for

_READY = "Simulated robot ready at "


class SimulatedRobot:
    """Context manager of ``python -m caris_desktop.simulator`` on a free port; kills it on exit.

    Parameters
    ----------
    ros
        1 or 2; None for the version of the robot model.
    robot_model
        Robot model whose names and types are used.
    port
        0 for a free one.
    arguments
        Further command line arguments.
    environment
        Additional environment variables.
    """

    def __init__(
        self,
        *arguments: str,
        ros: int | None = None,
        robot_model: str = "generic",
        port: int = 0,
        seed: int = 1,
        muted: bool = True,
        environment: dict[str, str] | None = None,
    ) -> None:
        self.ros = ros or (2 if robot_model.startswith("turtlebot") else 1)
        self.robot_model = robot_model
        command = [
            sys.executable,
            "-m",
            "caris_desktop.simulator",
            "--port",
            str(port),
            "--dress",
            robot_model,
            *(["--ros", str(ros)] if ros is not None else []),
            "--end-with-stdin",
        ]
        # A separate folder: a killed simulator leaves its maps behind.
        self.folder = Path(tempfile.mkdtemp(prefix="robot-"))
        self._process = subprocess.Popen(
            [*command, "--seed", str(seed), *(["--mute"] if muted else []), *arguments],
            env={**os.environ, "TMPDIR": str(self.folder), **(environment or {})},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        line = self._process.stdout.readline() if self._process.stdout is not None else ""
        if not line.startswith(_READY):
            self.kill()
            raise AssertionError(f"the simulated robot did not become ready: {line!r}")
        self.address = line.removeprefix(_READY).strip()
        self.port = int(self.address.rpartition(":")[2])

    def __enter__(self) -> "SimulatedRobot":
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

    @property
    def pid(self) -> int:
        return self._process.pid

    def next_line(self) -> str:
        """Next line of its output after the address."""
        return self._process.stdout.readline() if self._process.stdout is not None else ""

    def kill(self) -> None:
        """Kill it with SIGKILL."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    def terminate(self) -> int:
        """Send SIGTERM and return the exit status."""
        self._process.terminate()
        return self._process.wait(10)

    def call(self, service: str, /, **arguments: Any) -> Any:
        """Call a service on a new connection; AssertionError if it fails."""
        with RosbridgeClient(self.address) as client:
            return client.call(service, **arguments)

    def state(self) -> dict[str, Any]:
        """Ground truth of the robot and the people around it."""
        state: dict[str, Any] = self.call("/simulator/state")
        return state

    def fault(self, command: str) -> None:
        """Inject a fault, such as ``black_camera`` or ``clear``."""
        self.call("/simulator/fault", command=command)


class RosbridgeClient:
    """Plain websocket and JSON client without code of the package."""

    def __init__(self, address: str, *, tls: ssl.SSLContext | None = None) -> None:
        self._open = contextlib.ExitStack()
        self._socket = self._open.enter_context(connect(address, compression=None, max_size=None, ssl=tls))
        self._ids = itertools.count()
        self.received: list[dict[str, Any] | bytes] = []
        self.received_s: list[float] = []
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def __enter__(self) -> "RosbridgeClient":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def closed(self) -> bool:
        """True if the connection has been closed by the server."""
        return not self._thread.is_alive()

    def close(self) -> None:
        self._open.close()
        self._thread.join(5)

    def send(self, **operation: Any) -> None:
        self._socket.send(json.dumps(operation))

    def send_text(self, text: str) -> None:
        """Send any text, well-formed or not."""
        self._socket.send(text)

    def subscribe(self, topic: str, **options: Any) -> None:
        self.send(op="subscribe", topic=topic, id=f"subscribe:{topic}:{next(self._ids)}", **options)

    def publish(self, topic: str, message: dict[str, Any]) -> None:
        self.send(op="publish", topic=topic, msg=message)

    def drive(self, forward_mps: float, turn_radps: float = 0.0) -> None:
        """Send one velocity command."""
        self.publish("/cmd_vel", {"linear": {"x": forward_mps}, "angular": {"z": turn_radps}})

    def call(self, service: str, /, **arguments: Any) -> Any:
        """Result of a service call; AssertionError if it fails."""
        request_id = f"call:{service}:{next(self._ids)}"
        self.send(op="call_service", service=service, args=arguments, id=request_id)
        answer = self.wait_for_operation(lambda operation: operation.get("id") == request_id, f"an answer of {service}")
        assert answer["result"], answer["values"]
        return answer["values"]

    def operations(self) -> list[dict[str, Any]]:
        """All JSON operations received so far."""
        return [operation for operation in list(self.received) if isinstance(operation, dict)]

    def messages(self, topic: str) -> list[dict[str, Any]]:
        """All JSON messages received on ``topic`` so far."""
        return [
            operation["msg"]
            for operation in self.operations()
            if operation.get("op") == "publish" and operation["topic"] == topic
        ]

    def wait_for_operation(self, wanted: Callable[[dict[str, Any]], bool], what: str) -> dict[str, Any]:
        return wait_for(lambda: next(filter(wanted, self.operations()), None), what) or {}

    def wait_for_messages(self, topic: str, count: int = 1) -> list[dict[str, Any]]:
        wait_for(lambda: len(self.messages(topic)) >= count, f"{count} messages on {topic}")
        return self.messages(topic)

    def _listen(self) -> None:
        with contextlib.suppress(ConnectionClosed):
            for content in self._socket:
                self.received_s.append(time.monotonic())
                self.received.append(_decoded(content) if isinstance(content, str) else bytes(content))


def _decoded(content: str) -> Any:
    try:
        return json.loads(content)
    except (ValueError, RecursionError):
        return content.encode()
