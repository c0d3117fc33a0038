"""How often the panels get new state: less often while the machine lets the GUI thread wait."""

import time

from PySide6.QtCore import QObject, QTimer, Signal

UNHURRIED_S = 0.03
"""What a pass (taking state in and painting it) may take before it counts as slow."""

MOST_REST_S = 0.2


def rest_after(took_s: float) -> float:
    """How long to leave the GUI thread alone after a pass: twice as long as a slow one took.

    A thread that always has something to do waits behind all others on a full machine, its timers with it. One that
    rests is let in at once when a key or the renewal of the lease needs it. What pays is the rate of the picture.
    """
    return 0.0 if took_s <= UNHURRIED_S else min(2.0 * took_s, MOST_REST_S)


class PassPace(QObject):
    """``due`` when the next pass may begin and something waits for it."""

    due = Signal()

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._began_s = 0.0
        self._every_s = 0.0
        self._waiting = False
        self._free = True
        # Fires once everything that a pass has caused is painted: events come before timers without a delay.
        self._painted = QTimer(self, singleShot=True, interval=0)
        self._painted.timeout.connect(self._on_painted)
        self._rest = QTimer(self, singleShot=True)
        self._rest.timeout.connect(self._on_rested)

    def at_most_every(self, seconds: float) -> None:
        """No more passes than this, whatever they cost; 0 for as many as they allow themselves."""
        self._every_s = seconds

    def may_begin(self) -> bool:
        """Whether a pass may begin now; if not, ``due`` follows."""
        if not self._free:
            self._waiting = True
            return False
        self._free = False
        self._began_s = time.monotonic()
        self._painted.start()
        return True

    def end(self) -> None:
        """No pass may begin from now on."""
        self._free = self._waiting = False
        self._painted.stop()
        self._rest.stop()

    def _on_painted(self) -> None:
        took_s = time.monotonic() - self._began_s
        rest_s = max(rest_after(took_s), self._every_s - took_s)
        if rest_s > 0.0:
            self._rest.start(round(rest_s * 1000))
        else:
            self._on_rested()

    def _on_rested(self) -> None:
        self._free = True
        if self._waiting:
            self._waiting = False
            self.due.emit()
