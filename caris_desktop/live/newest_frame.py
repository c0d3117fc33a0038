"""The newest camera frame for a consumer that takes its time."""

import threading

from caris_desktop.domain.sensing import FrameRef


class NewestFrame:
    """One slot: an offer overwrites what nobody took."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._ref: FrameRef | None = None
        self._closed = False

    def offer(self, ref: FrameRef) -> None:
        with self._changed:
            self._ref = ref
            self._changed.notify()

    def take(self, *, timeout_s: float) -> FrameRef | None:
        """The newest frame that was not taken yet; None after ``timeout_s`` without one, or once closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._ref is not None or self._closed, timeout_s)
            ref, self._ref = self._ref, None
            return ref

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()
