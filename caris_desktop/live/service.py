"""Base classes of services, their processes, and the restart policy of these."""

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from PySide6.QtCore import QObject, Qt, QTimer, Signal

from caris_desktop.domain import clock
from caris_desktop.domain.events import Problem
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.plugins import ENDED, Plugin, PluginCall, not_returned
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ChildProcess, Health, ProcessSpec
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.scenario_model import Scenario

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

        def on_exit(_code: int | None) -> None:
            if not self._closed:
                self.call_in_gui(ended, child)

        child = ChildProcess(body, on_message=reads or partial(self.pass_on, on_message), on_exit=on_exit)
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


PANELS_FIRST_MS = 600
"""Delay of preparatory work after a scenario change: the window needs the processors first, and a further change may
make it unnecessary.
"""
Handler = Callable[[Any], None]
Handlers = Mapping[type[Intent], Handler]
Follows = Mapping[type[Any], Callable[[Any], None]]


class Service(QObject):
    """Base class of a console service; the defaults do nothing. GUI thread except ``end``.

    Services start in the order of the console's list; they stop and end in reverse order.
    """

    def handlers(self) -> Handlers:
        """Handlers by intent type. A handler raises UserFacingError if it fails."""
        return {}

    def follows(self) -> Follows:
        """Event handlers, called before any panel."""
        return {}

    def supervised(self) -> "Iterable[SupervisedProcess]":
        """Processes of the service, running or not."""
        return ()

    def processes(self) -> Mapping[str, ChildProcess]:
        """Child processes by name."""
        return {each.child.body.name: each.child for each in self.supervised() if each.child is not None}

    def restarts(self) -> "Mapping[str, Restarts]":
        """Restart policies by process name."""
        return {each.name: each.restarts for each in self.supervised() if each.name}

    def health(self) -> dict[str, Health]:
        """Health of the processes by name, without those that are not needed."""
        there: dict[str, Health] = dict.fromkeys(self.processes(), "running")
        restarts = self.restarts().items()
        return there | {name: of.health for name, of in restarts if name in there or of.health != "running"}

    def use_scenario(self, scenario: Scenario) -> None:
        """Apply a scenario; first called before ``start``."""

    def start(self) -> None:
        """Start slow work, once the window is shown."""

    def stop(self) -> None:
        """Begin shutting down: no new work, last messages. Returns within two seconds."""

    def end(self) -> None:
        """Wait for what was stopped: first of all its processes. May take long, in any thread; does not use Qt."""
        for each in self.supervised():
            each.end()


class ServiceContext(Value):
    """Shared parts of the console: ``children`` starts processes, ``slow_work`` reads and writes files, and ``parent``
    owns the services.
    """

    state: LiveState
    bus: Bus
    children: ProcessManager
    slow_work: BackgroundWorker
    parent: QObject


class ContextService(Service):
    """Service that uses the shared parts."""

    _scenario: Scenario
    """Scenario in use, if the service keeps it: from its first ``use_scenario`` on, before anything else happens."""

    def __init__(self, context: ServiceContext) -> None:
        super().__init__(context.parent)
        self._state, self._bus = context.state, context.bus
        self._children, self._slow_work = context.children, context.slow_work


@dataclass(slots=True)
class Restarts:
    """Restart policy: a process that keeps crashing is given up, instead of loading the computer."""

    at_most: float = 3
    used: int = 0
    _due: bool = False

    def after_end(
        self,
        report: Callable[[str], None],
        begin: Callable[[], None],
        *,
        after_ms: int | None = None,
        within: QObject | None = None,
    ) -> None:
        """Handle an unexpected exit: report it with advice through ``report``, and restart with ``begin`` unless it
        failed too often; at once, or after ``after_ms`` while ``within`` exists.
        """
        again = self.another()
        report(self.advice)
        if not again:
            return
        if after_ms is None or within is None:
            begin()
            return

        def begin_late() -> None:
            self._due = False
            begin()

        self._due = True
        QTimer.singleShot(after_ms, within, begin_late)

    @property
    def health(self) -> Health:
        return "failed" if self.exhausted else "restarting" if self._due else "running"

    def another(self) -> bool:
        """Count an exit; returns whether to restart."""
        self.used += 1
        return not self.exhausted

    @property
    def exhausted(self) -> bool:
        return self.used > self.at_most

    @property
    def advice(self) -> str:
        """Advice for the wizard."""
        return tr("It failed too often: restart the program.") if self.exhausted else tr("It is being restarted.")


class SupervisedProcess:
    """Child process of a service, one at a time, started when it is needed. GUI thread.

    ``ended`` is called after an unexpected end; ``on_message`` and ``reads`` as in :meth:`ProcessManager.new`.
    ``grace_s`` is the time to end before it is killed.
    """

    def __init__(
        self,
        children: ProcessManager,
        *,
        ended: Callable[[], None],
        on_message: Sink,
        reads: Reads | None = None,
        grace_s: float = 1.0,
        name: str = "",
    ) -> None:
        self._children = children
        self._ended = ended
        self._on_message = on_message
        self._reads = reads
        self._grace_s = grace_s
        self.name = name
        """Name under which restarts are reported; empty before the first start, unless given."""
        self.child: ChildProcess | None = None
        self.restarts = Restarts()

    def start(self, body: ProcessSpec) -> ChildProcess:
        """Start it, in place of one that has ended or was dismissed, whose messages are ignored from now on."""

        def on_message(message: Any) -> None:
            if child is self.child:
                self._on_message(message)

        self.name = body.name
        child = self.child = self._children.start(body, ended=self.on_ended, on_message=on_message, reads=self._reads)
        return child

    def send(self, message: Any) -> bool:
        """Send without waiting; False if impossible. Any thread."""
        child = self.child
        return child is not None and child.send(message)

    def dismiss(self, then: Callable[[], None] = lambda: None) -> bool:
        """End it because it is not needed now; ``then`` as in :meth:`ProcessManager.dismiss`. False if none runs."""
        child, self.child = self.child, None
        if child is not None:
            self._children.dismiss(child, grace_s=self._grace_s, then=then)
        return child is not None

    def kill(self) -> None:
        """Kill it because it hangs. Its end is reported."""
        if self.child is not None:
            self.child.kill()

    def ask_to_end(self) -> None:
        """Begin to end it with the program."""
        if self.child is not None:
            self.child.ask_to_end()

    def end(self) -> None:
        """Wait for its end. Any thread."""
        if self.child is not None:
            self.child.stop(grace_s=self._grace_s)

    def on_ended(self, child: ChildProcess) -> None:
        """Handle an exit, unless another process has replaced this one meanwhile."""
        if child is self.child:
            self.child = None
            self._ended()
