"""Sound over a network: compensation of delay, and detection of gaps."""

from itertools import pairwise

from caris_desktop.domain.sound_values import SoundClock

_MS = 1_000_000
PIECE_NS = 50 * _MS


def heard(delays_ms: list[float | None], *, clock: SoundClock | None = None) -> list[tuple[int, int]]:
    """(stamp error in ms, reported gap in ms) of each piece; a delay of None means a lost piece."""
    clock = clock or SoundClock()
    out = []
    for number, delay_ms in enumerate(delays_ms):
        begun_ns = number * PIECE_NS
        if delay_ms is not None:
            arrival_ns = begun_ns + PIECE_NS + round(delay_ms * _MS)
            stamp_ns, missing_ns = clock.stamp(arrival_ns=arrival_ns, length_ns=PIECE_NS)
            out.append((round((stamp_ns - begun_ns) / _MS), round(missing_ns / _MS)))
    return out


def test_delay_that_comes_and_goes_moves_no_sound() -> None:
    assert set(heard([0, 30, 200, 150, 100, 50, 0, 400, 350, 300, 0, 0] * 3)) == {(0, 0)}


def test_pieces_that_were_lost_are_found_within_a_second_and_then_it_is_right_again() -> None:
    told = heard([0] * 10 + [None] * 4 + [0] * 30)
    assert [missing for _, missing in told if missing] == [200]
    assert told[-1] == (0, 0)
    assert told[31] == (0, 0), "20 pieces are a second"


def test_a_long_silence_is_reported_at_once() -> None:
    told = heard([0] * 3 + [None] * 100 + [0] * 3)
    assert told[3] == (0, 5000)


def test_a_first_piece_that_was_late_itself_is_forgotten_slowly() -> None:
    told = heard([80] + [0] * 200)
    assert told[0] == (80, 0) and told[-1] == (0, 0)
    steps = [before - after for (before, _), (after, _) in pairwise(told)]
    assert max(steps) <= 1 and min(steps) >= 0


def test_a_clock_that_is_slower_than_ours_is_followed() -> None:
    clock, off_ms = SoundClock(), []
    for number in range(4000):
        begun_ns = round(number * PIECE_NS * 1.0002)
        stamp_ns, missing_ns = clock.stamp(arrival_ns=begun_ns + PIECE_NS, length_ns=PIECE_NS)
        off_ms.append((stamp_ns - begun_ns) / _MS)
        assert missing_ns == 0
    assert max(map(abs, off_ms)) < 10
