"""A whole session under load: data loss, cost of recording, and growth of memory.

Two cameras of 1280x720 at 30 Hz, scans of 720 beams at 20 Hz, ten people at 10 Hz for each camera, poses, odometry and
velocity commands at 20 Hz, a mark each second, and sound of 16 kHz in chunks of 50 ms. Prints one JSON object;
``--minutes`` sets the duration. Recorded values are counted in the files and compared with the sent ones.
"""

import argparse
import csv
import json
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import psutil

from caris_desktop.domain import clock
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import AudioChunk, Odometry, People, PersonBox
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.recording.recorder.recorder_messages import RecorderReport
from tests.benchmarks.recording_cpu import moving_pictures
from tests.recording.driving import RecorderUnderTest, command, mark, pose, scan, start
from tests.recording.recorder.test_recorder_process import mcap_counts

CAMERAS = ("front", "side")
SIZE_PX = (1280, 720)
RATE_HZ = 16_000
SAMPLE_EVERY_S = 5.0
WARM_UP_S = 20.0


@dataclass
class Usage:
    """Usage of the recorder process: CPU seconds in and outside its encoder threads, and resident bytes."""

    process: psutil.Process
    resident: list[tuple[float, int]] = field(default_factory=list)

    def seconds(self) -> tuple[float, float]:
        """CPU seconds of the encoder threads, the only ones with niceness 5, and of all others."""
        encoding = other = 0.0
        for thread in self.process.threads():
            stat = Path(f"/proc/{self.process.pid}/task/{thread.id}/stat")
            try:
                nice = int(stat.read_text().rpartition(")")[2].split()[16])
            except OSError:
                continue
            spent_s = thread.user_time + thread.system_time
            encoding, other = (encoding + spent_s, other) if nice == 5 else (encoding, other + spent_s)
        return encoding, other


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--folder", type=Path, help="where to record; a temporary folder if not given")
    args = parser.parse_args()
    print(json.dumps(run(args.minutes * 60.0, args.folder), indent=1))


def run(seconds: float, parent: Path | None = None) -> dict[str, Any]:
    """Record for that long; returns the results."""
    parent_folder = Path(tempfile.mkdtemp(dir=parent))
    folder = parent_folder / "session"
    rings = {camera: FrameRing.create(SIZE_PX[0] * SIZE_PX[1] * 3) for camera in CAMERAS}
    recorder = RecorderUnderTest(*rings.values())
    try:
        recorder.send(start(folder))
        recorder.wait_for(RecorderReport)
        sent, usage, spent, wall_s = feed(recorder, rings, seconds)
        report = recorder.stop_session()
    finally:
        recorder.close()
        for ring in rings.values():
            ring.close()
    found = mcap_counts(folder)
    sounds = json.loads((folder / "session.json").read_text())["audio"]
    videos = json.loads((folder / "session.json").read_text())["videos"]
    frames = dict.fromkeys(CAMERAS, 0)
    for video in videos:
        with (folder / video["index_file"]).open() as file:
            frames[video["camera"]] += sum(1 for _ in csv.reader(file)) - 1
    settled = [count for at_s, count in usage.resident if at_s >= min(WARM_UP_S, seconds / 3)]
    share = max(1, len(settled) // 4)
    figures = {
        "seconds": round(wall_s, 1),
        "values_sent": sum(sent.values()) - sent["frame"] - sent["audio_chunk"],
        "values_lost": {name: sent[name] - found[f"/{name}"] for name in sent if name not in ("frame", "audio_chunk")},
        "frames_sent": sent["frame"],
        "frames_recorded": frames,
        "frames_dropped_told": report.dropped.get("frame", 0),
        "frames_unaccounted": sent["frame"] - sum(frames.values()) - report.dropped.get("frame", 0),
        "dropped": report.dropped,
        "sound_off_by_samples": [
            round((sound["last_stamp_ns"] - sound["first_stamp_ns"]) * sound["sample_rate_hz"] / 1e9)
            - sent["audio_chunk"] * RATE_HZ // 20
            for sound in sounds
        ],
        "encoders": sorted({video["encoder"] for video in videos}),
        "cpu_encoding_percent": round(100 * spent[0] / wall_s, 1),
        "cpu_beyond_encoding_percent": round(100 * spent[1] / wall_s, 1),
        "resident_mb": round(settled[0] / 1e6, 1),
        # Frames queued for their encoder vary: the median counts.
        "resident_growth_mb": round((median(settled[-share:]) - median(settled[:share])) / 1e6, 1),
        "bytes_per_hour_mb": {
            path.name: round(path.stat().st_size / wall_s * 3600 / 1e6)
            for path in sorted(folder.iterdir())
            if path.is_file()
        },
    }
    shutil.rmtree(parent_folder)
    return figures


def feed(
    recorder: RecorderUnderTest, rings: dict[str, FrameRing], seconds: float
) -> tuple[Counter[str], Usage, tuple[float, float], float]:
    """Send everything at its rate. Returns the number of sent values by stream, and their cost for the recorder."""
    assert recorder.process.pid is not None
    pictures = moving_pictures(*SIZE_PX)
    tone = (np.sin(np.arange(RATE_HZ) * 2 * np.pi * 440 / RATE_HZ) * 8000).astype(np.int16)[:, None]
    noise = np.random.default_rng(2).normal(0.0, 0.01, (40, 720))
    scans = [(scan().ranges_m + row).astype(np.float32) for row in noise]
    numbers: Counter[str] = Counter()
    sound_ns = clock.now_ns()

    def number(kind: str) -> int:
        numbers[kind] += 1
        return numbers[kind]

    def frame(camera: str) -> Any:
        image_bgr = pictures[number(camera) % len(pictures)]
        return rings[camera].write(image_bgr, stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera=camera)

    def sound() -> AudioChunk:
        at = (number("sound") - 1) * RATE_HZ // 20
        stamp_ns = sound_ns + at * 1_000_000_000 // RATE_HZ
        return AudioChunk(stamp_ns, "microphone", RATE_HZ, tone[at % RATE_HZ :][: RATE_HZ // 20])

    def people(camera: str) -> People:
        boxes = tuple(
            PersonBox(index, f"p-{index}", 10.5 * index + numbers[camera] % 100, 80.25, 60.5, 200.125, 0.875)
            for index in range(10)
        )
        return People(clock.now_ns(), camera, numbers[camera], *SIZE_PX, boxes, 23.5)

    sources: list[tuple[float, Callable[[], Any]]] = [
        *((1 / 30, lambda camera=camera: frame(camera)) for camera in CAMERAS),
        *((1 / 10, lambda camera=camera: people(camera)) for camera in CAMERAS),
        (1 / 20, lambda: replace(scan(), ranges_m=scans[number("scan") % len(scans)])),
        (1 / 20, lambda: pose(number("pose") / 100)),
        (1 / 20, lambda: Odometry(clock.now_ns(), 1, Pose2D(number("odom") / 100, 2.0, 0.1), Twist2D(0.3, 0.0, 0.1))),
        (1 / 20, lambda: command(number("command"))),
        (1 / 20, sound),
        (1.0, lambda: mark(str(number("mark")))),
    ]
    sent: Counter[str] = Counter()
    usage = Usage(psutil.Process(recorder.process.pid))
    before, begun_s = usage.seconds(), time.monotonic()
    due_s = [begun_s] * len(sources)
    sample_s = begun_s
    while (now_s := time.monotonic()) - begun_s < seconds:
        for index, (period_s, make) in enumerate(sources):
            if now_s >= due_s[index]:
                due_s[index] += period_s
                value = make()
                sent[BY_TYPE[type(value)].name] += 1
                recorder.send(value)
        if now_s >= sample_s:
            sample_s += SAMPLE_EVERY_S
            usage.resident.append((now_s - begun_s, usage.process.memory_info().rss))
        recorder.drain()
        recorder.heard.clear()
        time.sleep(max(0.0, min(due_s) - time.monotonic()))
    after = usage.seconds()
    return sent, usage, (after[0] - before[0], after[1] - before[1]), time.monotonic() - begun_s


if __name__ == "__main__":
    sys.exit(main())
