"""The clock of the computer that a camera is plugged into, seen from here by asking for its time."""

from collections import deque
from collections.abc import Callable

from caris_desktop.domain import clock

_KEPT = 30
# Two clocks of ordinary computers drift apart by no more than this, in ns per ns.
_DRIFT = 50e-6


class FarClock:
    """``ask`` gives the far monotonic clock in nanoseconds, after one way there and back."""

    def __init__(self, ask: Callable[[], int], *, now_ns: Callable[[], int] = clock.now_ns) -> None:
        self._ask = ask
        self._now_ns = now_ns
        self._measured: deque[tuple[int, int, int]] = deque(maxlen=_KEPT)

    def measure(self) -> None:
        """One more round trip; the quickest tells most. Raises what ``ask`` raises."""
        asked_ns = self._now_ns()
        far_ns = self._ask()
        heard_ns = self._now_ns()
        self._measured.append((heard_ns, far_ns - (asked_ns + heard_ns) // 2, (heard_ns - asked_ns) // 2))

    def here(self, far_ns: int) -> tuple[int, int] | None:
        """That moment on the session clock, and to within how much; None where it is not known well enough."""
        if not self._measured:
            return None
        now_ns = self._now_ns()
        uncertainty_ns, offset_ns = min(
            (round(half_ns + _DRIFT * (now_ns - at_ns)), offset_ns) for at_ns, offset_ns, half_ns in self._measured
        )
        taken_ns = clock.measured_ns(far_ns, arrival_ns=now_ns, offset_ns=offset_ns, uncertainty_ns=uncertainty_ns)
        return None if taken_ns is None else (taken_ns, uncertainty_ns)
