"""Event bus: delivers domain values from any thread to taps, unconflated, and to followers and state
in the GUI thread.
"""

import logging
import threading
from collections import deque
from collections.abc import Callable, Collection, Iterable
from typing import Any

from PySide6.QtCore import QObject, Qt, Signal

from caris_desktop.domain import clock
from caris_desktop.domain.events import ANSWER, Problem, ProblemEnd, Severity
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.streams import BY_TYPE, CARRIER_STREAMS, Delivery, ShownAs, StreamSpec, streams_voided_by
from caris_desktop.live.confirmed_files import ConfirmationNeededError
from caris_desktop.live.service import Follows
from caris_desktop.live.state import LiveState
from caris_desktop.live.ui_throttle import UiThrottle

_log = logging.getLogger(__name__)
_CARRIERS = frozenset(spec.value_type for spec in CARRIER_STREAMS)  # for taps only: no panel reads audio
Tap = Callable[[Any, bytes | None], None]


class Bus(QObject):
    """Event bus; ``publish`` from any thread. Taps get each value at once in that thread. Then it is queued for the GUI
    thread, where state values are conflated and events are not, and delivered to followers and ``state``.
    """

    _woken = Signal()

    def __init__(self, state: LiveState, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._state = state
        self._every_tap: list[Tap] = []
        self._taps: dict[type[Any], list[Tap]] = {}
        self._followers: dict[type[Any], list[Callable[[Any], None]]] = {}
        self._before_work: Callable[[], None] = lambda: None
        self._mailbox = Mailbox(self._woken.emit)
        self._woken.connect(self._on_woken, Qt.ConnectionType.QueuedConnection)
        self._pace = UiThrottle(self)
        self._pace.due.connect(self._on_woken)

    def tap(self, take: Tap, types: Iterable[type[Any]] | None = None) -> None:
        """Register ``take`` for all values of these types (None: all types), with the pickled form if available, in the
        publishing thread. Register before the first value is published.
        """
        if types is None:
            self._every_tap.append(take)
        else:
            for each in types:
                self._taps.setdefault(each, []).append(take)

    def follow(self, follows: Follows) -> None:
        """Register functions by event type, called in the GUI thread before any panel."""
        for each, take in follows.items():
            self._followers.setdefault(each, []).append(take)

    def before_work(self, call: Callable[[], None]) -> None:
        """Set work to be done before queued values are processed."""
        self._before_work = call

    def pass_at_most_every(self, *, panels_s: float, picture_s: float) -> None:
        """Limit the update rates of panels and video; 0 for no limit."""
        self._pace.at_most_every(panels_s=panels_s, picture_s=picture_s)

    def hold_back(self, for_s: float) -> None:
        """Pause updates of panels and video for this time; events continue. GUI thread."""
        self._pace.hold_back(for_s)

    def publish(self, value: Any, raw: bytes | None = None) -> None:
        """Publish a value; ``raw`` is its pickled form if available. Any thread."""
        for take in self._every_tap:
            take(value, raw)
        for take in self._taps.get(type(value), ()):
            take(value, raw)
        if type(value) not in _CARRIERS:
            self._mailbox.put(value)

    def publish_recorded(self, value: Any) -> None:
        """Publish a value that its source has already recorded. Any thread."""
        self._mailbox.put(value)

    def problem(
        self, severity: Severity, what: str, meaning: str, advice: str, *, until: ProblemEnd = "", cause: str = ""
    ) -> None:
        """Report a problem to wizard and record; ``until`` and ``cause`` as in Problem."""
        _log.log(logging.INFO if severity == "info" else logging.WARNING, "%s %s %s", what, meaning, advice)
        self.publish(Problem(clock.now_ns(), severity, what, meaning, advice, until, cause))

    def answer(self, failure: UserFacingError, until: ProblemEnd = "") -> None:
        """Report that a command failed; with ``until`` the problem persists until then. An unconfirmed file leads to a
        question instead.
        """
        if isinstance(failure, ConfirmationNeededError):
            self._state.file_question.reset_value(failure.question)
            return
        cause = "" if until else ANSWER
        self.problem(failure.severity, failure.what, failure.meaning, failure.advice, until=until, cause=cause)

    def end(self) -> None:
        """Stop updates of panels; events continue."""
        self._pace.end()

    def take_in(self) -> None:
        """Process all queued values now."""
        self._take_in(("panels", "picture"))

    def _take_in(self, shown_as: Collection[ShownAs]) -> None:
        events, latest = self._mailbox.drain(shown_as)
        self._take_events(events)
        for value in latest:
            self._state.add(value)

    def _on_woken(self) -> None:
        self._before_work()
        waiting = self._mailbox.waiting
        self._take_in(self._pace.may_begin(waiting))
        if self._mailbox.waiting - waiting:
            self._woken.emit()  # queued meanwhile without a wake-up

    def _take_events(self, events: list[Any]) -> None:
        for event in events:
            for take in self._followers.get(type(event), ()):
                take(event)
            self._state.add(event)


class Mailbox:
    """Mailboxes between any thread and the GUI thread: one slot per state value, and a lossless event queue.

    Receives values from any thread; the GUI thread drains it.

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
