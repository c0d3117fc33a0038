"""Simulated robot of the console: started with it, connected once ready, ended with it."""

import asyncio
import json
import logging
import re
import sys
from collections.abc import Mapping, Sequence

from PySide6.QtCore import QObject, QProcess

from caris_desktop.app import composition
from caris_desktop.domain.actor import WIZARD, Actor
from caris_desktop.domain.translation import tr
from caris_desktop.live.console import Console

PROFILE = "simulated"
_log = logging.getLogger(__name__)
_READY = re.compile(r"ws://\S+")
_SIMULATE = ("-m", "caris_desktop", "simulate", "--port", "0", "--end-with-stdin")
_ENDS_WITHIN_MS = 2000


class DemoRobot(QObject):
    """Simulated robot in a process of its own. GUI thread.

    It ends when its standard input closes, as it does when the console is killed.
    """

    def __init__(
        self,
        console: Console,
        *,
        seed: int | None = None,
        actor: Actor = WIZARD,
        python_arguments: Sequence[str] = _SIMULATE,
    ) -> None:
        """``actor`` is for whom it is connected once it is ready."""
        super().__init__(console)
        self._console = console
        self._actor = actor
        self._address: str | None = None
        self.process = QProcess(self)
        self.process.setProgram(sys.executable)
        self.process.setArguments([*python_arguments, *(() if seed is None else ("--seed", str(seed)))])
        self.process.setProcessChannelMode(QProcess.ProcessChannelMode.ForwardedErrorChannel)
        if sys.platform != "win32":  # Ctrl+C in the terminal is for the console, which ends it in order
            self.process.setUnixProcessParameters(QProcess.UnixProcessFlag.CreateNewSession)
        self.process.readyReadStandardOutput.connect(self._on_output)
        self.process.finished.connect(self._on_finished)

    def start(self) -> None:
        self.process.start()

    def stop(self) -> None:
        self.process.finished.disconnect(self._on_finished)
        self.process.terminate()
        if not self.process.waitForFinished(_ENDS_WITHIN_MS):
            self.process.kill()
            self.process.waitForFinished()

    def use(self, actor: Actor) -> None:
        """Connect it for that actor, now or once it is ready."""
        address, self._actor = self._address, actor
        if address is not None:
            self._console.use_robot(lambda: composition.robot_connection(PROFILE, address=address), actor)

    def address_of(self, name: str) -> str | None:
        """Its address once it is ready, if ``name`` is this robot's profile."""
        return self._address if name == PROFILE else None

    def call(self, service: str, arguments: Sequence[Mapping[str, str]]) -> None:
        """Call a service of the robot itself, once it is ready, for each of ``arguments``. A failure is only logged."""
        if self._address is not None:
            self._console.asyncio_thread.submit(call_simulator(self._address, service, arguments))

    def _on_output(self) -> None:
        while self.process.canReadLine():
            line = bytes(self.process.readLine().data()).decode("utf-8", "replace").rstrip()
            _log.info("simulated robot: %s", line)
            if self._address is None and (found := _READY.search(line)):
                self._on_ready(found.group())

    def _on_finished(self, exit_code: int) -> None:
        if self._address is None:
            self._on_failed(tr("it ended with exit code {code}").format(code=exit_code))

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
