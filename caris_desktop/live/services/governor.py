"""Who pays when the machine is busy: looking for people first, then the panels, then the picture. Driving, stopping,
sound and the record never do, and where people have to be covered in the record, looking for them does not either.
Decided here alone, in steps, and shown.
"""

from collections import deque
from collections.abc import Callable

from PySide6.QtCore import QObject, Qt, QTimer

from caris_desktop.domain import clock
from caris_desktop.domain.sound import PARTICIPANT_SOURCES, Hearing
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.bus import Bus
from caris_desktop.live.model_client import ModelClient
from caris_desktop.live.service import Service
from caris_desktop.live.services.people import PeopleService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import LoadStatus
from caris_desktop.scenario.model import Scenario

LOOK_EVERY_MS = 100
_WINDOW = 30  # looks, three seconds
LATE_MS, IN_TIME_MS = 25.0, 10.0
"""A tenth of the looks later than this: one step more. Earlier than that all the while: one step less."""
_STEP_AFTER_NS = 2_000_000_000
_BACK_AFTER_NS = 8_000_000_000

# Of each step: the least time from one look for people to the next, the same of the panels, and what the wizard reads.
STEPS: tuple[tuple[float, float, str], ...] = (
    (0.0, 0.0, ""),
    (0.25, 0.0, QT_TR_NOOP("people less often")),
    (0.6, 0.07, QT_TR_NOOP("people less often, panels slower")),
    (1.2, 0.15, QT_TR_NOOP("people seldom, picture and panels slower")),
)
# The same where the record shows only what was looked at.
STEPS_WITH_BLUR: tuple[tuple[float, float, str], ...] = (
    (0.0, 0.0, ""),
    (0.0, 0.07, QT_TR_NOOP("panels slower")),
    (0.0, 0.11, QT_TR_NOOP("panels slower")),
    (0.0, 0.15, QT_TR_NOOP("picture and panels slower")),
)
_ANSWERING = 2
"""While a language model on this computer answers, whatever it is asked for, who waits for it comes before boxes. So
does, in a pause of a participant, who waits for the last words; while somebody speaks, their mouth tells who it is.
"""
_PANELS_STAND_NS = 600_000_000
"""For so long after another scenario was opened its panels are what the wizard waits for."""
_HEARD_WITHIN_NS = 5_000_000_000
"""Longer than any pause within a turn. What was heard before that says nothing of now: the recogniser may be gone."""


class LoadSteps:
    """How many steps are given up, from how late the GUI thread is. Times in ns of one clock."""

    def __init__(self) -> None:
        self.step = 0
        self._late_ms: deque[float] = deque(maxlen=_WINDOW)
        self._changed_ns = 0

    def look(self, late_ms: float, now_ns: int) -> int:
        """One look; gives the step from now on."""
        self._late_ms.append(late_ms)
        if len(self._late_ms) < _WINDOW // 2:
            return self.step
        late = sorted(self._late_ms)[-max(1, len(self._late_ms) // 10)]
        since_ns = now_ns - self._changed_ns
        if late > LATE_MS and self.step < len(STEPS) - 1 and since_ns >= _STEP_AFTER_NS:
            self._go(self.step + 1, now_ns)
        elif late < IN_TIME_MS and self.step > 0 and since_ns >= _BACK_AFTER_NS:
            self._go(self.step - 1, now_ns)
        return self.step

    def _go(self, step: int, now_ns: int) -> None:
        # What was late before says nothing of how it is with this step.
        self.step, self._changed_ns = step, now_ns
        self._late_ms.clear()


class GovernorService(Service):
    """Looks how late the GUI thread is, slows down what can wait, and keeps ``state.load``."""

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
        self._blurs = False
        self._hears_here = False
        self._panels_until_ns = 0
        for source in PARTICIPANT_SOURCES:
            state.hearing_of(source).changed.connect(self._apply)
        self._timer = QTimer(self, interval=LOOK_EVERY_MS, timerType=Qt.TimerType.PreciseTimer)
        self._timer.timeout.connect(self._look)
        models.answering_changed.connect(self._apply)

    def use_scenario(self, scenario: Scenario) -> None:
        self._blurs = scenario.covers_people
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

    def _look(self) -> None:
        now_ns = self._now_ns()
        late_ms = max(0.0, (now_ns - self._due_ns) / 1e6)
        self._due_ns = now_ns + LOOK_EVERY_MS * 1_000_000
        self._steps.look(late_ms, now_ns)
        self._apply()

    def _apply(self) -> None:
        step, steps = self._steps.step, STEPS_WITH_BLUR if self._blurs else STEPS
        look_every_s = steps[max(step, self._waited_for())][0]
        _, panels_every_s, detail = steps[step]
        self._people.look_at_most_every(look_every_s)
        self._bus.pass_at_most_every(panels_every_s)
        self._state.load.set(LoadStatus(step, tr(detail) if detail else ""))
