"""Video played through camera process, frame ring and inference process as in the console; records the people."""

import json
import queue
import subprocess
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from caris_desktop.domain import clock
from caris_desktop.domain.sensing import CameraState, FrameRef, People
from caris_desktop.live.child_process import ChildProcess, ProcessSpec, RingsToRead, RingToWrite
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.perception.cameras.camera_process import PlayVideo, run_camera
from caris_desktop.perception.cameras.camera_source import parse_camera
from caris_desktop.perception.inference import run_inference
from caris_desktop.perception.inference_messages import (
    DetectionRequest,
    FrameSkipped,
    InferenceFailed,
    InferenceReady,
    InferenceSettings,
)

_PATIENCE_S = 60.0


@dataclass(frozen=True, slots=True)
class Playback:
    """Results. ``latency_ms`` is from a frame's stamp to its people's arrival, one per ``people``."""

    model: str
    load_s: float
    frames: tuple[FrameRef, ...]
    people: tuple[People, ...]
    latency_ms: tuple[float, ...]
    inference_cpu_s: float
    wall_s: float


def play(video: Path, settings: InferenceSettings) -> Playback:
    """Play the video; AssertionError with the reported problem if inference does not start."""
    inbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
    ring = FrameRing.create()
    inference = ChildProcess(
        ProcessSpec("inference", run_inference, (RingsToRead((ring.name,)), settings)),
        on_message=lambda value, _raw: inbox.put(value),
    )
    camera = ChildProcess(
        ProcessSpec("camera", run_camera, (parse_camera(str(video)), RingToWrite(ring.name))),
        on_message=lambda value, _raw: inbox.put(value),
        on_exit=lambda _code: None,
    )
    try:
        inference.start()
        camera.start()
        return _collect(inbox, inference, camera)
    finally:
        camera.stop(grace_s=5.0)
        inference.stop(grace_s=5.0)
        ring.close()


def _collect(inbox: "queue.SimpleQueue[Any]", inference: ChildProcess, camera: ChildProcess) -> Playback:
    ready: InferenceReady | None = None
    frames: list[FrameRef] = []
    people: list[People] = []
    latency_ms: list[float] = []
    newest: FrameRef | None = None
    busy = ended = False
    started_s = cpu_s = 0.0
    while not (ended and newest is None and not busy):
        item = inbox.get(timeout=_PATIENCE_S)
        assert not isinstance(item, InferenceFailed), item.problem
        if isinstance(item, InferenceReady):
            ready = item
            camera.send(PlayVideo())
            started_s, cpu_s = time.monotonic(), _cpu_s(inference)
        elif isinstance(item, FrameRef):
            frames.append(item)
            newest = item
        elif isinstance(item, People | FrameSkipped):
            busy = False
            if isinstance(item, People):
                people.append(item)
                latency_ms.append((clock.now_ns() - item.stamp_ns) / 1e6)
        elif isinstance(item, CameraState) and item.state == "ended":
            ended = True
        if ready is not None and newest is not None and not busy and inference.send(DetectionRequest(newest)):
            newest, busy = None, True
    assert ready is not None, "the video ended before the detector was ready"
    return Playback(
        model=ready.model,
        load_s=ready.load_s,
        frames=tuple(frames),
        people=tuple(people),
        latency_ms=tuple(latency_ms),
        inference_cpu_s=_cpu_s(inference) - cpu_s,
        wall_s=time.monotonic() - started_s,
    )


def _cpu_s(child: ChildProcess) -> float:
    times = psutil.Process(child.pid).cpu_times()
    return float(times.user + times.system)


def write_mot(people: Iterable[People], path: Path) -> None:
    """Write MOTChallenge rows. In a new ring frame n of a video has sequence n, which is the frame number."""
    rows = [
        f"{one.frame_sequence},{box.track},{box.left_px:.2f},{box.top_px:.2f},{box.width_px:.2f},{box.height_px:.2f},"
        f"{box.confidence:.4f},-1,-1,-1\n"
        for one in people
        for box in one.boxes
    ]
    path.write_text("".join(rows), encoding="ascii")


def score(truth: Path, result: Path, scorer: Path) -> dict[str, float] | None:
    """HOTA, MOTA, IDF1 of the shared scorer; None if its package is missing."""
    finished = subprocess.run(
        [sys.executable, str(scorer), str(truth), str(result)], capture_output=True, text=True, check=False
    )
    if "No module named 'trackeval'" in finished.stderr:
        return None
    assert finished.returncode == 0, finished.stderr
    # Its package prints a line about missing imports before the scores.
    scores: dict[str, float] = json.loads(finished.stdout.splitlines()[-1])
    return scores
