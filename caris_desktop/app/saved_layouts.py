"""What arrangement of panels a scenario had before the wizard saved her own, so that it can be had back."""

import json
import logging
from pathlib import Path
from typing import Any

from PySide6.QtCore import QSettings

from caris_desktop.scenario.layout import checked_layout, layout_data
from caris_desktop.scenario.model import LayoutNode, Scenario

_log = logging.getLogger(__name__)
_KEY = "layouts_before_saving"


class SavedLayouts:
    """Kept in the user's settings, for each scenario file that an arrangement was saved in."""

    def __init__(self, settings: QSettings) -> None:
        self._settings = settings

    def before(self, scenario: Scenario) -> LayoutNode | None:
        """The arrangement that saving replaced; None where the file has none that was saved by this program."""
        known = self._all().get(str(scenario.path))
        # Whoever wrote another arrangement into the file by hand means that one.
        if not isinstance(known, dict) or known.get("saved") != layout_data(scenario.layout):
            return None
        try:
            return checked_layout(known.get("before"))
        except ValueError as error:
            _log.warning("the arrangement of %s before it was saved cannot be had back: %s", scenario.path, error)
            return None

    def note(self, path: Path, saved: LayoutNode, *, replaced: Scenario) -> None:
        """``saved`` went into ``path``; ``replaced`` is the scenario as it was open until then."""
        before = self.before(replaced) or replaced.layout
        self._keep(self._all() | {str(path): {"before": layout_data(before), "saved": layout_data(saved)}})

    def forget(self, path: Path) -> None:
        self._keep({known: layouts for known, layouts in self._all().items() if known != str(path)})

    def _all(self) -> dict[str, Any]:
        try:
            known = json.loads(str(self._settings.value(_KEY, "{}")))
        except ValueError:
            known = None
        return known if isinstance(known, dict) else {}

    def _keep(self, known: dict[str, Any]) -> None:
        self._settings.setValue(_KEY, json.dumps(known))
