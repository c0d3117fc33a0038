"""Comparison of live state and replay: a second's delay is permitted, a missing value is not."""

from typing import Any

import pytest

from caris_desktop.domain.streams import STATE_STREAMS
from tests.app.shown_state import differences

S = 1_000_000_000
AT_NS = 100 * S


def shown(*, scan: list[Any] | None = None, **status: Any) -> dict[str, Any]:
    streams = {spec.name: [None, "never", None] for spec in STATE_STREAMS}
    told = {"drive": {"allowed": True, "speed": 0.5}} | status
    return {
        "streams": streams | {"scan": [*(scan or [AT_NS, "fresh"]), 3.5]},
        "status": told,
        "robot": None,
        "scenario": None,
    }


@pytest.mark.parametrize("behind_ns", [-S, -S // 10, 0, S // 10, S])
def test_a_delay_within_a_second_is_no_difference(behind_ns: int) -> None:
    changed_ns = AT_NS + behind_ns
    before = shown(scan=[changed_ns - S // 10, "fresh"], drive={"allowed": False}, goal="kitchen")
    after = shown(scan=[changed_ns, "fresh"])

    def at(at_ns: int) -> dict[str, Any]:
        # A short goal between two samples.
        return after | {"status": after["status"] | {"goal": "hall" if at_ns == changed_ns + 7 else ""}}

    live = shown(scan=[changed_ns, "fresh"], goal="hall")
    sample = {"at_ns": AT_NS, "shown": live}
    found = differences(
        sample, lambda at_ns: before if at_ns < changed_ns else at(at_ns), lambda name, *_: [changed_ns + 7]
    )
    assert found == []


def test_a_missing_state_is_reported_by_its_difference() -> None:
    replayed = shown(scan=[AT_NS - 3 * S, "fresh"], drive={"allowed": False, "speed": 0.5})
    sample = {"at_ns": AT_NS, "shown": shown()}
    assert differences(sample, lambda _at_ns: replayed, lambda *_: []) == [
        f"scan of {AT_NS}, which the replay shows of {AT_NS - 3 * S}",
        "drive allowed: True, in the replay False",
    ]
    replayed["streams"]["scan"][0] -= S
    sample["shown"] = shown(scan=[AT_NS - 4 * S, "stale"], drive={"allowed": False, "speed": 0.5}) | {"robot": ["a"]}
    assert differences(sample, lambda _at_ns: replayed, lambda *_: []) == [
        "scan stale, which in the replay is fresh",
        "robot ['a'], in the replay None",
    ]
