"""One-slot mailboxes and a lossless event queue between any thread and the GUI thread."""

import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from caris_desktop.domain.streams import BY_TYPE, Delivery


class Mailbox:
    """Takes values from any thread; the GUI thread drains it.

    State values overwrite their predecessor (that is the back-pressure), events queue up. ``wake`` is called in the
    putting thread, once for all that comes until the GUI thread drains, so a busy one is not woken once per value.
    """

    def __init__(self, wake: Callable[[], None]) -> None:
        self._wake = wake
        self._lock = threading.Lock()
        self._latest: dict[str, Any] = {}
        self._events: deque[Any] = deque()
        self._woken = False

    def put(self, value: Any) -> None:
        """Raises KeyError for a type that is not in the stream table."""
        spec = BY_TYPE[type(value)]
        with self._lock:
            wakes = not self._woken
            if spec.delivery is Delivery.LOSSLESS:
                self._events.append(value)
            else:
                # What goes on waiting after drain_events is taken in without another call.
                wakes = wakes and not self._latest
                self._latest[spec.key_of(value)] = value
            self._woken = self._woken or wakes
        if wakes:
            self._wake()

    def drain_events(self) -> list[Any]:
        """All events in order; what there is of the state streams goes on waiting."""
        with self._lock:
            events = list(self._events)
            self._events.clear()
            self._woken = False
        return events

    def drain(self) -> tuple[list[Any], list[Any]]:
        """All events in order, and the newest value of each state stream; empties the mailbox."""
        with self._lock:
            events, latest = list(self._events), list(self._latest.values())
            self._events.clear()
            self._latest.clear()
            self._woken = False
        return events, latest
