"""Plan of a session against what happened: the recorded scenario, checks before the start, and the protocol's steps."""

import logging
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import field, replace
from typing import Any, Literal

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import (
    PlannedStep,
    PreflightChecked,
    ProtocolEnded,
    ProtocolOpened,
    ScenarioOpened,
    StepEntered,
    StepHow,
    StepTicked,
)
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.value_class import Value
from caris_desktop.domain.yaml_files import YamlSourceError, parse_yaml

_log = logging.getLogger(__name__)
_MAX_CHARACTERS = 256 * 1024


class ScenarioText(Value):
    """Scenario data for readers of a recording. ``permissions`` contains only what the file says."""

    title: str
    file_name: str
    sha256: str
    description: str = ""
    phrases: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()
    places: tuple[tuple[str, Pose2D], ...] = ()
    permissions: dict[str, bool] = field(default_factory=dict)
    panels: tuple[str, ...] = ()


def read_scenario(event: ScenarioOpened) -> ScenarioText:
    """Parse the scenario. Missing or invalid fields stay empty: the recording may be older than this program."""
    content = _mapping(parsed_yaml(event.content, "scenario"))
    recording = _mapping(content.get("recording"))
    return ScenarioText(
        title=event.title,
        file_name=event.file_name,
        sha256=event.sha256,
        description=_string(content.get("description")),
        phrases=tuple(_sentences(content.get("phrases"))),
        labels=_strings(recording.get("labels")),
        places=tuple(place for entry in _list(content.get("places")) if (place := _place(_mapping(entry))) is not None),
        permissions={
            str(name): value for name, value in _mapping(content.get("permissions")).items() if isinstance(value, bool)
        },
        panels=tuple(dict.fromkeys(_panels(content.get("layout")))),
    )


def parsed_yaml(text: str, what: str) -> Any:
    """Parsed YAML; an empty mapping if unreadable. ``what`` names it in the log."""
    if not text:
        return {}
    if len(text) > _MAX_CHARACTERS:
        _log.warning("the recorded %s is not read: %d characters", what, len(text))
        return {}
    try:
        return parse_yaml(text, finite=False).data
    except YamlSourceError as error:
        _log.warning("the recorded %s cannot be read: %s", what, error)
        return {}


def _place(entry: dict[Any, Any]) -> tuple[str, Pose2D] | None:
    name, x_m, y_m = entry.get("name"), _metres(entry.get("x_m")), _metres(entry.get("y_m"))
    return (name, Pose2D(x_m, y_m, 0.0)) if isinstance(name, str) and x_m is not None and y_m is not None else None


def _metres(value: Any) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def _sentences(phrases: Any) -> Iterator[str]:
    """Sentences of phrases: plain ones, those with options, and groups."""
    for entry in _list(phrases):
        group = _mapping(entry)
        yield from (sentence for sentence in (_string(entry), _string(group.get("say"))) if sentence)
        for inner in _list(group.get("phrases")):
            yield from (sentence for sentence in (_string(inner), _string(_mapping(inner).get("say"))) if sentence)


def _panels(node: Any, depth: int = 0) -> list[str]:
    if not isinstance(node, dict) or depth > 20:
        return []
    found = [_string(node.get("panel")), *_strings(node.get("tabs"))]
    for child in _list(node.get("children")):
        found += _panels(child, depth + 1)
    return [name for name in found if name]


def _mapping(value: Any) -> dict[Any, Any]:
    return value if isinstance(value, dict) else {}


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _string(value: Any) -> str:
    return value.strip() if isinstance(value, str) else ""


def _strings(value: Any) -> tuple[str, ...]:
    return tuple(item for item in _list(value) if isinstance(item, str))


class Preflight(Value):
    """State of each check at the start; those ticked manually afterwards are in ``ticked_later``."""

    checks: tuple[PreflightChecked, ...] = ()
    ticked_later: frozenset[str] = frozenset()

    @property
    def passed(self) -> int:
        return sum(check.state == "passed" for check in self.checks)

    @property
    def still_open(self) -> tuple[PreflightChecked, ...]:
        return tuple(check for check in self.checks if check.state != "passed")


def preflight_of(events: Iterable[PreflightChecked]) -> Preflight:
    """Fold ``events``, in order of time."""
    checks: dict[str, PreflightChecked] = {}
    ticked: set[str] = set()
    for event in events:
        if event.at_start:
            checks[event.check_id] = event
        elif event.check_id in checks and checks[event.check_id].state != "passed":
            (ticked.add if event.state == "passed" else ticked.discard)(event.check_id)
    return Preflight(tuple(checks.values()), frozenset(ticked))


def open_words(preflight: Preflight) -> list[str]:
    """Each open check with its state: ``Emergency stop is released (major; the wizard started anyway)``."""
    words = []
    for check in preflight.still_open:
        accepted = "; the wizard started anyway" if check.accepted else ""
        later = "; ticked later" if check.check_id in preflight.ticked_later else ""
        words.append(f"{check.title} ({check.state}{accepted}{later})")
    return words


ProtocolEvent = ScenarioOpened | ProtocolOpened | StepEntered | StepTicked | ProtocolEnded
PROTOCOL_EVENTS = (ScenarioOpened, ProtocolOpened, StepEntered, StepTicked, ProtocolEnded)
Left = Literal["", "next", "skipped", "back", "branch", "chosen", "ended"]


class StepVisit(Value):
    """One visit of a step of the protocol in the scenario file ``scenario``. ``left`` is empty if the session ended in
    it or another protocol was opened. ``time_s`` excludes pauses; ``late_s`` is the excess over the expected time,
    including earlier time in the step after a return to it.
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
    scenario: str = ""


class StepRecord(Value):
    """Step of the protocol in the scenario file ``scenario``, over the session. ``visits`` counts how often it was
    begun, without returns; 0 if never. ``ticked`` of ``to_tick`` items were ticked at the end.
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
    scenario: str = ""


def step_visits_of(
    events: Iterable[ProtocolEvent], *, ended_ns: int, pauses: Sequence[tuple[int, int]] = (), scenario: str = ""
) -> tuple[StepVisit, ...]:
    """Visits in order of time, from events in recording order; ``scenario`` is the file before the first is named."""
    plan: dict[str, PlannedStep] = {}
    visits: list[StepVisit] = []
    present: tuple[str, StepEntered] | None = None
    spent_s: dict[tuple[str, str], float] = {}

    def leave(at_ns: int, left: Left) -> None:
        nonlocal present
        if present is None:
            return
        entered_in, step = present
        key = entered_in, step.step_id
        planned, end_ns = plan.get(step.step_id), max(step.stamp_ns, at_ns)
        expected_s = 0.0 if planned is None else planned.expected_s
        paused_ns = sum(max(0, min(end_ns, until_ns) - max(step.stamp_ns, since_ns)) for since_ns, until_ns in pauses)
        time_s = (end_ns - step.stamp_ns - paused_ns) / 1e9
        before_s = spent_s.get(key, 0.0) if step.how == "back" else 0.0
        late_s = max(0.0, before_s + time_s - max(expected_s, before_s)) if expected_s else 0.0
        spent_s[key] = before_s + time_s
        visits.append(
            StepVisit(
                step.step_id, step.title, step.number, step.stamp_ns, end_ns, step.how, left,
                time_s, expected_s, late_s, step.branch, step.actor, entered_in,
            )
        )  # fmt: skip
        present = None

    for file, event in _by_scenario(events, scenario):
        match event:
            case ProtocolOpened(steps=steps):
                opened = {step.step_id: step for step in steps}
                if present is not None and (file != present[0] or present[1].step_id not in opened):
                    leave(event.stamp_ns, "")
                plan = opened
            case StepEntered(how=how):
                leave(event.stamp_ns, "" if how == "started" else how)
                present = file, event
            case ProtocolEnded(skipped=skipped):
                leave(event.stamp_ns, "skipped" if skipped else "ended")
    leave(ended_ns, "")
    return tuple(visits)


def steps_of(
    events: Iterable[ProtocolEvent], visits: Iterable[StepVisit], *, scenario: str = ""
) -> tuple[StepRecord, ...]:
    """All steps of the final plan of each scenario in use, and any others visited, in the order of the plans."""
    planned: dict[tuple[str, str], PlannedStep] = {}
    final: dict[str, tuple[PlannedStep, ...]] = {}
    ticks: dict[tuple[str, str, str], bool] = {}
    last = ""
    for file, event in _by_scenario(events, scenario):
        if isinstance(event, ProtocolOpened):
            planned |= {(file, step.step_id): step for step in event.steps}
            final[file] = event.steps or final.get(file, ())
            last = file
        elif isinstance(event, StepTicked):
            ticks[file, event.step_id, event.item] = event.on
    records: dict[tuple[str, str], StepRecord] = {}
    for visit in visits:
        key = visit.scenario, visit.step_id
        step = planned.get(key) or PlannedStep(visit.step_id, visit.title)
        record = records.get(key) or _unvisited(visit.scenario, step, visit.number)
        records[key] = replace(
            record,
            visits=record.visits + (visit.how != "back" or not record.visits),
            time_s=record.time_s + visit.time_s,
            late_s=record.late_s + visit.late_s,
            skipped=record.skipped + (visit.left == "skipped"),
            first_ns=visit.start_ns if record.first_ns is None else record.first_ns,
        )
    used = {file for file, _ in records} | {last}
    for file in used & final.keys():
        for number, step in enumerate(final[file], start=1):
            key = file, step.step_id
            records[key] = replace(records.get(key) or _unvisited(file, step, number), number=number)
    ticked = Counter((file, step_id) for (file, step_id, _), on in ticks.items() if on)
    done = (replace(record, ticked=ticked[record.scenario, record.step_id]) for record in records.values())
    places = {file: place for place, file in enumerate(final)}
    return tuple(sorted(done, key=lambda record: (places.get(record.scenario, 0), record.number)))


def _by_scenario(events: Iterable[ProtocolEvent], scenario: str) -> Iterator[tuple[str, ProtocolEvent]]:
    """Events with the scenario file in use."""
    for event in events:
        if isinstance(event, ScenarioOpened):
            scenario = event.file_name
        yield scenario, event


def _unvisited(scenario: str, step: PlannedStep, number: int) -> StepRecord:
    items = len(step.tick)
    return StepRecord(step.step_id, step.title, number, step.expected_s, 0, 0.0, 0.0, 0, 0, items, None, scenario)
