"""Practice results, saved in the wizard's profile."""

import json
from dataclasses import asdict, fields
from typing import Any

from caris_desktop.domain.value_class import dataclass
from caris_desktop.ui.wizard_profiles import WizardProfiles

_KEY = "practice"
_AT_MOST = 100


@dataclass(frozen=True, slots=True)
class PracticeRun:
    """Practice result. ``ended_utc``: ISO 8601; ``done`` of ``steps`` completed; ``score`` out of 100."""

    ended_utc: str
    done: int
    steps: int
    minutes: float
    score: int


def practised(wizards: WizardProfiles) -> tuple[PracticeRun, ...]:
    """Results of the current wizard, oldest first; unreadable ones are skipped."""
    try:
        kept = json.loads(str(wizards.own_value(_KEY, "[]")))
    except ValueError:
        return ()
    runs = [_run(item) for item in kept] if isinstance(kept, list) else []
    return tuple(run for run in runs if run is not None)


def save_run(wizards: WizardProfiles, run: PracticeRun) -> None:
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
