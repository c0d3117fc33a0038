"""Read-ahead of a recorded session in its own thread, so that the window never waits for the disk."""

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import field
from typing import Any

from caris_desktop.domain.events import (
    CommandSent,
    LayoutChanged,
    LinkChanged,
    LinkQuality,
    RobotChosen,
    ScenarioOpened,
    TrafficMeasured,
)
from caris_desktop.domain.sensing import FrameRef, People, PeopleInMap
from caris_desktop.domain.streams import BY_TYPE, EVENT_STREAMS, STREAMS_OF_LINK, streams_voided_by
from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.replay.session_timeline import SessionTimeline
from caris_desktop.recording.session.session_reader import Session

_log = logging.getLogger(__name__)
_AHEAD_NS = 1_500_000_000
_SLICE_NS = 250_000_000
_MAX_WAITING = 20_000
_SEEN_WITHIN_NS = 1_000_000_000
_EVENTS_SHOWN = 40
_LINK_CHANGES = 20
# A layout lasts until the next scenario, and each saved place adds a ScenarioOpened event.
_SCENARIOS = 20
# Useless in an event list, and frequent enough to hide the rest.
_UNLISTED = (CommandSent, LinkQuality, TrafficMeasured)
# Events whose value persists until the next one, and how many of the newest determine the current state.
_STANDING = {ScenarioOpened: _SCENARIOS, LayoutChanged: 1, RobotChosen: 1, LinkQuality: 1}


@dataclass(frozen=True, slots=True)
class Situation:
    """State at one time: state values, persistent events, the newest frame of each camera, and past events, oldest
    first. ``standing`` is in order of arrival. ``generation`` counts the seeks. Values received over a link before its
    loss are left out: they were no longer shown.
    """

    generation: int
    values: tuple[Any, ...]
    standing: tuple[Any, ...]
    frames: tuple[FrameRef, ...]
    events: tuple[Any, ...]


@dataclass(slots=True)
class _Ahead:
    waiting: deque[tuple[int, Any]] = field(default_factory=deque)
    read_until_ns: int = 0


class ReplayFeed:
    """Read-ahead thread. ``ready`` receives each Situation, ``failed`` a text; both in the reading thread."""

    def __init__(self, session: Session, *, ready: Callable[[Situation], None], failed: Callable[[str], None]) -> None:
        self._session = session
        self._ready = ready
        self._failed = failed
        self._changed = threading.Condition()
        self._ended = False
        self._jump: tuple[int, int, int] | None = None
        self._ahead = _Ahead()
        self._position_ns = 0
        self._rate = 1.0
        self._playing = False
        self._end_ns = 0
        self._thread = threading.Thread(target=self._run, name="replay-reader", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def jump(self, generation: int, at_ns: int, *, shown_ns: int) -> None:
        """Determine the state at ``shown_ns`` and continue from ``at_ns``. Discards what was read ahead, and an
        unfinished seek.
        """
        with self._changed:
            self._jump = (generation, at_ns, shown_ns)
            self._ahead = _Ahead(read_until_ns=at_ns)
            self._position_ns = at_ns
            self._changed.notify()

    def read_ahead(self, *, playing: bool) -> None:
        """Enable read-ahead; a paused replay needs none, and seeks faster without."""
        with self._changed:
            self._playing = playing
            self._changed.notify()

    def due(self, position_ns: int, rate: float) -> tuple[list[Any], bool]:
        """Values up to ``position_ns``, in order, and whether reading keeps up."""
        due = []
        with self._changed:
            self._position_ns, self._rate = position_ns, rate
            ahead = self._ahead
            while ahead.waiting and ahead.waiting[0][0] <= position_ns:
                due.append(ahead.waiting.popleft()[1])
            keeps_up = ahead.read_until_ns >= min(position_ns, self._end_ns)
            self._changed.notify()
        return due, keeps_up

    def close(self) -> None:
        with self._changed:
            self._ended = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join(5.0)

    def _run(self) -> None:
        try:
            timeline = SessionTimeline(self._session)
        except Exception as error:
            _log.exception("the session %s cannot be read", self._session.folder)
            self._failed(str(error))
            return
        self._end_ns = timeline.end_ns
        try:
            while self._work(timeline):
                pass
        except Exception as error:
            _log.exception("reading the session %s", self._session.folder)
            self._failed(str(error))
        finally:
            timeline.close()

    def _work(self, timeline: SessionTimeline) -> bool:
        with self._changed:
            while not self._ended and self._jump is None and not self._room():
                self._changed.wait()
            if self._ended:
                return False
            jump, self._jump = self._jump, None
            ahead = self._ahead
        if jump is not None:
            self._ready(_situation(timeline, *jump))
            return True
        until_ns = ahead.read_until_ns + _SLICE_NS
        values = list(timeline.between(ahead.read_until_ns, until_ns))
        with self._changed:
            if ahead is self._ahead:
                ahead.waiting.extend(values)
                ahead.read_until_ns = until_ns
        return True

    def _room(self) -> bool:
        if not self._playing:
            return False
        ahead = self._ahead
        wanted_ns = self._position_ns + round(_AHEAD_NS * max(1.0, self._rate))
        return ahead.read_until_ns < min(wanted_ns, self._end_ns) and len(ahead.waiting) < _MAX_WAITING


def _listed() -> list[type[Any]]:
    return [spec.value_type for spec in EVENT_STREAMS if spec.value_type not in _UNLISTED]


def _situation(timeline: SessionTimeline, generation: int, at_ns: int, shown_ns: int) -> Situation:
    lost_ns = {
        event.link: arrived_ns
        for arrived_ns, event in timeline.events_before(shown_ns, _LINK_CHANGES, types=(LinkChanged,))
        if streams_voided_by(event)
    }

    def newest(arrivals: Iterable[tuple[int, Any]]) -> dict[str, Any]:
        """Newest value per key by arrival, as a frame from before a loss may be processed only after it."""
        return {
            BY_TYPE[type(value)].key_of(value): value
            for arrived_ns, value in arrivals
            if not _was_lost(value, arrived_ns, lost_ns)
        }

    seen = newest(timeline.between(shown_ns - _SEEN_WITHIN_NS, shown_ns, types=(FrameRef, People, PeopleInMap)))
    frames = [value for value in seen.values() if isinstance(value, FrameRef)]
    # Cameras share a topic, whose newest value belongs to one of them.
    values = newest(timeline.arrivals_until(shown_ns))
    values |= {key: value for key, value in seen.items() if not isinstance(value, FrameRef)}
    standing = [
        arrived for kind, most in _STANDING.items() for arrived in timeline.events_before(shown_ns, most, types=(kind,))
    ]
    standing.sort(key=lambda arrived: arrived[0])
    return Situation(
        generation,
        tuple(values.values()),
        tuple(event for _, event in standing),
        tuple(sorted(frames, key=lambda frame: frame.stamp_ns)),
        tuple(event for _, event in timeline.events_before(at_ns, _EVENTS_SHOWN, types=_listed())),
    )


def _was_lost(value: Any, arrived_ns: int, lost_ns: dict[str, int]) -> bool:
    """Whether the link of this stream was lost after the value."""
    name = BY_TYPE[type(value)].name
    return any(arrived_ns < at_ns and name in STREAMS_OF_LINK.get(link, ()) for link, at_ns in lost_ns.items())
