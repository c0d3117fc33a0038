"""Measures of a session: one definition for report, methods sheet and statistics.

Times are in session time; values from before and after a pause are never combined into one.

Long because every measure is defined once, here.
"""

import itertools
import math
import statistics
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.address import is_loopback
from caris_desktop.domain.events import (
    LATE_FROM_S,
    AlarmChanged,
    AnswerUsed,
    CommandSent,
    DriveEnded,
    EmergencyStopChanged,
    Gap,
    GoalChanged,
    GuardChanged,
    GuardState,
    LinkChanged,
    LinkQuality,
    LlmExchange,
    Marked,
    PhotoDeleted,
    PhotoTaken,
    PreflightChecked,
    Problem,
    RecordingPaused,
    ResponseTimed,
    RobotChosen,
    ScenarioOpened,
    Speaker,
    StopRequested,
    UtteranceChanged,
    UtteranceCorrected,
)
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import Odometry, RobotPose
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.session.answers import answer_uses, questions_of
from caris_desktop.recording.session.goals import NavigationGoal, navigation_goals
from caris_desktop.recording.session.pauses import pauses_of
from caris_desktop.recording.session.responses import AT_ONCE_S, RESPONSE_LIMIT_S, Response, responses_of
from caris_desktop.recording.session.session_alarms import AlarmRecord, alarms_of
from caris_desktop.recording.session.session_driving import held_until_ns
from caris_desktop.recording.session.session_marks import FinalMark, final_marks_of
from caris_desktop.recording.session.session_protocol import (
    PROTOCOL_EVENTS,
    ProtocolEvent,
    StepRecord,
    StepVisit,
    step_visits_of,
    steps_of,
)
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session.session_visits import VISIT_EVENTS, Visit, most_at_once, visits_of
from caris_desktop.recording.session.utterances import SpokenUtterance, spoken_utterances

T = TypeVar("T")

_LONGEST_STEP_S = 1.0
"""A velocity says nothing of the time after that."""
PLAUSIBLE_SPEED_MPS = 5.0
"""A faster step of the odometry is a jump of its origin, not a way that was driven."""

_EVENTS = (
    AlarmChanged, AnswerUsed, DriveEnded, EmergencyStopChanged, Gap, GoalChanged, GuardChanged, LinkChanged,
    LinkQuality, LlmExchange, Marked, *VISIT_EVENTS, *PROTOCOL_EVENTS, PhotoDeleted, PhotoTaken, PreflightChecked,
    Problem, RecordingPaused, RobotChosen, ScenarioOpened, ResponseTimed, StopRequested, UtteranceChanged,
    UtteranceCorrected,
)  # fmt: skip


# What a session holds


@dataclass(frozen=True, slots=True)
class Interval:
    """Labelled interval of the session."""

    start_ns: int
    end_ns: int
    label: str

    @property
    def duration_s(self) -> float:
        return (self.end_ns - self.start_ns) / 1e9


@dataclass(frozen=True, slots=True, eq=False)
class SessionData:
    """Session data for the measures, read in one pass.

    ``commands`` has a row per velocity command: forward, left (m/s), turn (rad/s), at ``command_ns``, with its source
    in ``command_sources``. ``odometry`` has x, y (m), speed (m/s), turn (rad/s) at ``odometry_ns``; ``poses`` x, y (m),
    heading (rad) in the map at ``pose_ns``. Each in order of time.
    """

    session: Session
    utterances: tuple[SpokenUtterance, ...]
    marks: tuple[FinalMark, ...]
    pauses: tuple[Interval, ...]
    command_ns: NDArray[np.int64]
    commands: NDArray[np.float64]
    command_sources: tuple[str, ...]
    odometry_ns: NDArray[np.int64]
    odometry: NDArray[np.float64]
    pose_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    protocol: tuple[ProtocolEvent, ...]
    events: dict[type[Any], tuple[Any, ...]]

    def of(self, kind: type[T]) -> tuple[T, ...]:
        """Events of one type in recording order."""
        return self.events.get(kind, ())

    @property
    def photos(self) -> tuple[PhotoTaken, ...]:
        """Photos without deleted ones."""
        deleted = {event.file_name: not event.restored for event in self.of(PhotoDeleted)}
        return tuple(photo for photo in self.of(PhotoTaken) if not deleted.get(photo.file_name))


def read_facts(session: Session, progress: Callable[[float], None] = lambda _: None) -> SessionData:
    """Read the session data in one pass. ``progress`` may raise to cancel. Raises SessionError."""
    events: dict[type[Any], list[Any]] = {kind: [] for kind in (*_EVENTS, CommandSent, Odometry, RobotPose)}
    span_ns = max(1, session.ended_ns - session.started_ns)
    protocol: list[ProtocolEvent] = []
    for number, (_, value) in enumerate(session.values(*(BY_TYPE[kind].name for kind in events))):
        events[type(value)].append(value)
        if isinstance(value, PROTOCOL_EVENTS):
            protocol.append(value)
        if number % 2000 == 0:
            progress(min(1.0, max(0.0, (value.stamp_ns - session.started_ns) / span_ns)))
    commands = _in_time(events.pop(CommandSent))
    odometry = _in_time(events.pop(Odometry))
    poses = _in_time(events.pop(RobotPose))
    return SessionData(
        session=session,
        utterances=spoken_utterances(
            [*events[UtteranceChanged], *events[UtteranceCorrected]],
            ended_ns=session.ended_ns,
            paused_ns=[event.stamp_ns for event in events[RecordingPaused] if event.paused],
        ),
        marks=final_marks_of(events[Marked], ended_ns=session.ended_ns),
        pauses=tuple(
            Interval(start_ns, end_ns, "Paused")
            for start_ns, end_ns in pauses_of(events[RecordingPaused], ended_ns=session.ended_ns)
        ),
        command_ns=_stamps(commands),
        commands=_rows([_twist(item) for item in commands], 3),
        command_sources=tuple(item.source for item in commands),
        odometry_ns=_stamps(odometry),
        odometry=_rows([_odometry(item) for item in odometry], 4),
        pose_ns=_stamps(poses),
        poses=_rows([_pose(item.pose_in_map) for item in poses], 3),
        protocol=tuple(protocol),
        events={kind: tuple(values) for kind, values in events.items()},
    )


def _in_time(values: list[T]) -> list[T]:
    return sorted(values, key=lambda value: value.stamp_ns)  # type: ignore[attr-defined]  # all of the table have it


def _stamps(values: Sequence[Any]) -> NDArray[np.int64]:
    return np.array([value.stamp_ns for value in values], np.int64)


def _rows(rows: list[tuple[float, ...]], columns: int) -> NDArray[np.float64]:
    return np.array(rows, np.float64).reshape(-1, columns)


def _twist(command: CommandSent) -> tuple[float, ...]:
    return command.twist.forward_mps, command.twist.left_mps, command.twist.turn_radps


def _odometry(value: Odometry) -> tuple[float, ...]:
    pose, twist = value.pose_in_odom, value.twist
    return pose.x_m, pose.y_m, math.hypot(twist.forward_mps, twist.left_mps), twist.turn_radps


def _pose(pose: Pose2D) -> tuple[float, ...]:
    return pose.x_m, pose.y_m, pose.heading_rad


# Measures


@dataclass(frozen=True, slots=True)
class SummaryStats:
    """Distribution of values. ``sd`` is the sample standard deviation, None for a single value."""

    n: int
    mean: float
    sd: float | None
    median: float
    smallest: float
    largest: float

    @classmethod
    def of(cls, values: Sequence[float]) -> "SummaryStats | None":
        """None for no values."""
        if not values:
            return None
        return cls(
            n=len(values),
            mean=statistics.fmean(values),
            sd=statistics.stdev(values) if len(values) > 1 else None,
            median=statistics.median(values),
            smallest=min(values),
            largest=max(values),
        )


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer of the robot or wizard: ``delay_s`` from the end of its trigger to ``at_ns``."""

    at_ns: int
    delay_s: float
    utterance: SpokenUtterance


@dataclass(frozen=True, slots=True)
class Talk:
    """Speech of one speaker. ``speech_s`` is the sum of its utterances."""

    utterances: int
    words: int
    speech_s: float


@dataclass(frozen=True, slots=True)
class ModelUse:
    """Exchanges with one language model, and the use of its answers.

    ``place`` is the host of its server, or this computer; empty if not recorded.
    """

    provider: str
    model: str
    version: str
    place: str
    asked: int
    answered: int
    cancelled: int
    failed: int
    said: int
    edited: int
    dismissed: int
    unused: int
    first_token_s: tuple[float, ...]
    answer_s: tuple[float, ...]

    @property
    def accepted_fraction(self) -> float | None:
        """Share of answers that were said, unchanged or edited. None without answers."""
        return (self.said + self.edited) / self.answered if self.answered else None


@dataclass(frozen=True, slots=True)
class Driving:
    """Motion of the robot. ``seconds_by_source`` is time with a nonzero command; ``max_speed_mps`` and ``distance_m``
    are None without odometry: poses in the map jump with each localisation correction, which adds up to a multiple of
    the distance.
    """

    distance_m: float | None
    max_speed_mps: float | None
    seconds_by_source: dict[str, float]
    stops: int
    emergency_stops: int
    ended_by_itself: dict[str, int]
    goals: dict[str, int]
    navigating_s: float
    guard_interventions: int
    guard_s: dict[GuardState, float]

    @property
    def driving_s(self) -> float:
        return sum(self.seconds_by_source.values())


@dataclass(frozen=True, slots=True)
class Measures:
    """Measures of one session. Counters are in order of first occurrence, or by label.

    ``people`` is the maximum present at once, as by :func:`most_at_once`; ``identities`` are those of the tracker,
    which may assign several to one person.
    """

    recorded_s: float
    paused_s: float
    pauses: int
    responses: tuple[Reply, ...]
    content_responses: tuple[Reply, ...]
    reactions: tuple[Reply, ...]
    gaps: tuple[Response, ...]
    talk: dict[Speaker, Talk]
    origins: dict[str, int]
    unsaid: int
    interrupted: int
    models: tuple[ModelUse, ...]
    driving: Driving
    marks: dict[str, int]
    errors: dict[str, int]
    link_trouble_s: float
    lost: dict[str, int]
    missing: dict[str, int]
    problems: dict[str, int]
    alarms: tuple[AlarmRecord, ...]
    people: int
    identities: int
    photos: int
    steps: tuple[StepRecord, ...]

    @property
    def wizard_errors(self) -> int:
        return sum(self.errors.values())

    @property
    def errors_per_10_min(self) -> float | None:
        return per_10_min(self.wizard_errors, self.recorded_s)

    @property
    def gaps_s(self) -> tuple[float, ...]:
        """Gaps from the end of each answered participant turn to the first sound, negative for overlaps."""
        return tuple(response.gap_s for response in self.gaps if response.first)

    @property
    def response_times_s(self) -> tuple[float, ...]:
        return tuple(reply.delay_s for reply in self.responses)


def measure(facts: SessionData) -> Measures:
    """Compute all measures of a session."""
    session = facts.session
    paused_s = sum(pause.duration_s for pause in facts.pauses)
    recorded_s = max(0.0, session.duration_s - paused_s)
    spoken = [utterance for utterance in facts.utterances if utterance.said]
    robot = [utterance for utterance in facts.utterances if utterance.speaker == "robot"]
    lost: Counter[str] = Counter()
    for gap in facts.of(Gap):
        lost[gap.stream] += gap.count
    trouble = link_trouble(facts.of(LinkChanged), session.ended_ns)
    all_visits = visits(facts)
    questions = questions_of(facts.of(LlmExchange))
    return Measures(
        recorded_s=recorded_s,
        paused_s=paused_s,
        pauses=len(facts.pauses),
        responses=response_times(spoken, facts.pauses),
        content_responses=response_times([item for item in spoken if item.origin != "filler"], facts.pauses),
        reactions=reaction_times(facts.utterances, questions, facts.pauses),
        gaps=responses_of(
            facts.utterances, facts.of(ResponseTimed), [(pause.start_ns, pause.end_ns) for pause in facts.pauses]
        ),
        talk=talk(spoken),
        origins=dict(Counter(utterance.origin for utterance in robot if utterance.said)),
        unsaid=sum(not utterance.said for utterance in robot),
        interrupted=sum(utterance.said and utterance.state == "interrupted" for utterance in robot),
        models=model_use(questions, facts.of(AnswerUsed), facts.utterances),
        driving=_driving(facts),
        marks=dict(Counter(mark.label for mark in facts.marks if mark.kind == "mark")),
        errors=dict(Counter(mark.label for mark in facts.marks if mark.kind == "wizard_error")),
        link_trouble_s=sum(stretch.duration_s for stretch in trouble),
        lost=dict(lost),
        missing=dict(session.lost),
        problems=dict(Counter(problem.severity for problem in facts.of(Problem))),
        alarms=alarms_of(facts.of(AlarmChanged), ended_ns=session.ended_ns, pauses=_spans(facts.pauses)),
        people=most_at_once(all_visits),
        identities=len({visit.person_id for visit in all_visits}),
        photos=len(facts.photos),
        steps=steps_of(facts.protocol, step_visits(facts)),
    )


def step_visits(facts: SessionData) -> tuple[StepVisit, ...]:
    """Visits of the protocol's steps."""
    return step_visits_of(facts.protocol, ended_ns=facts.session.ended_ns, pauses=_spans(facts.pauses))


def per_10_min(count: int, seconds: float) -> float | None:
    """Rate per 10 minutes; None for zero time."""
    return count * 600.0 / seconds if seconds > 0.0 else None


def response_times(utterances: Iterable[SpokenUtterance], pauses: Sequence[Interval] = ()) -> tuple[Reply, ...]:
    """Response times: from the end of a participant's utterance to the start of the robot's next one.

    Excludes robot speech that begins before that end, or after ``RESPONSE_LIMIT_S``, or after a pause of the recording.
    """
    turns = [item for item in utterances if item.speaker in ("participant", "robot") and item.start_ns is not None]
    turns.sort(key=lambda item: (item.start_ns or 0, item.speaker == "robot"))
    replies = []
    for before, after in itertools.pairwise(turns):
        if before.speaker == "participant" and after.speaker == "robot":
            replies += _reply(before.end_ns, after.start_ns, after, pauses)
    return tuple(replies)


def reaction_times(
    utterances: Iterable[SpokenUtterance], exchanges: Iterable[LlmExchange], pauses: Sequence[Interval] = ()
) -> tuple[Reply, ...]:
    """Reaction times of the wizard: from the end of a participant's utterance or the arrival of a language model's
    answer, whichever is later, to the next speech request. Limits as for :func:`response_times`.
    """
    happened: list[tuple[int, int, SpokenUtterance | None]] = []
    for item in utterances:
        if item.speaker == "participant" and item.end_ns is not None:
            happened.append((item.end_ns, 0, None))
        elif item.speaker == "robot" and item.requested_ns is not None:
            happened.append((item.requested_ns, 1, item))
    happened += [(exchange.stamp_ns, 0, None) for exchange in exchanges if exchange.outcome == "answered"]
    happened.sort(key=lambda moment: moment[:2])
    replies = []
    for (before_ns, _, before), (after_ns, _, after) in itertools.pairwise(happened):
        if before is None and after is not None:
            replies += _reply(before_ns, after_ns, after, pauses)
    return tuple(replies)


def _reply(
    end_ns: int | None, at_ns: int | None, utterance: SpokenUtterance, pauses: Sequence[Interval]
) -> list[Reply]:
    if end_ns is None or at_ns is None:
        return []
    delay_s = (at_ns - end_ns) / 1e9
    paused = any(pause.start_ns < at_ns and pause.end_ns > end_ns for pause in pauses)
    return [Reply(at_ns, delay_s, utterance)] if 0.0 <= delay_s <= RESPONSE_LIMIT_S and not paused else []


def talk(utterances: Iterable[SpokenUtterance]) -> dict[Speaker, Talk]:
    """Speech per speaker, in the order participant, robot, wizard; without uncertain speakers."""
    by_speaker: dict[Speaker, list[SpokenUtterance]] = {"participant": [], "robot": [], "wizard": []}
    for utterance in utterances:
        if utterance.speaker:
            by_speaker[utterance.speaker].append(utterance)
    return {
        speaker: Talk(
            utterances=len(items),
            words=sum(len(item.text.split()) for item in items),
            speech_s=sum(((item.end_ns or 0) - (item.start_ns or 0)) / 1e9 for item in items),
        )
        for speaker, items in by_speaker.items()
        if items
    }


THIS_COMPUTER = "this computer"


def model_asked(exchange: LlmExchange) -> tuple[str, str, str, str]:
    """Provider, model, version, and host (or this computer); empty where not recorded."""
    try:
        here = exchange.provider == "embedded" or is_loopback(f"//{exchange.server}")
    except ValueError:
        here = False
    return exchange.provider, exchange.model, exchange.model_version, THIS_COMPUTER if here else exchange.server


def model_use(
    exchanges: Sequence[LlmExchange], uses: Iterable[AnswerUsed], utterances: Sequence[SpokenUtterance]
) -> tuple[ModelUse, ...]:
    """Exchanges by model and version, in the order of first use."""
    became = answer_uses(exchanges, uses, utterances)
    groups: dict[tuple[str, str, str, str], list[LlmExchange]] = {}
    for exchange in exchanges:
        groups.setdefault(model_asked(exchange), []).append(exchange)
    table = []
    for (provider, model, version, place), group in groups.items():
        outcomes = Counter(exchange.outcome for exchange in group)
        answered = [exchange for exchange in group if exchange.outcome == "answered"]
        made = Counter(became[exchange.exchange_id] for exchange in answered)
        first = [item for item in answered if item.first_token_ns is not None]
        table.append(
            ModelUse(
                provider=provider,
                model=model,
                version=version,
                place=place,
                asked=len(group),
                answered=outcomes["answered"],
                cancelled=outcomes["cancelled"],
                failed=outcomes["failed"],
                said=made["said"],
                edited=made["edited"],
                dismissed=made["dismissed"],
                unused=made["unused"],
                first_token_s=tuple(((item.first_token_ns or 0) - item.asked_ns) / 1e9 for item in first),
                answer_s=tuple((item.stamp_ns - item.asked_ns) / 1e9 for item in answered),
            )
        )
    return tuple(table)


def link_trouble(changes: Iterable[LinkChanged], ended_ns: int) -> tuple[Interval, ...]:
    """Intervals without a control link after the first connection, except deliberate disconnection."""
    return tuple(
        stretch
        for stretch in _states(
            [(event.stamp_ns, event.state) for event in _since_connected(changes) if event.link == "control"], ended_ns
        )
        if stretch.label in ("trouble", "lost", "connecting")
    )


def _since_connected(changes: Iterable[LinkChanged]) -> list[LinkChanged]:
    control = [event for event in changes if event.link == "control"]
    first = next((number for number, event in enumerate(control) if event.state == "connected"), len(control))
    return control[first:]


def driving_intervals(facts: SessionData) -> tuple[Interval, ...]:
    """Intervals of driving by source: nonzero commands, each until the next one."""
    stretches: list[Interval] = []
    for start_ns, end_ns, source in _commanded(facts):
        last = stretches[-1] if stretches else None
        if last is not None and last.label == source and start_ns - last.end_ns <= 0:
            stretches[-1] = Interval(last.start_ns, end_ns, source)
        else:
            stretches.append(Interval(start_ns, end_ns, source))
    return tuple(stretches)


def _commanded(facts: SessionData) -> list[tuple[int, int, str]]:
    moving = (facts.commands != 0.0).any(axis=1)
    until_ns = held_until_ns(facts.command_ns, facts.session.ended_ns, _spans(facts.pauses))
    return [
        (int(facts.command_ns[index]), int(until_ns[index]), facts.command_sources[index])
        for index in np.flatnonzero(moving)
    ]


def goals_of(facts: SessionData) -> tuple[NavigationGoal, ...]:
    """Navigation goals of the recording, including refused ones."""
    return navigation_goals(facts.of(GoalChanged), started_ns=facts.session.started_ns, pauses=_spans(facts.pauses))


def goal_intervals(facts: SessionData) -> tuple[Interval, ...]:
    """Intervals of autonomous navigation; ``label`` is the outcome, ``unfinished`` if the session ended first.

    Excludes goals that were refused at once.
    """
    stretches = []
    for goal in goals_of(facts):
        end_ns = max(facts.session.ended_ns, goal.start_ns) if goal.end_ns is None else goal.end_ns
        if goal.end_ns is None or end_ns > goal.start_ns:
            stretches.append(Interval(goal.start_ns, end_ns, _outcome(goal)))
    return tuple(sorted(stretches, key=lambda stretch: stretch.start_ns))


def _outcome(goal: NavigationGoal) -> str:
    return "unfinished" if goal.end_ns is None else goal.state


def visits(facts: SessionData) -> tuple[Visit, ...]:
    """Visits of each identity."""
    return visits_of(
        [event for kind in VISIT_EVENTS for event in facts.of(kind)],
        started_ns=facts.session.started_ns,
        ended_ns=facts.session.ended_ns,
        pauses=_spans(facts.pauses),
    )


def _spans(stretches: Iterable[Interval]) -> list[tuple[int, int]]:
    return [(stretch.start_ns, stretch.end_ns) for stretch in stretches]


def _driving(facts: SessionData) -> Driving:
    seconds: dict[str, float] = {}
    for start_ns, end_ns, source in _commanded(facts):
        seconds[source] = seconds.get(source, 0.0) + (end_ns - start_ns) / 1e9
    ended_ns = facts.session.ended_ns
    guard = _states([(event.stamp_ns, event.state) for event in facts.of(GuardChanged)], ended_ns)
    guard_s: dict[GuardState, float] = {}
    for event, stretch in zip(facts.of(GuardChanged), guard, strict=True):
        guard_s[event.state] = guard_s.get(event.state, 0.0) + stretch.duration_s
    distance_m: float | None = None
    speed_mps: float | None = None
    if facts.odometry_ns.size:
        distance_m, speed_mps = (
            trajectory_length_m(facts.odometry_ns, facts.odometry[:, :2]),
            float(facts.odometry[:, 2].max()),
        )
        if not np.ptp(facts.odometry[:, :2], axis=0).any():
            # Odometry with velocity only, without poses.
            steps_s = np.minimum(np.diff(facts.odometry_ns) / 1e9, _LONGEST_STEP_S)
            distance_m = float((facts.odometry[:-1, 2] * steps_s).sum())
    return Driving(
        distance_m=distance_m,
        max_speed_mps=speed_mps,
        seconds_by_source=seconds,
        stops=len(facts.of(StopRequested)),
        emergency_stops=_rises([event.latched for event in facts.of(EmergencyStopChanged)]),
        ended_by_itself=dict(Counter(event.reason for event in facts.of(DriveEnded))),
        goals=dict(Counter(_outcome(goal) for goal in goals_of(facts))),
        navigating_s=covered_s(goal_intervals(facts)),
        guard_interventions=_rises([event.state in ("slowing", "blocked") for event in facts.of(GuardChanged)]),
        guard_s=guard_s,
    )


def trajectory_length_m(stamps_ns: NDArray[np.int64], points_m: NDArray[np.float64]) -> float:
    """Path length through the points, shape (n, 2), without implausible jumps."""
    steps_m = np.hypot(*np.diff(points_m, axis=0).T)
    seconds = np.diff(stamps_ns) / 1e9
    return float(steps_m[steps_m <= PLAUSIBLE_SPEED_MPS * seconds].sum())


def covered_s(stretches: Iterable[Interval]) -> float:
    """Duration of the union of the intervals."""
    total_ns = until_ns = 0
    for stretch in sorted(stretches, key=lambda item: item.start_ns):
        total_ns += max(0, stretch.end_ns - max(stretch.start_ns, until_ns))
        until_ns = max(until_ns, stretch.end_ns)
    return total_ns / 1e9


def _states(changes: Sequence[tuple[int, str]], ended_ns: int) -> list[Interval]:
    """Interval of each state until the next change."""
    ends_ns = [stamp_ns for stamp_ns, _ in changes[1:]] + [ended_ns]
    return (
        [
            Interval(start_ns, max(start_ns, end_ns), state)
            for (start_ns, state), end_ns in zip(changes, ends_ns, strict=True)
        ]
        if changes
        else []
    )


def _rises(states: Sequence[bool]) -> int:
    return sum(now and not before for before, now in zip([False, *states], states, strict=False))


def nearest_index(stamps_ns: NDArray[np.int64], at_ns: int) -> int | None:
    """Index of the last value at or before ``at_ns``, else the first; None if there are none."""
    if not stamps_ns.size:
        return None
    return max(0, bisect_left(stamps_ns, at_ns + 1) - 1)


# Measures as one row of a table


@dataclass(frozen=True, slots=True)
class Measure:
    """Measure of a session as a number. ``of`` returns None if it was not recorded."""

    name: str
    unit: str
    description: str
    of: Callable[[Measures], float | None]


def _robot_talk_s(measures: Measures) -> float:
    return measures.talk["robot"].speech_s if "robot" in measures.talk else 0.0


def _robot_utterances(measures: Measures) -> float:
    return measures.talk["robot"].utterances if "robot" in measures.talk else 0


def _from(origin: str) -> Callable[[Measures], float]:
    return lambda measures: measures.origins.get(origin, 0)


def _median(replies: Iterable[Reply]) -> float | None:
    delays_s = [reply.delay_s for reply in replies]
    return statistics.median(delays_s) if delays_s else None


def quantile(values: Sequence[float], share: float) -> float | None:
    """Quantile; None for no values."""
    return float(np.quantile(values, share)) if values else None


def share_at_once(gaps_s: Sequence[float]) -> float | None:
    """Share of gaps shorter than ``AT_ONCE_S``; None for none."""
    return sum(gap_s < AT_ONCE_S for gap_s in gaps_s) / len(gaps_s) if gaps_s else None


def _of_steps(figure: Callable[[Sequence[StepRecord]], float]) -> Callable[[Measures], float | None]:
    """Measure over the protocol's steps; None without a protocol."""
    return lambda measures: figure(measures.steps) if measures.steps else None


def _accepted(measures: Measures) -> float | None:
    answered = sum(model.answered for model in measures.models)
    return sum(model.said + model.edited for model in measures.models) / answered if answered else None


MEASURES: tuple[Measure, ...] = (
    Measure("recorded_s", "s", "Recorded time, excluding pauses.", lambda m: m.recorded_s),
    Measure("paused_s", "s", "Time during which the recording was paused.", lambda m: m.paused_s),
    Measure(
        "responses", "", "Number of robot answers to a participant; empty if no participant was transcribed.",
        lambda m: len(m.responses) if "participant" in m.talk else None,
    ),
    Measure(
        "response_time_s", "s", "Median time from the end of a participant's utterance to the robot's answer.",
        lambda m: _median(m.responses),
    ),
    Measure(
        "content_response_time_s", "s", "The same, to the first answer that is not a filler.",
        lambda m: _median(m.content_responses),
    ),
    Measure(
        "reaction_time_s", "s",
        "Median time from the end of a participant's utterance, or a language model's answer, to the wizard's request.",
        lambda m: _median(m.reactions),
    ),
    Measure(
        "gap_s", "s", "Median time from the end of a participant's voice to the first sound; negative for overlaps.",
        lambda m: quantile(m.gaps_s, 0.5),
    ),
    Measure("gap_lower_quartile_s", "s", "Lower quartile of these gaps.", lambda m: quantile(m.gaps_s, 0.25)),
    Measure("gap_upper_quartile_s", "s", "Upper quartile of these gaps.", lambda m: quantile(m.gaps_s, 0.75)),
    Measure(
        "gaps_under_1_s_fraction", "0-1", "Fraction of these gaps that are shorter than a second, including overlaps.",
        lambda m: share_at_once(m.gaps_s),
    ),
    Measure(
        "overlaps", "", "Number of times the robot started before the participant had finished; empty if no "
        "participant was answered.",
        lambda m: sum(gap_s < 0.0 for gap_s in m.gaps_s) if m.gaps_s else None,
    ),
    Measure("participant_talk_s", "s", "Speaking time of participants; empty if no participant was transcribed.",
           lambda m: m.talk["participant"].speech_s if "participant" in m.talk else None),
    Measure("robot_talk_s", "s", "Speaking time of the robot.", _robot_talk_s),
    Measure("participant_utterances", "", "Number of participant utterances; empty if no participant was transcribed.",
           lambda m: m.talk["participant"].utterances if "participant" in m.talk else None),
    Measure("robot_utterances", "", "Number of robot utterances.", _robot_utterances),
    Measure("typed_utterances", "", "Robot utterances that the wizard typed.", _from("typed")),
    Measure("phrase_utterances", "", "Robot utterances from the scenario's phrases.", _from("phrase")),
    Measure("filler_utterances", "", "Robot utterances from fillers.", _from("filler")),
    Measure("assistant_utterances", "", "Robot utterances from the language model.", _from("assistant")),
    Measure("suggestion_utterances", "", "Robot utterances from suggested replies.", _from("suggestion")),
    Measure("dictated_utterances", "", "Robot utterances that the wizard dictated.", _from("dictated")),
    Measure("own_voice_utterances", "", "Number of times the wizard spoke through the robot.", _from("own_voice")),
    Measure("llm_exchanges", "", "Questions to a language model.", lambda m: sum(model.asked for model in m.models)),
    Measure("llm_accepted_fraction", "0-1", "Fraction of its answers that were said, edited or not.", _accepted),
    Measure("distance_m", "m", "Distance that the robot drove, from its odometry; empty if it reported none.",
           lambda m: m.driving.distance_m),
    Measure("driving_s", "s", "Time during which the wizard drove.", lambda m: m.driving.driving_s),
    Measure("max_speed_mps", "m/s", "Highest speed, from the robot's odometry.", lambda m: m.driving.max_speed_mps),
    Measure("stops", "", "Number of times the wizard pressed Stop.", lambda m: m.driving.stops),
    Measure("emergency_stops", "", "Number of times the emergency stop was activated.",
           lambda m: m.driving.emergency_stops),
    Measure("goals", "", "Navigation goals.", lambda m: sum(m.driving.goals.values())),
    Measure("goals_reached", "", "Navigation goals that were reached.", lambda m: m.driving.goals.get("reached", 0)),
    Measure("guard_interventions", "", "Number of times the obstacle guard slowed or stopped the robot.",
           lambda m: m.driving.guard_interventions),
    Measure("protocol_steps", "", "Steps of the protocol; empty, like the measures of steps below, if there was no "
           "protocol.",
           _of_steps(len)),
    Measure("steps_visited", "", "Number of these steps that were started.",
           _of_steps(lambda s: sum(x.visits > 0 for x in s))),
    Measure("steps_skipped", "", "Number of these steps that were skipped.",
           _of_steps(lambda s: sum(x.skipped > 0 for x in s))),
    Measure("steps_late", "", "Number of these steps that took at least one second longer than expected.",
           _of_steps(lambda s: sum(x.late_s >= LATE_FROM_S for x in s))),
    Measure("steps_late_s", "s", "Total time by which these steps took longer than expected.",
           _of_steps(lambda s: sum(x.late_s for x in s))),
    Measure("marks", "", "Marks set by the wizard.", lambda m: sum(m.marks.values())),
    Measure("wizard_errors", "", "Errors that the wizard marked.", lambda m: m.wizard_errors),
    Measure("wizard_errors_per_10_min", "1/10 min", "The same per ten minutes.", lambda m: m.errors_per_10_min),
    Measure("link_trouble_s", "s", "Time during which the robot could not be reached.", lambda m: m.link_trouble_s),
    Measure("lost_values", "", "Values that were not recorded.", lambda m: sum(m.lost.values())),
    Measure(
        "missing_values", "", "Values that were recorded according to the counts in session.json but can no "
            "longer be read.",
        lambda m: sum(m.missing.values()),
    ),
    Measure("problems", "", "Problems reported to the wizard.", lambda m: sum(m.problems.values())),
    Measure("alarms", "", "Alarms: problems that needed attention, including those that were active when the "
        "recording started.",
           lambda m: len(m.alarms)),
    Measure("alarms_s", "s", "Total time that these alarms were active.",
           lambda m: sum(one.stood_s for one in m.alarms)),
    Measure("alarms_seen_to", "", "Number of these alarms that were dismissed; the others ended automatically or "
        "remained active.",
           lambda m: sum(bool(one.seen_to_by) for one in m.alarms)),
    Measure("people", "", "Highest number of people present at once for 2 s or longer, as counted on the screen.",
           lambda m: m.people),
    Measure("identities", "", "Number of identities that detector and tracker distinguished; one person may "
        "get several.",
           lambda m: m.identities),
)  # fmt: skip
