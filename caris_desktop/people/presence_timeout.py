"""Presence timeout per camera: how long a person counts as present after the last detection.

It grows with the detection interval and latency of the camera: without a detection run, absence is unknown.
"""

import itertools
from collections import deque

_MOST_NS = 6_000_000_000
# Number of detection runs whose longest interval counts, and how many such intervals without a person mean a departure.
_LOOKS, _LOOKS_MISSED = 5, 2.5


class PresenceTimeout:
    """Timeout per camera, from its recent detection runs."""

    def __init__(self, least_ns: int) -> None:
        self._least_ns = least_ns
        self._looks_ns: dict[str, deque[int]] = {}
        self._late_ns: dict[str, deque[int]] = {}

    def note_detection(self, camera: str, taken_ns: int, known_ns: int) -> None:
        self._looks_ns.setdefault(camera, deque(maxlen=_LOOKS)).append(taken_ns)
        self._late_ns.setdefault(camera, deque(maxlen=_LOOKS)).append(known_ns - taken_ns)

    def in_pictures_ns(self, camera: str) -> int:
        """Timeout in image time: from the last detection to a later image without the person."""
        looks_ns = self._looks_ns.get(camera, ())
        apart_ns = max((after - before for before, after in itertools.pairwise(looks_ns)), default=0)
        return max(self._least_ns, min(round(_LOOKS_MISSED * apart_ns), _MOST_NS))

    def now_ns(self, camera: str) -> int:
        """Timeout in real time: from the last detection until now, including latency."""
        late_ns = max(self._late_ns.get(camera, ()), default=0)
        return self.in_pictures_ns(camera) + min(late_ns, _MOST_NS)
