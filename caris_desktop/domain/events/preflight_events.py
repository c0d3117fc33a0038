"""Events of the preflight checks before a recording."""

from typing import Literal

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.value_class import dataclass

PreflightState = Literal["not checked", "pending", "minor", "major", "passed"]
"""``pending`` is under way; with ``minor`` a recording lacks something, with ``major`` it should not begin."""


@dataclass(frozen=True, slots=True)
class PreflightChecked:
    """How one check stands: all of them head a recording (``at_start``), and a tick by hand may follow.

    ``checked_ns`` is when a ``manual`` one was ticked by ``actor``, which may be before the recording; None where
    nobody did. ``accepted``: the wizard was asked about it and began nevertheless.
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
