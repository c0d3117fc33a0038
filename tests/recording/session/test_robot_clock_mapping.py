"""Robot stamps on the session clock: drift, noise, clock steps and unknown clocks."""

import itertools
import random
from collections.abc import Callable
from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st

from caris_desktop.domain.events import LinkQuality
from caris_desktop.recording.session.robot_clock_mapping import RobotClock
from tests.support.examples import examples

S = 1_000_000_000
START = 5_000 * S
UTC = 1_790_000_000 * S


def estimates(
    robot_ns: Callable[[int], int], *, seconds: int = 120, bound_ms: float = 2.0, seed: int = 1
) -> list[LinkQuality]:
    """Clock estimates of a link once a second, within the bound of the true offset."""
    rng = random.Random(seed)  # noqa: S311 - a test, not cryptography
    told = []
    for second in range(seconds):
        at_ns = START + second * S + rng.randrange(S // 10)
        offset_ms = (robot_ns(at_ns) - at_ns) / 1e6 + rng.uniform(-bound_ms, bound_ms)
        told.append(LinkQuality(at_ns, 1.0, offset_ms, bound_ms))
    return told


def drifting(at_ns: int) -> int:
    """2 s ahead of UTC, and 50 ms more with each minute."""
    return UTC + 2 * S + (at_ns - START) + (at_ns - START) * 50 // 60_000


@given(st.integers(-4 * S, 124 * S), st.integers(0, 20))
@settings(max_examples=examples(60), deadline=None)
def test_a_drifting_clock_is_followed_within_what_is_stated(moment_ns: int, seed: int) -> None:
    robot = RobotClock(estimates(drifting, bound_ms=8.0, seed=seed))
    measured = robot.measured(drifting(START + moment_ns), arrival_ns=START + max(0, moment_ns) + S // 20)
    assert measured is not None
    assert abs(measured.stamp_ns - START - moment_ns) <= measured.uncertainty_ns + 2_000
    assert measured.uncertainty_ns < 20e6


def test_noise_is_taken_out_by_the_neighbours() -> None:
    robot = RobotClock(estimates(drifting, bound_ms=8.0))
    off_ns = []
    for second in range(10, 110):
        measured = robot.measured(drifting(START + second * S), arrival_ns=START + second * S)
        assert measured is not None
        off_ns.append(abs(measured.stamp_ns - START - second * S))
    assert sum(off_ns) / len(off_ns) < 2e6
    assert max(off_ns) < 4e6


def test_an_uncertain_estimate_is_bounded_by_better_ones_around_it() -> None:
    told = estimates(drifting, bound_ms=1.0)
    told[0] = replace(told[0], clock_offset_ms=(told[0].clock_offset_ms or 0.0) + 25.0, clock_uncertainty_ms=30.0)
    told[60] = replace(told[60], clock_offset_ms=(told[60].clock_offset_ms or 0.0) - 40.0, clock_uncertainty_ms=45.0)
    robot = RobotClock(told)
    for second in (0, 60):
        measured = robot.measured(drifting(START + second * S), arrival_ns=START + second * S)
        assert measured is not None
        assert abs(measured.stamp_ns - START - second * S) <= measured.uncertainty_ns < 4e6


def test_without_an_estimate_nothing_is_known() -> None:
    for robot in (RobotClock([]), RobotClock([LinkQuality(START, 3.0)])):
        assert not robot
        assert robot.measured(UTC, arrival_ns=START) is None
        assert robot.summary(utc_ns_at=UTC, session_ns_at=START) is None
    assert RobotClock(estimates(drifting)).measured(None, arrival_ns=START) is None


def test_a_single_estimate_is_used_as_it_is() -> None:
    robot = RobotClock([LinkQuality(START, 1.0, (UTC - START) / 1e6, 1.5)])
    measured = robot.measured(UTC - S, arrival_ns=START)
    assert measured is not None
    assert abs(measured.stamp_ns - START + S) < 1_000
    assert 2.5e6 <= measured.uncertainty_ns <= 2.6e6, "a second away, a clock may have gained a millisecond"


def test_stamps_that_are_not_of_this_clock_are_not_believed() -> None:
    robot = RobotClock(estimates(drifting))
    assert robot.measured(123, arrival_ns=START + S) is None
    assert robot.measured(drifting(START) + 3_600 * S, arrival_ns=START + S) is None


def test_a_clock_that_is_set_is_followed_on_both_sides() -> None:
    def set_back(at_ns: int) -> int:
        return drifting(at_ns) - (30 * S if at_ns >= START + 60 * S else 0)

    robot = RobotClock(estimates(set_back))
    for second in itertools.chain(range(1, 59), range(61, 119)):
        measured = robot.measured(set_back(START + second * S), arrival_ns=START + second * S + S // 50)
        assert measured is not None
        assert abs(measured.stamp_ns - START - second * S) <= measured.uncertainty_ns
    summary = robot.summary(utc_ns_at=UTC, session_ns_at=START)
    assert summary is not None
    assert summary.times_set == 1


def test_simulation_time_that_stands_still_and_runs_on_is_followed() -> None:
    def simulated(at_ns: int) -> int:
        """Half speed, and a pause of 10 s after 30."""
        passed_ns = at_ns - START
        return min(passed_ns, 30 * S) // 2 + max(0, passed_ns - 40 * S) // 2

    robot = RobotClock(estimates(simulated, seconds=80, bound_ms=3.0))
    for second in (5, 20, 50, 75):
        measured = robot.measured(simulated(START + second * S), arrival_ns=START + second * S)
        assert measured is not None
        assert abs(measured.stamp_ns - START - second * S) < 30e6
        assert abs(measured.stamp_ns - START - second * S) <= measured.uncertainty_ns


def test_the_summary_gives_offset_and_drift() -> None:
    summary = RobotClock(estimates(drifting)).summary(utc_ns_at=UTC, session_ns_at=START)
    assert summary is not None
    assert summary.estimates == 120
    assert abs(summary.utc_offset_s - 2.0) < 0.005
    assert abs(summary.drift_ms_per_min - 50.0) < 2.0
    assert 2.0 <= summary.uncertainty_ms < 5.0
