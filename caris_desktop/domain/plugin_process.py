"""Process of one plug-in, with time limits, its output captured and its log passed on."""

import contextlib
import functools
import io
import logging
import logging.handlers
import multiprocessing
import os
import pickle
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from caris_desktop.domain.plugins import ENDED, LOAD_WITHIN_S, Plugin, PluginError, load, not_returned, watched
from caris_desktop.domain.translation import QT_TR_NOOP, localized

_log = logging.getLogger(__name__)
Report = Callable[..., None]
Host = Callable[[Any], Callable[..., Any]]
"""Called in the process with what the entry point names; its result answers each request as
``answer(report, *request)``.
"""
SWITCHED_OFF: dict[Plugin, str] = {}
"""Plug-ins that failed in this process, with the reason: a hang costs its time limit once."""


def call_apart(
    plugin: Plugin, job: Callable[..., Any], *arguments: Any, within_s: float, on_report: Report = lambda *_: None
) -> Any:
    """Result of ``job(what the entry point names, report, *arguments)`` in a process for this call alone.

    The rest is as in :meth:`PluginProcess.ask`.
    """
    process = PluginProcess(plugin, functools.partial(functools.partial, job))
    try:
        return process.ask(*arguments, within_s=within_s, on_report=on_report)
    finally:
        process.close()


def why_unusable(plugin: Plugin) -> str:
    """Why the plug-in cannot be loaded, as a clause; empty if it can."""
    try:
        PluginProcess(plugin, functools.partial).close()
    except PluginError as error:
        return error.reason
    return ""


class PluginProcess:
    """Process that loads a plug-in and answers one request at a time; for one thread. It ends with this process.

    Raises PluginError if the plug-in cannot be loaded, or failed earlier in this process.
    """

    def __init__(self, plugin: Plugin, host: Host, *, load_within_s: float | None = None) -> None:
        if plugin in SWITCHED_OFF:
            raise PluginError(plugin, SWITCHED_OFF[plugin])
        self._plugin = plugin
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        # Daemonic processes may have no children, since those would outlive them; this one ends with its connection.
        multiprocessing.current_process()._config["daemon"] = False  # type: ignore[attr-defined]
        self._process = context.Process(target=_serve, args=(theirs, plugin, host), daemon=True)
        self._process.start()
        theirs.close()
        within_s = LOAD_WITHIN_S if load_within_s is None else load_within_s
        reason = localized(QT_TR_NOOP("it was not loaded within {seconds} s"), seconds=f"{within_s:g}")
        self._result(within_s, reason, lambda *_: None)

    def ask(self, *request: Any, within_s: float, on_report: Report = lambda *_: None) -> Any:
        """Answer to a request; both are pickled.

        ``report(*values)`` there calls ``on_report(*values)`` here. ``within_s`` limits the time from one report to
        the next.

        Raises PluginError if the plug-in raised, printed, ended its process or was too slow. The process is ended then.
        """
        with contextlib.suppress(OSError):  # it has ended, which its result says
            self._connection.send(request)
        return self._result(within_s, not_returned(within_s), on_report)

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()
        self._connection.close()

    def _result(self, within_s: float, reason: str, on_report: Report) -> Any:
        ends_s = time.monotonic() + within_s
        try:
            while self._connection.poll(max(0.0, ends_s - time.monotonic())):
                match _Unpickler(io.BytesIO(self._connection.recv_bytes())).load():
                    case "log", str(name), int(level), str(text):
                        logging.getLogger(name).log(level, "%s", text)
                    case "result", result:
                        return result
                    case "failed", str(failure):
                        reason = failure
                        break
                    case "report", values:
                        on_report(*values)
                        ends_s = time.monotonic() + within_s
        except (EOFError, OSError):
            reason = ENDED
        except Exception:  # whatever unpickling raises
            _log.warning("what the plug-in %s sent", self._plugin.name, exc_info=True)
            reason = QT_TR_NOOP("it returned something of an unexpected kind")
        SWITCHED_OFF[self._plugin] = reason
        self.close()
        raise PluginError(self._plugin, reason)


def _serve(connection: Connection, plugin: Plugin, host: Host) -> None:
    """Child side."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl+C reaches the whole group; this process ends with its parent
    os.dup2(2, 1)  # what a library in C prints must not get into the result of a command
    requests: queue.SimpleQueue[tuple[Any, ...]] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(connection, requests), daemon=True).start()
    sending = threading.Lock()

    def send(message: object) -> None:
        with sending:
            connection.send(message)

    to_parent = logging.handlers.QueueHandler(queue.SimpleQueue())
    to_parent.enqueue = lambda record: send(("log", record.name, record.levelno, record.getMessage()))  # type: ignore[method-assign]
    logging.getLogger().addHandler(to_parent)
    logging.getLogger().setLevel(logging.INFO)
    try:
        with watched(plugin):
            answer = host(load(plugin))
        result = None
        while True:
            send(("result", result))
            request = requests.get()
            with watched(plugin):
                result = _known(answer(lambda *values: send(("report", values)), *request))
    except PluginError as error:
        send(("failed", error.reason))


def _known(result: Any) -> Any:
    """A result; an error is one of a class that the other process knows, which does not run the plug-in's code."""
    if not isinstance(result, Exception):
        return result
    ours = ("builtins", "caris_desktop")
    kind = next(one for one in type(result).__mro__ if one.__module__.partition(".")[0] in ours)
    if kind is type(result):
        return result
    code = getattr(result, "errno", None)
    return kind(str(result)) if code is None else kind(code, str(getattr(result, "strerror", result)))


class _Unpickler(pickle.Unpickler):
    """Reader of messages that imports nothing: the code of a plug-in stays in its own process."""

    def find_class(self, module: str, name: str) -> Any:
        if module not in sys.modules:
            raise pickle.UnpicklingError(f"{module}.{name} is not known here")
        return super().find_class(module, name)


def _read(connection: Connection, requests: "queue.SimpleQueue[tuple[Any, ...]]") -> None:
    try:
        while True:
            requests.put(connection.recv())
    except (EOFError, OSError):
        os._exit(1)
