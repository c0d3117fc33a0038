"""Events of the preflight checks before a recording."""

from typing import Literal

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.value_class import dataclass

PreflightState = Literal["not checked", "pending", "minor", "major", "passed"]
"""``pending``: in progress. ``minor``: a recording lacks something. ``major``: it should not start."""


@dataclass(frozen=True, slots=True)
class PreflightChecked:
    """State of one check. A recording starts with all of them (``at_start``); manual ticks may follow.

    ``checked_ns`` is when ``actor`` ticked a ``manual`` check, possibly before the recording; None if not ticked.
    ``accepted``: the wizard was asked about it and started anyway.
    """

    stamp_ns: int
    check_id: str
    title: str
    state: PreflightState
    detail: str = ""
    manual: bool = False
    at_start: bool = False
    accepted: bool = False
    checked_ns: int | None = None
    actor: Actor = ""
