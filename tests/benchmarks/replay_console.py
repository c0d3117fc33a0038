"""Replay of a long session in the console: opening, seeking, and playback in real time.

``python -m tests.benchmarks.replay_console [--minutes 60] [--seeks 100] [--play-s 20] [--session FOLDER]`` prints JSON.
"""

import argparse
import functools
import json
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from caris_desktop.domain.sensing import FrameRef
from tests.benchmarks.screen_and_statistics import percentiles
from tests.support.recorded_session import make_session

_SETTLED_WITHIN_S = 20.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seeks", type=int, default=100)
    parser.add_argument("--play-s", type=float, default=20.0)
    parser.add_argument("--size", default="320x180", help="of the pictures of a session that is made")
    parser.add_argument("--session", type=Path, help="use this session; without it one is made")
    arguments = parser.parse_args()
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    with tempfile.TemporaryDirectory(prefix="caris-benchmark-") as workplace:
        folder = arguments.session
        if folder is None:
            folder = Path(workplace) / "session"
            width_px, height_px = map(int, arguments.size.split("x"))
            make_session(
                folder,
                seconds=60 * arguments.minutes,
                scans_hz=20.0,
                beams=720,
                people=10,
                people_hz=10.0,
                fps=30.0,
                size_px=(width_px, height_px),
            )
        print(json.dumps(_measured(folder, arguments), indent=2))


def _measured(folder: Path, arguments: argparse.Namespace) -> dict[str, Any]:
    from PySide6.QtWidgets import QApplication

    from caris_desktop.app.composition import find_scenario
    from caris_desktop.live.replay_console import ReplayAdapters, ReplayConsole
    from caris_desktop.recording.replay.video_reader import VideoReader
    from caris_desktop.recording.session.session_reader import open_session

    application = QApplication.instance() or QApplication([])

    def until(seen: Callable[[], object]) -> float:
        began_s = time.perf_counter()
        while not seen():
            application.processEvents()
            time.sleep(0.0005)
            assert time.perf_counter() - began_s < _SETTLED_WITHIN_S
        return 1000 * (time.perf_counter() - began_s)

    def not_read(_event: Any) -> Any:
        raise ValueError("scenario and robot are not the matter here")

    began_s = time.perf_counter()
    session = open_session(folder)
    opened_ms = 1000 * (time.perf_counter() - began_s)
    videos = VideoReader(session)
    console = ReplayConsole(
        ReplayAdapters(
            start_scenario=find_scenario("tour-guide"),
            read_scenario=not_read,
            read_layout=not_read,
            read_robot=not_read,
            name_of=lambda _person: None,
            end_ns=session.ended_ns,
            cameras=videos.cameras[:1],
            frame_times=functools.cache(videos.frame_times_ns),
            monotonic_ns=time.monotonic_ns,
        ),
        session,
    )
    state = console.state
    console.start()
    until(lambda: console.settled)
    first_ms = 1000 * (time.perf_counter() - began_s)
    rng = np.random.default_rng(3)
    seek_ms = []
    for at_s in rng.uniform(5.0, session.duration_s - 5.0, arguments.seeks):
        shown: set[str] = set()

        def on_frame(ref: FrameRef, shown: set[str] = shown) -> None:
            shown.add(ref.camera)

        state.frame.changed.connect(on_frame)
        console.seek(session.started_ns + round(float(at_s) * 1e9))
        seek_ms.append(until(lambda shown=shown: console.settled and state.camera.value in shown))
        state.frame.changed.disconnect(on_frame)
        assert abs(state.scan.age_s() or 9.0) < 0.2
    late: dict[str, list[float]] = {"scan": [], "people": [], "frame": []}
    arrivals = _arrivals(session, console.state.present.now_ns(), arguments.play_s)
    for name, values in late.items():
        stream = getattr(state, name)
        stream.changed.connect(
            lambda value, values=values: values.append(
                (state.present.now_ns() - arrivals.get((type(value), value.stamp_ns), state.present.now_ns())) / 1e6
            )
        )
    console.play()
    began_s = time.perf_counter()
    until(lambda: time.perf_counter() - began_s > min(arguments.play_s, _SETTLED_WITHIN_S - 1.0))
    console.pause()
    console.shutdown()
    videos.close()
    return {
        "session_minutes": round(session.duration_s / 60, 1),
        "opened_ms": round(opened_ms),
        "first_shown_ms": round(first_ms),
        "seek_to_all_shown_ms": percentiles(seek_ms),
        "late_at_1x_ms": {name: percentiles(values) for name, values in late.items()},
    }


def _arrivals(session: Any, from_ns: int, seconds: float) -> dict[tuple[type[Any], int], int]:
    from caris_desktop.recording.replay.session_timeline import SessionTimeline

    with SessionTimeline(session) as timeline:
        between = timeline.between(from_ns, from_ns + round((seconds + 2.0) * 1e9))
        return {(type(value), getattr(value, "stamp_ns", 0)): arrived_ns for arrived_ns, value in between}


if __name__ == "__main__":
    main()
