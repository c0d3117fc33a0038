"""Mailboxes between any thread and the GUI thread: one slot per state value, and a lossless event queue."""

import threading
from collections import deque
from collections.abc import Callable, Collection
from typing import Any

from caris_desktop.domain.streams import BY_TYPE, Delivery, ShownAs, StreamSpec, streams_voided_by


class Mailbox:
    """Receives values from any thread; the GUI thread drains it.

    State values replace their predecessor (back-pressure), events are queued; an event that voids streams removes their
    waiting values, which would otherwise follow it. ``wake`` is called in the sending thread, once until the next
    drain, so that a busy GUI thread is not woken per value.
    """

    def __init__(self, wake: Callable[[], None]) -> None:
        self._wake = wake
        self._lock = threading.Lock()
        self._latest: dict[str, tuple[StreamSpec, Any]] = {}
        self._waiting: frozenset[ShownAs] = frozenset()
        self._events: deque[Any] = deque()
        self._woken = False

    def put(self, value: Any) -> None:
        """Add a value. Raises KeyError for a type outside the stream table."""
        spec = BY_TYPE[type(value)]
        with self._lock:
            wakes = not self._woken
            if spec.delivery is Delivery.LOSSLESS:
                for name in streams_voided_by(value):
                    self._latest = {key: held for key, held in self._latest.items() if held[0].name != name}
                self._events.append(value)
            else:
                # Values that remain after a drain need no further wake-up.
                wakes = wakes and spec.shown_as not in self._waiting
                self._waiting |= {spec.shown_as}
                self._latest[spec.key_of(value)] = spec, value
            self._woken = self._woken or wakes
        if wakes:
            self._wake()

    @property
    def waiting(self) -> frozenset[ShownAs]:
        """Kinds of state values waiting."""
        return self._waiting

    def drain(self, shown_as: Collection[ShownAs] = ("panels", "picture")) -> tuple[list[Any], list[Any]]:
        """Return all events in order, and the newest value of each state stream of these kinds; others keep waiting."""
        with self._lock:
            events = list(self._events)
            self._events.clear()
            latest = [value for spec, value in self._latest.values() if spec.shown_as in shown_as]
            self._latest = {key: held for key, held in self._latest.items() if held[0].shown_as not in shown_as}
            self._waiting -= frozenset(shown_as)
            self._woken = False
        return events, latest
