"""Messages to the console while it reads, and while it does not."""

import multiprocessing
from multiprocessing.connection import Connection
from typing import Any

import pytest

from caris_desktop.domain.events import CommandSent, Gap, LinkChanged, Problem
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import BatteryState, RobotPose
from caris_desktop.robot.link_process import MOST_VALUES_PER_STREAM, ConsoleSender, ProblemReporter


def drain(connection: Connection) -> list[Any]:
    values = []
    while connection.poll(0.3):
        values.append(connection.recv())
    return values


def pose(number: int) -> RobotPose:
    return RobotPose(number, None, Pose2D(float(number), 0.0, 0.0))


def command(number: int) -> CommandSent:
    return CommandSent(number, number, Twist2D(), "keyboard")


def test_a_console_that_sleeps_blocks_nobody_loses_no_event_and_wakes_to_the_newest() -> None:
    ours, theirs = multiprocessing.Pipe()
    outbox = ConsoleSender(theirs)
    # More than a pipe holds: a blocking put would never return.
    for number in range(20_000):
        outbox.put(command(number))
        outbox.put(pose(number))
    values = drain(ours)
    assert [value.sequence for value in values if isinstance(value, CommandSent)] == list(range(20_000))
    poses = [value for value in values if isinstance(value, RobotPose)]
    assert poses[-1] == pose(19_999)
    missing = sum(value.count for value in values if isinstance(value, Gap) and value.stream == "pose")
    assert len(poses) + missing == 20_000
    assert missing > 0
    outbox.close(1.0)


def test_a_burst_passes_whole() -> None:
    ours, theirs = multiprocessing.Pipe()
    outbox = ConsoleSender(theirs)
    for number in range(MOST_VALUES_PER_STREAM):
        outbox.put(pose(number))
    assert drain(ours) == [pose(number) for number in range(MOST_VALUES_PER_STREAM)]
    outbox.close(1.0)


def test_no_value_overtakes_the_event_that_voids_it() -> None:
    """All values are in one batch, as after a pause of the console."""
    ours, theirs = multiprocessing.Pipe()
    outbox = ConsoleSender(theirs)
    for number in range(20_000):
        outbox.put(command(number))  # fills the pipe
    lost, again = LinkChanged(2, "control", "lost", "ws://robot"), LinkChanged(4, "control", "connected", "ws://robot")
    for value in (pose(1), BatteryState(1, 0.5), lost, again, pose(5)):
        outbox.put(value)
    told = [value for value in drain(ours) if not isinstance(value, CommandSent)]
    assert told == [pose(1), BatteryState(1, 0.5), lost, again, pose(5)]
    outbox.close(1.0)


def test_a_console_that_is_gone_does_not_hurt() -> None:
    ours, theirs = multiprocessing.Pipe()
    outbox = ConsoleSender(theirs)
    ours.close()
    for number in range(100):
        outbox.put(command(number))
    outbox.close(1.0)


def test_only_what_the_stream_table_knows_is_taken() -> None:
    _, theirs = multiprocessing.Pipe()
    outbox = ConsoleSender(theirs)
    with pytest.raises(KeyError):
        outbox.put("text")
    outbox.close(1.0)


def test_equal_mishaps_become_one_problem_with_their_number() -> None:
    told: list[Problem] = []
    now_ns = 0
    reporter = ProblemReporter(told.append, at_most_every_s=0.05, clock=lambda: now_ns)
    for _ in range(50):
        reporter.count("a", severity="warning", what="{count} broken", meaning="m", advice="a")
    assert [problem.what for problem in told] == ["1 broken"]
    now_ns = 60_000_000
    reporter.count("a", severity="warning", what="{count} broken", meaning="m", advice="a")
    assert told[-1].what == "50 broken"
