"""Estimate of the robot's clock from samples with various delays: the truth is within the stated uncertainty."""

import random

import pytest

from caris_desktop.robot.clock_offset import ClockOffset, OffsetEstimate

S = 1_000_000_000
MS = 1_000_000
# The robot's clock counts from 1970, the session clock from the start of the machine.
EPOCH_NS = 1_700_000_000 * S


def clock_ahead(session_ns: int, *, drift: float = 0.0, jump_ns: int = 0) -> int:
    """Robot clock 2 s ahead of UTC, with drift."""
    return EPOCH_NS + session_ns + 2 * S + round(session_ns * drift) + jump_ns


def ask(clock: ClockOffset, session_ns: int, *, there_ms: float, back_ms: float, drift: float, jump_ns: int = 0) -> int:
    """Add one exchange that starts now; returns its end."""
    read_ns = session_ns + int(there_ms * MS)
    answered_ns = read_ns + int(back_ms * MS)
    robot_ns = clock_ahead(read_ns, drift=drift, jump_ns=jump_ns)
    clock.add_exchange(sent_ns=session_ns, answered_ns=answered_ns, robot_ns=robot_ns)
    return answered_ns


def error_ns(estimate: OffsetEstimate | None, session_ns: int, *, drift: float, jump_ns: int = 0) -> int:
    assert estimate is not None
    return abs(estimate.offset_ns - (clock_ahead(session_ns, drift=drift, jump_ns=jump_ns) - session_ns))


def test_nothing_is_known_before_the_robot_reported_its_time() -> None:
    clock = ClockOffset()
    clock.add_stamp(robot_stamp_ns=EPOCH_NS, arrival_ns=5)
    assert clock.at(10) is None


@pytest.mark.parametrize("drift", [0.0, 0.05 / 60, -0.05 / 60, 20e-6])
def test_the_truth_is_within_the_stated_uncertainty_for_a_drifting_clock_behind_an_uneven_network(drift: float) -> None:
    chance = random.Random(5)  # noqa: S311 (delays, not secrets)
    clock = ClockOffset()
    uncertainties = []
    for second in range(240):
        # The return path is slower, with occasional spikes, as with images on a shared wireless network.
        back_ms = 6.0 + chance.expovariate(1 / 20.0) + (120.0 if chance.random() < 0.1 else 0.0)
        ended_ns = ask(clock, second * S, there_ms=1.0 + chance.expovariate(1 / 2.0), back_ms=back_ms, drift=drift)
        for later_ns in (0, 300 * MS, 900 * MS):
            estimate = clock.at(ended_ns + later_ns)
            assert estimate is not None
            assert error_ns(estimate, ended_ns + later_ns, drift=drift) <= estimate.uncertainty_ns
        uncertainties.append(clock.at(ended_ns).uncertainty_ms)  # type: ignore[union-attr]
    # A single exchange would give half its round-trip time, 17 ms on average.
    assert sum(uncertainties[60:]) / len(uncertainties[60:]) < 7.0


def test_the_uncertainty_grows_with_the_time_since_the_last_good_answer() -> None:
    clock = ClockOffset()
    at_ns = 0
    for second in range(30):
        at_ns = ask(clock, second * S, there_ms=1.0, back_ms=1.0, drift=20e-6)
    estimates = [clock.at(at_ns + after * S) for after in (0, 10, 100, 1000)]
    stated = [estimate.uncertainty_ns for estimate in estimates if estimate is not None]
    assert stated == sorted(stated)
    assert stated[0] < 2 * MS < stated[-1]
    for after, estimate in zip((0, 10, 100, 1000), estimates, strict=True):
        assert estimate is not None
        assert error_ns(estimate, at_ns + after * S, drift=20e-6) <= estimate.uncertainty_ns


def test_one_late_answer_spoils_nothing() -> None:
    clock = ClockOffset()
    ask(clock, 0, there_ms=1.0, back_ms=1.0, drift=0.0)
    before = clock.at(1 * S)
    at_ns = ask(clock, 1 * S, there_ms=1.0, back_ms=2_000.0, drift=0.0)
    after = clock.at(at_ns)
    assert before is not None
    assert after is not None
    assert after.uncertainty_ms < before.uncertainty_ms + 4.0


def test_a_clock_that_is_set_is_followed_from_the_next_answer_on() -> None:
    clock = ClockOffset()
    for second in range(20):
        ask(clock, second * S, there_ms=1.0, back_ms=1.0, drift=0.0)
    at_ns = ask(clock, 20 * S, there_ms=1.0, back_ms=1.0, drift=0.0, jump_ns=-3600 * S)
    estimate = clock.at(at_ns)
    assert estimate is not None
    assert error_ns(estimate, at_ns, drift=0.0, jump_ns=-3600 * S) <= estimate.uncertainty_ns <= 2 * MS


def test_stamps_narrow_it_and_those_of_another_clock_are_ignored() -> None:
    plain, helped, misled = ClockOffset(), ClockOffset(), ClockOffset()
    for second in range(10):
        for clock in (plain, helped, misled):
            ask(clock, second * S, there_ms=10.0, back_ms=40.0, drift=0.0)
        stamped_ns = second * S + 500 * MS
        helped.add_stamp(robot_stamp_ns=clock_ahead(stamped_ns), arrival_ns=stamped_ns + 2 * MS)
        misled.add_stamp(robot_stamp_ns=clock_ahead(stamped_ns) + 7 * S, arrival_ns=stamped_ns)
    at_ns = 10 * S
    for clock in (plain, helped, misled):
        ask(clock, at_ns, there_ms=10.0, back_ms=40.0, drift=0.0)
        estimate = clock.at(at_ns + 60 * MS)
        assert estimate is not None
        assert error_ns(estimate, at_ns + 60 * MS, drift=0.0) <= estimate.uncertainty_ns
    narrow, wide = helped.at(at_ns + 60 * MS), plain.at(at_ns + 60 * MS)
    assert narrow is not None
    assert wide is not None
    assert narrow.uncertainty_ns < wide.uncertainty_ns / 2


def test_a_simulation_that_stands_still_stays_within_what_is_stated() -> None:
    clock = ClockOffset.of_simulation_time()
    for tick in range(100):
        at_ns = tick * 100 * MS
        # The clock stops at five seconds.
        robot_ns = min(at_ns, 5 * S)
        clock.add_exchange(sent_ns=at_ns, answered_ns=at_ns + 20 * MS, robot_ns=robot_ns)
        estimate = clock.at(at_ns + 20 * MS)
        assert estimate is not None
        assert abs(estimate.offset_ns - (robot_ns - at_ns - 20 * MS)) <= estimate.uncertainty_ns + 20 * MS


def test_an_answer_before_its_question_is_a_mistake_of_the_caller() -> None:
    with pytest.raises(ValueError, match="after its question"):
        ClockOffset().add_exchange(sent_ns=2, answered_ns=1, robot_ns=0)
