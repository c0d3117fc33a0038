"""Replay player: plays a recorded session into LiveState, as the panels saw it live. GUI thread."""

import bisect
import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from PySide6.QtCore import QObject, Qt, QTimer, Signal

from caris_desktop.domain.events import LayoutChanged, LinkChanged, LinkQuality, RobotChosen, ScenarioOpened
from caris_desktop.domain.sensing import FrameRef, People, StatusShown
from caris_desktop.domain.streams import BY_TYPE, STATE_STREAMS, Delivery
from caris_desktop.live.playback_clock import PlaybackClock
from caris_desktop.live.replay_feed import ReplayFeed, Situation
from caris_desktop.live.replay_video import KEY_FRAMES_FROM_RATE, ReplayFrames, ReplayVideo
from caris_desktop.live.state import LiveState, LiveValue
from caris_desktop.live.status import PlaybackStatus
from caris_desktop.live.status_tap import show_status
from caris_desktop.recording.session.session_reader import Session

_log = logging.getLogger(__name__)
_TICK_MS = 5
_BEGINNING_NS = 500_000_000
_TELL_EVERY_TICKS = 8
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
        self._timer = QTimer(self)
        self._timer.setTimerType(Qt.TimerType.PreciseTimer)
        self._timer.timeout.connect(self._tick)

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
        self._timer.start(_TICK_MS)
        self._notify()

    def pause(self) -> None:
        self._clock.pause()
        self._feed.read_ahead(playing=False)
        self._timer.stop()
        self._notify()

    def set_rate(self, rate: float) -> None:
        self._clock.set_rate(rate)
        self._notify()

    def seek(self, at_ns: int) -> None:
        self._clock.seek(at_ns)
        self._jump()

    def step(self, frames: int) -> None:
        self.pause()
        shown: FrameRef | None = self._state.frame.value
        times = self._frame_times(shown.camera) if shown is not None else []
        if shown is None or not times:
            self.seek(self._clock.position_ns() + frames * 100_000_000)
            return
        # A frame is visible from its arrival, slightly after its capture: seek behind both.
        index = bisect.bisect_right(times, shown.stamp_ns) - 1 + frames
        target_ns = times[min(len(times) - 1, max(0, index))]
        self.seek(target_ns + self._delay_ns(shown))

    def _delay_ns(self, shown: FrameRef) -> int:
        return max(0, min(200_000_000, self._clock.position_ns() - shown.stamp_ns))

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
        if self._ticks % _TELL_EVERY_TICKS == 0 or not keeps_up:
            self._notify()

    def _show(self, due: list[Any]) -> None:
        """Show events in order, and the newest value of each stream, as live."""
        latest: dict[str, Any] = {}
        for value in due:
            spec = BY_TYPE[type(value)]
            if spec.delivery is Delivery.LOSSLESS:
                self._take_event(value)
            else:
                latest[spec.key_of(value)] = value
        for value in latest.values():
            self._take_value(value)

    def _take_event(self, event: Any) -> None:
        if isinstance(event, (ScenarioOpened, RobotChosen, LayoutChanged)):
            self.standing_changed.emit(event)
        elif isinstance(event, LinkChanged):
            self._state.forget_what_came_over(event)
        self._state.take(event)

    def _take_value(self, value: Any) -> None:
        if isinstance(value, FrameRef):
            if self._state.camera.value not in ("", value.camera):
                self._show_small(value)
                return
            quick = self._clock.playing and self._clock.rate > KEY_FRAMES_FROM_RATE
            self._video.show(self._generation, value, nearest_key=quick)
        elif isinstance(value, StatusShown):
            self._take_status(value)
        else:
            self._state.take(value)

    def _show_small(self, ref: FrameRef) -> None:
        """Show another camera as a thumbnail at a low rate, which costs little."""
        now_s = time.monotonic()
        if now_s - self._small_s.get(ref.camera, -math.inf) >= _SMALL_EVERY_S:
            self._small_s[ref.camera] = now_s
            self._video.show(self._generation, ref, nearest_key=True)

    def _on_camera_changed(self, _camera: str) -> None:
        if not self._showing_status:
            self._camera_chosen = True
            self._jump()

    def _take_status(self, shown: StatusShown) -> None:
        if shown.name == "camera" and self._camera_chosen:
            return
        self._showing_status = True
        try:
            self._put_status_back(shown)
        finally:
            self._showing_status = False

    def _put_status_back(self, shown: StatusShown) -> None:
        if shown.name == "recording":
            if not isinstance(shown.content, dict):
                _log.warning("a recorded status recording is not shown: it is a %s", type(shown.content).__name__)
                return
            shown = replace(shown, content={**shown.content, "folder": None})
        show_status(self._state, shown, name_of=self._name_of)
        if shown.name == "recording":
            self._state.recording.set(replace(self._state.recording.value, folder=self._session.folder))

    def _on_situation(self, situation: Situation) -> None:
        if situation.generation != self._generation:
            return
        for event in situation.standing:
            if isinstance(event, LinkQuality):
                self._state.take(event)
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
        seen_by = {value.camera for value in values if isinstance(value, People)}
        for camera in self._state.cameras.value:
            if camera not in seen_by:
                self._state.people_of(camera).clear()
        self._state.time_jumped.emit(situation.events)
        for value in values:
            self._take_value(value)
        wanted = self._state.camera.value or _camera_of_people(values)
        self._show_frames(situation.frames, wanted)
        self._awaits_situation = False
        self._state.check_freshness()
        self._notify()

    def _show_frames(self, frames: Sequence[FrameRef], wanted: str) -> None:
        """After a seek: show each camera's frame, and clear cameras that had none."""
        of_camera = {ref.camera: ref for ref in frames}
        for camera in self._state.cameras.value:
            if camera not in of_camera:
                self._state.frame_of(camera).clear()
        if frames and not wanted:
            wanted = frames[-1].camera
        if wanted not in of_camera:
            self._state.frame.clear()
        if not self._state.camera.value:
            self._showing_status = True  # not the viewer's choice
            self._state.camera.set(wanted)
            self._showing_status = False
        for camera, ref in of_camera.items():
            self._video.show(self._generation, ref, nearest_key=camera != wanted)

    def _on_frame(self, generation: int, ref: FrameRef) -> None:
        if generation != self._generation:
            return
        self._showing_status = True  # the first frame determines the camera
        self._state.take(ref)
        self._showing_status = False

    def _on_failed(self, why: str) -> None:
        self._clock.pause()
        self._timer.stop()
        self.playback.set(replace(self.playback.value, playing=False, detail=why))

    def _notify(self) -> None:
        self.playback.set(
            replace(
                self.playback.value,
                position_ns=self._clock.position_ns(),
                playing=self._clock.playing,
                rate=self._clock.rate,
            )
        )


def _camera_of_people(values: list[Any]) -> str:
    """Camera in older recordings without a choice: the one used for detection."""
    return next((value.camera for value in values if isinstance(value, People)), "")
