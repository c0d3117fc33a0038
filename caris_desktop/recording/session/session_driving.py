"""Driving of a session: one definition for measures, tables, report, timeline and training data."""

from collections.abc import Iterable, Sequence
from operator import attrgetter

import numpy as np

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import CommandSent, CommandSource, GoalChanged, GoalState
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
