"""Duration relative to a fixed computation, independent of the speed of the machine."""

import time
from collections.abc import Callable

_ROUNDS = 20_000


def _computing() -> None:
    """About a millisecond of plain Python on a desktop of 2025."""
    total = 0
    for number in range(_ROUNDS):
        total += number ^ 0x55


def _seconds(work: Callable[[], object]) -> float:
    # CPU time of this thread: it does not count the time of others.
    begun_s = time.thread_time()
    work()
    return time.thread_time() - begun_s


def in_yardsticks(work: Callable[[], object], *, tries: int = 20) -> float:
    """Best of ``tries`` runs divided by the best of as many reference computations, taken alternately.

    The minimum shows the work itself; other runs include effects of other load on caches.
    """
    pairs = [(_seconds(work), _seconds(_computing)) for _ in range(tries)]
    return min(each for each, _ in pairs) / min(yardstick for _, yardstick in pairs)
