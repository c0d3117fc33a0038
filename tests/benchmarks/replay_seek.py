"""Time to open an hour of recording and to seek, and correctness of the result.

Generates a session of ``--seconds`` (two cameras at 30 Hz, scans of 720 beams at 20 Hz, ten people at 10 Hz, sound), or
uses ``--session`` of an earlier run, opens it, seeks to 200 random times, and compares scan, people, pose and both
frames with a sequential reading. Prints one JSON object; times in milliseconds.
"""

import argparse
import json
import random
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from caris_desktop.domain.schema import to_jsonable
from caris_desktop.domain.sensing import LaserScan, People, RobotPose
from caris_desktop.recording.replay.session_timeline import SessionTimeline
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session.session_reader import Session, open_session
from tests.support.recorded_session import SessionPlan, make_session, number_in

_COMPARED = {LaserScan: "scan", People: "people", RobotPose: "pose"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--size", default="320x180", help="of the pictures")
    parser.add_argument("--seeks", type=int, default=200)
    parser.add_argument("--session", type=Path, help="made here if it is not there, and kept")
    args = parser.parse_args()
    width_px, height_px = map(int, args.size.split("x"))
    plan = plan_of(args.seconds, (width_px, height_px))
    temporary = None if args.session else Path(tempfile.mkdtemp())
    folder = args.session or temporary / "session"
    try:
        made_s = 0.0
        if not folder.exists():
            begun_s = time.monotonic()
            make_session(folder, plan)
            made_s = time.monotonic() - begun_s
        print(json.dumps({"made_s": round(made_s, 1), **measured(folder, plan, args.seeks)}))
    finally:
        if temporary is not None:
            shutil.rmtree(temporary)


def plan_of(seconds: float, size_px: tuple[int, int]) -> SessionPlan:
    """Session with all streams at high rates."""
    return SessionPlan(
        seconds=seconds,
        fps=30.0,
        size_px=size_px,
        scans_hz=20.0,
        beams=720,
        people=10,
        people_hz=10.0,
        odometry_hz=20.0,
        map_cells=(1000, 1600),
    )


def measured(folder: Path, plan: SessionPlan, seeks: int) -> dict[str, Any]:
    begun_s = time.monotonic()
    session = open_session(folder)
    timeline, videos = SessionTimeline(session), VideoReader(session)
    frame_times = {camera: np.array(videos.frame_times_ns(camera)) for camera in videos.cameras}
    timeline.state_at(timeline.start_ns)
    for camera in videos.cameras:
        videos.frame(camera, 0)
    open_s = time.monotonic() - begun_s

    chosen = random.Random(1)  # noqa: S311 - a benchmark, not cryptography
    moments_ns = [chosen.randrange(timeline.start_ns + 10**9, timeline.end_ns) for _ in range(seeks)]
    states_s, frames_s, wrong_frames = [], [], 0
    shown: dict[int, dict[str, Any]] = {}
    for at_ns in moments_ns:
        begun_s = time.monotonic()
        state = timeline.state_at(at_ns)
        states_s.append(time.monotonic() - begun_s)
        begun_s = time.monotonic()
        pictures = {camera: videos.frame_at(camera, at_ns) for camera in videos.cameras}
        frames_s.append(time.monotonic() - begun_s)
        shown[at_ns] = {_COMPARED[type(value)]: to_jsonable(value) for value in state if type(value) in _COMPARED}
        for camera, picture in pictures.items():
            expected = int(np.searchsorted(plan.frame_stamps_ns(camera), at_ns, side="right")) - 1
            wrong_frames += picture is None or number_in(picture.image_bgr) != expected
            assert picture is None or picture.info.stamp_ns == frame_times[camera][expected]
    timeline.close()
    videos.close()
    seeks_ms = 1000 * (np.array(states_s) + np.array(frames_s))
    return {
        "session_minutes": round(session.duration_s / 60, 1),
        "events_mb": round((folder / "events.mcap").stat().st_size / 1e6),
        "open_ms": round(1000 * open_s),
        "seek_p50_ms": _percentile(seeks_ms, 50),
        "seek_p95_ms": _percentile(seeks_ms, 95),
        "seek_max_ms": _percentile(seeks_ms, 100),
        "state_p95_ms": _percentile(1000 * np.array(states_s), 95),
        "frames_p95_ms": _percentile(1000 * np.array(frames_s), 95),
        "seeks": seeks,
        "wrong_frames": wrong_frames,
        "wrong_states": _wrong_states(session, shown),
    }


def _wrong_states(session: Session, shown: dict[int, dict[str, Any]]) -> int:
    """Number of times with a result different from sequential reading."""
    waiting, newest, wrong = sorted(shown), dict[str, Any](), 0
    for arrived_ns, _, value in session.arrivals(*_COMPARED.values()):
        while waiting and waiting[0] < arrived_ns:
            wrong += shown[waiting.pop(0)] != {name: to_jsonable(value) for name, value in newest.items()}
        newest[_COMPARED[type(value)]] = value
    return wrong + sum(
        shown[at_ns] != {name: to_jsonable(value) for name, value in newest.items()} for at_ns in waiting
    )


def _percentile(values_ms: Any, percent: float) -> float:
    return round(float(np.percentile(values_ms, percent)), 1)


if __name__ == "__main__":
    main()
