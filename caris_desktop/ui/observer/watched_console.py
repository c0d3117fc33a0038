"""Read-only view of the console for observer panels."""

from dataclasses import replace
from typing import Any, cast

from caris_desktop.domain.intents import Intent
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.scenario_model import Scenario


class WatchedConsole:
    """Proxy of ``console`` for display-only panels.

    ``discreet``: hides names and the language model, so that neither names nor suggestions appear.
    """

    def __init__(self, console: WizardConsole, *, discreet: bool) -> None:
        self._console = console
        self._discreet = discreet

    def __getattr__(self, name: str) -> Any:
        return getattr(self._console, name)

    @property
    def scenario(self) -> Scenario:
        scenario = self._console.scenario
        if not self._discreet:
            return scenario
        return replace(
            scenario, permissions=replace(scenario.permissions, naming_people=False, assistant=False, notes=False)
        )

    def do(self, _intent: Intent) -> str:
        return ""


def watched(console: WizardConsole, *, discreet: bool) -> WizardConsole:
    return cast("WizardConsole", WatchedConsole(console, discreet=discreet))
