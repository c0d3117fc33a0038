"""Plain data of LiveState as read by panels, and comparison of a live state with its replay."""

from collections.abc import Callable
from typing import Any

from caris_desktop.domain.streams import BY_NAME, STATE_STREAMS
from caris_desktop.live.state import LOST_AFTER_S, STATUS_TYPES, LiveState, content_of

# Not displayed as robot state: the recorder's own status, and streams that no panel reads live.
_LEFT_OUT = ("audio", "status", "lens")


def shown_state(state: LiveState) -> dict[str, Any]:
    """Stamp, freshness and age of each stream, and the complete status of the console."""
    streams = {
        spec.name: [getattr(stream.value, "stamp_ns", None), stream.freshness, stream.age_s()]
        for spec in STATE_STREAMS
        if spec.name not in _LEFT_OUT and (stream := state.stream(spec.name))
    }
    status = {name: content_of(name, getattr(state, name).value) for name in STATUS_TYPES}
    robot, scenario = state.robot.value, state.scenario.value
    return {
        "streams": streams,
        "status": status,
        "robot": None if robot is None else [robot.name, robot.title],
        "scenario": None if scenario is None else [scenario.title, scenario.sha256],
    }


def differences(
    sample: dict[str, Any],
    shown_at: Callable[[int], dict[str, Any]],
    told_between: Callable[[str, int, int], list[int]],
) -> list[str]:
    """Displayed live state that the replay has neither at that time nor within a second of it.

    Values are recorded at once and displayed as soon as the window has time, which on a busy computer is later.
    ``shown_at`` returns the replay's state at a time, ``told_between`` the times of a recorded status.
    """
    at_ns, live = sample["at_ns"], sample["shown"]
    replayed: dict[int, dict[str, Any]] = {}

    def shown(offset_ns: int) -> dict[str, Any]:
        if offset_ns not in replayed:
            replayed[offset_ns] = shown_at(at_ns + offset_ns)
        return replayed[offset_ns]

    found = []
    for name, (stamp_ns, freshness, age_s) in live["streams"].items():
        now_ns, now_called, _ = shown(0)["streams"][name]
        if stamp_ns != now_ns:
            around_ns = [shown(offset_ns)["streams"][name][0] for offset_ns in _AROUND_NS]
            if stamp_ns not in around_ns and not _is_between(name, stamp_ns, around_ns):
                found.append(f"{name} of {stamp_ns}, which the replay shows of {now_ns}")
        elif freshness != now_called and not _ages(name, age_s or 0.0):
            found.append(f"{name} {freshness}, which in the replay is {now_called}")
    for name, value in live["status"].items():
        if value == shown(0)["status"][name]:
            continue
        moments_ns = told_between(name, at_ns + _AROUND_NS[0], at_ns + _AROUND_NS[-1])
        offsets_ns = (*_AROUND_NS, *(moment_ns - at_ns for moment_ns in moments_ns))
        if all(value != shown(offset_ns)["status"][name] for offset_ns in offsets_ns):
            found.append(f"{name} {_unlike(value, shown(0)['status'][name])}")
    for name in ("robot", "scenario"):
        if all(live[name] != shown(offset_ns)[name] for offset_ns in (0, *_AROUND_NS)):
            found.append(f"{name} {_unlike(live[name], shown(0)[name])}")
    return found


_AROUND_NS = tuple(quarter * 250_000_000 for quarter in range(-4, 5))


def _is_between(name: str, stamp_ns: int | None, shown_ns: list[int | None]) -> bool:
    """True if the stamp is between those of this second."""
    stamps_ns = [each or 0 for each in shown_ns]
    # A large value is recorded with a delay, and checked once a second.
    spare_ns = round(2.5 * BY_NAME[name].record_every_s * 1e9)
    return stamp_ns is not None and min(stamps_ns) <= stamp_ns <= max(stamps_ns) + spare_ns


def _ages(name: str, age_s: float) -> bool:
    """True if the freshness just changed or is about to: ages are updated now and then.

    Ages count from the measurement, which on a busy computer is long before the arrival.
    """
    moments_s = (BY_NAME[name].stale_after_s or 0.0, LOST_AFTER_S)
    return any(moment_s - 0.25 < age_s < moment_s + 1.0 for moment_s in moments_s)


def _unlike(live: Any, replayed: Any) -> str:
    """Differences only."""
    if isinstance(live, dict) and isinstance(replayed, dict):
        names = [name for name in {**live, **replayed} if live.get(name) != replayed.get(name)]
        return "; ".join(f"{name}: {_unlike(live.get(name), replayed.get(name))}" for name in names)
    return f"{live!r:.150}, in the replay {replayed!r:.150}"
