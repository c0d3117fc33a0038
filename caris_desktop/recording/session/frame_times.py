"""Frame index of a video: arrival and capture time of each frame, one line each."""

import math
from contextlib import suppress
from dataclasses import fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session.session_clock import SessionClock
from caris_desktop.recording.session.session_header import VideoInfo

INDEX_HEAD = "frame,video_s,stamp_ns,robot_stamp_ns,utc,sequence,taken_ns,taken_utc,uncertainty_ms\n"
INDEX_SUFFIX = ".frames.csv"
NO_ROBOT_STAMP = UNKNOWN = -1
_TAKEN = ("taken_ns", "uncertainty_ms")
_MAX_INDEX_BYTES = 1 << 30


class FrameTimes(Value, eq=False):
    """One entry per frame. ``stamps_ns`` are arrivals; ``robot_stamps_ns`` is NO_ROBOT_STAMP if the robot sent none.
    ``taken_ns`` is the capture time within ``uncertainty_ms``; UNKNOWN and NaN if not known.
    """

    video_s: NDArray[np.float64]
    stamps_ns: NDArray[np.int64]
    robot_stamps_ns: NDArray[np.int64]
    taken_ns: NDArray[np.int64]
    uncertainty_ms: NDArray[np.float64]

    @property
    def delay_ms(self) -> float | None:
        """Median delay from capture to arrival in ms; None if unknown for all frames."""
        known = self.taken_ns != UNKNOWN
        return round(float(np.median((self.stamps_ns - self.taken_ns)[known])) / 1e6, 3) if known.any() else None

    @property
    def worst_uncertainty_ms(self) -> float | None:
        known = np.isfinite(self.uncertainty_ms)
        return float(self.uncertainty_ms[known].max()) if known.any() else None

    @property
    def shown_ns(self) -> NDArray[np.int64]:
        """Times that the video shows: capture, else arrival."""
        return np.where(self.taken_ns == UNKNOWN, self.stamps_ns, self.taken_ns)

    @property
    def count(self) -> int:
        return len(self.stamps_ns)

    def first(self, count: int) -> "FrameTimes":
        """Entries of the first ``count`` frames."""
        return FrameTimes(*(getattr(self, field.name)[:count] for field in fields(self)))

    @classmethod
    def none(cls) -> "FrameTimes":
        stamps = np.zeros(0, np.int64)
        return cls(np.zeros(0), stamps, stamps, stamps, np.zeros(0))


def index_path(video: Path) -> Path:
    """Path of the frame index of ``video``."""
    return video.with_suffix(INDEX_SUFFIX)


def read_frame_times(path: Path) -> FrameTimes:
    """Read a frame index up to the first invalid line.

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
        raise ValueError(
            f"{path.name} does not have the columns of a video index: {', '.join(columns)[:200]}"
        ) from error
    number_at, video_at, stamp_at, robot_at = at
    # Older recordings lack them.
    taken_at, uncertainty_at = (columns.index(name) if name in columns else None for name in _TAKEN)
    rows: list[tuple[float, int, int, int, float]] = []
    with suppress(ValueError, IndexError):  # zeros after a power failure, or an edit: the lines before it are valid
        for number, line in enumerate(rest.split(b"\n")[:-1]):  # after the last line end: empty, or a truncated line
            cells = [cell.strip() for cell in line.split(b",")]
            if int(cells[number_at]) != number:
                break
            row = (
                float(cells[video_at]),
                int(cells[stamp_at]),
                int(cells[robot_at] or NO_ROBOT_STAMP),
                UNKNOWN if taken_at is None else int(cells[taken_at] or UNKNOWN),
                math.nan if uncertainty_at is None else float(cells[uncertainty_at] or math.nan),
            )
            if max(map(abs, row[1:4])) >= 2**63:
                break
            rows.append(row)
    video_s, stamps_ns, robot_stamps_ns, taken_ns, uncertainty_ms = zip(*rows, strict=True) if rows else ((),) * 5
    return FrameTimes(
        np.array(video_s, np.float64),
        np.array(stamps_ns, np.int64),
        np.array(robot_stamps_ns, np.int64),
        np.array(taken_ns, np.int64),
        np.array(uncertainty_ms, np.float64),
    )


def moments_words(video: VideoInfo) -> str:
    """User text on which moments a video shows."""
    if video.delay_ms is None or video.uncertainty_ms is None:
        return "Its frames are shown at their arrival time at the computer; their capture time is unknown."
    return (
        f"Its frames are shown at their capture time, from the robot's timestamps and clock, accurate to "
        f"{video.uncertainty_ms:.1f} ms; they reached the computer {video.delay_ms:.0f} ms later."
    )


def index_cells(ref: FrameRef, video_s: float, clock: SessionClock) -> str:
    """Line of the index without the frame number and the line end."""
    robot_stamp = "" if ref.robot_stamp_ns is None else str(ref.robot_stamp_ns)
    taken = ",,"
    if ref.taken_ns is not None:
        uncertainty = "" if ref.taken_uncertainty_ns is None else f"{ref.taken_uncertainty_ns / 1e6:.3f}"
        taken = f"{ref.taken_ns},{clock.utc(ref.taken_ns)},{uncertainty}"
    return f"{video_s:.6f},{ref.stamp_ns},{robot_stamp},{clock.utc(ref.stamp_ns)},{ref.sequence},{taken}"
