"""How long something takes, whatever the machine: in units of a fixed piece of computing."""

import time
from collections.abc import Callable

_ROUNDS = 20_000


def _computing() -> None:
    """About a millisecond of plain Python on a desktop of 2025."""
    total = 0
    for number in range(_ROUNDS):
        total += number ^ 0x55


def _seconds(work: Callable[[], object]) -> float:
    # Of this thread alone: while others have the processor, it stands still.
    begun_s = time.thread_time()
    work()
    return time.thread_time() - begun_s


def in_yardsticks(work: Callable[[], object], *, tries: int = 20) -> float:
    """The best of ``tries`` against the best of as many yardsticks, taken in turn.

    The best say something of the work, the others of what else goes through the machine's caches.
    """
    pairs = [(_seconds(work), _seconds(_computing)) for _ in range(tries)]
    return min(each for each, _ in pairs) / min(yardstick for _, yardstick in pairs)
