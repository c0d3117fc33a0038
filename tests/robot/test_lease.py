"""Motion lease with an injected clock."""

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from caris_desktop.domain.geometry import ZERO_TWIST, Twist2D
from caris_desktop.robot.lease import EXPIRY_S, ZERO_REPEAT_S, LeasedTwist, MotionLease, bounded_twist, ramp
from caris_desktop.robot.profile_model import MotionLimits

LIMITS = MotionLimits()
PERIOD_S = 0.05
FORWARD = Twist2D(0.5, 0.0, 0.0)


class Bench:
    """Runs a lease as the link's timer does, and records its commands."""

    def __init__(self, limits: MotionLimits = LIMITS) -> None:
        self.allowed = 1.0
        self.lease = MotionLease(limits, rate_hz=1 / PERIOD_S, allow=lambda _twist, _now_s: self.allowed)
        self.now_s = 100.0
        self.sent: list[tuple[float, LeasedTwist]] = []

    def pump(self) -> list[LeasedTwist]:
        """Commands due now."""
        due = []
        while (leased := self.lease.next_twist(self.now_s)) is not None:
            due.append(leased)
            self.sent.append((self.now_s, leased))
        return due

    def run(self, duration_s: float, *, renew: bool = True) -> list[tuple[float, LeasedTwist]]:
        """Advance the time; renew every 50 ms as the console does."""
        first, end_s, renew_s = len(self.sent), self.now_s + duration_s, self.now_s + 0.05
        while True:
            self.now_s = min(self.lease.due_s(), renew_s, end_s)
            if renew and self.now_s >= renew_s:
                self.lease.renew(self.now_s)
            if self.now_s >= renew_s:
                renew_s += 0.05
            self.pump()
            if self.now_s >= end_s:
                return self.sent[first:]

    def drive(self, target: Twist2D = FORWARD) -> list[LeasedTwist]:
        self.lease.drive(target, "keyboard", self.now_s)
        return self.pump()


def test_the_first_step_goes_out_at_once_and_moves() -> None:
    bench = Bench()
    [first] = bench.drive()
    assert first.twist.forward_mps == pytest.approx(LIMITS.acceleration_mps2 * PERIOD_S)
    assert first.source == "keyboard"


def test_it_ramps_at_the_command_rate_and_stays_at_the_target() -> None:
    bench = Bench()
    bench.drive()
    sent = bench.run(1.0)
    assert len(sent) == 20
    for (before_s, before), (after_s, after) in pairwise(sent):
        assert after_s - before_s == pytest.approx(PERIOD_S)
        step = after.twist.forward_mps - before.twist.forward_mps
        assert 0.0 <= step <= LIMITS.acceleration_mps2 * PERIOD_S + 1e-9
    assert sent[-1][1].twist == FORWARD


def test_each_change_goes_out_at_once() -> None:
    bench = Bench()
    bench.drive()
    bench.run(0.52)
    [changed] = bench.drive(Twist2D(0.5, 0.0, 1.0))
    assert changed.twist.turn_radps > 0.0


def test_the_same_target_again_renews_and_adds_nothing() -> None:
    bench = Bench()
    bench.drive()
    bench.now_s += 0.01
    assert bench.drive() == []


def test_150_ms_without_renewal_end_in_zero_at_once_for_half_a_second_and_then_silence() -> None:
    bench = Bench()
    bench.drive()
    bench.run(0.6)
    last_renewal_s = bench.now_s
    sent = bench.run(3.0, renew=False)
    zeros = [(at_s, leased) for at_s, leased in sent if not leased.twist.moving]
    moving = [at_s for at_s, leased in sent if leased.twist.moving]
    assert max(moving) < last_renewal_s + EXPIRY_S
    assert zeros[0][0] == pytest.approx(last_renewal_s + EXPIRY_S, abs=0.001)
    assert zeros[0][1] == LeasedTwist(ZERO_TWIST, "lease")
    assert zeros[-1][0] == pytest.approx(zeros[0][0] + ZERO_REPEAT_S, abs=0.001)
    assert len(zeros) == 11
    assert bench.lease.due_s() == math.inf
    assert bench.lease.pop_expired()
    assert not bench.lease.pop_expired()


def test_release_is_zero_at_once_and_not_ramped() -> None:
    bench = Bench()
    bench.drive()
    bench.run(1.01)
    bench.lease.release(bench.now_s)
    assert bench.pump() == [LeasedTwist(ZERO_TWIST, "keyboard")]
    assert all(not leased.twist.moving for _, leased in bench.run(2.0))
    assert bench.sent[-1][0] == pytest.approx(101.51, abs=0.01)


def test_release_sends_nothing_when_nothing_was_held() -> None:
    bench = Bench()
    assert not bench.lease.release(bench.now_s)
    assert bench.pump() == []


def test_driving_to_zero_is_a_release() -> None:
    bench = Bench()
    bench.drive()
    assert [leased.twist for leased in bench.drive(ZERO_TWIST)] == [ZERO_TWIST]
    assert not bench.lease.held


def test_a_renewal_does_not_bring_a_lease_back() -> None:
    bench = Bench()
    bench.drive()
    bench.now_s += EXPIRY_S + 0.02
    assert not bench.lease.renew(bench.now_s)
    assert [leased.twist for leased in bench.pump()] == [ZERO_TWIST]
    assert not bench.lease.renew(bench.now_s)
    assert all(not leased.twist.moving for _, leased in bench.run(1.0))


def test_stop_says_zero_even_when_nothing_was_held() -> None:
    bench = Bench()
    bench.lease.stop(bench.now_s)
    assert bench.pump() == [LeasedTwist(ZERO_TWIST, "stop")]


def test_reversal_passes_through_zero_and_slows_down_faster_than_it_speeds_up() -> None:
    bench = Bench()
    bench.drive()
    bench.run(1.02)
    bench.drive(Twist2D(-0.3, 0.0, 0.0))
    speeds = [leased.twist.forward_mps for _, leased in bench.run(1.5)]
    assert 0.0 in speeds
    falling = speeds[: speeds.index(0.0)]
    rising = speeds[speeds.index(0.0) + 1 :]
    assert all(speed > 0.0 for speed in falling)
    assert all(speed < 0.0 for speed in rising)
    assert len(falling) < len([speed for speed in rising if speed > -0.3])
    assert speeds[-1] == pytest.approx(-0.3)


def test_the_latched_emergency_stop_refuses_and_answers_each_attempt_with_zeros() -> None:
    bench = Bench()
    bench.drive()
    bench.run(0.3)
    bench.lease.emergency(True, bench.now_s)
    assert bench.pump() == [LeasedTwist(ZERO_TWIST, "stop")]
    bench.run(1.0)
    assert bench.lease.due_s() == math.inf
    assert not bench.lease.drive(FORWARD, "keyboard", bench.now_s)
    sent = bench.run(1.0)
    assert sent
    assert all(not leased.twist.moving for _, leased in sent)


def test_clearing_the_emergency_stop_moves_nothing_automatically() -> None:
    bench = Bench()
    bench.drive()
    bench.lease.emergency(True, bench.now_s)
    bench.run(1.0)
    bench.lease.emergency(False, bench.now_s)
    assert bench.run(1.0) == []
    assert [leased.twist.moving for leased in bench.drive()] == [True]


def test_after_a_lost_link_nothing_is_left_to_be_sent() -> None:
    bench = Bench()
    bench.drive()
    bench.run(0.3)
    bench.lease.forget()
    assert bench.run(2.0) == []
    assert not bench.lease.held


def test_a_late_timer_does_not_make_the_step_larger() -> None:
    bench = Bench()
    bench.drive()
    bench.now_s += 0.14
    [late] = bench.pump()
    assert late.twist.forward_mps <= 2 * LIMITS.acceleration_mps2 * PERIOD_S + 1e-9


def test_a_limit_of_the_guard_applies_at_once_and_the_arc_stays() -> None:
    bench = Bench()
    bench.drive(Twist2D(0.4, 0.0, 0.8))
    bench.run(1.0)
    bench.allowed = 0.25
    slowed = bench.run(0.5)[1:]
    assert {leased.twist for _, leased in slowed} == {Twist2D(0.1, 0.0, 0.2)}
    assert {leased.source for _, leased in slowed} == {"keyboard"}


def test_a_stop_of_the_guard_applies_at_once_and_not_at_the_next_tick() -> None:
    bench = Bench()
    bench.drive()
    bench.run(1.0)
    bench.now_s += 0.01
    assert bench.pump() == []
    bench.allowed = 0.0
    bench.lease.reconsider(bench.now_s)
    assert [leased.twist for leased in bench.pump()] == [ZERO_TWIST]
    assert bench.lease.held, "the key is still down"
    assert all(not leased.twist.moving for _, leased in bench.run(0.5))


def test_a_new_scan_that_forbids_nothing_sends_nothing() -> None:
    bench = Bench()
    bench.drive()
    bench.run(1.0)
    bench.now_s += 0.01
    bench.lease.reconsider(bench.now_s)
    assert bench.pump() == []


def test_on_a_free_path_it_speeds_up_as_from_rest_on_the_same_arc() -> None:
    bench = Bench()
    bench.drive(Twist2D(0.5, 0.0, 0.5))
    bench.run(1.0)
    bench.allowed = 0.0
    bench.run(0.3)
    bench.allowed = 1.0
    twists = [leased.twist for _, leased in bench.run(1.0)]
    assert twists[-1] == Twist2D(0.5, 0.0, 0.5)
    for before, after in pairwise([ZERO_TWIST, *twists]):
        assert after.forward_mps - before.forward_mps <= LIMITS.acceleration_mps2 * PERIOD_S + 1e-9
        assert after.turn_radps == pytest.approx(after.forward_mps)


def test_from_standing_before_an_obstacle_another_direction_begins_at_once() -> None:
    bench = Bench()
    bench.drive()
    bench.run(0.5)
    bench.allowed = 0.0
    bench.run(0.5)
    bench.allowed = 1.0
    [first] = bench.drive(Twist2D(0.0, 0.0, 1.0))
    bench.run(0.05)
    assert first.twist.forward_mps == 0.0, "nothing is left of the speed that the guard had taken away"
    assert bench.sent[-1][1].twist.turn_radps > 0.0


def test_values_beyond_the_limits_or_no_numbers_are_bounded() -> None:
    assert bounded_twist(Twist2D(9.0, 1.0, -9.0), LIMITS) == Twist2D(0.5, 0.0, -1.0)
    assert bounded_twist(Twist2D(-9.0, 0.0, math.nan), LIMITS) == Twist2D(-0.3, 0.0, 0.0)


speeds = st.floats(-3.0, 3.0)


whats = st.sampled_from(["drive", "release", "wait", "lapse"])


@given(st.lists(st.tuples(speeds, speeds, speeds, whats, st.sampled_from([1.0, 1.0, 0.3, 0.0])), max_size=30))
def test_the_robot_is_never_sent_values_beyond_its_limits(
    asked: list[tuple[float, float, float, str, float]],
) -> None:
    limits = MotionLimits(left_mps=0.2)
    bench = Bench(limits)
    for forward, left, turn, what, allowed in asked:
        bench.allowed = allowed
        if what == "drive":
            bench.drive(Twist2D(forward, left, turn))
        elif what == "release":
            bench.lease.release(bench.now_s)
            bench.pump()
        bench.run(0.13, renew=what != "lapse")
    for _, leased in bench.sent:
        assert -limits.backward_mps <= leased.twist.forward_mps <= limits.forward_mps
        assert abs(leased.twist.left_mps) <= limits.left_mps
        assert abs(leased.twist.turn_radps) <= limits.turn_radps
    for (_, before), (_, after) in pairwise(bench.sent):
        faster = abs(after.twist.forward_mps) - abs(before.twist.forward_mps)
        assert faster <= limits.acceleration_mps2 * PERIOD_S + 1e-9


@given(speeds, speeds, st.floats(0.001, 0.1))
def test_a_ramp_step_never_overshoots(current: float, target: float, elapsed_s: float) -> None:
    stepped = ramp(Twist2D(current), Twist2D(target), LIMITS, elapsed_s).forward_mps
    assert min(current, target) <= stepped <= max(current, target)
