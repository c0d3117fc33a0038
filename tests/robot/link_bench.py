"""Handles for link tests: the bridge double and the link process, each in a separate process."""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import DriveEnded, LinkChanged
from caris_desktop.domain.geometry import Twist2D
from caris_desktop.domain.link_commands import Drive, RenewLease, SetGuard
from caris_desktop.robot.link import LinkSettings, run_control_link
from caris_desktop.robot.profile import load_profile
from tests.support.polling import wait_for

V = TypeVar("V")


class BridgeDouble:
    """``bridge_double.py`` in a child process that may be killed, stopped and restarted on the same port."""

    def __init__(self) -> None:
        self.lines: list[dict[str, Any]] = []
        self.port = 0
        self._connected_s = 0.0
        self.start()

    @property
    def address(self) -> str:
        return f"ws://127.0.0.1:{self.port}"

    @property
    def connected_s(self) -> float:
        """Time of the last connection on the monotonic clock; clearing ``lines`` keeps it."""
        return self._connected_s

    def start(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("bridge_double.py")), str(self.port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        ready = json.loads(self._process.stdout.readline())  # type: ignore[union-attr]
        self.port = ready["port"]
        self._reader = threading.Thread(target=self._read, args=(self._process,), daemon=True)
        self._reader.start()

    def tell(self, **order: Any) -> None:
        """Send a command to the double."""
        self._process.stdin.write(json.dumps(order) + "\n")  # type: ignore[union-attr]
        self._process.stdin.flush()  # type: ignore[union-attr]

    def publish(self, topic: str, message: Any) -> None:
        self.tell(text=json.dumps({"op": "publish", "topic": topic, "msg": message}))

    def signal(self, number: signal.Signals) -> None:
        os.kill(self._process.pid, number)

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join(5)
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()

    def operations(self, op: str, topic: str | None = None) -> list[dict[str, Any]]:
        """Received operations, oldest first."""
        return [line for line in list(self.lines) if line.get("op") == op and topic in (None, line.get("topic"))]

    def twists(self) -> list[tuple[float, float, float]]:
        """(arrival on the monotonic clock, forward, turn) of each velocity command."""
        return [
            (line["at"], line["msg"]["linear"]["x"], line["msg"]["angular"]["z"])
            for line in self.operations("publish", "/cmd_vel")
        ]

    def _read(self, process: "subprocess.Popen[str]") -> None:
        for text in process.stdout:  # type: ignore[union-attr]
            line = json.loads(text)
            if line.get("event") == "connected":
                self._connected_s = line["at"]
            self.lines.append(line)


class LinkProcess:
    """Control link in a child process as in the console; ``method`` selects a cheaper start method."""

    def __init__(
        self,
        address: str,
        profile: str = "simulated",
        *,
        body: Any = run_control_link,
        extra: Any = (),
        method: str = "spawn",
    ) -> None:
        context: Any = multiprocessing.get_context(method)
        self._ours, theirs = context.Pipe()
        settings = LinkSettings(load_profile(profile), address)
        self.process = context.Process(target=body, args=(theirs, settings, *extra), daemon=True)
        self.process.start()
        theirs.close()
        self.values: list[Any] = []
        self.reading = threading.Event()
        self.reading.set()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def send(self, command: Any) -> None:
        self._ours.send(command)

    def send_bytes(self, piece: bytes) -> None:
        """Write a part of a message, as a console that is stopped in the middle of a write."""
        while piece:
            piece = piece[os.write(self._ours.fileno(), piece) :]

    def drive(self, forward_mps: float = 0.3, turn_radps: float = 0.0) -> None:
        self.send(Drive(now_ns(), Twist2D(forward_mps, 0.0, turn_radps), "keyboard"))

    def hold(self, until: Callable[[], V], what: str, *, timeout_s: float = 10.0) -> V:
        """Renew the lease as the console does until ``until`` is true."""
        last_s = 0.0

        def observe() -> V:
            nonlocal last_s
            if time.monotonic() - last_s > 0.05:
                last_s = time.monotonic()
                self.send(RenewLease(now_ns()))
            return until()

        return wait_for(observe, what, timeout_s=timeout_s)

    def drive_until(
        self,
        until: Callable[[], V],
        what: str,
        *,
        forward_mps: float = 0.0,
        turn_radps: float = 0.0,
        guard: bool = True,
        timeout_s: float = 10.0,
    ) -> V:
        """Drive, and press again when the drive has ended, as on a machine too busy for the lease."""
        ended = -1

        def observe() -> V:
            nonlocal ended
            if ended != (ended := len(self.of(DriveEnded))):
                self.drive(forward_mps, turn_radps)
                if not guard:
                    self.send(SetGuard(now_ns(), on=False))
            return until()

        return self.hold(observe, what, timeout_s=timeout_s)

    def of(self, kind: type[V]) -> list[V]:
        return [value for value in list(self.values) if isinstance(value, kind)]

    def states(self) -> list[str]:
        return [change.state for change in self.of(LinkChanged)]

    def wait_for_state(self, state: str, *, after: int = 0, timeout_s: float = 10.0) -> LinkChanged:
        """First change to ``state`` after the first ``after`` changes."""
        return wait_for(
            lambda: next((change for change in self.of(LinkChanged)[after:] if change.state == state), None),
            f"link {state}, have {self.states()}",
            timeout_s=timeout_s,
        )  # type: ignore[return-value]

    def disappear(self) -> None:
        """Close the console's end of the pipe, as a kill does."""
        import socket

        with socket.socket(fileno=os.dup(self._ours.fileno())) as half:
            half.shutdown(socket.SHUT_WR)

    def close(self) -> None:
        self.reading.set()
        if self.process.is_alive():
            self.disappear()
            self.process.join(5)
        if self.process.is_alive():
            self.process.kill()
        self._reader.join(5)
        self._ours.close()

    def _read(self) -> None:
        while True:
            self.reading.wait()
            try:
                self.values.append(self._ours.recv())
            except (EOFError, OSError):
                return
