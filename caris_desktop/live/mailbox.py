"""One-slot mailboxes and a lossless event queue between any thread and the GUI thread."""

import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from caris_desktop.domain.streams import BY_TYPE, Delivery


class Mailbox:
    """Takes values from any thread; the GUI thread drains it.

    State values overwrite their predecessor of the same source (that is the back-pressure), events queue up. ``wake``
    is called, in the putting thread, only when the mailbox was empty, so a busy GUI thread is not woken once per value.
    """

    def __init__(self, wake: Callable[[], None]) -> None:
        self._wake = wake
        self._lock = threading.Lock()
        self._latest: dict[str, Any] = {}
        self._events: deque[Any] = deque()
        self._overwritten: dict[str, int] = {}

    def put(self, value: Any) -> None:
        """Raises KeyError for a type that is not in the stream table."""
        spec = BY_TYPE[type(value)]
        with self._lock:
            was_empty = not self._latest and not self._events
            if spec.delivery is Delivery.LOSSLESS:
                self._events.append(value)
            else:
                key = spec.key_of(value)
                if key in self._latest:
                    self._overwritten[key] = self._overwritten.get(key, 0) + 1
                self._latest[key] = value
        if was_empty:
            self._wake()

    def drain(self) -> tuple[list[Any], list[Any]]:
        """All events in order, and the newest value of each state stream; empties the mailbox."""
        with self._lock:
            events, latest = list(self._events), list(self._latest.values())
            self._events.clear()
            self._latest.clear()
        return events, latest

    @property
    def overwritten(self) -> dict[str, int]:
        """How many values of each stream were replaced before the GUI thread took them."""
        with self._lock:
            return dict(self._overwritten)
