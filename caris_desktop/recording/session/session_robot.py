"""Driving, navigation goals and alarms of a session, from its events."""

from collections.abc import Iterable, Sequence
from operator import attrgetter

import numpy as np

from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import AlarmChanged, CommandSent, CommandSource, GoalChanged, GoalState, Severity
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.value_class import Value

COMMAND_HOLDS_S = 0.5
"""A velocity command counts as driving until the next one, but no longer than this: a base executes it for so long
(``cmd_vel_timeout`` of ros2_control's diff_drive_controller, and the simulated robot)."""


class Drive(Value):
    """Interval in which the robot was commanded to move, with one velocity after the other from one source.

    ``source`` is that of the commands; a command counts if any velocity component is nonzero, however slow.
    """

    start_ns: int
    end_ns: int
    source: CommandSource

    @property
    def duration_s(self) -> float:
        return round((self.end_ns - self.start_ns) / 1e9, 6)


def commanded(
    commands: Iterable[CommandSent], *, ended_ns: int, pauses: Sequence[tuple[int, int]] = ()
) -> list[tuple[int, int, CommandSent]]:
    """Start and end of each command other than zero, in order of time: until the next command, the end of the
    recording or a pause, at most ``COMMAND_HOLDS_S``.
    """
    ordered = sorted(commands, key=attrgetter("stamp_ns"))
    if not ordered:
        return []
    stamps_ns = np.array([command.stamp_ns for command in ordered], np.int64)
    breaks_ns = np.sort(np.array([*(begin_ns for begin_ns, _ in pauses), max(ended_ns, int(stamps_ns[-1]))], np.int64))
    next_break_ns = breaks_ns[np.minimum(np.searchsorted(breaks_ns, stamps_ns), len(breaks_ns) - 1)]
    next_ns = np.append(stamps_ns[1:], breaks_ns[-1])
    ends_ns = np.minimum(np.minimum(next_ns, next_break_ns), stamps_ns + int(COMMAND_HOLDS_S * 1e9)).tolist()
    return [
        (command.stamp_ns, end_ns, command)
        for command, end_ns in zip(ordered, ends_ns, strict=True)
        if command.twist != Twist2D()
    ]


def drives_of(
    commands: Iterable[CommandSent], *, ended_ns: int, pauses: Sequence[tuple[int, int]] = ()
) -> tuple[Drive, ...]:
    """Drives in order of time."""
    drives: list[Drive] = []
    for start_ns, end_ns, command in commanded(commands, ended_ns=ended_ns, pauses=pauses):
        last = drives[-1] if drives else None
        if last is not None and last.source == command.source and start_ns <= last.end_ns:
            drives[-1] = Drive(last.start_ns, end_ns, command.source)
        else:
            drives.append(Drive(start_ns, end_ns, command.source))
    return tuple(drives)


# Navigation goals of a session: one record per goal, from its change events.

_OVER: tuple[GoalState, ...] = ("reached", "cancelled", "failed")


class NavigationGoal(Value):
    """One goal. ``end_ns`` is None if it was still active, and ``start_ns`` if it was refused at once. ``actor`` set
    it.
    """

    goal_id: str
    target_in_map: Pose2D
    place: str | None
    start_ns: int
    end_ns: int | None
    state: GoalState
    actor: Actor = ""

    @property
    def duration_s(self) -> float | None:
        return None if self.end_ns is None else (self.end_ns - self.start_ns) / 1e9


def navigation_goals(
    events: Iterable[GoalChanged], *, started_ns: int, pauses: Sequence[tuple[int, int]] = ()
) -> tuple[NavigationGoal, ...]:
    """Goals of a session in order of their first event.

    A recording that begins, or resumes after one of the ``pauses``, notes the state of the last goal: one that was over
    by then does not belong to it.
    """
    histories: dict[str, list[GoalChanged]] = {}
    for event in events:
        histories.setdefault(event.goal_id, []).append(event)
    goals = []
    for history in histories.values():
        first = history[0]
        over = next((event for event in history if event.state in _OVER), None)
        unrecorded = first.stamp_ns <= started_ns or any(begin < first.stamp_ns <= end for begin, end in pauses)
        if over is not first or not unrecorded:
            end_ns, state = (None, history[-1].state) if over is None else (over.stamp_ns, over.state)
            # The event of a cancelled goal names who cancelled it.
            actor = first.actor if first.state != "cancelled" else ""
            goals.append(
                NavigationGoal(first.goal_id, first.target_in_map, first.place, first.stamp_ns, end_ns, state, actor)
            )
    return tuple(goals)


class AlarmRecord(Value):
    """One alarm. ``start_ns`` is its first record, ``end_ns`` its last end, None if active at the end of the session.
    ``stood_s`` is its active time without pauses; ``times`` counts how often it was raised. ``seen_to_by`` is who
    resolved it, unless it ended without intervention.
    """

    alarm_id: str
    cause: str
    severity: Severity
    what: str
    start_ns: int
    end_ns: int | None
    stood_s: float
    times: int
    seen_to_by: Actor = ""


def alarms_of(
    events: Iterable[AlarmChanged], *, ended_ns: int, pauses: Sequence[tuple[int, int]] = ()
) -> tuple[AlarmRecord, ...]:
    """Alarms in order of their first occurrence.

    Nothing is recorded during a pause, and active alarms are raised again after it: an alarm without a later event
    ended with the pause.
    """
    histories: dict[str, list[AlarmChanged]] = {}
    for event in events:
        histories.setdefault(event.alarm_id, []).append(event)
    return tuple(_alarm(history, ended_ns, pauses) for history in histories.values())


def _alarm(history: Sequence[AlarmChanged], ended_ns: int, pauses: Sequence[tuple[int, int]]) -> AlarmRecord:
    stood_ns, end_ns = 0, None
    for number, event in enumerate(history):
        if event.state == "ended":
            end_ns = event.stamp_ns
            continue
        following = history[number + 1].stamp_ns if number + 1 < len(history) else None
        paused = next((begin for begin, _end in pauses if begin >= event.stamp_ns), None)
        until = min(one for one in (following, paused, max(ended_ns, event.stamp_ns)) if one is not None)
        stood_ns += until - event.stamp_ns
        end_ns = until if until != following and until == paused else None
    last = history[-1]
    by_itself = last.state != "ended" or last.actor in ("", CONSOLE)
    return AlarmRecord(
        last.alarm_id, last.cause, last.severity, last.what, history[0].stamp_ns, end_ns, stood_ns / 1e9,
        max(event.times for event in history), "" if by_itself else last.actor,
    )  # fmt: skip
