"""Half an hour at full rate: no unreported loss, little CPU time, no memory leak."""

import pytest

from tests.benchmarks.recording_load import run

MINUTES = 30.0


@pytest.mark.long
@pytest.mark.alone
@pytest.mark.timeout(MINUTES * 60 + 300)
def test_half_an_hour_costs_little_and_loses_nothing_untold() -> None:
    figures = run(MINUTES * 60)
    assert set(figures["values_lost"].values()) == {0}
    assert figures["frames_unaccounted"] == 0
    assert all(abs(off) <= 80 for off in figures["sound_off_by_samples"])
    assert figures["cpu_beyond_encoding_percent"] <= 15
    assert figures["resident_growth_mb"] < 20
