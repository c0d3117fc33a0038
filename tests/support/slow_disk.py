"""A disk that takes its time: what is asked of it comes back when the test says so."""

import threading
from collections.abc import Callable
from typing import Any

_AT_MOST_S = 60.0


class SlowDisk:
    """``slow(work)`` does ``work`` at once, but between ``hold`` and ``answer`` only after ``answer``.

    ``asked`` is set once something waits. ``refuse`` is raised instead of the next piece of work.
    """

    def __init__(self) -> None:
        self._answers = threading.Event()
        self._answers.set()
        self.asked = threading.Event()
        self.refuse: Exception | None = None

    def hold(self) -> None:
        self.asked.clear()
        self._answers.clear()

    def answer(self) -> None:
        self._answers.set()

    def slow(self, work: Callable[..., Any]) -> Callable[..., Any]:
        def waits(*arguments: Any) -> Any:
            if not self._answers.is_set():
                self.asked.set()
            if not self._answers.wait(_AT_MOST_S):
                raise TimeoutError("whoever asked the disk waits for it, and so nobody lets it answer")
            refuse, self.refuse = self.refuse, None
            if refuse is not None:
                raise refuse
            return work(*arguments)

        return waits
