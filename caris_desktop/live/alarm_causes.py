"""Alarm logic: problems with a common cause form one alarm, with automatic end. Plain values, given the time."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import ANSWER, AlarmChanged, AlarmState, Problem, ProblemEnd, Severity
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.live.status import Alarm

FOLLOWS_FROM: Mapping[str, tuple[str, ...]] = {
    "picture": ("link",),
    "lidar": ("link",),
    "pose": ("link",),
    "battery": ("link",),
    "goal": ("link",),
    "robot_sound": ("link",),
    "utterance": ("link", "voice"),
}
"""Causes that suppress an alarm which follows from them."""
CAUSE_OF_END: Mapping[ProblemEnd, str] = {"connected": "link", "released": "emergency_stop"}
"""Cause while a condition is awaited, where their names differ."""
HOLD_NS = 1_500_000_000
"""Delay of a problem that may follow from another cause, so that the cause can appear first."""
AGAIN_NS = 120_000_000_000
"""A recurrence within this time is the same alarm."""
LAPSE_NS = 60_000_000_000
"""A problem that is reported repeatedly ends when it was not reported for this time."""
_STEADY_S = {"link": 2.0}
_LONGEST_STEADY_S = 30.0
_FOLDED_AT_MOST = 12
_GRAVITY: Mapping[Severity, int] = {"info": 0, "warning": 1, "error": 2}


class Condition(Value):
    """Alarm condition derived from the state, once it has lasted ``after_s``.

    ``prevails``: its text replaces that of reported problems, which become the reason.
    """

    cause: str
    severity: Severity
    what: str
    meaning: str
    advice: str
    after_s: float = 0.0
    until: ProblemEnd = ""
    prevails: bool = False


def cause_of(problem: Problem) -> str:
    """Cause of a problem: as named, else the awaited condition, else its text."""
    if problem.cause not in ("", ANSWER):
        return problem.cause
    return CAUSE_OF_END.get(problem.until, problem.until) or problem.what


def cause_among(problem: Problem, alarms: Iterable[Alarm]) -> Alarm | None:
    """Existing alarm that explains this problem."""
    causes = (*FOLLOWS_FROM.get(cause_of(problem), ()), cause_of(problem))
    active = {alarm.cause: alarm for alarm in alarms}
    return next((active[cause] for cause in causes if cause in active), None)


@dataclass(slots=True)
class _ActiveAlarm:
    alarm: Alarm
    reported_ns: int
    by_condition: bool
    was_not_over: bool
    over_since_ns: int | None = None
    prevails: bool = False


class AlarmBook:
    """Collects problems and conditions and maintains the alarms. :meth:`take_changes` returns changes
    for the record.
    """

    def __init__(self) -> None:
        self._active: dict[str, _ActiveAlarm] = {}
        self._ended: dict[str, tuple[Alarm, int]] = {}
        self._held: list[tuple[int, Problem]] = []
        self._pending: dict[str, tuple[int, int]] = {}  # start of the condition, and when it becomes an alarm
        self._changes: list[AlarmChanged] = []
        self._ends: frozenset[ProblemEnd] = frozenset()
        self._number = 0

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """Current alarms, most severe first, then newest first."""
        alarms = (active.alarm for active in self._active.values())
        return tuple(sorted(alarms, key=lambda alarm: (-_GRAVITY[alarm.severity], -alarm.began_ns)))

    def causes(self) -> frozenset[str]:
        return frozenset(self._active)

    def take_changes(self) -> list[AlarmChanged]:
        changes, self._changes = self._changes, []
        return changes

    def add(self, problem: Problem, now_ns: int) -> None:
        """Add a reported problem."""
        if problem.severity == "info":
            return
        under = cause_among(problem, self.alarms)
        if problem.cause == ANSWER:
            if under is not None:
                self._fold(under.cause, problem.what, now_ns, asked=True)
            return
        cause = cause_of(problem)
        if under is not None and under.cause != cause:
            self._fold(under.cause, problem.what, now_ns)
        elif under is not None:
            self._report_again(problem, now_ns)
        elif cause in FOLLOWS_FROM:
            self._held.append((now_ns + HOLD_NS, problem))
        else:
            self._raise(_alarm_of(problem, now_ns), now_ns)

    def evaluate(self, conditions: Sequence[Condition], ends: frozenset[ProblemEnd], now_ns: int) -> None:
        """Evaluate the current conditions: raise those that lasted long enough, end those that are over."""
        self._ends = ends
        self._check_conditions(conditions, now_ns)
        due = [problem for due_ns, problem in self._held if due_ns <= now_ns]
        self._held = [(due_ns, problem) for due_ns, problem in self._held if due_ns > now_ns]
        for problem in due:
            under = cause_among(problem, self.alarms)
            if under is not None:
                self._fold(under.cause, problem.what, now_ns)
            elif problem.until and problem.until in ends:
                continue  # ended before it became an alarm
            elif "link" in FOLLOWS_FROM[cause_of(problem)] and "connected" not in ends:
                # Unclear whether the robot is not yet or no longer connected.
                self._held.append((now_ns + HOLD_NS, problem))
            else:
                self._raise(_alarm_of(problem, now_ns), now_ns)
        true_now = {condition.cause for condition in conditions}
        for active in tuple(self._active.values()):
            self._find_end(active, true_now, now_ns)

    def dismiss(self, alarm_id: str, actor: Actor, now_ns: int) -> bool:
        """Dismiss an alarm; False if only the state can end it, or if it is over."""
        active = next((each for each in self._active.values() if each.alarm.alarm_id == alarm_id), None)
        if active is None or active.alarm.ends_by_itself:
            return False
        self._end(active, now_ns, actor)
        return True

    def forget(self, causes: Collection[str], now_ns: int) -> None:
        """End the alarms of these causes, whose subject no longer exists."""
        for active in [each for cause, each in self._active.items() if cause in causes]:
            self._end(active, now_ns)

    def report_all(self, now_ns: int) -> None:
        """Report all alarms again at the start of a recording."""
        for active in self._active.values():
            self._notify("raised", active, now_ns)

    def wait_s(self, now_ns: int) -> float | None:
        """Time until the next evaluation in s without a change; None for never."""
        due_ns = [due for due, _ in self._held]
        due_ns += [due for _since, due in self._pending.values()]
        for active in self._active.values():
            if active.over_since_ns is not None:
                due_ns.append(active.over_since_ns + _steady_ns(active.alarm))
            elif _lapses(active):
                due_ns.append(active.reported_ns + LAPSE_NS)
        return max(0.0, (min(due_ns) - now_ns) / 1e9) if due_ns else None

    def _check_conditions(self, conditions: Sequence[Condition], now_ns: int) -> None:
        pending: dict[str, tuple[int, int]] = {}
        for condition in conditions:
            active = self._active.get(condition.cause)
            if active is not None:
                if condition.prevails and active.alarm.what != condition.what:
                    # Reasons about the former robot are obsolete.
                    reason = "" if active.by_condition else _reason(active.alarm)
                    active.alarm = replace(_in_words_of(condition, active.alarm), why=reason)
                    active.by_condition = active.prevails = True
                continue
            since_ns, _due = self._pending.get(condition.cause, (now_ns, 0))
            due_ns = since_ns + round(condition.after_s * 1e9)
            if due_ns > now_ns:
                pending[condition.cause] = since_ns, due_ns
            elif not any(cause in self._active for cause in FOLLOWS_FROM.get(condition.cause, ())):
                raised = Alarm("", condition.cause, condition.severity, "", "", "", now_ns)
                self._raise(_in_words_of(condition, raised), now_ns, by_condition=True)
                self._active[condition.cause].prevails = condition.prevails
        self._pending = pending

    def _find_end(self, active: _ActiveAlarm, true_now: Collection[str], now_ns: int) -> None:
        alarm = active.alarm
        if alarm.until and alarm.until != "quiet":
            there = alarm.until in self._ends
            active.was_not_over |= not there
            over = there and active.was_not_over
        else:
            over = active.by_condition and alarm.cause not in true_now
        if over and active.over_since_ns is None:
            active.over_since_ns = now_ns
        elif not over and active.over_since_ns is not None:
            active.over_since_ns = None
            active.alarm = replace(alarm, times=alarm.times + 1)
        lapsed = _lapses(active) and now_ns - active.reported_ns >= LAPSE_NS
        steady = active.over_since_ns is not None and now_ns - active.over_since_ns >= _steady_ns(active.alarm)
        if steady or lapsed:
            self._end(active, now_ns)

    def _raise(self, alarm: Alarm, now_ns: int, *, by_condition: bool = False) -> None:
        before, ended_ns = self._ended.pop(alarm.cause, (None, 0))
        if before is not None and now_ns - ended_ns < AGAIN_NS:
            alarm = replace(alarm, alarm_id=before.alarm_id, times=before.times + 1)
        else:
            self._number += 1
            alarm = replace(alarm, alarm_id=f"a-{self._number}-{now_ns:x}")
        for cause, causes in FOLLOWS_FROM.items():
            if alarm.cause in causes and cause in self._active:
                following = self._active[cause]
                alarm = replace(alarm, folded=_with_line(alarm.folded, following.alarm.what))
                self._end(following, now_ns)
        there = alarm.until in self._ends
        self._active[alarm.cause] = _ActiveAlarm(alarm, now_ns, by_condition, was_not_over=not there)
        self._notify("raised", self._active[alarm.cause], now_ns)

    def _end(self, active: _ActiveAlarm, now_ns: int, actor: Actor = CONSOLE) -> None:
        del self._active[active.alarm.cause]
        self._ended[active.alarm.cause] = (active.alarm, now_ns)
        self._notify("ended", active, now_ns, actor)

    def _notify(self, state: AlarmState, active: _ActiveAlarm, now_ns: int, actor: Actor = CONSOLE) -> None:
        alarm = active.alarm
        self._changes.append(
            AlarmChanged(
                now_ns, alarm.alarm_id, alarm.cause, state, alarm.severity, alarm.what, alarm.meaning, alarm.advice,
                alarm.times, not active.by_condition, actor,
            )
        )  # fmt: skip

    def _fold(self, cause: str, what: str, now_ns: int, *, asked: bool = False) -> None:
        active = self._active[cause]
        alarm = active.alarm
        asked_ns = now_ns if asked else alarm.asked_ns
        active.alarm = replace(alarm, folded=_with_line(alarm.folded, what), asked_ns=asked_ns)

    def _report_again(self, problem: Problem, now_ns: int) -> None:
        """Merge a recurrence: the most severe text wins, of equal ones the newest; others become details."""
        active = self._active[cause_of(problem)]
        alarm = active.alarm
        active.reported_ns = now_ns
        if problem.what == alarm.what:
            active.alarm = replace(alarm, meaning=problem.meaning, advice=problem.advice)
        elif active.prevails:
            active.alarm = replace(alarm, why=_reason(problem))
        elif active.by_condition or _GRAVITY[problem.severity] < _GRAVITY[alarm.severity]:
            active.alarm = replace(alarm, folded=_with_line(alarm.folded, problem.what))
        else:
            folded = _with_line(alarm.folded, alarm.what)
            active.alarm = replace(
                alarm, severity=problem.severity, what=problem.what, meaning=problem.meaning, advice=problem.advice,
                until=problem.until or alarm.until, folded=tuple(line for line in folded if line != problem.what),
            )  # fmt: skip


def _alarm_of(problem: Problem, now_ns: int) -> Alarm:
    return Alarm(
        "", cause_of(problem), problem.severity, problem.what, problem.meaning, problem.advice, now_ns,
        until=problem.until, ends_by_itself=bool(problem.until),
    )  # fmt: skip


def _reason(problem: Problem | Alarm) -> str:
    return " ".join(part for part in (problem.what, problem.advice) if part)


def _in_words_of(condition: Condition, alarm: Alarm) -> Alarm:
    return replace(
        alarm, severity=condition.severity, what=condition.what, meaning=condition.meaning, advice=condition.advice,
        until=condition.until, ends_by_itself=True,
    )  # fmt: skip


def _lapses(active: _ActiveAlarm) -> bool:
    return active.alarm.until == "quiet"


def _steady_ns(alarm: Alarm) -> int:
    """Time in ns for which it must be over before the alarm ends; longer for each recurrence."""
    least_s = _STEADY_S.get(alarm.cause, 0.0)
    again_s = 2.0 * 3.0 ** (alarm.times - 2) if alarm.times > 1 else 0.0
    return round(min(least_s + again_s, _LONGEST_STEADY_S) * 1e9)


def _with_line(lines: tuple[str, ...], line: str) -> tuple[str, ...]:
    """Unique lines, newest last."""
    return (*(each for each in lines if each != line), line)[-_FOLDED_AT_MOST:]
