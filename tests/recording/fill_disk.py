"""Recording onto a small disk until it is full; prints one JSON object with the recorder's messages."""

import json
import sys
import time
from pathlib import Path

import numpy as np

from caris_desktop.domain import clock
from caris_desktop.domain.events import Problem, SessionEnded
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.recording.recorder.disk_watch import DiskLimits
from caris_desktop.recording.recorder.recorder_messages import RecorderReport
from tests.recording.driving import RecorderUnderTest, mark, start

# The small disk has 12 MiB: 2 for the reserve, about 2 for the video, the rest for events.
LIMITS = {
    "slowly": DiskLimits(warn_free_bytes=9_800_000, end_video_free_bytes=8_500_000, reserve_bytes=2_000_000),
    "suddenly": DiskLimits(warn_free_bytes=0, end_video_free_bytes=0, reserve_bytes=2_000_000),
}


def problems(recorder: RecorderUnderTest) -> list[str]:
    return [message.what for message in recorder.heard if isinstance(message, Problem)]


def main(folder: Path, how: str) -> None:
    ring = FrameRing.create(640 * 480 * 3)
    recorder = RecorderUnderTest(ring, limits=LIMITS[how])
    recorder.send(start(folder))
    recorder.wait_for(RecorderReport)
    noise = np.random.default_rng(1)
    pictures = [noise.integers(0, 96, (480, 640, 3), dtype=np.uint8) for _ in range(5)]
    number, deadline = 0, time.monotonic() + 60
    while time.monotonic() < deadline and not any(
        isinstance(message, RecorderReport) and message.state == "failed" for message in recorder.heard
    ):
        pictures.append(pictures.pop(0))
        recorder.send(ring.write(pictures[0], stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera="front"))
        if how == "suddenly" or any("nearly" in what for what in problems(recorder)):
            # Incompressible data.
            recorder.send(mark(f"{number} {noise.bytes(200_000).hex()}"))
            number += 1
        recorder.drain()
        time.sleep(0.02)
    report = recorder.wait_for(RecorderReport, state="failed")
    ended = recorder.wait_for(SessionEnded)
    recorder.close()
    ring.close()
    print(json.dumps({"problems": problems(recorder), "state": report.state, "reason": ended.reason}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
