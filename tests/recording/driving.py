"""Real recorder process for tests, and values for it."""

import multiprocessing
import pickle
import threading
import time
from collections.abc import Callable
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain import clock
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import CommandSent, Marked
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import FrameRef, LaserScan, RobotPose
from caris_desktop.live.frame_ring import FrameRing, FrameRings
from caris_desktop.perception import blur
from caris_desktop.recording.recorder.disk_watch import DiskLimits
from caris_desktop.recording.recorder.recorder_messages import (
    ARRIVED,
    RecorderReport,
    StartRecording,
    StopRecording,
)
from caris_desktop.recording.recorder.recorder_process import run_recorder
from caris_desktop.recording.session.session_header import RecordedScenario, SessionHeader

SPAWN = multiprocessing.get_context("spawn")


def body(connection: Connection, ring_names: tuple[str, ...], limits: DiskLimits) -> None:
    rings = FrameRings(FrameRing.attach(name) for name in ring_names)
    try:
        run_recorder(connection, rings, limits, covering=blur)
    finally:
        rings.close()


class RecorderUnderTest:
    """The recorder in a separate process, and its messages.

    With ``in_thread`` it runs in this process instead, which starts at once, for tests that do not depend on the
    process.
    """

    def __init__(
        self,
        *rings: FrameRing,
        limits: DiskLimits | None = None,
        target: Callable[[Connection, tuple[str, ...], DiskLimits], None] = body,
        in_thread: bool = False,
    ) -> None:
        self.connection, theirs = SPAWN.Pipe(duplex=True)
        self.heard: list[Any] = []
        self._thread: threading.Thread | None = None
        if in_thread:
            recorder = partial(run_recorder, theirs, FrameRings(rings), limits or DiskLimits(), covering=blur)
            self._thread = threading.Thread(target=recorder, name="recorder")
            self._thread.start()
            return
        self.process = SPAWN.Process(
            target=target, args=(theirs, tuple(ring.name for ring in rings), limits or DiskLimits()), daemon=True
        )
        self.process.start()
        theirs.close()

    def send(self, *messages: Any) -> None:
        """Send messages with their arrival times, as the console does."""
        for message in messages:
            raw = pickle.dumps(message)
            self.connection.send_bytes(ARRIVED + clock.now_ns().to_bytes(8, "little", signed=True) + raw)

    def wait_for(self, kind: type[Any], *, timeout_s: float = 20.0, **fields: Any) -> Any:
        """The first message of ``kind`` with these fields, already received or later."""
        deadline, seen = time.monotonic() + timeout_s, 0
        while True:
            for message in self.heard[seen:]:
                if isinstance(message, kind) and all(getattr(message, key) == fields[key] for key in fields):
                    return message
            seen = len(self.heard)
            assert time.monotonic() < deadline, f"no {kind.__name__} {fields}; heard {self.heard}"
            if self.connection.poll(0.1):
                self.heard.append(self.connection.recv())

    def drain(self) -> None:
        while self.connection.poll(0):
            self.heard.append(self.connection.recv())

    def stop_session(self) -> RecorderReport:
        self.send(StopRecording())
        report: RecorderReport = self.wait_for(RecorderReport, state="idle")
        return report

    def close(self) -> None:
        self.connection.close()
        if self._thread is not None:
            self._thread.join(10)
            assert not self._thread.is_alive()
            return
        self.process.join(10)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


def header(**fields: Any) -> SessionHeader:
    return SessionHeader(
        clock=ClockAnchor.take(),
        program_version="0.test",
        **{"scenario": RecordedScenario("Tour guide"), "trial": {"participant": "P07", "condition": "B"}, **fields},
    )


def start(folder: Path, **fields: Any) -> StartRecording:
    return StartRecording(folder, header(), **fields)


def scan(beams: int = 720, stamp_ns: int | None = None) -> LaserScan:
    ranges_m = np.linspace(0.5, 8.0, beams, dtype=np.float32)
    ranges_m[::10] = np.inf
    return LaserScan(
        stamp_ns=clock.now_ns() if stamp_ns is None else stamp_ns,
        robot_stamp_ns=123,
        frame_id="laser",
        angle_min_rad=-3.14,
        angle_increment_rad=6.28 / beams,
        range_min_m=0.1,
        range_max_m=10.0,
        ranges_m=ranges_m,
        robot_from_laser=Pose2D(0.1, 0.0, 0.0),
    )


def pose(x_m: float) -> RobotPose:
    return RobotPose(clock.now_ns(), None, Pose2D(x_m, 2.0, 0.5))


def command(sequence: int, forward_mps: float = 0.3) -> CommandSent:
    return CommandSent(clock.now_ns(), sequence, Twist2D(forward_mps, 0.0, 0.1), "keyboard")


def mark(label: str) -> Marked:
    return Marked(clock.now_ns(), label)


def picture(number: int, *, width_px: int = 640, height_px: int = 480) -> NDArray[np.uint8]:
    """A moving gradient, uint8 BGR, with the number as brightness of its top left corner."""
    row = ((np.arange(width_px) + 7 * number) % 256).astype(np.uint8)
    image_bgr = np.repeat(np.repeat(row[None, :, None], height_px, axis=0), 3, axis=2).copy()
    image_bgr[: height_px // 4, : width_px // 4] = number % 8 * 32
    return image_bgr


def feed_frames(
    recorder: RecorderUnderTest, ring: FrameRing, count: int, *, period_s: float, camera: str = "front"
) -> list[FrameRef]:
    """Write and announce frames at a steady rate."""
    refs, next_s = [], time.monotonic()
    for number in range(count):
        ref = ring.write(picture(number), stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera=camera)
        recorder.send(ref)
        refs.append(ref)
        next_s += period_s
        time.sleep(max(0.0, next_s - time.monotonic()))
    return refs
