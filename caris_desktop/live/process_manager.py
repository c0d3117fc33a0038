"""Process manager: starts child processes for services and delivers their messages in the GUI thread."""

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from PySide6.QtCore import QObject, Qt, Signal

from caris_desktop.domain import clock
from caris_desktop.domain.events import Problem
from caris_desktop.domain.plugins import ENDED, Plugin, PluginCall, not_returned
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.domain.translation import tr
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ChildProcess, ProcessSpec

Sink = Callable[[Any], None]
Reads = Callable[[Any, bytes], None]


class ProcessManager(QObject):
    """Creates children whose messages and exits are delivered in the GUI thread, until ``close``."""

    _received = Signal(object, object)

    def __init__(self, bus: Bus, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._bus = bus
        self._ends: list[threading.Thread] = []
        self._closed = False
        self._received.connect(self._notify, Qt.ConnectionType.QueuedConnection)

    def close(self) -> None:
        """Ignore further exits: the program is ending."""
        self._closed = True

    def new(
        self, body: ProcessSpec, *, ended: Callable[[ChildProcess], None], on_message: Sink, reads: Reads | None = None
    ) -> ChildProcess:
        """Create a child without starting it.

        ``ended(child)`` and ``heard(message)`` are called in the GUI thread; ``on_message`` gets messages that are not
        stream values, which go to the bus. ``reads(value, raw)`` receives everything instead, in the reader thread.
        """

        def read(value: Any, raw: bytes) -> None:
            self.pass_on(on_message, value, raw)

        def on_exit(_code: int | None) -> None:
            if not self._closed:
                self.call_in_gui(ended, child)

        child = ChildProcess(body, on_message=reads or read, on_exit=on_exit)
        return child

    def start(
        self, body: ProcessSpec, *, ended: Callable[[ChildProcess], None], on_message: Sink, reads: Reads | None = None
    ) -> ChildProcess:
        """Create and start a child."""
        child = self.new(body, ended=ended, on_message=on_message, reads=reads)
        child.start()
        return child

    def dismiss(self, child: ChildProcess, *, grace_s: float, then: Callable[[], None] = lambda: None) -> None:
        """End a child that this scenario does not need. Returns at once; a thread waits for its exit, so that neither
        the next scenario nor a file nor another exit is delayed.

        ``then`` is called in that thread after the exit.
        """
        child.ask_to_end()

        def end() -> None:
            child.stop(grace_s=grace_s)
            then()

        self._ends = [thread for thread in self._ends if thread.is_alive()]
        self._ends.append(threading.Thread(target=end, name=f"end-{child.body.name}", daemon=True))
        self._ends[-1].start()

    def end(self) -> None:
        """Wait for all dismissed children. Any thread; blocks up to their longest grace time."""
        for thread in self._ends:
            thread.join()
        self._ends.clear()

    def pass_on(self, on_message: Sink, value: Any, raw: bytes) -> None:
        """Deliver a child's message to the bus, or to ``on_message`` in the GUI thread. Any thread."""
        if type(value) in BY_TYPE:
            self._bus.publish(localize_problem(value) if isinstance(value, Problem) else value, raw)
        else:
            self.call_in_gui(on_message, value)

    def call_in_gui(self, take: Callable[[Any], None], value: Any) -> None:
        """Call ``take(value)`` in the GUI thread, in order. Any thread."""
        self._received.emit(take, value)

    def _notify(self, take: Callable[[Any], None], value: Any) -> None:
        if not (self._closed and isinstance(value, ChildProcess)):
            take(value)


def localize_problem(problem: Problem) -> Problem:
    """Localise a problem of a child process, which reports in English with separate values."""
    what, meaning, advice = (tr(text) if text else "" for text in (problem.what, problem.meaning, problem.advice))
    return replace(problem, what=what, meaning=meaning, advice=advice)


# Watch over a plug-in that a child process calls.


class PluginWatch:
    """The call in progress, from the messages of one child process. ``note`` may be called in its reader thread."""

    def __init__(self) -> None:
        self._called = (PluginCall(), 0)

    def note(self, call: PluginCall) -> None:
        self._called = (call, clock.now_ns())

    @property
    def called(self) -> Plugin | None:
        """Plug-in that has not returned."""
        return self._called[0].plugin

    @property
    def overdue(self) -> bool:
        """Whether it should have returned: its process must be ended."""
        call, since_ns = self._called
        return call.plugin is not None and clock.now_ns() - since_ns >= call.within_s * 1e9

    @property
    def blame(self) -> str:
        """Why the plug-in is to blame for the end of the process, as a clause."""
        return not_returned(self._called[0].within_s) if self.overdue else ENDED
