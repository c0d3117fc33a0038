"""Handle on ``tests.support.bag_server``: a recording to connect to like a robot."""

import subprocess
import sys
from pathlib import Path

_READY = "Recording ready at "


class RecordedRobot:
    """Context manager that plays ``bag`` in a separate process."""

    def __init__(self, bag: Path, *, from_s: float = 0.0, pace: float = 1.0) -> None:
        self._process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "tests.support.bag_server",
                str(bag),
                "--from",
                str(from_s),
                "--pace",
                str(pace),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        line = self._process.stdout.readline() if self._process.stdout is not None else ""
        if not line.startswith(_READY):
            self.close()
            raise AssertionError(f"the recording is not served: {line!r}")
        self.address = line.removeprefix(_READY).strip()

    def __enter__(self) -> "RecordedRobot":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()
