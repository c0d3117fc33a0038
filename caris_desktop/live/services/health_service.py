"""Health service: state of the child processes."""

from collections.abc import Callable, Iterable

from PySide6.QtCore import QObject, QTimer

from caris_desktop.live.service import Service
from caris_desktop.live.state import LiveState

_POLL_EVERY_MS = 1000


class HealthService(Service):
    """Maintains ``state.health``."""

    def __init__(self, state: LiveState, services: Callable[[], Iterable[Service]], parent: QObject) -> None:
        super().__init__(parent)
        self._state = state
        self._services = services
        self._timer = QTimer(self, interval=_POLL_EVERY_MS)
        self._timer.timeout.connect(self.update)

    def start(self) -> None:
        self._timer.start()

    def stop(self) -> None:
        self._timer.stop()

    def update(self) -> None:
        self._state.health.set({name: how for each in self._services() for name, how in each.health().items()})
