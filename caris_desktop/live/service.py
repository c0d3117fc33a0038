"""What every part of the running console is."""

from collections.abc import Callable, Mapping
from typing import Any

from PySide6.QtCore import QObject, QTimer

from caris_desktop.domain.intents import Intent
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import dataclass
from caris_desktop.live.child_process import ChildProcess, Health
from caris_desktop.scenario.model import Scenario

PANELS_FIRST_MS = 600
"""Another scenario is to be seen at once. What only gets something ready for it waits so long: it would take the
processors from the window, and who goes on to yet another scenario needs none of it.
"""
Handler = Callable[[Any], None]
Handlers = Mapping[type[Intent], Handler]
Follows = Mapping[type[Any], Callable[[Any], None]]


class Service(QObject):
    """One part of the running console; whatever it does not say here it has not. GUI thread but for ``end``.

    The console's list gives the order: services are started in it, and stopped and ended in the reverse.
    """

    def handlers(self) -> Handlers:
        """What it can be asked. A handler raises ToldFailure where it cannot be done."""
        return {}

    def follows(self) -> Follows:
        """The events that it hears of before any panel does."""
        return {}

    def processes(self) -> Mapping[str, ChildProcess]:
        """Its child processes, by name."""
        return {}

    def restarts(self) -> "Mapping[str, Restarts]":
        """How often what ends by itself was started again, by the names of its processes."""
        return {}

    def health(self) -> dict[str, Health]:
        """How its processes are, by name; one that nothing needs now is left out."""
        there: dict[str, Health] = dict.fromkeys(self.processes(), "running")
        restarts = self.restarts().items()
        return there | {name: of.health for name, of in restarts if name in there or of.health != "running"}

    def use_scenario(self, scenario: Scenario) -> None:
        """What this scenario says holds from now on; the first comes before ``start``."""

    def start(self) -> None:
        """The window stands: start what takes time."""

    def stop(self) -> None:
        """The program ends: begin nothing new, say the last words. Returns at once, or after two seconds at most."""

    def end(self) -> None:
        """Wait for what was stopped. May take long, in any thread; touches nothing of Qt."""


@dataclass(slots=True)
class Restarts:
    """How often something that ends by itself is started again: whatever crashes again and again is left alone,
    instead of keeping the computer busy.
    """

    at_most: float = 3
    used: int = 0
    _due: bool = False

    def after_end(
        self,
        tell: Callable[[str], None],
        begin: Callable[[], None],
        *,
        after_ms: int | None = None,
        within: QObject | None = None,
    ) -> None:
        """It has ended by itself: ``tell`` the wizard, with what they can do, and ``begin`` it again unless that was
        done too often; at once, or ``after_ms`` as long as there is ``within``.
        """
        again = self.another()
        tell(self.advice)
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
        """It has ended once more: whether to start it again."""
        self.used += 1
        return not self.exhausted

    @property
    def exhausted(self) -> bool:
        return self.used > self.at_most

    @property
    def advice(self) -> str:
        """What the wizard can do."""
        return tr("It failed too often: restart the program.") if self.exhausted else tr("It is being started again.")
