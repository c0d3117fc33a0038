"""Protocol service: the wizard's progress in the scenario's protocol, shown and recorded. GUI thread."""

from collections.abc import Callable
from dataclasses import replace

from PySide6.QtCore import QObject

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import Event, ProtocolEnded, ProtocolOpened, StepEntered, StepTicked
from caris_desktop.live.protocol_run import ProtocolRun
from caris_desktop.live.service import Handlers, Service
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.scenario_model import Scenario

ProtocolEvent = ProtocolOpened | StepEntered | StepTicked | ProtocolEnded


class ProtocolService(Service):
    """Maintains ``state.protocol``.

    A recording begins with the first step, unless the scenario leaves that to the wizard, and resets the protocol at
    its end. An edited scenario keeps the current step.
    """

    def __init__(self, state: LiveState, publish: Callable[[Event], None], parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._state = state
        self._publish = publish
        self._scenario: Scenario | None = None
        self._walk = ProtocolRun()
        self._entered: StepEntered | None = None
        self._in_session = False
        # Events during a pause, missing in the record; None without a pause.
        self._since_pause: list[ProtocolEvent] | None = None

    def handlers(self) -> Handlers:
        return {
            intents.NextStep: lambda asked: self._notify(self._walk.next(clock.now_ns(), asked.actor)),
            intents.PreviousStep: lambda asked: self._notify(self._walk.back(clock.now_ns(), asked.actor)),
            intents.SkipStep: lambda asked: self._notify(self._walk.skip(clock.now_ns(), asked.actor)),
            intents.TakeBranch: lambda asked: self._notify(
                self._walk.branch(asked.branch, clock.now_ns(), asked.actor)
            ),
            intents.GoToStep: lambda asked: self._notify(self._walk.choose(asked.step_id, clock.now_ns(), asked.actor)),
            intents.TickItem: self._tick,
        }

    def use_scenario(self, scenario: Scenario) -> None:
        before, self._scenario = self._scenario, scenario
        steps, known = scenario.protocol.steps, () if before is None else before.protocol.steps
        another = before is None or not known or (scenario.title != before.title and scenario.path != before.path)
        if another:
            self._walk = ProtocolRun()
            self._walk.pause(self._since_pause is not None, clock.now_ns())
        self._walk.follow(steps)
        if steps != known:
            self._notify(self._walk.opened(clock.now_ns()), shown=False)
        if another and self._in_session:
            self._begin(CONSOLE, shown=False)
        self._show()

    # Session

    def begin_session(self, actor: Actor, *, step_id: str = "") -> None:
        """Begin a session, at this step of a resumed trial if the protocol still has it."""
        self._in_session, self._since_pause = True, None
        if self._walk.has(step_id):
            self._walk = ProtocolRun(self._walk.steps)
            self._notify(self._walk.choose(step_id, clock.now_ns(), actor))
        else:
            self._begin(actor)

    def state_events(self, now_ns: int, *, resumed: bool) -> list[Event]:
        """Initial events of a recording, or those missed during a pause."""
        if resumed:
            return [replace(event, stamp_ns=now_ns) for event in self._since_pause or ()]
        opened: list[Event] = [self._walk.opened(now_ns)] if self._walk.steps else []
        entered = self._entered if self._walk.is_running else None
        return opened if entered is None else [*opened, replace(entered, stamp_ns=now_ns)]

    def pause(self, paused: bool) -> None:
        if self._in_session:
            self._walk.pause(paused, clock.now_ns())
            self._since_pause = [] if paused else None
            self._show()

    def end_session(self) -> None:
        """Reset after a session; no effect without one."""
        if self._in_session:
            self._in_session, self._since_pause = False, None
            self._walk = ProtocolRun(self._walk.steps)
            self._show()

    # Internals

    def _begin(self, actor: Actor, *, shown: bool = True) -> None:
        """Restart the protocol, unless the wizard starts it by hand and may have done so."""
        if self._scenario is not None and self._scenario.protocol.begins == "with_recording":
            self._walk = ProtocolRun(self._scenario.protocol.steps)
            self._walk.pause(self._since_pause is not None, clock.now_ns())
            if self._walk.steps:
                self._notify(self._walk.start(clock.now_ns(), actor), shown=shown)

    def _tick(self, asked: intents.TickItem) -> None:
        event = self._walk.tick(asked.item, asked.on, clock.now_ns(), asked.actor)
        if event is not None:
            self._notify(event)

    def _notify(self, event: ProtocolEvent, *, shown: bool = True) -> None:
        """Publish an event; ``shown``: update the state, once after several events."""
        if isinstance(event, StepEntered):
            self._entered = event
        if self._since_pause is not None:
            self._since_pause.append(event)
        if shown:
            self._show()
        self._publish(event)

    def _show(self) -> None:
        self._state.protocol.set(self._walk.status())
