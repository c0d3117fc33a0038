"""Recording of a few seconds with all streams, for a trace of the system calls."""

import sys
import time
from pathlib import Path

import numpy as np

from caris_desktop.domain import clock
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.recording.recorder.recorder_messages import RecorderReport, TakePhoto
from tests.recording.driving import RecorderUnderTest, command, mark, picture, pose, scan, start

SECONDS = 3.0


def main(folder: Path) -> None:
    ring = FrameRing.create(640 * 480 * 3)
    recorder = RecorderUnderTest(ring)
    recorder.send(start(folder))
    recorder.wait_for(RecorderReport, timeout_s=60.0)
    begun_s, number = time.monotonic(), 0
    while time.monotonic() - begun_s < SECONDS:
        number += 1
        ref = ring.write(picture(number), stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera="front")
        recorder.send(ref, mark(str(number)), pose(number), command(number, number % 2), scan())
        recorder.send(AudioChunk(clock.now_ns(), "microphone", 16_000, np.ones((800, 1), np.int16)))
        recorder.send(UtteranceChanged(clock.now_ns(), str(number), "robot", "Hello", "typed", "started"))
        if number == 20:
            recorder.send(TakePhoto(ref, folder / "elsewhere.png"))
        recorder.drain()
        time.sleep(0.05)
    recorder.stop_session()
    recorder.close()
    ring.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
