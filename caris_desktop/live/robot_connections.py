"""Stop of live robots from a replay, which is another program: discovery of this user's consoles on this computer.

Each console listens on a local socket in a folder that only this user can enter. A replay can request a stop and an
emergency stop, nothing else; a second start of a console requests its window. Each request is confirmed. GUI thread,
except :func:`show_window`.
"""

import hashlib
import json
import logging
import os
import socket
import tempfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any, Literal

from PySide6.QtCore import QObject, Signal
from PySide6.QtNetwork import QLocalServer, QLocalSocket

from caris_desktop.domain import intents
from caris_desktop.domain.events import Severity
from caris_desktop.domain.translation import tr
from caris_desktop.live.background_worker import BackgroundWorker, new_timer
from caris_desktop.live.state import LiveValue
from caris_desktop.live.status import LiveRobotsStatus
from caris_desktop.live.wizard_console import WizardConsole

_log = logging.getLogger(__name__)
_POLL_EVERY_MS = 500
CONFIRMED_WITHIN_MS = 2000
_LONGEST_LINE_BYTES = 4096
# Socket addresses are limited to 104 bytes on some systems; Qt appends ten temporarily.
_LONGEST_PATH_BYTES = 90
_REACHED = ("connected", "trouble")

Order = Literal["stop", "emergency_stop"]


def _meeting_place(folder: Path) -> Path:
    """Folder of the sockets, which only its owner can enter. Raises OSError."""
    if len(os.fsencode(folder)) > _LONGEST_PATH_BYTES - 10:
        short = hashlib.sha256(os.fsencode(folder)).hexdigest()[:16]
        folder = Path(tempfile.gettempdir()) / f"caris-desktop-{short}"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    held = folder.lstat()
    if held.st_uid != os.getuid() or folder.is_symlink():
        raise OSError(f"{folder} belongs to another user")
    if held.st_mode & 0o077:
        folder.chmod(0o700)
    return folder


def _own_place(folder: Path) -> Path | None:
    """Socket path of this console; None if unavailable. Reads files."""
    try:
        folder = _meeting_place(folder)
        for left in folder.iterdir():
            if left.name.isdecimal() and not _runs(left.name):
                left.unlink(missing_ok=True)  # left by a killed console
        socket_path = folder / str(os.getpid())
        socket_path.unlink(missing_ok=True)
    except OSError:
        _log.exception("replays cannot stop this console's robot")
        return None
    return socket_path


def _runs(pid: str) -> bool:
    import psutil  # imported late: the first window does not need it

    return bool(psutil.pid_exists(int(pid)))


def _found_consoles(folder: Path) -> list[Path]:
    """Socket paths of running consoles. Reads files."""
    try:
        found = [path for path in _meeting_place(folder).iterdir() if path.name.isdecimal()]
    except OSError:
        _log.debug("no live console can be found", exc_info=True)
        return []
    return [path for path in found if _runs(path.name)]


def show_window(folder: Path, pid: int) -> bool:
    """Ask the console of this process to show its window; whether it did. False while it starts or ends. Blocks."""
    try:
        with closing(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)) as console:
            console.settimeout(CONFIRMED_WITHIN_MS / 1e3)
            console.connect(os.fspath(_meeting_place(folder) / str(pid)))
            console.sendall(json.dumps({"do": "show_window"}).encode() + b"\n")
            with console.makefile("r", encoding="utf-8") as lines:
                return any(json.loads(line).get("did") == "show_window" for line in lines)
    except (OSError, ValueError):
        _log.debug("the console of process %d does not answer", pid, exc_info=True)
        return False


class RobotConnections(QObject):
    """Server side: lets replays stop this console's robot, and sends them its state."""

    window_requested = Signal()  # by a second start of the console

    def __init__(self, console: WizardConsole, folder: Path, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._console = console
        self._folder = folder
        self._clients: list[_Lines] = []
        self._ended = False
        self._server = QLocalServer(self)
        self._server.setSocketOptions(QLocalServer.SocketOption.UserAccessOption)
        self._server.newConnection.connect(self._on_new_connection)
        self._sent: dict[str, Any] = {}
        console.state.link.changed.connect(self._on_changed)
        console.state.drive.changed.connect(self._on_changed)

    def start(self) -> None:
        """Start listening. On failure the console works without; replays then find none."""
        self._console.run_in_background(lambda: _own_place(self._folder), self._listen)

    def _listen(self, socket_path: Path | None) -> None:
        if socket_path is None or self._ended:
            return
        if not self._server.listen(str(socket_path)):
            _log.error("replays cannot stop this console's robot: %s", self._server.errorString())

    def shutdown(self) -> None:
        self._ended = True
        self._server.close()
        for client in self._clients:
            client.close()
        self._clients.clear()

    def _on_new_connection(self) -> None:
        while (pending := self._server.nextPendingConnection()) is not None:
            client = _Lines(pending, self._on_message, self._on_gone)
            self._clients.append(client)
            client.send(self._present())
            client.read()

    def _on_message(self, client: "_Lines", message: dict[str, Any]) -> None:
        order = message.get("do")
        if order == "stop":
            self._console.do(intents.Stop())
        elif order == "emergency_stop":
            self._console.do(intents.EmergencyStop())
        elif order == "show_window":
            self.window_requested.emit()
        else:
            return
        _log.info("another window asked for %s", order)
        client.send({"did": order})

    def _on_gone(self, client: "_Lines") -> None:
        if client in self._clients:
            self._clients.remove(client)

    def _present(self) -> dict[str, Any]:
        link = self._console.state.link.value
        return {
            "robot": "" if link.state == "closed" else link.robot or tr("The robot"),
            "reached": link.state in _REACHED,
            "emergency_stop": self._console.state.drive.value.emergency_stop,
        }

    def _on_changed(self, _value: object) -> None:
        present = self._present()
        if present != self._sent:
            self._sent = present
            for client in self._clients:
                client.send(present)


class LiveRobots(QObject):
    """Client side in a replay: ``status`` holds a LiveRobotsStatus of all running consoles; their robots can be
    stopped.
    """

    def __init__(
        self, folder: Path, problem: Callable[[Severity, str, str, str], None], parent: QObject | None = None
    ) -> None:
        super().__init__(parent)
        self._folder = folder
        self._problem = problem
        self.status = LiveValue(LiveRobotsStatus(), self)
        self._consoles: dict[str, _Lines] = {}
        self._present: dict[str, dict[str, Any]] = {}
        self._unconfirmed: dict[str, list[str]] = {}
        self._slow_work = BackgroundWorker(self)
        self._looking = False
        self._search_timer = new_timer(self, self._find_consoles, _POLL_EVERY_MS)
        self._patience = new_timer(self, self._on_not_confirmed, CONFIRMED_WITHIN_MS, single_shot=True)

    def start(self) -> None:
        self._search_timer.start()
        self._find_consoles()

    def shutdown(self) -> None:
        self._search_timer.stop()
        self._slow_work.finish(lambda _words, wait: wait())
        self._patience.stop()
        consoles, self._consoles = self._consoles, {}
        for console in consoles.values():
            console.close()

    def stop(self, nobody: Callable[[], None] = lambda: None) -> None:
        """Stop all robots; ``nobody`` is called if no console runs."""
        self._ask("stop", nobody)

    def emergency_stop(self, nobody: Callable[[], None] = lambda: None) -> None:
        """Emergency stop; like ``stop``."""
        self._ask("emergency_stop", nobody)

    def _ask(self, order: Order, nobody: Callable[[], None]) -> None:
        """Send to known consoles at once, and to new ones when found."""
        recipients = set(self._consoles)
        self._send(order, recipients)

        def found(paths: list[Path]) -> None:
            self._connect_new(paths)
            self._send(order, set(self._consoles) - recipients)
            if not (recipients or self._consoles):
                nobody()

        self._slow_work.do(lambda: _found_consoles(self._folder), found, lambda _failure: nobody())

    def _send(self, order: Order, names: set[str]) -> None:
        for name in names & self._consoles.keys():
            self._unconfirmed.setdefault(name, []).append(order)
            self._consoles[name].send({"do": order})
            self._patience.start()

    def _find_consoles(self) -> None:
        if self._looking:
            return  # an unresponsive disk is queried once
        self._looking = True

        def found(paths: list[Path]) -> None:
            self._looking = False
            self._connect_new(paths)

        self._slow_work.do(lambda: _found_consoles(self._folder), found, lambda _failure: None)

    def _connect_new(self, paths: list[Path]) -> None:
        for path in paths:
            if path.name in self._consoles:
                continue
            console = QLocalSocket(self)
            console.connectToServer(str(path))
            if console.state() == QLocalSocket.LocalSocketState.ConnectedState:
                self._consoles[path.name] = _Lines(console, self._on_message, self._on_gone)
            else:
                console.deleteLater()  # just ended, or still starting

    def _name_of(self, console: "_Lines") -> str:
        return next((name for name, known in self._consoles.items() if known is console), "")

    def _on_message(self, console: "_Lines", message: dict[str, Any]) -> None:
        name = self._name_of(console)
        if "did" in message:
            waiting = self._unconfirmed.get(name, [])
            if message["did"] in waiting:
                waiting.remove(message["did"])
            if not any(self._unconfirmed.values()):
                self._patience.stop()
            if message["did"] == "emergency_stop" and not self._present.get(name, {}).get("reached"):
                self._report_not_done(tr("The live console cannot currently reach the robot."), name)
        else:
            self._present[name] = message
            self._show()

    def _on_gone(self, console: "_Lines") -> None:
        name = self._name_of(console)
        self._consoles.pop(name, None)
        if self._unconfirmed.pop(name, None):
            self._report_not_done(tr("The live console closed before it responded."), name)
        self._present.pop(name, None)
        self._show()

    def _on_not_confirmed(self) -> None:
        for name, orders in self._unconfirmed.items():
            if orders:
                orders.clear()
                self._report_not_done(tr("The live console does not respond."), name)

    def _report_not_done(self, what: str, name: str) -> None:
        robot = self._present.get(name, {}).get("robot") or tr("Its robot")
        self._problem(
            "error", what, tr("{robot} may not have been stopped.").format(robot=robot),
            tr("Stop it in the live window or with the robot's own emergency stop button."),
        )  # fmt: skip

    def _show(self) -> None:
        with_robot = [present for _name, present in sorted(self._present.items()) if present.get("robot")]
        self.status.set(
            LiveRobotsStatus(
                tuple(str(present["robot"]) for present in with_robot),
                emergency_stop=bool(with_robot) and all(present.get("emergency_stop") for present in with_robot),
            )
        )


class _Lines:
    """JSON objects, one per line, over a local socket owned by a QObject."""

    def __init__(
        self,
        socket: QLocalSocket,
        on_message: Callable[["_Lines", dict[str, Any]], None],
        on_closed: Callable[["_Lines"], None],
    ) -> None:
        self._socket = socket
        self._on_message = on_message
        self._on_closed = on_closed
        self._unread = b""
        socket.readyRead.connect(self.read)
        socket.disconnected.connect(self._on_disconnected)

    def send(self, message: dict[str, Any]) -> None:
        self._socket.write(json.dumps(message).encode() + b"\n")
        self._socket.flush()

    def read(self) -> None:
        self._unread += bytes(self._socket.readAll().data())
        *lines, self._unread = self._unread.split(b"\n")
        if len(self._unread) > _LONGEST_LINE_BYTES:
            self._socket.abort()
            return
        for line in lines:
            try:
                message = json.loads(line)
            except (ValueError, RecursionError):
                continue
            if isinstance(message, dict):
                self._on_message(self, message)

    def close(self) -> None:
        self._socket.disconnected.disconnect(self._on_disconnected)
        self._socket.abort()
        self._socket.deleteLater()

    def _on_disconnected(self) -> None:
        self._on_closed(self)
        self._socket.deleteLater()
