"""Frame rate reduction of a camera: encode every second or fourth frame while the machine is overloaded."""

from collections import deque
from typing import Literal

_LARGEST_STEP = 4
# Waiting time and its duration that lower the rate; short bursts do not.
_TOO_LATE_S, _LATE_FOR_NS = 0.3, 1_000_000_000
_IN_TIME_S = 0.1
_SETTLE_NS = 1_500_000_000
_CALM_NS = 6_000_000_000
_LONGEST_PATIENCE_NS = 96_000_000_000
_BUSY_AT_MOST = 0.75

Change = Literal["", "lowered", "raised"]


class VideoRate:
    """Rate of one camera. The recorder's main thread calls ``wants``, the encoder's thread ``observe``."""

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
        """True if the next frame is to be encoded."""
        self._offered += 1
        return self._offered % self.step == 0

    def observe(self, now_ns: int, *, waited_s: float, took_s: float, crowded: bool = False) -> Change:
        """Add an encoded frame: its waiting time and encoding time. Returns the change from now on.

        Lowers the rate when frames wait too long, at once if ``crowded`` reports a nearly full queue; raises it when
        twice the frames would not keep the encoder busy.
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
            # Each failed attempt doubles the wait before the next one.
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
        """Reset to every frame after another measure, and allow it time to take effect."""
        self._step = 1
        self._encoded.clear()

    def _change(self, now_ns: int, step: int, change: Change) -> Change:
        self._step, self._changed_ns, self._late_since_ns = step, now_ns, None
        self._encoded.clear()
        return change
