"""Event bus: delivers domain values from any thread to taps, unconflated, and to followers and state
in the GUI thread.
"""

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

from PySide6.QtCore import QObject, Qt, Signal

from caris_desktop.domain import clock
from caris_desktop.domain.events import ANSWER, Problem, ProblemEnd, Severity
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.streams import BY_TYPE, CARRIER_STREAMS, Delivery, ShownAs, StreamSpec, streams_voided_by
from caris_desktop.live.background_worker import new_timer
from caris_desktop.live.confirmed_files import ConfirmationNeededError
from caris_desktop.live.state import LiveState

# UI throttle: limits the update rate of panels while the GUI thread is slow.

UNHURRIED_S = 0.03
"""Duration of a pass (process state, repaint) from which it counts as slow."""

MOST_REST_S = 0.2


def rest_after(took_s: float) -> float:
    """Rest of the GUI thread after a pass: twice the duration of a slow one.

    A thread that is always busy queues behind all others on a loaded machine, together with its timers. A rested one
    runs at once when a key or the lease renewal needs it. The cost is a lower video rate.
    """
    return 0.0 if took_s <= UNHURRIED_S else min(2.0 * took_s, MOST_REST_S)


class UiThrottle(QObject):
    """Emits ``due`` when waiting values may be passed on."""

    due = Signal()

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._began_s = 0.0
        self._every_s: dict[ShownAs, float] = {"panels": 0.0, "picture": 0.0}
        self._passed_s: dict[ShownAs, float] = {"panels": 0.0, "picture": 0.0}
        self._waiting = False
        self._free = True
        self._ended = False
        # Fires after all repaints of a pass: posted events precede zero timers.
        self._painted = new_timer(self, self._on_painted, 0, single_shot=True)
        self._rest = new_timer(self, self._on_rested, single_shot=True)
        self._held = new_timer(self, self._on_held, single_shot=True)

    def at_most_every(self, *, panels_s: float, picture_s: float) -> None:
        """Minimum intervals between passes, whatever their duration; 0 for none."""
        self._every_s = {"panels": panels_s, "picture": picture_s}

    def hold_back(self, for_s: float) -> None:
        """Start no pass for this time."""
        from_s = time.monotonic() + for_s
        self._passed_s = {what: from_s - every_s for what, every_s in self._every_s.items()}

    def may_begin(self, waiting: Collection[ShownAs] = ("panels", "picture")) -> frozenset[ShownAs]:
        """Kinds of values to pass on now; ``due`` follows for the rest."""
        if not waiting or self._ended:
            return frozenset()
        if not self._free:
            self._waiting = True
            return frozenset()
        now_s = time.monotonic()
        held_s = {what: self._passed_s[what] + self._every_s[what] - now_s for what in waiting}
        passed = frozenset(what for what, wait_s in held_s.items() if wait_s <= 0.0)
        if len(passed) < len(held_s):
            self._held.start(math.ceil(min(wait_s for wait_s in held_s.values() if wait_s > 0.0) * 1000))
        if passed:
            self._free = False
            self._began_s = now_s
            self._passed_s.update(dict.fromkeys(passed, now_s))
            self._painted.start()
        return passed

    def end(self) -> None:
        """Allow no more passes."""
        self._ended = True
        for timer in (self._painted, self._rest, self._held):
            timer.stop()

    def _on_painted(self) -> None:
        rest_s = rest_after(time.monotonic() - self._began_s)
        if rest_s > 0.0:
            self._rest.start(round(rest_s * 1000))
        else:
            self._on_rested()

    def _on_rested(self) -> None:
        self._free = True
        if self._waiting:
            self._waiting = False
            self.due.emit()

    def _on_held(self) -> None:
        if self._free:
            self.due.emit()
        else:
            self._waiting = True


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

    def follow(self, follows: Mapping[type[Any], Callable[[Any], None]]) -> None:
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

    def inform(self, what: str, meaning: str, advice: str = "") -> None:
        """Report the outcome of a command."""
        self.problem("info", what, meaning, advice, cause=ANSWER)

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
        for event in events:
            for take in self._followers.get(type(event), ()):
                take(event)
            self._state.add(event)
        for value in latest:
            self._state.add(value)

    def _on_woken(self) -> None:
        self._before_work()
        waiting = self._mailbox.waiting
        self._take_in(self._pace.may_begin(waiting))
        if self._mailbox.waiting - waiting:
            self._woken.emit()  # queued meanwhile without a wake-up


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
