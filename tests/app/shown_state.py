"""What panels can read of LiveState, as plain data to compare."""

from typing import Any

from caris_desktop.domain.streams import STATE_STREAMS
from caris_desktop.live.state import LiveState
from caris_desktop.live.status_tap import STATUS_TYPES, content_of

# Not part of what a panel shows of the robot: how the recorder itself fares, and streams that no panel reads live.
_LEFT_OUT = ("audio", "status", "lens")


def shown_state(state: LiveState) -> dict[str, Any]:
    """Of each stream the stamp of its value and its freshness; of the console's own status everything."""
    streams = {
        spec.name: [getattr(state.stream(spec.name).value, "stamp_ns", None), state.stream(spec.name).freshness]
        for spec in STATE_STREAMS
        if spec.name not in _LEFT_OUT
    }
    status = {name: content_of(name, getattr(state, name).value) for name in STATUS_TYPES}
    robot, scenario = state.robot.value, state.scenario.value
    return {
        "streams": streams,
        "status": status,
        "robot": None if robot is None else [robot.name, robot.title],
        "scenario": None if scenario is None else [scenario.title, scenario.sha256],
    }
