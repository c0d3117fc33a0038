"""Simulated slow disk, whose delay is controlled by the test."""

import threading
from collections.abc import Callable
from typing import Any

_TIMEOUT_S = 60.0


class SlowDisk:
    """Wrapper of file operations: between ``hold`` and ``release`` they block until ``release``.

    ``waiting`` is set when an operation blocks. ``error`` is raised by the next operation.
    """

    def __init__(self) -> None:
        self._released = threading.Event()
        self._released.set()
        self.waiting = threading.Event()
        self.error: Exception | None = None

    def hold(self) -> None:
        self.waiting.clear()
        self._released.clear()

    def release(self) -> None:
        self._released.set()

    def delayed(self, work: Callable[..., Any]) -> Callable[..., Any]:
        def wait(*arguments: Any) -> Any:
            if not self._released.is_set():
                self.waiting.set()
            if not self._released.wait(_TIMEOUT_S):
                raise TimeoutError("the thread that should call release() waits for the disk itself")
            error, self.error = self.error, None
            if error is not None:
                raise error
            return work(*arguments)

        return wait
