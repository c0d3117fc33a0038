"""For how long somebody is still here who is not seen: longer where a camera is looked at rarely, or known late.

Who was not looked for is not gone, and until a look is known nobody knows better.
"""

import itertools
from collections import deque

_MOST_NS = 6_000_000_000
# Of how many looks the longest pause counts, and how many pauses of that length without somebody are a leaving.
_LOOKS, _LOOKS_MISSED = 5, 2.5


class Patience:
    """With each camera, from the last looks through it."""

    def __init__(self, least_ns: int) -> None:
        self._least_ns = least_ns
        self._looks_ns: dict[str, deque[int]] = {}
        self._late_ns: dict[str, deque[int]] = {}

    def note_look(self, camera: str, taken_ns: int, known_ns: int) -> None:
        self._looks_ns.setdefault(camera, deque(maxlen=_LOOKS)).append(taken_ns)
        self._late_ns.setdefault(camera, deque(maxlen=_LOOKS)).append(known_ns - taken_ns)

    def in_pictures_ns(self, camera: str) -> int:
        """From when somebody was seen to when another picture was taken without them."""
        looks_ns = self._looks_ns.get(camera, ())
        apart_ns = max((after - before for before, after in itertools.pairwise(looks_ns)), default=0)
        return max(self._least_ns, min(round(_LOOKS_MISSED * apart_ns), _MOST_NS))

    def now_ns(self, camera: str) -> int:
        """From when somebody was seen until now."""
        late_ns = max(self._late_ns.get(camera, ()), default=0)
        return self.in_pictures_ns(camera) + min(late_ns, _MOST_NS)
