"""Usage history of the command palette, per wizard."""

import json
from collections import Counter
from typing import Any

from caris_desktop.ui.palette.palette_item import PaletteItem
from caris_desktop.ui.palette.palette_search import Used
from caris_desktop.ui.wizard_profiles import WizardProfiles

RECENT = 5
OFTEN = 6
_OFTEN_FROM = 3  # uses
_KEPT = 200
_KEY = "palette/used"


class PaletteMemory:
    """Saved in the wizard profile. Items that disable a protection are not recorded: they must be searched for."""

    def __init__(self, wizards: WizardProfiles) -> None:
        self._wizards = wizards

    @property
    def used(self) -> Used:
        recent, counts = self._read()
        often = [name for name, times in counts.most_common() if times >= _OFTEN_FROM and name not in recent[:RECENT]]
        return Used(tuple(recent[:RECENT]), tuple(often[:OFTEN]))

    def note(self, entry: PaletteItem) -> None:
        """Record a use."""
        if entry.deliberate:
            return
        recent, counts = self._read()
        name = entry.id
        counts[name] += 1
        recent = [name, *(known for known in recent if known != name)][:_KEPT]
        recent_counts = {known: counts[known] for known in recent}
        self._wizards.set_value(_KEY, json.dumps({"recent": recent, "counts": recent_counts}))

    def _read(self) -> tuple[list[str], Counter[str]]:
        try:
            stored: Any = json.loads(str(self._wizards.value(_KEY, "{}")))
        except (ValueError, RecursionError):
            stored = {}
        if not isinstance(stored, dict):
            stored = {}
        recent, counts = stored.get("recent"), stored.get("counts")
        return (
            [name for name in recent if isinstance(name, str)] if isinstance(recent, list) else [],
            Counter({name: times for name, times in counts.items() if isinstance(times, int)})
            if isinstance(counts, dict)
            else Counter(),
        )
