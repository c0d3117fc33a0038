"""When the robot measured something, from its stamp and what is known of its clock."""

import pytest

from caris_desktop.domain.clock import measured_ns

MS = 1_000_000
ARRIVAL_NS, OFFSET_NS = 1_000_000 * MS, 1_700_000_000_000 * MS


@pytest.mark.parametrize(
    ("late_ms", "uncertainty_ms", "found_ms"),
    [
        (40, 1, 40),
        (9_000, 1, 9_000),
        (0, 1, 0),
        (-1, 2, 0),  # ahead by less than the error: it cannot have been taken after it came
        (-5, 2, None),
        (11_000, 1, None),  # another clock's
        (40, 100, 40),
        (40, 101, None),  # known no better than guessed
    ],
)
def test_the_stamp_counts_where_it_can_be_right(late_ms: int, uncertainty_ms: int, found_ms: int | None) -> None:
    stamp_ns = ARRIVAL_NS + OFFSET_NS - late_ms * MS
    found = measured_ns(stamp_ns, arrival_ns=ARRIVAL_NS, offset_ns=OFFSET_NS, uncertainty_ns=uncertainty_ms * MS)
    assert found == (None if found_ms is None else ARRIVAL_NS - found_ms * MS)


def test_without_a_stamp_nothing_is_known() -> None:
    assert measured_ns(None, arrival_ns=ARRIVAL_NS, offset_ns=OFFSET_NS, uncertainty_ns=MS) is None
