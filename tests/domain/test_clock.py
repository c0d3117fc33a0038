"""Measurement time from the robot's stamp and the estimate of its clock."""

import pytest

from caris_desktop.domain.clock import StampAge, measured_ns

MS = 1_000_000
ARRIVAL_NS, OFFSET_NS = 1_000_000 * MS, 1_700_000_000_000 * MS


@pytest.mark.parametrize(
    ("late_ms", "uncertainty_ms", "found_ms"),
    [
        (40, 1, 40),
        (4_900, 1, 4_900),
        (9_000, 1, None),
        (0, 1, 0),
        (-1, 2, 0),  # ahead by less than the error: it cannot be measured after its arrival
        (-5, 2, None),
        (11_000, 1, None),  # of another clock
        (40, 100, 40),
        (40, 101, None),  # too uncertain
    ],
)
def test_the_stamp_counts_where_it_can_be_right(late_ms: int, uncertainty_ms: int, found_ms: int | None) -> None:
    stamp_ns = ARRIVAL_NS + OFFSET_NS - late_ms * MS
    found = measured_ns(stamp_ns, arrival_ns=ARRIVAL_NS, offset_ns=OFFSET_NS, uncertainty_ns=uncertainty_ms * MS)
    assert found == (None if found_ms is None else ARRIVAL_NS - found_ms * MS)


def test_without_a_stamp_nothing_is_known() -> None:
    assert measured_ns(None, arrival_ns=ARRIVAL_NS, offset_ns=OFFSET_NS, uncertainty_ns=MS) is None


def test_an_age_is_known_up_to_what_can_be_believed() -> None:
    ages = StampAge()
    for late_ms, known, delay_s in (
        (40, True, 0.04), (4900, True, 4.9), (5100, False, 0.0), (-400, True, 0.0), (-600, False, 0.0),
    ):  # fmt: skip
        ages.add(ARRIVAL_NS + OFFSET_NS - late_ms * MS, arrival_ns=ARRIVAL_NS)
        assert ages.is_known(OFFSET_NS) is known, late_ms
        if known:
            assert ages.delay_s(OFFSET_NS) == pytest.approx(delay_s)
    ages.add(None, arrival_ns=ARRIVAL_NS)
    assert (ages.is_known(OFFSET_NS), ages.delay_s(OFFSET_NS)) == (True, 0.0)


def test_without_a_clock_the_quickest_of_the_last_while_is_the_measure() -> None:
    ages = StampAge()
    for number in range(1200):  # two minutes, ten per second
        arrival_ns = ARRIVAL_NS + number * 100 * MS
        late_ms = 2000 if 300 <= number < 310 else 30 * (number % 2)
        ages.add(arrival_ns - late_ms * MS, arrival_ns=arrival_ns)
        assert ages.delay_s(None) == pytest.approx(late_ms / 1e3, abs=1e-6), number
