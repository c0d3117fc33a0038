"""Simulated robot of a demonstration or rehearsal: separate program that ends with the console."""

import logging
import re
import subprocess
import threading
from collections.abc import Callable, Sequence

from caris_desktop.domain.translation import tr

_log = logging.getLogger(__name__)
_READY = re.compile(r"ws://\S+")


class SimulatedRobotProcess:
    """``on_ready(address)`` and ``on_failed(text)`` are called in a background thread.

    The command must end when its standard input closes, as it does when the console is killed.
    """

    def __init__(
        self, command: Sequence[str], *, on_ready: Callable[[str], None], on_failed: Callable[[str], None]
    ) -> None:
        self._command = list(command)
        self._on_ready = on_ready
        self._on_failed = on_failed
        self._process: subprocess.Popen[str] | None = None
        self._stopping = False

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    def start(self) -> None:
        self._process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        threading.Thread(target=self._watch, args=(self._process,), name="simulated-robot", daemon=True).start()

    def stop(self, *, grace_s: float = 2.0) -> None:
        self._stopping = True
        if self._process is None:
            return
        self._process.terminate()
        try:
            self._process.wait(grace_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _watch(self, process: "subprocess.Popen[str]") -> None:
        if process.stdout is None:
            raise RuntimeError("the simulated robot was started without a pipe")
        for line in process.stdout:
            found = _READY.search(line)
            if found:
                self._on_ready(found.group())
                break
        else:
            if not self._stopping:
                self._on_failed(tr("it ended with exit code {code}").format(code=process.wait()))
            return
        for line in process.stdout:
            _log.info("simulated robot: %s", line.rstrip())
