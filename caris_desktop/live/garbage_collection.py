"""Garbage collection of reference cycles in the GUI thread only."""

import gc

from PySide6.QtCore import QObject, QTimer

_EVERY_MS = 250


class GarbageCollector(QObject):
    """Runs Python's cyclic garbage collector in the GUI thread, as often as Python would.

    By default Python collects in whichever thread allocates next. Qt objects in a cycle would be destroyed there, and
    Qt crashes at their next event.
    """

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self._was_enabled = gc.isenabled()
        gc.disable()
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._collect)
        self._timer.start(_EVERY_MS)

    def stop(self) -> None:
        """Restore automatic collection."""
        self._timer.stop()
        if self._was_enabled:
            gc.enable()

    def _collect(self) -> None:
        # Collecting a generation includes the younger ones.
        for generation in (2, 1, 0):
            if gc.get_count()[generation] > gc.get_threshold()[generation]:
                gc.collect(generation)
                break
