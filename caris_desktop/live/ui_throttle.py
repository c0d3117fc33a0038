"""UI throttle: limits the update rate of panels while the GUI thread is slow."""

import math
import time
from collections.abc import Collection

from PySide6.QtCore import QObject, QTimer, Signal

from caris_desktop.domain.streams import ShownAs

UNHURRIED_S = 0.03
"""Duration of a pass (process state, repaint) from which it counts as slow."""

MOST_REST_S = 0.2


def rest_after(took_s: float) -> float:
    """Rest of the GUI thread after a pass: twice the duration of a slow one.

    A thread that is always busy queues behind all others on a loaded machine, together with its timers. A rested one
    runs at once when a key or the lease renewal needs it. The cost is a lower video rate.
    """
    return 0.0 if took_s <= UNHURRIED_S else min(2.0 * took_s, MOST_REST_S)


class UiThrottle(QObject):
    """Emits ``due`` when waiting values may be passed on."""

    due = Signal()

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._began_s = 0.0
        self._every_s: dict[ShownAs, float] = {"panels": 0.0, "picture": 0.0}
        self._passed_s: dict[ShownAs, float] = {"panels": 0.0, "picture": 0.0}
        self._waiting = False
        self._free = True
        self._ended = False
        # Fires after all repaints of a pass: posted events precede zero timers.
        self._painted = QTimer(self, singleShot=True, interval=0)
        self._painted.timeout.connect(self._on_painted)
        self._rest = QTimer(self, singleShot=True)
        self._rest.timeout.connect(self._on_rested)
        self._held = QTimer(self, singleShot=True)
        self._held.timeout.connect(self._on_held)

    def at_most_every(self, *, panels_s: float, picture_s: float) -> None:
        """Minimum intervals between passes, whatever their duration; 0 for none."""
        self._every_s = {"panels": panels_s, "picture": picture_s}

    def hold_back(self, for_s: float) -> None:
        """Start no pass for this time."""
        from_s = time.monotonic() + for_s
        self._passed_s = {what: from_s - every_s for what, every_s in self._every_s.items()}

    def may_begin(self, waiting: Collection[ShownAs] = ("panels", "picture")) -> frozenset[ShownAs]:
        """Kinds of values to pass on now; ``due`` follows for the rest."""
        if not waiting or self._ended:
            return frozenset()
        if not self._free:
            self._waiting = True
            return frozenset()
        now_s = time.monotonic()
        held_s = {what: self._passed_s[what] + self._every_s[what] - now_s for what in waiting}
        passed = frozenset(what for what, wait_s in held_s.items() if wait_s <= 0.0)
        if len(passed) < len(held_s):
            self._held.start(math.ceil(min(wait_s for wait_s in held_s.values() if wait_s > 0.0) * 1000))
        if passed:
            self._free = False
            self._began_s = now_s
            self._passed_s.update(dict.fromkeys(passed, now_s))
            self._painted.start()
        return passed

    def end(self) -> None:
        """Allow no more passes."""
        self._ended = True
        for timer in (self._painted, self._rest, self._held):
            timer.stop()

    def _on_painted(self) -> None:
        rest_s = rest_after(time.monotonic() - self._began_s)
        if rest_s > 0.0:
            self._rest.start(round(rest_s * 1000))
        else:
            self._on_rested()

    def _on_rested(self) -> None:
        self._free = True
        if self._waiting:
            self._waiting = False
            self.due.emit()

    def _on_held(self) -> None:
        if self._free:
            self.due.emit()
        else:
            self._waiting = True
