"""Throttle for seeking while dragging: the newest position wins, at a rate that can be displayed."""

from PySide6.QtCore import QObject, QTimer, Signal

EVERY_MS = 40


class SeekThrottle(QObject):
    """``due(at_ns)`` at once for the first position, then for the newest one per interval."""

    due = Signal(object)

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self._wanted_ns: int | None = None
        self._pause = QTimer(self, singleShot=True, interval=EVERY_MS)
        self._pause.timeout.connect(self._send)

    def want(self, at_ns: int) -> None:
        self._wanted_ns = at_ns
        if not self._pause.isActive():
            self._send()

    def _send(self) -> None:
        if self._wanted_ns is not None:
            wanted, self._wanted_ns = self._wanted_ns, None
            self._pause.start()
            self.due.emit(wanted)
