"""Recording console to be killed: prints ``recording``, then the number of each sent mark."""

import itertools
import sys
import time
from pathlib import Path

from caris_desktop.domain import clock
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.recording.recorder.recorder_messages import RecorderReport
from tests.recording.driving import RecorderUnderTest, mark, picture, start


def main(folder: Path) -> None:
    ring = FrameRing.create(640 * 480 * 3)
    recorder = RecorderUnderTest(ring)
    recorder.send(start(folder))
    recorder.wait_for(RecorderReport)
    print("recording", flush=True)
    for number in itertools.count():
        recorder.send(mark(str(number)))
        if number % 10 == 0:
            recorder.send(ring.write(picture(number), stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera="front"))
        if number == 100:
            print(number, flush=True)
        time.sleep(0.005)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
