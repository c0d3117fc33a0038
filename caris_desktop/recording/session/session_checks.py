"""Pre-session checks of a recording, from its events."""

from collections.abc import Iterable

from caris_desktop.domain.events import PreflightChecked
from caris_desktop.domain.value_class import Value


class Preflight(Value):
    """State of each check at the start; those ticked manually afterwards are in ``ticked_later``."""

    checks: tuple[PreflightChecked, ...] = ()
    ticked_later: frozenset[str] = frozenset()

    @property
    def passed(self) -> int:
        return sum(check.state == "passed" for check in self.checks)

    @property
    def still_open(self) -> tuple[PreflightChecked, ...]:
        return tuple(check for check in self.checks if check.state != "passed")


def preflight_of(events: Iterable[PreflightChecked]) -> Preflight:
    """Fold ``events``, in order of time."""
    checks: dict[str, PreflightChecked] = {}
    ticked: set[str] = set()
    for event in events:
        if event.at_start:
            checks[event.check_id] = event
        elif event.check_id in checks and checks[event.check_id].state != "passed":
            (ticked.add if event.state == "passed" else ticked.discard)(event.check_id)
    return Preflight(tuple(checks.values()), frozenset(ticked))


def open_words(preflight: Preflight) -> list[str]:
    """Each open check with its state: ``Emergency stop is released (major; the wizard started anyway)``."""
    return [_open_words(check, later=check.check_id in preflight.ticked_later) for check in preflight.still_open]


def _open_words(check: PreflightChecked, *, later: bool) -> str:
    how: str = check.state
    if check.accepted:
        how += "; the wizard started anyway"
    if later:
        how += "; ticked later"
    return f"{check.title} ({how})"
