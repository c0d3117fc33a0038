"""Looks at an unknown robot: what it offers, which profile fits it, and whether what a profile names really comes.

Everything here is asyncio and opens connections of its own; ``*_blocking`` functions are for where no loop runs.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from caris_desktop.domain.failure import ToldFailure
from caris_desktop.robot.profile import RobotProfile, SecuritySettings
from caris_desktop.robot.proposal import Offer, Proposal
from caris_desktop.ros.dialect import Dialect

StreamState = Literal["good", "slow", "quiet", "nothing", "wrong"]


class ExploreError(ToldFailure):
    """The robot cannot be asked."""


@dataclass(frozen=True, slots=True)
class Resemblance:
    """A profile of the list that this robot may be: ``share`` of the names in it are there with the right type."""

    name: str
    title: str
    share: float


@dataclass(frozen=True, slots=True)
class Exploration:
    """What was found at an address. ``resembles`` comes best first and may be empty."""

    address: str
    offer: Offer
    proposal: Proposal
    resembles: tuple[Resemblance, ...]


@dataclass(frozen=True, slots=True)
class StreamCheck:
    """One stream of a profile after listening for a moment.

    ``state``: good; slow (comes, but more rarely than the console needs); quiet (nothing came, and need not: it comes
    only at times); nothing (nothing came, and should have); wrong (what came is not what the profile says).
    ``rate_hz`` is None for fewer than two messages, ``age_s`` (since the last one) for none. ``detail`` is a sentence.
    """

    field: str
    label: str
    topic: str
    state: StreamState
    rate_hz: float | None
    age_s: float | None
    detail: str


# async def detect_dialect(address: str, *, security: SecuritySettings | None = None, timeout_s: float = 3.0) -> Dialect
# async def explore_robot(address: str, *, security: SecuritySettings | None = None, timeout_s: float = 10.0,
#     namespace: str | None = None, on_progress: Callable[[str], None] | None = None) -> Exploration
# async def check_streams(profile: RobotProfile, address: str | None = None, *, seconds: float = 3.0,
#     timeout_s: float = 8.0, on_check: Callable[[StreamCheck], None] | None = None) -> tuple[StreamCheck, ...]
# def load_profile_blocking(name_or_path_or_url: str, *, timeout_s: float = 2.0) -> RobotProfile
