"""Driving time: one definition for measures, report, timeline, tiers and training data."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

COMMAND_HOLDS_S = 0.3
"""A velocity command counts as driving until the next one, but no longer than this."""


def held_until_ns(
    stamps_ns: NDArray[np.int64], *, ended_ns: int, pauses: Sequence[tuple[int, int]] = ()
) -> NDArray[np.int64]:
    """End of each velocity command: the next one, the end of the recording, a pause, or ``COMMAND_HOLDS_S``.

    ``stamps_ns`` is sorted. A command counts as driving if any velocity component is nonzero, however slow.
    """
    if not stamps_ns.size:
        return stamps_ns
    breaks_ns = np.sort(np.array([*(begin_ns for begin_ns, _ in pauses), max(ended_ns, int(stamps_ns[-1]))], np.int64))
    next_break_ns = breaks_ns[np.minimum(np.searchsorted(breaks_ns, stamps_ns), len(breaks_ns) - 1)]
    next_ns = np.append(stamps_ns[1:], breaks_ns[-1])
    held_ns: NDArray[np.int64] = np.minimum(np.minimum(next_ns, next_break_ns), stamps_ns + int(COMMAND_HOLDS_S * 1e9))
    return held_ns
