"""Driving of a session: one definition for measures, tables, report, timeline and training data."""

from collections.abc import Iterable, Sequence
from operator import attrgetter

import numpy as np

from caris_desktop.domain.events import CommandSent, CommandSource
from caris_desktop.domain.geometry import Twist2D
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
