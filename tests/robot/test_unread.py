"""Limit of velocity commands that the robot has not read."""

import pytest

from caris_desktop.robot.unread import MOST_UNREAD, READ_WITHIN_S, UnreadCommands


def answering(
    round_trip_s: float, *, handled_s: float | None = None, seconds: float = 4.0
) -> tuple[UnreadCommands, float]:
    """Model after a period with this round-trip time and all commands handled; and the current time."""
    unread, now_s = UnreadCommands(rate_hz=20.0), 100.0
    while now_s < 100.0 + seconds:
        now_s += 0.2
        unread.read(round_trip_s, now_s)
        unread.answered(handled_s or round_trip_s, now_s)
    return unread, now_s


def sent_until_full(unread: UnreadCommands, now_s: float, period_s: float) -> int:
    """Number of commands sent to a robot that reads nothing."""
    count = 0
    while not unread.full(now_s):
        unread.sent(now_s, moving=True)
        now_s += period_s
        count += 1
    return count


@pytest.mark.parametrize("rate_hz", [5.0, 20.0, 50.0, 100.0])
def test_a_robot_that_does_not_read_gets_four_at_most_and_none_after_150_ms(rate_hz: float) -> None:
    unread, now_s = answering(0.004)
    count = sent_until_full(unread, now_s, 1.0 / rate_hz)
    assert count <= MOST_UNREAD
    assert (count - 1) / rate_hz < READ_WITHIN_S + 0.004
    assert unread.late_from_s() == pytest.approx(now_s + READ_WITHIN_S + 0.004)


def test_before_anything_was_answered_it_is_no_more() -> None:
    assert sent_until_full(UnreadCommands(rate_hz=20.0), 100.0, 0.05) <= MOST_UNREAD


def test_one_that_reads_gets_all_of_them() -> None:
    unread, now_s = answering(0.01)
    for _ in range(200):
        assert not unread.full(now_s)
        unread.sent(now_s, moving=True)
        unread.answered(0.01, now_s + 0.01)
        now_s += 0.05


def test_an_ordinary_wireless_network_is_allowed_no_more() -> None:
    unread, now_s = answering(0.06)
    assert sent_until_full(unread, now_s, 0.05) <= MOST_UNREAD


def test_the_usual_latency_of_the_network_is_added() -> None:
    unread, now_s = answering(0.6)
    count = sent_until_full(unread, now_s, 0.05)
    assert MOST_UNREAD + 10 <= count <= MOST_UNREAD + 12
    assert unread.late_from_s() == pytest.approx(now_s + READ_WITHIN_S + 0.6)


def test_a_robot_that_is_slow_to_handle_on_a_fast_network_is_allowed_no_more() -> None:
    unread, now_s = answering(0.01, handled_s=0.6)
    assert sent_until_full(unread, now_s, 0.05) == MOST_UNREAD
    assert unread.late_from_s() == pytest.approx(now_s + READ_WITHIN_S + 0.6)


def test_one_slow_answer_does_not_count_as_usual_and_a_fast_one_does_at_once() -> None:
    unread, now_s = answering(0.01)
    unread.answered(0.5, now_s + 0.5)
    assert sent_until_full(unread, now_s + 0.6, 0.05) <= MOST_UNREAD
    unread, now_s = answering(0.6)
    unread.read(0.01, now_s + 0.1)
    unread.answered(0.01, now_s + 0.1)
    assert sent_until_full(unread, now_s + 0.2, 0.05) <= MOST_UNREAD


def test_it_is_settled_when_a_zero_after_the_last_velocity_was_answered() -> None:
    unread = UnreadCommands(rate_hz=20.0)
    assert not unread.acknowledged, "whoever drove before is not known"
    unread.sent(1.0, moving=False)
    unread.answered(0.1, 1.05)
    assert not unread.acknowledged, "that ping was older"
    unread.answered(0.1, 1.1)
    assert unread.acknowledged
    unread.sent(2.0, moving=True)
    unread.sent(2.1, moving=False)
    unread.sent(2.2, moving=True)
    unread.answered(0.01, 2.4)
    assert not unread.acknowledged, "that zero was not the last"
    unread.sent(2.5, moving=False)
    unread.forget()
    unread.answered(0.01, 3.0)
    assert not unread.acknowledged, "on another connection nothing of before was read"
