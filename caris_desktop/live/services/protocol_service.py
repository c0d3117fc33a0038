"""Protocol service: the wizard's progress in the scenario's protocol, shown and recorded. GUI thread."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from PySide6.QtCore import QObject

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import (
    Event,
    PlannedStep,
    ProtocolEnded,
    ProtocolOpened,
    StepEntered,
    StepHow,
    StepTicked,
)
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.translation import tr
from caris_desktop.live.service import Handlers, Service
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import ProtocolStatus
from caris_desktop.scenario.protocol_steps import ProtocolStep, step_after, step_named
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
            intents.NextStep: lambda intent: self._notify(self._walk.next(clock.now_ns(), intent.actor)),
            intents.PreviousStep: lambda intent: self._notify(self._walk.back(clock.now_ns(), intent.actor)),
            intents.SkipStep: lambda intent: self._notify(self._walk.skip(clock.now_ns(), intent.actor)),
            intents.TakeBranch: lambda intent: self._notify(
                self._walk.branch(intent.branch, clock.now_ns(), intent.actor)
            ),
            intents.GoToStep: lambda intent: self._notify(
                self._walk.choose(intent.step_id, clock.now_ns(), intent.actor)
            ),
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

    def _tick(self, intent: intents.TickItem) -> None:
        event = self._walk.tick(intent.item, intent.on, clock.now_ns(), intent.actor)
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


class ProtocolRun:
    """Protocol run: state machine of the wizard's progress, without clock or Qt. Each move returns its event.

    Protocol run. Moves raise UserFacingError if impossible.
    """

    def __init__(self, steps: Sequence[ProtocolStep] = ()) -> None:
        self.steps = tuple(steps)
        self._ids = [step.step_id for step in self.steps]
        self._at = ""
        self._ended = False
        self._since_ns = 0
        self._paused_ns: int | None = None
        # Former steps, latest last, and the time spent in each.
        self._path: list[str] = []
        self._spent_ns: dict[str, int] = {}
        self._ticked: dict[str, tuple[str, ...]] = {}
        self._done: dict[str, None] = {}
        self._skipped: dict[str, None] = {}

    def status(self) -> ProtocolStatus:
        step = self._step
        if step is None:
            first = self.steps[0].title if self.steps and not self._ended else ""
            return ProtocolStatus(
                steps=len(self.steps), next_title=first,
                done=tuple(self._done), skipped=tuple(self._skipped), ended=self._ended,
            )  # fmt: skip
        number, following = self._ids.index(self._at) + 1, step_after(self.steps, step)
        return ProtocolStatus(
            step.step_id, step.title, number, len(self.steps), self._since_ns, self._paused_ns, step.expected_s,
            ticked=self._ticked.get(self._at, ()),
            next_title="" if following is None else following.title,
            done=tuple(done for done in self._done if done != self._at),
            skipped=tuple(skipped for skipped in self._skipped if skipped != self._at),
        )  # fmt: skip

    @property
    def is_running(self) -> bool:
        return bool(self._at)

    def has(self, step_id: str) -> bool:
        return step_id in self._ids

    # Moves

    def next(self, now_ns: int, actor: Actor) -> StepEntered | ProtocolEnded:
        step = self._step
        if step is None:
            return self.start(now_ns, actor)
        self._leave_done()
        return self._on(step, now_ns, "next", actor)

    def start(self, now_ns: int, actor: Actor) -> StepEntered:
        """Start at the first step, clearing the path back."""
        if not self.steps:
            raise _no_protocol()
        if self._ended:
            raise _ended()
        return self._enter(self._ids[0], now_ns, "started", actor)

    def skip(self, now_ns: int, actor: Actor) -> StepEntered | ProtocolEnded:
        step = self._present()
        self._skipped[self._at] = None
        self._done.pop(self._at, None)
        return self._on(step, now_ns, "skipped", actor)

    def back(self, now_ns: int, actor: Actor) -> StepEntered:
        if not self._at and not self._ended:
            raise _not_begun() if self.steps else _no_protocol()
        if self._path:
            before = self._path.pop()
        elif self._at and self._ids.index(self._at):
            before = self._ids[self._ids.index(self._at) - 1]
        else:
            raise UserFacingError(
                tr("This is the first step."), tr("There is no previous step."),
                tr("Choose any other step in the list of steps."), severity="info",
            )  # fmt: skip
        self._done.pop(before, None)
        self._skipped.pop(before, None)
        way = self._path.copy()
        event = self._enter(before, now_ns, "back", actor)
        self._path = way
        self._since_ns -= self._spent_ns.get(before, 0)
        return event

    def branch(self, title: str, now_ns: int, actor: Actor) -> StepEntered:
        taken = next((one for one in self._present().branches if one.title == title), None)
        target = None if taken is None else step_named(self.steps, taken.to)
        if target is None:
            raise UserFacingError(
                tr(
                    "The current step has no branch "
                    "“{title}”.").format(title=title), tr("The current step stays active."),
                tr("Choose the step in the list of steps."), severity="info",
            )  # fmt: skip
        self._leave_done()
        return self._enter(target.step_id, now_ns, "branch", actor, branch=title)

    def choose(self, step_id: str, now_ns: int, actor: Actor) -> StepEntered:
        if step_id not in self._ids:
            raise UserFacingError(
                tr("The protocol has no step “{step}”.").format(step=step_id), tr("The current step stays active."),
                tr("Choose one in the list of steps."), severity="info",
            )  # fmt: skip
        if step_id != self._at:
            self._leave_done()
        return self._enter(step_id, now_ns, "chosen", actor)

    def tick(self, item: str, on: bool, now_ns: int, actor: Actor) -> StepTicked | None:
        """Set a checklist item; None if unchanged."""
        step, ticked = self._present(), self._ticked.get(self._at, ())
        if item not in step.tick:
            raise UserFacingError(
                tr("The current step has no item “{item}”.").format(item=item), tr("No item was ticked off."),
                tr("Go to the step that contains it."), severity="info",
            )  # fmt: skip
        if (item in ticked) == on:
            return None
        self._ticked[self._at] = tuple(each for each in step.tick if (on if each == item else each in ticked))
        return StepTicked(now_ns, self._at, item, on, actor)

    # Lifecycle

    def pause(self, paused: bool, now_ns: int) -> None:
        """Pause: no step accumulates time."""
        if paused and self._paused_ns is None:
            self._paused_ns = now_ns
        elif not paused and self._paused_ns is not None:
            self._since_ns += now_ns - self._paused_ns
            self._paused_ns = None

    def follow(self, steps: Sequence[ProtocolStep]) -> None:
        """Adopt an edited protocol: ticks stay, and the current step by id, or by position if only ids changed."""
        before, self.steps = self._ids, tuple(steps)
        self._ids = [step.step_id for step in self.steps]
        other = [(old, new) for old, new in zip(before, self._ids, strict=False) if old != new]
        moved = any(old in self._ids or new in before for old, new in other)
        if len(before) == len(self._ids) and not moved:
            self._rename(dict(other))
        self._path = [step_id for step_id in self._path if step_id in self._ids]
        self._done = {step_id: None for step_id in self._done if step_id in self._ids}
        self._skipped = {step_id: None for step_id in self._skipped if step_id in self._ids}
        self._ticked = {
            step.step_id: tuple(item for item in step.tick if item in self._ticked.get(step.step_id, ()))
            for step in self.steps
        }
        if self._at not in self._ids:
            self._at = ""

    def _rename(self, new: Mapping[str, str]) -> None:
        self._at = new.get(self._at, self._at)
        self._path = [new.get(step_id, step_id) for step_id in self._path]
        self._spent_ns = {new.get(step_id, step_id): spent_ns for step_id, spent_ns in self._spent_ns.items()}
        self._done = {new.get(step_id, step_id): None for step_id in self._done}
        self._skipped = {new.get(step_id, step_id): None for step_id in self._skipped}
        self._ticked = {new.get(step_id, step_id): ticked for step_id, ticked in self._ticked.items()}

    def opened(self, now_ns: int) -> ProtocolOpened:
        planned = (PlannedStep(step.step_id, step.title, step.expected_s, step.tick) for step in self.steps)
        return ProtocolOpened(now_ns, tuple(planned))

    # Internals

    @property
    def _step(self) -> ProtocolStep | None:
        return self.steps[self._ids.index(self._at)] if self._at else None

    def _present(self) -> ProtocolStep:
        step = self._step
        if step is None:
            raise _ended() if self._ended else _not_begun() if self.steps else _no_protocol()
        return step

    def _leave_done(self) -> None:
        if self._at:
            self._done[self._at] = None
            self._skipped.pop(self._at, None)

    def _on(self, step: ProtocolStep, now_ns: int, how: StepHow, actor: Actor) -> StepEntered | ProtocolEnded:
        following = step_after(self.steps, step)
        if following is not None:
            return self._enter(following.step_id, now_ns, how, actor)
        left = self._leave(now_ns)
        self._at, self._ended = "", True
        return ProtocolEnded(now_ns, left, how == "skipped", actor)

    def _leave(self, now_ns: int) -> str:
        """Record the time spent in the current step; returns its id."""
        left = self._at
        if left:
            self._path.append(left)
            self._spent_ns[left] = (now_ns if self._paused_ns is None else self._paused_ns) - self._since_ns
        return left

    def _enter(self, step_id: str, now_ns: int, how: StepHow, actor: Actor, *, branch: str = "") -> StepEntered:
        left = self._leave(now_ns)
        if left == step_id:
            self._path.pop()
        self._at, self._ended = step_id, False
        self._since_ns = now_ns if self._paused_ns is None else self._paused_ns
        step = self.steps[self._ids.index(step_id)]
        return StepEntered(now_ns, step_id, step.title, self._ids.index(step_id) + 1, how, left, branch, actor)


def _no_protocol() -> UserFacingError:
    return UserFacingError(
        tr("This scenario has no protocol."), tr("There are no steps."),
        tr("Add steps to the scenario, or open one that has them."), severity="info",
    )  # fmt: skip


def _not_begun() -> UserFacingError:
    return UserFacingError(
        tr("No step is active."), tr("Nothing was changed."), tr("Start with the next step."), severity="info"
    )


def _ended() -> UserFacingError:
    return UserFacingError(
        tr("The protocol has ended."), tr("All its steps are done."),
        tr("Go back to the last step, or choose one in the list of steps."), severity="info",
    )  # fmt: skip
