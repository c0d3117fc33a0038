"""The side index of a video: when each of its frames was taken, one line each, as the recorder writes it."""

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

INDEX_SUFFIX = ".frames.csv"
NO_ROBOT_STAMP = -1
_MAX_INDEX_BYTES = 1 << 30


@dataclass(frozen=True, slots=True, eq=False)
class FrameTimes:
    """One entry for each frame. ``robot_stamps_ns`` is NO_ROBOT_STAMP where the robot sent none."""

    video_s: NDArray[np.float64]
    stamps_ns: NDArray[np.int64]
    robot_stamps_ns: NDArray[np.int64]

    @property
    def count(self) -> int:
        return len(self.stamps_ns)

    def first(self, count: int) -> "FrameTimes":
        """Those of the first ``count`` frames."""
        return FrameTimes(*(getattr(self, field.name)[:count] for field in fields(self)))

    @classmethod
    def none(cls) -> "FrameTimes":
        return cls(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64))


def index_path(video: Path) -> Path:
    """Where the side index of ``video`` lies."""
    return video.with_suffix(INDEX_SUFFIX)


def read_frame_times(path: Path) -> FrameTimes:
    """The whole lines of a side index, up to the first that is none.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is no side index.
    """
    with path.open("rb") as file:
        content = file.read(_MAX_INDEX_BYTES)
    head, _, rest = content.partition(b"\n")
    columns = head.decode("utf-8", "replace").strip().split(",")
    try:
        at = [columns.index(name) for name in ("frame", "video_s", "stamp_ns", "robot_stamp_ns")]
    except ValueError as error:
        raise ValueError(f"{path.name} has not the columns of a video's index: {', '.join(columns)[:200]}") from error
    lines = rest.split(b"\n")[:-1]  # what follows the last line end is empty, or a line cut off
    number_at, video_at, stamp_at, robot_at = at
    video_s = np.zeros(len(lines))
    stamps_ns, robot_stamps_ns = np.zeros(len(lines), np.int64), np.full(len(lines), NO_ROBOT_STAMP, np.int64)
    whole = 0
    try:
        for number, line in enumerate(lines):
            cells = line.split(b",")
            if int(cells[number_at]) != number:
                break
            video_s[number] = float(cells[video_at])
            stamps_ns[number] = int(cells[stamp_at])
            if cells[robot_at].strip():
                robot_stamps_ns[number] = int(cells[robot_at])
            whole = number + 1
    except (ValueError, IndexError, OverflowError):
        pass  # zeros after a power cut, or somebody's edit: the lines before it are good
    return FrameTimes(video_s[:whole], stamps_ns[:whole], robot_stamps_ns[:whole])
