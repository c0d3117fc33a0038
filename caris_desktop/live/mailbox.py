"""One-slot mailboxes and a lossless event queue between any thread and the GUI thread."""

import threading
from collections import deque
from collections.abc import Callable, Collection
from typing import Any

from caris_desktop.domain.streams import BY_TYPE, Delivery, ShownAs, StreamSpec, streams_voided_by


class Mailbox:
    """Takes values from any thread; the GUI thread drains it.

    State values overwrite their predecessor (that is the back-pressure), events queue up; an event that voids streams
    takes what waits of them along, for it would come after the event. ``wake`` is called in the
    putting thread, once for all that comes until the GUI thread drains, so a busy one is not woken once per value.
    """

    def __init__(self, wake: Callable[[], None]) -> None:
        self._wake = wake
        self._lock = threading.Lock()
        self._latest: dict[str, tuple[StreamSpec, Any]] = {}
        self._waiting: frozenset[ShownAs] = frozenset()
        self._events: deque[Any] = deque()
        self._woken = False

    def put(self, value: Any) -> None:
        """Raises KeyError for a type that is not in the stream table."""
        spec = BY_TYPE[type(value)]
        with self._lock:
            wakes = not self._woken
            if spec.delivery is Delivery.LOSSLESS:
                for name in streams_voided_by(value):
                    self._latest = {key: held for key, held in self._latest.items() if held[0].name != name}
                self._events.append(value)
            else:
                # What goes on waiting after a drain is taken in without another call.
                wakes = wakes and spec.shown_as not in self._waiting
                self._waiting |= {spec.shown_as}
                self._latest[spec.key_of(value)] = spec, value
            self._woken = self._woken or wakes
        if wakes:
            self._wake()

    @property
    def waiting(self) -> frozenset[ShownAs]:
        """Of what there are values of state streams."""
        return self._waiting

    def drain(self, shown_as: Collection[ShownAs] = ("panels", "picture")) -> tuple[list[Any], list[Any]]:
        """All events in order, and the newest value of each state stream that is shown as one of these; the others go
        on waiting.
        """
        with self._lock:
            events = list(self._events)
            self._events.clear()
            latest = [value for spec, value in self._latest.values() if spec.shown_as in shown_as]
            self._latest = {key: held for key, held in self._latest.items() if held[0].shown_as not in shown_as}
            self._waiting -= frozenset(shown_as)
            self._woken = False
        return events, latest
