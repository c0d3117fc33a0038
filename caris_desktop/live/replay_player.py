"""Replay player: plays a recorded session into LiveState, as the panels saw it live. GUI thread."""

import bisect
import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import field, replace
from typing import Any

from PySide6.QtCore import QObject, Qt, Signal

from caris_desktop.domain.events import (
    CommandSent,
    LayoutChanged,
    LinkChanged,
    LinkQuality,
    RobotChosen,
    ScenarioOpened,
    TrafficMeasured,
)
from caris_desktop.domain.sensing import FrameRef, People, PeopleInMap, StatusShown
from caris_desktop.domain.streams import (
    BY_TYPE,
    EVENT_STREAMS,
    STATE_STREAMS,
    STREAMS_OF_LINK,
    Delivery,
    streams_voided_by,
)
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.live.background_worker import new_timer
from caris_desktop.live.replay_video import KEY_FRAMES_FROM_RATE, ReplayFrames, ReplayVideo
from caris_desktop.live.state import LiveState, LiveValue, show_status
from caris_desktop.live.status import PlaybackStatus
from caris_desktop.recording.replay.session_timeline import SessionTimeline
from caris_desktop.recording.session.session_reader import Session

# Replay clock: current position in the recorded session.

LEAST_RATE, MOST_RATE = 0.1, 16.0


class PlaybackClock:
    """Clock from ``start_ns`` to ``end_ns`` of the session, running at ``rate`` times real time, or paused."""

    def __init__(self, start_ns: int, end_ns: int, *, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.start_ns = start_ns
        self.end_ns = max(start_ns, end_ns)
        self._now_ns = now_ns
        self._position_ns = start_ns
        self._since_ns: int | None = None
        self.rate = 1.0

    @property
    def playing(self) -> bool:
        return self._since_ns is not None

    def position_ns(self) -> int:
        if self._since_ns is None:
            return self._position_ns
        elapsed_ns = round((self._now_ns() - self._since_ns) * self.rate)
        return min(self.end_ns, self._position_ns + elapsed_ns)

    def play(self) -> None:
        if self._since_ns is None:
            self._since_ns = self._now_ns()

    def pause(self) -> None:
        self._position_ns = self.position_ns()
        self._since_ns = None

    def set_rate(self, rate: float) -> None:
        self.seek(self.position_ns())
        self.rate = min(MOST_RATE, max(LEAST_RATE, rate))

    def seek(self, at_ns: int) -> None:
        self._position_ns = min(self.end_ns, max(self.start_ns, at_ns))
        if self._since_ns is not None:
            self._since_ns = self._now_ns()


_AHEAD_NS = 1_500_000_000
_SLICE_NS = 250_000_000
_MAX_WAITING = 20_000
_VISIBLE_NS = 1_000_000_000
_EVENTS_SHOWN = 40
_LINK_CHANGES = 20
# A layout lasts until the next scenario, and each saved place adds a ScenarioOpened event.
_SCENARIOS = 20
# Useless in an event list, and frequent enough to hide the rest.
_UNLISTED = (CommandSent, LinkQuality, TrafficMeasured)
_LISTED = [spec.value_type for spec in EVENT_STREAMS if spec.value_type not in _UNLISTED]
# Events whose value persists until the next one, and how many of the newest determine the current state.
_STANDING = {ScenarioOpened: _SCENARIOS, LayoutChanged: 1, RobotChosen: 1, LinkQuality: 1}


class Situation(Value):
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
        until_ns = self._position_ns + round(_AHEAD_NS * max(1.0, self._rate))
        return ahead.read_until_ns < min(until_ns, self._end_ns) and len(ahead.waiting) < _MAX_WAITING


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

    latest = newest(timeline.between(shown_ns - _VISIBLE_NS, shown_ns, types=(FrameRef, People, PeopleInMap)))
    frames = [value for value in latest.values() if isinstance(value, FrameRef)]
    # Cameras share a topic, whose newest value belongs to one of them.
    values = newest(timeline.arrivals_until(shown_ns))
    values |= {key: value for key, value in latest.items() if not isinstance(value, FrameRef)}
    standing = [
        arrived for kind, most in _STANDING.items() for arrived in timeline.events_before(shown_ns, most, types=(kind,))
    ]
    standing.sort(key=lambda arrived: arrived[0])
    return Situation(
        generation,
        tuple(values.values()),
        tuple(event for _, event in standing),
        tuple(sorted(frames, key=lambda frame: frame.stamp_ns)),
        tuple(event for _, event in timeline.events_before(at_ns, _EVENTS_SHOWN, types=_LISTED)),
    )


def _was_lost(value: Any, arrived_ns: int, lost_ns: dict[str, int]) -> bool:
    """Whether the link of this stream was lost after the value."""
    name = BY_TYPE[type(value)].name
    return any(arrived_ns < at_ns and name in STREAMS_OF_LINK.get(link, ()) for link, at_ns in lost_ns.items())


_log = logging.getLogger(__name__)
_TICK_MS = 5
_BEGINNING_NS = 500_000_000
_REPORT_EVERY_TICKS = 8
_SMALL_EVERY_S = 0.4


class ReplayPlayer(QObject):
    """Play, pause, rate, seek and step; ``playback`` holds a PlaybackStatus.

    ``standing_changed(event)``: new scenario, layout or robot; ``standing_jumped(events)``: those that determine the
    state after a seek, in order.
    """

    standing_changed = Signal(object)
    standing_jumped = Signal(object)
    _situation_ready = Signal(object)
    _frame_ready = Signal(int, object)
    _failed = Signal(str)

    def __init__(
        self,
        session: Session,
        clock: PlaybackClock,
        state: LiveState,
        frames: ReplayFrames,
        *,
        name_of: Callable[[str], str | None],
        frame_times: Callable[[str], list[int]],
        parent: QObject | None = None,
    ) -> None:
        """``frame_times`` returns the stamps of a camera's frames, in order."""
        super().__init__(parent)
        self._session = session
        self._clock = clock
        self._state = state
        self._name_of = name_of
        self._frame_times = frame_times
        self._generation = 0
        self._awaits_situation = False
        self._ticks = 0
        # The viewer's choice of camera wins; until then it is the wizard's.
        self._camera_chosen = False
        self._showing_status = False
        self._small_s: dict[str, float] = {}
        state.camera.changed.connect(self._on_camera_changed)
        self.playback = LiveValue(PlaybackStatus(session.folder.name, clock.start_ns, clock.end_ns), self)
        self._situation_ready.connect(self._on_situation, Qt.ConnectionType.QueuedConnection)
        self._frame_ready.connect(self._on_frame, Qt.ConnectionType.QueuedConnection)
        self._failed.connect(self._on_failed, Qt.ConnectionType.QueuedConnection)
        self._feed = ReplayFeed(session, ready=self._situation_ready.emit, failed=self._failed.emit)
        self._video = ReplayVideo(session, frames, self._frame_ready.emit)
        self._timer = new_timer(self, self._tick, _TICK_MS, precise=True)

    def start(self) -> None:
        """Start paused at the beginning."""
        self._feed.start()
        self.seek(self._clock.start_ns)

    def close(self) -> None:
        self._timer.stop()
        self._feed.close()
        self._video.close()

    @property
    def settled(self) -> bool:
        """Whether the display matches the position and no seek is pending."""
        return not self._awaits_situation

    def play(self) -> None:
        if self._clock.position_ns() >= self._clock.end_ns:
            self.seek(self._clock.start_ns)
        self._clock.play()
        self._feed.read_ahead(playing=True)
        self._timer.start()
        self._notify()

    def pause(self) -> None:
        self._clock.pause()
        self._feed.read_ahead(playing=False)
        self._timer.stop()
        self._notify()

    def set_rate(self, rate: float) -> None:
        """Set the rate, 0.1 to 16."""
        self._clock.set_rate(rate)
        self._notify()

    def seek(self, at_ns: int) -> None:
        """Seek to a time of the session clock, clamped to the session."""
        self._clock.seek(at_ns)
        self._jump()

    def step(self, frames: int) -> None:
        """Pause and move by this many frames, backward if negative."""
        self.pause()
        frame: FrameRef | None = self._state.frame.value
        times = self._frame_times(frame.camera) if frame is not None else []
        if frame is None or not times:
            self.seek(self._clock.position_ns() + frames * 100_000_000)
            return
        # A frame is visible from its arrival, slightly after its capture: seek behind both.
        index = bisect.bisect_right(times, frame.stamp_ns) - 1 + frames
        target_ns = times[min(len(times) - 1, max(0, index))]
        self.seek(target_ns + max(0, min(200_000_000, self._clock.position_ns() - frame.stamp_ns)))

    def _jump(self) -> None:
        self._generation += 1
        self._awaits_situation = True
        at_ns = self._clock.position_ns()
        # Latched values are recorded right after the start.
        at_beginning = at_ns == self._clock.start_ns
        shown_ns = min(at_ns + _BEGINNING_NS, self._clock.end_ns) if at_beginning else at_ns
        self._feed.jump(self._generation, at_ns, shown_ns=shown_ns)
        self._notify()

    def _tick(self) -> None:
        if self._awaits_situation:
            # Nothing is skipped: the clock waits at the seek position.
            self._clock.seek(self.playback.value.position_ns)
            return
        position_ns = self._clock.position_ns()
        due, keeps_up = self._feed.due(position_ns, self._clock.rate)
        self._show(due)
        if not keeps_up:
            self._clock.seek(self.playback.value.position_ns)
        if position_ns >= self._clock.end_ns:
            self.pause()
        self._ticks += 1
        if self._ticks % _REPORT_EVERY_TICKS == 0 or not keeps_up:
            self._notify()

    def _show(self, due: list[Any]) -> None:
        """Show events in order, and the newest value of each stream, as live."""
        latest: dict[str, Any] = {}
        for value in due:
            spec = BY_TYPE[type(value)]
            if spec.delivery is Delivery.LOSSLESS:
                if isinstance(value, (ScenarioOpened, RobotChosen, LayoutChanged)):
                    self.standing_changed.emit(value)
                elif isinstance(value, LinkChanged):
                    self._state.forget_received(value)
                self._state.add(value)
            else:
                latest[spec.key_of(value)] = value
        for value in latest.values():
            self._take_value(value)

    def _take_value(self, value: Any) -> None:
        if isinstance(value, FrameRef):
            if self._state.camera.value not in ("", value.camera):
                # Show another camera as a thumbnail at a low rate, which costs little.
                now_s = time.monotonic()
                if now_s - self._small_s.get(value.camera, -math.inf) >= _SMALL_EVERY_S:
                    self._small_s[value.camera] = now_s
                    self._video.show(self._generation, value, nearest_key=True)
                return
            quick = self._clock.playing and self._clock.rate > KEY_FRAMES_FROM_RATE
            self._video.show(self._generation, value, nearest_key=quick)
        elif isinstance(value, StatusShown):
            if value.name != "camera" or not self._camera_chosen:
                self._showing_status = True
                try:
                    self._put_status_back(value)
                finally:
                    self._showing_status = False
        else:
            self._state.add(value)

    def _on_camera_changed(self, _camera: str) -> None:
        if not self._showing_status:
            self._camera_chosen = True
            self._jump()

    def _put_status_back(self, status: StatusShown) -> None:
        if status.name == "recording":
            if not isinstance(status.content, dict):
                _log.warning("a recorded status recording is not shown: it is a %s", type(status.content).__name__)
                return
            status = replace(status, content={**status.content, "folder": None})
        show_status(self._state, status, name_of=self._name_of)
        if status.name == "recording":
            self._state.recording.update(folder=self._session.folder)

    def _on_situation(self, situation: Situation) -> None:
        if situation.generation != self._generation:
            return
        for event in situation.standing:
            if isinstance(event, LinkQuality):
                self._state.add(event)
        self.standing_jumped.emit(
            tuple(
                event for event in situation.standing if isinstance(event, (ScenarioOpened, RobotChosen, LayoutChanged))
            )
        )
        values = list(situation.values)
        present = {BY_TYPE[type(value)].name for value in values}
        for spec in STATE_STREAMS:
            if spec.name not in present and spec.name != "frame":
                self._state.stream(spec.name).clear()
        cameras = {value.camera for value in values if isinstance(value, People)}
        for camera in self._state.cameras.value:
            if camera not in cameras:
                self._state.people_of(camera).clear()
        self._state.time_jumped.emit(situation.events)
        for value in values:
            self._take_value(value)
        # In older recordings without a choice: the camera used for detection.
        main_camera = self._state.camera.value or next((each.camera for each in values if isinstance(each, People)), "")
        self._show_frames(situation.frames, main_camera)
        self._awaits_situation = False
        self._state.check_freshness()
        self._notify()

    def _show_frames(self, frames: Sequence[FrameRef], main_camera: str) -> None:
        """After a seek: show each camera's frame, and clear cameras that had none."""
        of_camera = {ref.camera: ref for ref in frames}
        for camera in self._state.cameras.value:
            if camera not in of_camera:
                self._state.frame_of(camera).clear()
        if frames and not main_camera:
            main_camera = frames[-1].camera
        if main_camera not in of_camera:
            self._state.frame.clear()
        if not self._state.camera.value:
            self._showing_status = True  # not the viewer's choice
            self._state.camera.set(main_camera)
            self._showing_status = False
        for camera, ref in of_camera.items():
            self._video.show(self._generation, ref, nearest_key=camera != main_camera)

    def _on_frame(self, generation: int, ref: FrameRef) -> None:
        if generation != self._generation:
            return
        self._showing_status = True  # the first frame determines the camera
        self._state.add(ref)
        self._showing_status = False

    def _on_failed(self, reason: str) -> None:
        self._clock.pause()
        self._timer.stop()
        self.playback.update(playing=False, detail=reason)

    def _notify(self) -> None:
        self.playback.update(
            position_ns=self._clock.position_ns(),
            playing=self._clock.playing,
            rate=self._clock.rate,
        )
