"""Recording into a read-only folder, then into a writable one; prints the recorder's messages."""

import json
import sys
from pathlib import Path

from caris_desktop.domain.events import Problem
from caris_desktop.recording.recorder.recorder_messages import RecorderReport
from tests.recording.driving import RecorderUnderTest, mark, start


def main(read_only: Path, good: Path) -> None:
    recorder = RecorderUnderTest()
    recorder.send(start(read_only), mark("nowhere to write this"))
    problem = recorder.wait_for(Problem)
    recorder.wait_for(RecorderReport, state="failed")
    recorder.send(start(good), mark("here"))
    recorder.stop_session()
    recorder.close()
    print(json.dumps({"problem": problem.what}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
