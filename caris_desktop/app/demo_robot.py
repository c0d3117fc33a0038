"""Simulated robot of the console: started with it, connected once ready, ended with it."""

import asyncio
import json
import logging
import sys
from collections.abc import Mapping, Sequence

from PySide6.QtCore import QObject, Qt, Signal

from caris_desktop.app import composition
from caris_desktop.domain.actor import WIZARD, Actor
from caris_desktop.domain.translation import tr
from caris_desktop.live.console import Console
from caris_desktop.live.robot_connections import SimulatedRobotProcess

PROFILE = "simulated"


class DemoRobot(QObject):
    """Simulated robot's process, in the GUI thread; reports through signals."""

    _ready = Signal(str)
    _failed = Signal(str)

    def __init__(self, console: Console, *, seed: int | None = None, actor: Actor = WIZARD) -> None:
        """``actor`` is for whom it is connected once it is ready."""
        super().__init__(console)
        self._console = console
        self._actor = actor
        self._address: str | None = None
        command = [sys.executable, "-m", "caris_desktop", "simulate", "--port", "0", "--end-with-stdin"]
        if seed is not None:
            command += ["--seed", str(seed)]
        self.process = SimulatedRobotProcess(command, on_ready=self._ready.emit, on_failed=self._failed.emit)
        self._ready.connect(self._on_ready, Qt.ConnectionType.QueuedConnection)
        self._failed.connect(self._on_failed, Qt.ConnectionType.QueuedConnection)

    def start(self) -> None:
        self.process.start()

    def use(self, actor: Actor) -> None:
        """Connect it for that actor, now or once it is ready."""
        address, self._actor = self._address, actor
        if address is not None:
            self._console.use_robot(lambda: composition.robot_connection(PROFILE, address=address), actor)

    def stop(self) -> None:
        self.process.stop()

    def address_of(self, name: str) -> str | None:
        """Its address once it is ready, if ``name`` is this robot's profile."""
        return self._address if name == PROFILE else None

    def _on_ready(self, address: str) -> None:
        self._address = address
        self.use(self._actor)

    def _on_failed(self, detail: str) -> None:
        self._console.problem(
            "error",
            tr("The simulated robot did not start: {why}.").format(why=detail),
            tr("There is no robot to drive; everything else works."),
            tr("Run 'caris-desktop simulate' in a terminal to see why."),
            until="connected",
        )


# Service calls to the simulated robot itself: speech and faults.


_log = logging.getLogger(__name__)
SAY, PREPARE, FAULT = "/simulator/say", "/simulator/prepare", "/simulator/fault"
# Speech is synthesised first, which takes long on a busy computer.
_TIMEOUT_S = 60.0


async def call_simulator(address: str, service: str, arguments: Sequence[Mapping[str, str]]) -> None:
    """Call ``service`` once for each of ``arguments``. A rosbridge drops unexecuted calls when its client disconnects,
    so each call_simulator awaits its answer. Failures are logged only; the caller notices the missing effect.
    """
    from websockets.asyncio.client import connect
    from websockets.exceptions import WebSocketException

    try:
        async with asyncio.timeout(_TIMEOUT_S), connect(address) as robot:
            for number, values in enumerate(arguments):
                operation = {"op": "call_service", "id": f"{number}", "service": service, "args": dict(values)}
                await robot.send(json.dumps(operation))
                while json.loads(await robot.recv()).get("id") != operation["id"]:
                    pass
    except (OSError, TimeoutError, ValueError, WebSocketException):
        _log.warning("the simulated robot could not be asked for %s", service, exc_info=True)
