"""Python's cyclic garbage collector, kept in the GUI thread."""

import gc

from PySide6.QtCore import QObject, QTimer

_EVERY_MS = 250


class GarbageCollector(QObject):
    """Collects garbage in the GUI thread only, as often as Python itself would.

    Left to itself Python collects in whichever thread allocates next. A widget or timer that is part of a cycle would
    be destroyed there, and Qt crashes at the next event of an object that another thread has destroyed.
    """

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self._was_enabled = gc.isenabled()
        gc.disable()
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._collect)
        self._timer.start(_EVERY_MS)

    def stop(self) -> None:
        """Leave collecting to whoever did it before."""
        self._timer.stop()
        if self._was_enabled:
            gc.enable()

    def _collect(self) -> None:
        # The oldest generation that is due takes the younger ones along.
        for generation in (2, 1, 0):
            if gc.get_count()[generation] > gc.get_threshold()[generation]:
                gc.collect(generation)
                break
