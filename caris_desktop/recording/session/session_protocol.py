"""Protocol of a session, planned against actual: visits of each step, durations and delays."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Literal

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import PlannedStep, ProtocolEnded, ProtocolOpened, StepEntered, StepHow, StepTicked
from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.session.pauses import pauses_of
from caris_desktop.recording.session.session_reader import Session

ProtocolEvent = ProtocolOpened | StepEntered | StepTicked | ProtocolEnded
PROTOCOL_EVENTS = (ProtocolOpened, StepEntered, StepTicked, ProtocolEnded)
PROTOCOL_STREAMS = ("event/protocol_opened", "event/step_entered", "event/step_ticked", "event/protocol_ended")
Left = Literal["", "next", "skipped", "back", "branch", "chosen", "ended"]


@dataclass(frozen=True, slots=True)
class StepVisit:
    """One visit of a step. ``left`` is empty if the session ended in it or another protocol was opened. ``time_s``
    excludes pauses; ``late_s`` is the excess over the expected time, including earlier time in the step after a return
    to it.
    """

    step_id: str
    title: str
    number: int
    start_ns: int
    end_ns: int
    how: StepHow
    left: Left
    time_s: float
    expected_s: float
    late_s: float = 0.0
    branch: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class StepRecord:
    """Step of the protocol over the whole session. ``visits`` counts how often it was begun, without returns; 0 if
    never. ``ticked`` of ``to_tick`` items were ticked at the end.
    """

    step_id: str
    title: str
    number: int
    expected_s: float
    visits: int
    time_s: float
    late_s: float
    skipped: int
    ticked: int
    to_tick: int
    first_ns: int | None


def read_protocol(session: Session) -> tuple[tuple[StepVisit, ...], tuple[StepRecord, ...]]:
    """Visits and steps of a session; empty without a protocol. Raises SessionError."""
    events = [value for _, value in session.values(*PROTOCOL_STREAMS)]
    pauses = pauses_of((value for _, value in session.values("event/recording_paused")), ended_ns=session.ended_ns)
    visits = step_visits_of(events, ended_ns=session.ended_ns, pauses=pauses)
    return visits, steps_of(events, visits)


def step_visits_of(
    events: Iterable[ProtocolEvent], *, ended_ns: int, pauses: Sequence[tuple[int, int]] = ()
) -> tuple[StepVisit, ...]:
    """Visits in order of time, from events in recording order."""
    plan: dict[str, PlannedStep] = {}
    visits: list[StepVisit] = []
    present: StepEntered | None = None
    spent_s: dict[str, float] = {}

    def leave(at_ns: int, left: Left) -> None:
        nonlocal present
        if present is None:
            return
        planned, end_ns = plan.get(present.step_id), max(present.stamp_ns, at_ns)
        expected_s = 0.0 if planned is None else planned.expected_s
        time_s = _without(present.stamp_ns, end_ns, pauses)
        before_s = spent_s.get(present.step_id, 0.0) if present.how == "back" else 0.0
        late_s = max(0.0, before_s + time_s - max(expected_s, before_s)) if expected_s else 0.0
        spent_s[present.step_id] = before_s + time_s
        visits.append(
            StepVisit(
                present.step_id, present.title, present.number, present.stamp_ns, end_ns, present.how, left,
                time_s, expected_s, late_s, present.branch, present.actor,
            )
        )  # fmt: skip
        present = None

    for event in events:
        match event:
            case ProtocolOpened(steps=steps):
                plan = {step.step_id: step for step in steps}
                if present is not None and present.step_id not in plan:
                    leave(event.stamp_ns, "")
            case StepEntered(how=how):
                leave(event.stamp_ns, "" if how == "started" else how)
                present = event
            case ProtocolEnded(skipped=skipped):
                leave(event.stamp_ns, "skipped" if skipped else "ended")
    leave(ended_ns, "")
    return tuple(visits)


def steps_of(events: Iterable[ProtocolEvent], visits: Iterable[StepVisit]) -> tuple[StepRecord, ...]:
    """All steps of the final plan, and any others visited, in the order of the plan."""
    planned: dict[str, PlannedStep] = {}
    last: tuple[PlannedStep, ...] = ()
    ticks: dict[tuple[str, str], bool] = {}
    for event in events:
        if isinstance(event, ProtocolOpened):
            planned |= {step.step_id: step for step in event.steps}
            last = event.steps or last
        elif isinstance(event, StepTicked):
            ticks[event.step_id, event.item] = event.on
    records: dict[str, StepRecord] = {}
    for visit in visits:
        step = planned.get(visit.step_id) or PlannedStep(visit.step_id, visit.title)
        record = records.get(visit.step_id) or _unvisited(step, visit.number)
        records[visit.step_id] = replace(
            record,
            visits=record.visits + (visit.how != "back" or not record.visits),
            time_s=record.time_s + visit.time_s,
            late_s=record.late_s + visit.late_s,
            skipped=record.skipped + (visit.left == "skipped"),
            first_ns=visit.start_ns if record.first_ns is None else record.first_ns,
        )
    for number, step in enumerate(last, start=1):
        records[step.step_id] = replace(records.get(step.step_id) or _unvisited(step, number), number=number)
    ticked = Counter(step_id for (step_id, _), on in ticks.items() if on)
    done = (replace(record, ticked=ticked[record.step_id]) for record in records.values())
    return tuple(sorted(done, key=lambda record: record.number))


def _unvisited(step: PlannedStep, number: int) -> StepRecord:
    return StepRecord(step.step_id, step.title, number, step.expected_s, 0, 0.0, 0.0, 0, 0, len(step.tick), None)


def _without(start_ns: int, end_ns: int, pauses: Sequence[tuple[int, int]]) -> float:
    """Seconds between two times, without pauses."""
    paused_ns = sum(max(0, min(end_ns, until_ns) - max(start_ns, since_ns)) for since_ns, until_ns in pauses)
    return (end_ns - start_ns - paused_ns) / 1e9
