"""Synthetic session of one minute with content known to the nanosecond."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from caris_desktop.domain import clock
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import LinkQuality, Marked, UtteranceChanged, UtteranceOrigin, UtteranceState
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import (
    AudioBlock,
    DepthGrid,
    LaserScan,
    OccupancyGrid,
    Odometry,
    People,
    PersonBox,
    PlannedPath,
    StatusShown,
    ThingBox,
)
from caris_desktop.recording.session.session_header import RecordedScenario, SessionHeader
from tests.recording.session.test_session_reader import record

S = 1_000_000_000
LENGTH_S = 60.0


def make_session(
    folder: Path, values_from: Callable[[int], Iterable[Any]], *, trial: dict[str, str] | None = None
) -> int:
    """Record the values that ``values_from`` creates for the start time, and return that time."""
    begin_ns = clock.now_ns()
    header = SessionHeader(
        clock=ClockAnchor.take(),
        program_version="0.test",
        scenario=RecordedScenario("Tour guide"),
        trial=trial or {"participant": "P07", "condition": "B", "trial": "2"},
    )
    record(folder, list(values_from(begin_ns)), head=header)
    path = folder / "session.json"
    data = json.loads(path.read_text())
    data["started_ns"], data["ended_ns"] = begin_ns, begin_ns + int(LENGTH_S * S)
    path.write_text(json.dumps(data))
    return begin_ns


def utterance(stamp_ns: int, state: UtteranceState, **fields: Any) -> UtteranceChanged:
    """Robot utterance."""
    told: dict[str, Any] = {"utterance_id": "u", "speaker": "robot", "text": "Hello.", "origin": "typed", **fields}
    return UtteranceChanged(stamp_ns=stamp_ns, state=state, **told)


def said(
    begin_ns: int, *, at_s: float, for_s: float, text: str, speaker: str = "robot", origin: UtteranceOrigin = "typed"
) -> list[UtteranceChanged]:
    """An utterance from its start to its end."""
    start_ns = begin_ns + round(at_s * S)
    told = {"utterance_id": f"u-{at_s}-{speaker}", "speaker": speaker, "text": text, "origin": origin}
    return [
        utterance(start_ns, "started", **told),
        utterance(start_ns + round(for_s * S), "finished", **told),
    ]


def robot_ns(begin_ns: int, at_s: float) -> int:
    """Robot time: two seconds ahead of 2026."""
    return 1_790_000_002 * S + round(at_s * S)


def everything(begin_ns: int) -> list[Any]:
    """One value of most kinds, ten scans a second stamped by the robot that arrive after 30 ms, and clock estimates."""
    ranges_m = np.linspace(0.5, 8.0, 90, dtype=np.float32)
    ranges_m[::10] = np.inf
    values: list[Any] = []
    for second in range(int(LENGTH_S)):
        at_ns = begin_ns + second * S
        values.append(LinkQuality(at_ns, 2.0, (robot_ns(begin_ns, second) - at_ns) / 1e6, 1.5))
    for tenth in range(int(LENGTH_S) * 10):
        arrived_ns = begin_ns + tenth * S // 10 + 30_000_000
        stamp_ns = robot_ns(begin_ns, tenth / 10)
        if tenth % 10 == 0:
            values.append(
                LaserScan(arrived_ns, stamp_ns, "laser", -1.5, 0.03, 0.1, 10.0, ranges_m, Pose2D(0.1, 0.0, 0.0))
            )
        values.append(Odometry(arrived_ns, stamp_ns, Pose2D(tenth / 100, 0.0, 0.0), Twist2D(0.1, 0.0, 0.0)))
    boxes = tuple(PersonBox(track, f"p-{track}", 1.5, 2.0, 3.0, 4.0, 0.5) for track in (7, 9))
    values += [
        *said(begin_ns, at_s=5.0, for_s=2.5, text="Welcome to the lab."),
        utterance(begin_ns + 9 * S, "requested", utterance_id="never", text="Too late."),
        utterance(begin_ns + 10 * S, "interrupted", utterance_id="never", text="Too late."),
        *said(begin_ns, at_s=12.0, for_s=1.0, text="Ünïcode \U0001f916 \ud800 & <b>", speaker="participant"),
        Marked(begin_ns + 20 * S, "laughs", mark_id="m1", start_ns=begin_ns + 17 * S),
        Marked(begin_ns + 30 * S, "talks", mark_id="m2", state="open"),
        Marked(begin_ns + 41 * S, "slip", "wizard_error", mark_id="m3"),
        Marked(begin_ns + 42 * S, "slip", "wizard_error", mark_id="m3", state="withdrawn"),
        People(begin_ns + 3 * S, "front", 3, 640, 480, boxes, 12.0, (ThingBox("chair", 10.0, 20.5, 30.0, 40.0, 0.5),)),
        People(begin_ns + 4 * S, "front", 4, 640, 480, (), 12.0),
        StatusShown(begin_ns + S, "link", {"state": "connected", "rates": [1, 2.5]}),
        StatusShown(begin_ns + S, "robot", None),
        AudioBlock(begin_ns + S, "microphone", "audio-microphone.wav", 0, 4800, 48000),
        DepthGrid(begin_ns + S, "mast", np.array([[0, 700], [6553, 65535]], np.uint16)),
        OccupancyGrid(begin_ns + S, None, 0.05, Pose2D(0.0, 0.0, 0.0), np.arange(-1, 14, dtype=np.int8).reshape(3, 5)),
        PlannedPath(begin_ns + S, None, np.array([[1.0, 2.5], [3.0, -4.0]], np.float32)),
    ]
    return values
