"""An hour of recording: time to open it, and time to seek."""

from pathlib import Path

import pytest

from tests.benchmarks.replay_seek import measured, plan_of
from tests.support.recorded_session import make_session


@pytest.mark.long
@pytest.mark.alone
@pytest.mark.timeout(1800)
def test_an_hour_opens_in_a_second_and_any_moment_shows_in_a_blink(tmp_path: Path) -> None:
    plan = plan_of(3600.0, (320, 180))
    make_session(tmp_path / "session", plan)
    found = measured(tmp_path / "session", plan, 200)
    assert (found["wrong_frames"], found["wrong_states"]) == (0, 0)
    assert found["open_ms"] <= 1000
    assert found["seek_p95_ms"] <= 150


@pytest.mark.long
def test_any_moment_shows_what_a_reading_from_the_beginning_gives(tmp_path: Path) -> None:
    plan = plan_of(12.0, (160, 90))
    make_session(tmp_path / "session", plan)
    found = measured(tmp_path / "session", plan, 40)
    assert (found["wrong_frames"], found["wrong_states"]) == (0, 0)
