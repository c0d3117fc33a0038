"""Cost of recording: CPU time and bytes of the recorder process under the traffic of a real session.

One camera of 640x480 at 15 frames/s, scans of 720 beams at 10 Hz, odometry at 20 Hz, poses at 10 Hz, velocity commands
at 20 Hz. Prints one JSON object; ``--seconds`` sets the duration, ``--fps`` and ``--size`` the camera.
"""

import argparse
import json
import shutil
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import psutil

from caris_desktop.domain import clock
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import Odometry
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.recording.recorder.recorder_messages import RecorderReport
from tests.recording.driving import RecorderUnderTest, command, pose, scan, start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--fps", type=float, default=15.0)
    parser.add_argument("--size", default="640x480")
    args = parser.parse_args()
    width_px, height_px = map(int, args.size.split("x"))
    folder = Path(tempfile.mkdtemp())
    ring = FrameRing.create(width_px * height_px * 3)
    recorder = RecorderUnderTest(ring)
    recorder.send(start(folder / "s"))
    recorder.wait_for(RecorderReport)
    process = psutil.Process(recorder.process.pid)
    before = process.cpu_times()
    begun_s = time.monotonic()
    periods_s = {"frame": 1 / args.fps, "scan": 0.1, "odometry": 0.05, "pose": 0.1, "command": 0.05}
    due_s = dict.fromkeys(periods_s, begun_s)
    pictures = moving_pictures(width_px, height_px)
    number = 0
    while time.monotonic() - begun_s < args.seconds:
        for kind, at_s in due_s.items():
            if time.monotonic() < at_s:
                continue
            due_s[kind] += periods_s[kind]
            number += 1
            if kind == "frame":
                image_bgr = pictures[number % len(pictures)]
                recorder.send(ring.write(image_bgr, stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera="front"))
            elif kind == "scan":
                recorder.send(scan())
            elif kind == "odometry":
                recorder.send(Odometry(clock.now_ns(), 1, Pose2D(number / 10, 2.0, 0.1), Twist2D(0.3, 0.0, 0.1)))
            elif kind == "pose":
                recorder.send(pose(number / 10))
            else:
                recorder.send(command(number))
        recorder.drain()
        time.sleep(max(0.0, min(due_s.values()) - time.monotonic()))
    after = process.cpu_times()
    wall_s = time.monotonic() - begun_s
    memory_bytes = process.memory_info().rss
    report = recorder.stop_session()
    recorder.close()
    ring.close()
    sizes = {path.name: path.stat().st_size for path in (folder / "s").iterdir() if path.is_file()}
    shutil.rmtree(folder)
    cpu_s = (after.user + after.system) - (before.user + before.system)
    print(
        json.dumps(
            {
                "camera": f"{args.size}@{args.fps:g}",
                "seconds": round(wall_s, 1),
                "cpu_percent_of_one_core": round(100 * cpu_s / wall_s, 1),
                "memory_mb": round(memory_bytes / 1e6),
                "video_mb_per_hour": round(
                    sum(size for name, size in sizes.items() if name.endswith(".mp4")) / wall_s * 3600 / 1e6
                ),
                "events_mb_per_hour": round(sizes["events.mcap"] / wall_s * 3600 / 1e6),
                "dropped": report.dropped,
            }
        )
    )


def moving_pictures(width_px: int, height_px: int) -> list[np.ndarray]:
    """Panning textured scene with camera noise, of realistic difficulty for an encoder."""
    rng = np.random.default_rng(1)
    scene = cv2.GaussianBlur(rng.integers(0, 255, (height_px, 2 * width_px, 3), dtype=np.uint8), (0, 0), 6)
    scene = cv2.normalize(scene, None, 0, 255, cv2.NORM_MINMAX)
    pictures = []
    for number in range(30):
        view = scene[:, number * 4 : number * 4 + width_px].astype(np.int16)
        pictures.append(np.clip(view + rng.integers(-4, 5, view.shape), 0, 255).astype(np.uint8))
    return pictures


if __name__ == "__main__":
    main()
