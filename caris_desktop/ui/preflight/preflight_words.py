"""Texts of preflight checks."""

from collections.abc import Sequence
from datetime import datetime

from caris_desktop.domain.actor import WIZARD, in_words
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import PreflightChecked, PreflightState
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import PreflightCheck

STATES: dict[PreflightState, str] = {
    "not checked": QT_TR_NOOP("Not checked"),
    "pending": QT_TR_NOOP("Pending"),
    "minor": QT_TR_NOOP("Minor"),
    "major": QT_TR_NOOP("Major"),
    "passed": QT_TR_NOOP("Passed"),
}
_BEGAN_WITH: dict[PreflightState, str] = {
    "not checked": QT_TR_NOOP("Started with: {check} (not checked)"),
    "pending": QT_TR_NOOP("Started with: {check} (pending)"),
    "minor": QT_TR_NOOP("Started with: {check} (minor)"),
    "major": QT_TR_NOOP("Started with: {check} (major)"),
}
_BEGAN_IN_SPITE_OF: dict[PreflightState, str] = {
    "not checked": QT_TR_NOOP("Started despite: {check} (not checked)"),
    "pending": QT_TR_NOOP("Started despite: {check} (pending)"),
    "minor": QT_TR_NOOP("Started despite: {check} (minor)"),
    "major": QT_TR_NOOP("Started despite: {check} (major)"),
}
ROLES: dict[PreflightState, str] = {
    "not checked": "dim", "pending": "dim", "minor": "amber", "major": "red", "passed": "green",
}  # fmt: skip
ICONS: dict[PreflightState, str] = {
    "not checked": "circle-dashed", "pending": "hourglass", "minor": "warning", "major": "warning-octagon",
    "passed": "check-circle",
}  # fmt: skip
_WORST_FIRST: tuple[PreflightState, ...] = ("major", "minor", "not checked", "pending", "passed")


def worst(checks: Sequence[PreflightCheck]) -> PreflightState:
    """Worst state of all checks."""
    return min((check.state for check in checks), key=_WORST_FIRST.index, default="passed")


def summary(checks: Sequence[PreflightCheck], *, past: bool = False) -> str:
    """Summary as "3 of 12 to check", or for a ``past`` recording "3 of 12 checks were open"."""
    still_open = sum(check.state != "passed" for check in checks)
    if not still_open:
        return tr("All %n checks passed", "", len(checks))
    text = (
        tr("{open} of %n checks were open", "", len(checks)) if past else tr("{open} of %n to check", "", len(checks))
    )
    return text.format(open=still_open)


def open_words(checks: Sequence[PreflightCheck]) -> str:
    """Question before a recording that starts with open checks."""
    titles = [tr(check.title) for check in checks if check.asks_first]
    named = ", ".join(f"“{title}”" for title in titles[:3])
    if len(titles) > 3:
        named = tr("{some} and %n more", "", len(titles) - 3).format(some=named)
    return tr("Not ready: {checks}. Start anyway? The recording will note this.").format(checks=named)


def state_words(check: PreflightCheck, anchor: ClockAnchor) -> str:
    """State of a check; for a manual one, by whom and when it was ticked."""
    if not check.manual or check.checked_ns is None:
        return _as_sentence(tr(check.detail))
    moment = datetime.fromtimestamp(anchor.utc_ns_at(check.checked_ns) / 1e9).strftime("%H:%M")
    if check.actor == WIZARD:
        return tr("Ticked by you at {moment}.").format(moment=moment)
    return tr("Ticked by {who} at {moment}.").format(who=in_words(check.actor), moment=moment)


def _as_sentence(detail: str) -> str:
    """Capitalise a status reason, which elsewhere follows a colon."""
    return f"{detail[:1].upper()}{detail[1:].removesuffix('.')}." if detail else ""


def log_line(event: PreflightChecked) -> tuple[str, str] | None:
    """Log line of a check; None if it had passed when a recording began."""
    if not event.at_start:
        text = tr("Checked: {check}") if event.state == "passed" else tr("No longer checked: {check}")
    elif event.state == "passed":
        return None
    else:
        text = tr((_BEGAN_IN_SPITE_OF if event.accepted else _BEGAN_WITH)[event.state])
    return QT_TR_NOOP("Session"), text.format(check=tr(event.title))
