"""Who pays when the machine is busy: small pictures first, then looking for people, then the panels and the map, then
the picture. Driving, stopping, sound and the record never do, and where people have to be covered in the record,
looking for them does not either. Decided here alone, in steps, and shown.
"""

from collections import deque
from collections.abc import Callable

from PySide6.QtCore import QObject, Qt, QTimer

from caris_desktop.domain import clock
from caris_desktop.domain.sensing import FrameRef, People
from caris_desktop.domain.sound import PARTICIPANT_SOURCES, Hearing
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass
from caris_desktop.live.bus import Bus
from caris_desktop.live.model_client import ModelClient
from caris_desktop.live.service import Service
from caris_desktop.live.services.people import PeopleService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import LoadStatus
from caris_desktop.scenario.model import Scenario

LOOK_EVERY_MS = 100
_WINDOW = 30  # looks, three seconds
_LEAST_KNOWN = 3
_STEP_AFTER_NS = 2_000_000_000
_BACK_AFTER_NS = 8_000_000_000


@dataclass(frozen=True, slots=True)
class Limits:
    """Of one measure in ms: one step more where the ``counted`` share of the looks is above ``late``, and one less once
    that is below ``in_time`` for all of them.
    """

    late: float
    in_time: float
    counted: float


STALLS = Limits(late=25.0, in_time=10.0, counted=0.1)
"""How late the GUI thread is: a tenth of the looks tells, as one stall is no load."""
FRAMES = Limits(late=150.0, in_time=80.0, counted=0.1)
"""How old a picture is when it gets here: to unpack a large one takes some 20 ms."""
DETECTION = Limits(late=500.0, in_time=300.0, counted=0.5)
"""How long a look for people takes: with fewer than two a second who walks by is counted more than once."""


@dataclass(frozen=True, slots=True)
class Step:
    """What is given up: the least time from one look for people to the next, from one pass of the panels and of the
    picture; and what the wizard reads. Small pictures pay from the first step on (:meth:`LoadStatus.pays_small`).
    """

    look_every_s: float = 0.0
    panels_every_s: float = 0.0
    picture_every_s: float = 0.0
    detail: str = ""


# No panel waits longer than 0.15 s: a scan that is older than half a second slows driving down.
STEPS = (
    Step(),
    Step(detail=QT_TR_NOOP("small pictures less often")),
    Step(0.25, detail=QT_TR_NOOP("people less often")),
    Step(0.6, 0.15, detail=QT_TR_NOOP("people less often, panels slower")),
    Step(1.2, 0.15, 0.15, QT_TR_NOOP("people seldom, picture and panels slower")),
)
# The same where the record shows only what was looked at.
STEPS_WITH_BLUR = (
    Step(),
    Step(detail=QT_TR_NOOP("small pictures less often")),
    Step(0.0, 0.07, detail=QT_TR_NOOP("panels slower")),
    Step(0.0, 0.15, detail=QT_TR_NOOP("panels slower")),
    Step(0.0, 0.15, 0.15, QT_TR_NOOP("picture and panels slower")),
)
PEOPLE_PAY = 2
"""The last step before panels and picture pay. Boxes alone are worth no more than this."""
_ANSWERING = 3
"""While a language model on this computer answers, whatever it is asked for, who waits for it comes before boxes. So
does, in a pause of a participant, who waits for the last words; while somebody speaks, their mouth tells who it is.
"""
_PANELS_STAND_NS = 600_000_000
"""For so long after another scenario was opened its panels are what the wizard waits for."""
_LOOK_COUNTS_NS = 5_000_000_000
"""For so long a look for people says how long the next one will take."""
_HEARD_WITHIN_NS = 5_000_000_000
"""Longer than any pause within a turn. What was heard before that says nothing of now: the recogniser may be gone."""


class _Measure:
    """The last looks at one figure; None where there was none to be had."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._seen_ms: deque[float | None] = deque(maxlen=_WINDOW)

    def look(self, ms: float | None) -> None:
        self._seen_ms.append(ms)

    def forget(self) -> None:
        self._seen_ms.clear()

    @property
    def counts(self) -> float:
        """The figure that tells: 0 where there are too few."""
        known = sorted(ms for ms in self._seen_ms if ms is not None)
        return known[-max(1, int(len(known) * self._limits.counted))] if len(known) >= _LEAST_KNOWN else 0.0

    @property
    def late(self) -> bool:
        return self.counts > self._limits.late

    @property
    def in_time(self) -> bool:
        return self.counts < self._limits.in_time


class LoadSteps:
    """How many steps are given up, from how late the GUI thread is, how old pictures are when they get here, and how
    long a look for people takes. Times in ns of one clock.
    """

    def __init__(self) -> None:
        self.step = 0
        self.covers = False
        """Looking for people ranks with the record: where it is slow, everything else pays."""
        self._stalls, self._frames, self._detection = _Measure(STALLS), _Measure(FRAMES), _Measure(DETECTION)
        self._measures = (self._stalls, self._frames, self._detection)
        self._looks = 0
        self._changed_ns = 0

    def look(
        self, late_ms: float, now_ns: int, *, frame_age_ms: float | None = None, detection_ms: float | None = None
    ) -> int:
        """One look; gives the step from now on. None where no picture came, or nobody is looked for here."""
        for measure, ms in zip(self._measures, (late_ms, frame_age_ms, detection_ms), strict=True):
            measure.look(ms)
        self._looks += 1
        if self._looks < _WINDOW // 2:
            return self.step
        since_ns = now_ns - self._changed_ns
        last = len(STEPS) - 1
        worth = last if self._stalls.late or self._frames.late else 0
        if self._detection.late:
            worth = max(worth, last if self.covers else PEOPLE_PAY)
        if self.step < worth:
            if since_ns >= _STEP_AFTER_NS:
                self._go(self.step + 1, now_ns)
        elif since_ns >= _BACK_AFTER_NS and self.step > self._kept:
            self._go(self.step - 1, now_ns)
        return self.step

    @property
    def _kept(self) -> int:
        """The step below which nothing is given back as it is."""
        if not (self._stalls.in_time and self._frames.in_time):
            return self.step
        if self._detection.in_time:
            return 0
        return self.step if self.covers else min(self.step, PEOPLE_PAY)

    def _go(self, step: int, now_ns: int) -> None:
        # What was late before says nothing of how it is with this step.
        self.step, self._changed_ns, self._looks = step, now_ns, 0
        for measure in self._measures:
            measure.forget()


class GovernorService(Service):
    """Looks how loaded the machine is, slows down what can wait, and keeps ``state.load``."""

    def __init__(
        self,
        state: LiveState,
        bus: Bus,
        people: PeopleService,
        models: ModelClient,
        *,
        parent: QObject,
        now_ns: Callable[[], int] = clock.now_ns,
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._bus = bus
        self._people = people
        self._models = models
        self._now_ns = now_ns
        self._steps = LoadSteps()
        self._due_ns = 0
        self._frame_age_ms: float | None = None
        self._detection_ms, self._detected_ns = 0.0, 0
        self._blurs = False
        self._hears_here = False
        self._panels_until_ns = 0
        for source in PARTICIPANT_SOURCES:
            state.hearing_of(source).changed.connect(self._apply)
        bus.tap(self._note_frame, (FrameRef,))
        bus.tap(self._note_people, (People,))
        self._timer = QTimer(self, interval=LOOK_EVERY_MS, timerType=Qt.TimerType.PreciseTimer)
        self._timer.timeout.connect(self._look)
        models.answering_changed.connect(self._apply)

    def use_scenario(self, scenario: Scenario) -> None:
        self._blurs = self._steps.covers = scenario.covers_people
        self._hears_here = scenario.listening.engine == "local"
        self._panels_until_ns = self._now_ns() + _PANELS_STAND_NS
        self._apply()

    def start(self) -> None:
        self._due_ns = self._now_ns() + LOOK_EVERY_MS * 1_000_000
        self._timer.start()

    def stop(self) -> None:
        self._timer.stop()

    def _waited_for(self) -> int:
        """The step that looking for people takes so that what somebody waits for comes first."""
        if self._now_ns() < self._panels_until_ns or (self._models.answering and self._models.answers_here):
            return _ANSWERING
        heard = (self._state.hearing_of(source).value for source in PARTICIPANT_SOURCES if self._hears_here)
        return _ANSWERING if any(map(self._makes_out_words, heard)) else 0

    def _makes_out_words(self, hearing: Hearing | None) -> bool:
        return (
            hearing is not None
            and bool(hearing.utterance_id)
            and not hearing.speaking
            and hearing.speaker in ("", "participant")
            and self._now_ns() - hearing.stamp_ns < _HEARD_WITHIN_NS
        )

    def _note_frame(self, frame: FrameRef, _raw: bytes | None) -> None:  # any thread
        self._frame_age_ms = max(0.0, (self._now_ns() - frame.stamp_ns) / 1e6)

    def _note_people(self, people: People, _raw: bytes | None) -> None:  # any thread
        self._detection_ms, self._detected_ns = people.inference_ms, self._now_ns()

    def _look(self) -> None:
        now_ns = self._now_ns()
        late_ms = max(0.0, (now_ns - self._due_ns) / 1e6)
        self._due_ns = now_ns + LOOK_EVERY_MS * 1_000_000
        frame_age_ms, self._frame_age_ms = self._frame_age_ms, None
        # Another machine that is slow gets nothing of what is given up here.
        looks_here = not self._state.perception.value.server and now_ns - self._detected_ns < _LOOK_COUNTS_NS
        self._steps.look(
            late_ms, now_ns, frame_age_ms=frame_age_ms, detection_ms=self._detection_ms if looks_here else None
        )
        self._apply()

    def _apply(self) -> None:
        number, steps = self._steps.step, STEPS_WITH_BLUR if self._blurs else STEPS
        step = steps[number]
        self._people.look_at_most_every(steps[max(number, self._waited_for())].look_every_s)
        self._bus.pass_at_most_every(panels_s=step.panels_every_s, picture_s=step.picture_every_s)
        self._state.load.set(LoadStatus(number, step.detail))
