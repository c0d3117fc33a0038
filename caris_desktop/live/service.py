"""Base class of services, and restart policy of their processes."""

from collections.abc import Callable, Mapping
from typing import Any

from PySide6.QtCore import QObject, QTimer

from caris_desktop.domain.intents import Intent
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import dataclass
from caris_desktop.live.child_process import ChildProcess, Health
from caris_desktop.scenario.scenario_model import Scenario

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

    def processes(self) -> Mapping[str, ChildProcess]:
        """Child processes by name."""
        return {}

    def restarts(self) -> "Mapping[str, Restarts]":
        """Restart policies by process name."""
        return {}

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
        """Wait for what was stopped. May take long, in any thread; does not use Qt."""


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
