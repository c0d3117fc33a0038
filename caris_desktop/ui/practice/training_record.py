"""What each wizard's practice came to, kept in their profile."""

import json
from dataclasses import asdict, fields
from typing import Any

from caris_desktop.domain.value_class import dataclass
from caris_desktop.ui.wizard_profiles import WizardProfiles

_KEY = "practice"
_AT_MOST = 100


@dataclass(frozen=True, slots=True)
class PracticeRun:
    """``ended_utc`` is an ISO 8601 time; ``done`` of ``steps`` came about; ``score`` is of 100."""

    ended_utc: str
    done: int
    steps: int
    minutes: float
    score: int


def practised(wizards: WizardProfiles) -> tuple[PracticeRun, ...]:
    """The runs of the present wizard, oldest first; what cannot be read is left out."""
    try:
        kept = json.loads(str(wizards.own_value(_KEY, "[]")))
    except ValueError:
        return ()
    runs = [_run(item) for item in kept] if isinstance(kept, list) else []
    return tuple(run for run in runs if run is not None)


def keep(wizards: WizardProfiles, run: PracticeRun) -> None:
    runs = (*practised(wizards), run)[-_AT_MOST:]
    wizards.set_value(_KEY, json.dumps([asdict(one) for one in runs]))


def _run(item: Any) -> PracticeRun | None:
    if not isinstance(item, dict) or {field.name for field in fields(PracticeRun)} - set(item):
        return None
    try:
        return PracticeRun(
            str(item["ended_utc"]), int(item["done"]), int(item["steps"]), float(item["minutes"]), int(item["score"])
        )
    except (TypeError, ValueError):
        return None
