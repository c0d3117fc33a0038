"""Load shedding: on a busy machine thumbnails are reduced first, then detection, then panels and map, then video.
Driving, stopping, audio and recording are never reduced, nor is detection while recordings need blurring. Decided here
only, in visible levels.
"""

from collections import deque
from collections.abc import Callable, Iterable

from PySide6.QtCore import QObject

from caris_desktop.domain import clock
from caris_desktop.domain.sensing import FrameRef, People
from caris_desktop.domain.sound_values import PARTICIPANT_SOURCES, Hearing
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import new_timer
from caris_desktop.live.model_client import ModelClient
from caris_desktop.live.service import ContextService, Service, ServiceContext
from caris_desktop.live.services.people_service import PeopleService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import LoadStatus
from caris_desktop.scenario.scenario_model import Scenario

POLL_EVERY_MS = 100
_WINDOW = 30  # samples, three seconds
_LEAST_KNOWN = 3
_STEP_AFTER_NS = 2_000_000_000
_BACK_AFTER_NS = 8_000_000_000


class Limits(Value):
    """Thresholds of a measure in ms: one level up if the ``counted`` share of samples exceeds ``late``, one down once
    it is below ``in_time`` for all measures.
    """

    late: float
    in_time: float
    counted: float


STALLS = Limits(late=25.0, in_time=10.0, counted=0.1)
"""GUI thread delay: a tenth of the samples, as a single stall is no load."""
FRAMES = Limits(late=150.0, in_time=80.0, counted=0.1)
"""Frame age on arrival: decoding a large frame takes about 20 ms."""
DETECTION = Limits(late=500.0, in_time=300.0, counted=0.5)
"""Duration of a detection: below two per second a passer-by is counted repeatedly."""


class Step(Value):
    """Load shedding level: minimum intervals of detection, panels and video; and its text. Thumbnails are reduced from
    the first level on (:meth:`LoadStatus.pays_small`).
    """

    detection_interval_s: float = 0.0
    panels_every_s: float = 0.0
    picture_every_s: float = 0.0
    detail: str = ""


# Panels wait 0.15 s at most: a scan older than half a second slows down driving.
STEPS = (
    Step(),
    Step(detail=QT_TR_NOOP("thumbnails less often")),
    Step(0.25, detail=QT_TR_NOOP("people detection less often")),
    Step(0.6, 0.15, detail=QT_TR_NOOP("people detection less often, panels slower")),
    Step(1.2, 0.15, 0.15, QT_TR_NOOP("people detection much less often, video and panels slower")),
)
# Levels while recordings contain only frames with detections.
STEPS_WITH_BLUR = (
    Step(),
    Step(detail=QT_TR_NOOP("thumbnails less often")),
    Step(0.0, 0.07, detail=QT_TR_NOOP("panels slower")),
    Step(0.0, 0.15, detail=QT_TR_NOOP("panels slower")),
    Step(0.0, 0.15, 0.15, QT_TR_NOOP("video and panels slower")),
)
PEOPLE_PAY = 2
"""Last level before panels and video are reduced; more than that is not worth the boxes."""
_ANSWERING = 3
"""Level while a local language model answers: its user comes before boxes. Likewise in a participant's pause, when the
last words are transcribed; during speech, detection identifies the speaker.
"""
_PANELS_STAND_NS = 600_000_000
"""After a scenario change the wizard waits for its panels for this time."""
_DETECTION_COUNTS_NS = 5_000_000_000
"""Age up to which a detection predicts the duration of the next one."""
_SPEECH_WITHIN_NS = 5_000_000_000
"""Longer than any pause in a turn. Older audio is irrelevant: the recogniser may have ended."""


class _Measure:
    """Recent samples of one measure; None for a missing sample."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self.seen_ms: deque[float | None] = deque(maxlen=_WINDOW)

    @property
    def counts(self) -> float:
        """Deciding value of the measure: 0 with too few samples."""
        known = sorted(ms for ms in self.seen_ms if ms is not None)
        return known[-max(1, int(len(known) * self._limits.counted))] if len(known) >= _LEAST_KNOWN else 0.0

    @property
    def late(self) -> bool:
        return self.counts > self._limits.late

    @property
    def in_time(self) -> bool:
        return self.counts < self._limits.in_time


class LoadLevels:
    """Level from GUI thread delay, frame age and detection time. Times in ns of one clock."""

    def __init__(self) -> None:
        self.step = 0
        self.covers = False
        """Looking for people ranks with the record: where it is slow, everything else pays."""
        self._stalls, self._frames, self._detection = _Measure(STALLS), _Measure(FRAMES), _Measure(DETECTION)
        self._measures = (self._stalls, self._frames, self._detection)
        self._sample_count = 0
        self._changed_ns = 0

    def add_samples(
        self, late_ms: float, now_ns: int, *, frame_age_ms: float | None = None, detection_ms: float | None = None
    ) -> int:
        """Add samples; returns the new level. None without a frame or local detection."""
        for measure, ms in zip(self._measures, (late_ms, frame_age_ms, detection_ms), strict=True):
            measure.seen_ms.append(ms)
        self._sample_count += 1
        if self._sample_count < _WINDOW // 2:
            return self.step
        since_ns = now_ns - self._changed_ns
        last = len(STEPS) - 1
        worth = last if self._stalls.late or self._frames.late else 0
        if self._detection.late:
            worth = max(worth, last if self.covers else PEOPLE_PAY)
        if self.step < worth:
            if since_ns >= _STEP_AFTER_NS:
                self._go(self.step + 1, now_ns)
        elif since_ns >= _BACK_AFTER_NS and self.step > self._lowest_permitted:
            self._go(self.step - 1, now_ns)
        return self.step

    @property
    def _lowest_permitted(self) -> int:
        """Lowest level that the samples permit."""
        if not (self._stalls.in_time and self._frames.in_time):
            return self.step
        if self._detection.in_time:
            return 0
        return self.step if self.covers else min(self.step, PEOPLE_PAY)

    def _go(self, step: int, now_ns: int) -> None:
        # Samples from another level are meaningless for this one.
        self.step, self._changed_ns, self._sample_count = step, now_ns, 0
        for measure in self._measures:
            measure.seen_ms.clear()


class LoadSheddingService(ContextService):
    """Measures the load, reduces deferrable work, and maintains ``state.load``."""

    def __init__(
        self,
        context: ServiceContext,
        people: PeopleService,
        models: ModelClient,
        *,
        now_ns: Callable[[], int] = clock.now_ns,
    ) -> None:
        super().__init__(context)
        self._people = people
        self._models = models
        self._now_ns = now_ns
        self._steps = LoadLevels()
        self._due_ns = 0
        self._frame_age_ms: float | None = None
        self._detection_ms, self._detected_ns = 0.0, 0
        self._blurs = False
        self._listens_locally = False
        self._panels_until_ns = 0
        for source in PARTICIPANT_SOURCES:
            self._state.hearing_of(source).changed.connect(self._apply)
        self._bus.tap(self._note_frame, (FrameRef,))
        self._bus.tap(self._note_people, (People,))
        self._timer = new_timer(self, self._measure, POLL_EVERY_MS, precise=True)
        models.answering_changed.connect(self._apply)

    def use_scenario(self, scenario: Scenario) -> None:
        self._blurs = self._steps.covers = scenario.covers_people
        self._listens_locally = scenario.listening.engine == "local"
        self._panels_until_ns = self._now_ns() + _PANELS_STAND_NS
        self._apply()

    def start(self) -> None:
        self._due_ns = self._now_ns() + POLL_EVERY_MS * 1_000_000
        self._timer.start()

    def stop(self) -> None:
        self._timer.stop()

    def _waited_for(self) -> int:
        """Detection level that favours work someone is waiting for."""
        if self._now_ns() < self._panels_until_ns or (self._models.answering and self._models.answers_here):
            return _ANSWERING
        hearings = (self._state.hearing_of(source).value for source in PARTICIPANT_SOURCES if self._listens_locally)
        return _ANSWERING if any(map(self._makes_out_words, hearings)) else 0

    def _makes_out_words(self, hearing: Hearing | None) -> bool:
        return (
            hearing is not None
            and bool(hearing.utterance_id)
            and not hearing.speaking
            and hearing.speaker in ("", "participant")
            and self._now_ns() - hearing.stamp_ns < _SPEECH_WITHIN_NS
        )

    def _note_frame(self, frame: FrameRef, _raw: bytes | None) -> None:  # any thread
        self._frame_age_ms = max(0.0, (self._now_ns() - frame.stamp_ns) / 1e6)

    def _note_people(self, people: People, _raw: bytes | None) -> None:  # any thread
        self._detection_ms, self._detected_ns = people.inference_ms, self._now_ns()

    def _measure(self) -> None:
        now_ns = self._now_ns()
        late_ms = max(0.0, (now_ns - self._due_ns) / 1e6)
        self._due_ns = now_ns + POLL_EVERY_MS * 1_000_000
        frame_age_ms, self._frame_age_ms = self._frame_age_ms, None
        # Load shedding here does not help another machine.
        detects_here = not self._state.perception.value.server and now_ns - self._detected_ns < _DETECTION_COUNTS_NS
        self._steps.add_samples(
            late_ms, now_ns, frame_age_ms=frame_age_ms, detection_ms=self._detection_ms if detects_here else None
        )
        self._apply()

    def _apply(self) -> None:
        number, steps = self._steps.step, STEPS_WITH_BLUR if self._blurs else STEPS
        step = steps[number]
        self._people.limit_detection_rate(steps[max(number, self._waited_for())].detection_interval_s)
        self._bus.pass_at_most_every(panels_s=step.panels_every_s, picture_s=step.picture_every_s)
        self._state.load.set(LoadStatus(number, step.detail))


# Health service: state of the child processes.

_POLL_EVERY_MS = 1000


class HealthService(Service):
    """Maintains ``state.health``."""

    def __init__(self, state: LiveState, services: Callable[[], Iterable[Service]], parent: QObject) -> None:
        super().__init__(parent)
        self._state = state
        self._services = services
        self._timer = new_timer(self, self.update, _POLL_EVERY_MS)

    def start(self) -> None:
        self._timer.start()

    def stop(self) -> None:
        self._timer.stop()

    def update(self) -> None:
        self._state.health.set({name: how for each in self._services() for name, how in each.health().items()})
