"""The one monotonic clock of a session.

``time.monotonic_ns`` counts from the same origin in every process of a machine, so values stamped in
different child processes can be compared without translation.
"""

import time
from dataclasses import dataclass

now_ns = time.monotonic_ns


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
