"""Process of a robot plug-in, which serves rosbridge's protocol on loopback for one link.

The link starts it, restarts it with the pauses of its own reconnection, and ends it by closing its standard input. The
process leaves the robot safe when that happens, also when the link was killed: see
:mod:`caris_desktop.robot.bridge_server`.
"""

import asyncio
import contextlib
import json
import logging
import os
import secrets
import socket
import subprocess
import sys
import threading

from caris_desktop.domain import plugins
from caris_desktop.domain.address import plugin_address
from caris_desktop.domain.foreign_text import printable
from caris_desktop.domain.plugins import PluginError
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.robot import bridge_server
from caris_desktop.robot.bridge_security import LinkError

logger = logging.getLogger(__name__)

_LOADED_WITHIN_S = 30.0
_ENDED_WITHIN_S = 2.0
_AGAIN_AFTER_S = 5.0
_RUN = "import json, sys; sys.path[:] = json.loads(sys.argv.pop(1)); from {module} import run_plugin; run_plugin()"
# Without the folder of the script, whose modules would hide those of the standard library.
_RUN_FILE = "import sys; sys.path.pop(0); import runpy; runpy.run_path(sys.argv.pop(1), run_name='__main__')"


def start_s(address: str) -> float:
    """Time that a connection to this address may take beyond that of a rosbridge: its process has to start."""
    return _LOADED_WITHIN_S if plugin_address(address) else 0.0


class BridgeProcess:
    """Process for a robot address such as ``ros2:5``. Belongs to one asyncio loop."""

    def __init__(self, address: str) -> None:
        self._name, self._target = plugin_address(address) or ("", "")
        self._address = address
        self._loop = asyncio.get_running_loop()
        self._reported = asyncio.Event()
        self._problem: LinkError | None = None
        self._url = ""
        self._process: subprocess.Popen[str] | None = None
        self._running: threading.Thread | None = None
        self._may_start_s = 0.0
        self._closed = False

    async def url(self) -> str:
        """Websocket address of the process, which is started if it does not run.

        Raises
        ------
        LinkError
            While the plug-in cannot be used, or does not find its robot.
        """
        if self._running is None and self._loop.time() >= self._may_start_s:
            self._start()
        try:
            async with asyncio.timeout(_LOADED_WITHIN_S):
                await self._reported.wait()
        except TimeoutError:
            if self._process is not None:
                self._process.kill()
            self._problem = self._failed(QT_TR_NOOP("it did not start in time"))
        if self._problem is not None:
            raise self._problem
        return self._url

    async def close(self) -> None:
        """End the process, which stops the robot first."""
        self._closed = True
        process, running = self._process, self._running
        if process is None or running is None:
            return
        if process.stdin is not None:
            with contextlib.suppress(OSError):
                process.stdin.close()
        await asyncio.to_thread(running.join, _ENDED_WITHIN_S)
        if running.is_alive():
            logger.warning("the robot plug-in %s did not end: killed", self._name)
            process.kill()

    def _start(self) -> None:
        self._may_start_s = self._loop.time() + _AGAIN_AFTER_S
        self._reported.clear()
        self._problem = None
        if sys.platform == "win32":
            self._report(self._failed(QT_TR_NOOP("it needs Linux or macOS")))
            return
        listener = socket.create_server(("127.0.0.1", 0))
        token = secrets.token_urlsafe(24)
        self._url = f"ws://127.0.0.1:{listener.getsockname()[1]}/{token}"
        self._running = threading.Thread(target=self._run, args=(listener, token), name="robot-plugin", daemon=True)
        self._running.start()

    def _run(self, listener: socket.socket, token: str) -> None:
        """Start the process and read what it says. A thread of its own."""
        if hasattr(os, "sched_setscheduler"):
            # The process would inherit the link's real-time priority, with which importing takes too long.
            with contextlib.suppress(OSError):
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        with listener:
            descriptor = listener.fileno()
            code = _RUN.format(module=__name__)
            command = [sys.executable, "-P", "-c", code, json.dumps(sys.path), self._name, self._target]
            self._process = process = subprocess.Popen(
                [*command, str(descriptor)], pass_fds=(descriptor,), stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT, text=True, errors="replace", start_new_session=True,
            )  # fmt: skip
        if process.stdin is None or process.stdout is None:
            raise RuntimeError("the process was started without pipes")
        with contextlib.suppress(OSError):
            process.stdin.write(f"{token}\n")
            process.stdin.flush()
        failed: LinkError | None = None
        for line in process.stdout:
            if line.startswith(bridge_server.READY):
                self._report_from_thread(None)
            elif line.startswith(bridge_server.UNUSABLE):
                what, advice = json.loads(line[len(bridge_server.UNUSABLE) :])
                failed = LinkError(printable(what), printable(advice)) if advice else self._failed(printable(what))
                self._report_from_thread(failed)
            else:
                logger.info("robot plug-in %s: %s", self._name, printable(line.rstrip()))
        ended = localized(QT_TR_NOOP("its process ended with code {code}"), code=process.wait())
        self._running = None
        self._report_from_thread(failed or self._failed(ended))

    def _report_from_thread(self, problem: LinkError | None) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._report, problem)

    def _report(self, problem: LinkError | None) -> None:
        self._problem = problem
        self._reported.set()

    def _failed(self, reason: str) -> LinkError:
        what = localized(
            QT_TR_NOOP("The robot plug-in {name} cannot be used: {reason}."), name=self._name, reason=reason
        )
        return LinkError(what, QT_TR_NOOP("Update the plug-in, or correct the robot's address; the log has details."))


def run_plugin() -> None:
    """Load the plug-in that the arguments name, and serve; in its own Python, if it has one."""
    name, target, descriptor = sys.argv[1:]
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    try:
        plugin = plugins.find("robots", name)
        with plugins.watched(plugin):
            make = plugins.load(plugin)
        if not hasattr(make, "interpreter"):
            bridge_server.serve(make, target, int(descriptor))
            return
        with plugins.watched(plugin):
            command, environment = make.interpreter(target)
    except (PluginError, OSError) as error:
        cause = error.__cause__ if isinstance(error.__cause__, OSError) else error
        what, advice = (*cause.args, "", "")[:2]
        print(bridge_server.UNUSABLE + json.dumps([str(what), str(advice)]), flush=True)
        raise SystemExit(1) from error
    place = f"{sys.modules[make.__module__].__file__}:{make.__name__}"
    arguments = [*command, "-c", _RUN_FILE, bridge_server.__file__, place, target, descriptor]
    os.execvpe(arguments[0], arguments, environment)  # noqa: S606 - the plug-in's own Python
