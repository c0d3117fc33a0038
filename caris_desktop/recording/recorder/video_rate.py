"""Which frames of a camera are encoded: all of them, or every second or fourth while the machine cannot keep up."""

from collections import deque
from typing import Literal

_LARGEST_STEP = 4
# Frames that wait so long, for so long: a burst at the beginning is none of it.
_TOO_LATE_S, _LATE_FOR_NS = 0.3, 1_000_000_000
_IN_TIME_S = 0.1
_SETTLE_NS = 1_500_000_000
_CALM_NS = 6_000_000_000
_LONGEST_PATIENCE_NS = 96_000_000_000
_BUSY_AT_MOST = 0.75

Change = Literal["", "lowered", "raised"]


class VideoRate:
    """One camera. ``wants`` is asked by the recorder's main thread, ``observe`` is told by the encoder's thread."""

    def __init__(self) -> None:
        self._step = 1
        self.least_step = 1
        self._offered = 0
        self._changed_ns = 0
        self._late_since_ns: int | None = None
        self._patience_ns = _CALM_NS // 2
        self._encoded: deque[tuple[int, float, float]] = deque()

    @property
    def step(self) -> int:
        """1: every frame is encoded, 2: every second one, and so on."""
        return max(self._step, self.least_step)

    @property
    def lowest(self) -> bool:
        return self._step >= _LARGEST_STEP

    def wants(self) -> bool:
        """Whether the next frame is to be encoded."""
        self._offered += 1
        return self._offered % self.step == 0

    def observe(self, now_ns: int, *, waited_s: float, took_s: float, crowded: bool = False) -> Change:
        """A frame was encoded: how long it had waited before, and how long that took. Tells what changes from now on.

        Lowers the rate when frames wait too long, at once where ``crowded`` says that no more of them can wait soon,
        and raises it when twice as many would not keep the encoder busy.
        """
        self._encoded.append((now_ns, waited_s, took_s))
        while now_ns - self._encoded[0][0] > _CALM_NS:
            self._encoded.popleft()
        if waited_s <= _TOO_LATE_S:
            self._late_since_ns = None
        elif self._late_since_ns is None:
            self._late_since_ns = now_ns
        late = self._late_since_ns is not None and now_ns - self._late_since_ns >= _LATE_FOR_NS
        if (late or crowded) and not self.lowest and now_ns - self._changed_ns >= _SETTLE_NS:
            # Each time it was too much again, the next attempt waits longer.
            self._patience_ns = min(2 * self._patience_ns, _LONGEST_PATIENCE_NS)
            return self._change(now_ns, self._step * 2, "lowered")
        if self._step > 1 and now_ns - self._changed_ns >= self._patience_ns:
            busy = sum(took_s for _, _, took_s in self._encoded) / (_CALM_NS / 1e9)
            latest_s = max(waited_s for _, waited_s, _ in self._encoded)
            more = self.step / max(self._step // 2, self.least_step)
            if latest_s < _IN_TIME_S and busy * more < _BUSY_AT_MOST:
                return self._change(now_ns, self._step // 2, "raised")
        return ""

    def forget(self) -> None:
        """Something else was done about it: every frame again, and time to see whether that helps."""
        self._step = 1
        self._encoded.clear()

    def _change(self, now_ns: int, step: int, change: Change) -> Change:
        self._step, self._changed_ns, self._late_since_ns = step, now_ns, None
        self._encoded.clear()
        return change
