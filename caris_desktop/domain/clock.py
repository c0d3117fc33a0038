"""The one monotonic clock of a session.

``time.monotonic_ns`` counts from the same origin in every process of a machine, so values stamped in
different child processes can be compared without translation.
"""

import time

from caris_desktop.domain.value_class import dataclass

now_ns = time.monotonic_ns


# A stamp that is further off than this is of another clock than the one that the robot tells.
_PLAUSIBLE_WAY_NS = 10_000_000_000
# What is known no better says less of a moment than the arrival does.
_USEFUL_UNCERTAINTY_NS = 100_000_000


@dataclass(frozen=True, slots=True)
class ClockAnchor:
    """One reading of both clocks, which maps session time to UTC."""

    monotonic_ns: int
    utc_ns: int

    @classmethod
    def take(cls) -> "ClockAnchor":
        return cls(monotonic_ns=time.monotonic_ns(), utc_ns=time.time_ns())

    def utc_ns_at(self, monotonic_ns: int) -> int:
        return self.utc_ns + (monotonic_ns - self.monotonic_ns)


def measured_ns(robot_stamp_ns: int | None, *, arrival_ns: int, offset_ns: int, uncertainty_ns: int) -> int | None:
    """When the robot measured what arrived at ``arrival_ns``, on our clock; None where its stamp does not tell.

    ``offset_ns`` is the robot's clock minus ours, right to within ``uncertainty_ns``; so is the moment then.
    """
    if robot_stamp_ns is None or uncertainty_ns > _USEFUL_UNCERTAINTY_NS:
        return None
    at_ns = robot_stamp_ns - offset_ns
    if not arrival_ns - _PLAUSIBLE_WAY_NS <= at_ns <= arrival_ns + uncertainty_ns:
        return None
    return min(at_ns, arrival_ns)
