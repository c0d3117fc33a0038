"""Video and audio files of a session: names, WAV headers, frame indexes, and the repair of interrupted ones."""

import logging
import math
import os
import re
import struct
from bisect import bisect_left
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.free_names import free_name
from caris_desktop.domain.media_checks import FILM_OPTIONS
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session.session_header import SessionClock, VideoInfo

_NAME = re.compile(r"(?P<first>.*?)(-\d+)?\.mp4")


def video_file_name(camera: str, taken: set[str]) -> str:
    """``video-CAMERA.mp4``, sanitised and not in ``taken``."""
    return free_name(f"video-{in_file_names(camera) or 'camera'}", ".mp4", taken.__contains__)


def audio_file_name(source: str, taken: set[str]) -> str:
    """``audio-SOURCE.wav``, sanitised and not in ``taken``."""
    return free_name(f"audio-{in_file_names(source) or 'sound'}", ".wav", taken.__contains__)


def camera_of_video(file_name: str, cameras: Iterable[str]) -> str:
    """Camera of a video: one of ``cameras``, or from the file name. Further files of a camera have a number after the
    name.
    """
    of_name = {video_file_name(camera, set()): camera for camera in cameras}
    match = _NAME.fullmatch(file_name)
    first = file_name if match is None else f"{match['first']}.mp4"
    plain = first.removesuffix(".mp4").removeprefix("video-")
    return of_name.get(file_name) or of_name.get(first) or plain


def in_file_names(text: str) -> str:
    """Text as part of a file name; empty if no character is allowed."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", text).strip("-")[:40]


# Headers of WAV files with 16-bit samples, also of those that grow or were never completed.

_HEADER = struct.Struct("<4sI4s4sIHHIIHH4sI")
HEADER_BYTES = _HEADER.size
_READ_SAMPLES = 1 << 20


class WavLayout(Value):
    """Format of a WAV file, and where its samples begin. ``data_bytes`` is what the header says of their length;
    ``samples`` counts those of one channel.
    """

    channels: int
    sample_rate_hz: int
    frame_bytes: int
    offset_bytes: int
    data_bytes: int

    @property
    def samples(self) -> int:
        return self.data_bytes // self.frame_bytes


def wav_layout(file: IO[bytes]) -> WavLayout:
    """Read the header of ``file``. Raises OSError, and ValueError if it is no WAV with 16-bit samples."""
    file.seek(0)
    head = file.read(12)
    if head[:4] != b"RIFF" or head[8:] != b"WAVE":
        raise ValueError(QT_TR_NOOP("it does not have a WAV header"))
    channels = rate_hz = frame_bytes = 0
    while len(chunk := file.read(8)) == 8:
        name, length = chunk[:4], int.from_bytes(chunk[4:], "little")
        if name == b"data" and channels and rate_hz and frame_bytes == 2 * channels:
            return WavLayout(channels, rate_hz, frame_bytes, file.tell(), length)
        if name == b"fmt " and length >= 16:
            _, channels, rate_hz, _, frame_bytes, _ = struct.unpack("<HHIIHH", file.read(16))
            length -= 16
        file.seek(length + length % 2, 1)
    raise ValueError(QT_TR_NOOP("it contains no audio"))


def wav_header(channels: int, sample_rate_hz: int, samples: int) -> bytes:
    """Header of a file with ``samples`` of each channel."""
    frame_bytes = 2 * channels
    data_bytes = samples * frame_bytes
    return _HEADER.pack(
        b"RIFF", HEADER_BYTES - 8 + data_bytes, b"WAVE", b"fmt ", 16, 1, channels, sample_rate_hz,
        sample_rate_hz * frame_bytes, frame_bytes, 16, b"data", data_bytes,
    )  # fmt: skip


class WavReader:
    """Samples of a 16-bit PCM WAV file, even if its header was never completed."""

    def __init__(self, path: Path) -> None:
        """Open the file. Raises OSError, and ValueError for another format."""
        self._file = path.open("rb")
        try:
            wav, size_bytes = wav_layout(self._file), path.stat().st_size
            self.channels, self.sample_rate_hz, self.offset_bytes = wav.channels, wav.sample_rate_hz, wav.offset_bytes
            # A killed recording leaves a zero or too large length.
            self.samples = min(wav.data_bytes or size_bytes, size_bytes - wav.offset_bytes) // (2 * wav.channels)
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> "WavReader":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def read(self, first: int, count: int) -> Iterator[tuple[int, NDArray[np.float32]]]:
        """Yield (index, float32 in -1..1) of the loudest channel in pieces: ``count`` samples from ``first`` on."""
        for content in self.read_bytes(first, count):
            block = np.frombuffer(content, "<i2").reshape(-1, self.channels)
            loudest = block[:, 0]
            if self.channels > 1:
                loudest = block[np.arange(len(block)), np.abs(block.astype(np.int32)).argmax(axis=1)]
            yield first, loudest.astype(np.float32) / np.float32(32768)
            first += len(block)

    def read_bytes(self, first: int, count: int) -> Iterator[bytes]:
        """Yield the raw samples of all channels in pieces."""
        end = min(first + count, self.samples)
        frame_bytes = 2 * self.channels
        while first < end:
            self._file.seek(self.offset_bytes + first * frame_bytes)
            content = self._file.read(min(end - first, _READ_SAMPLES) * frame_bytes)
            frames = len(content) // frame_bytes
            if not frames:
                return
            yield content[: frames * frame_bytes]
            first += frames


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

    Raises OSError if the file cannot be read. Raises ValueError if it is no side index.
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


def frame_times_of(video: Path) -> FrameTimes:
    """Frame times of a video; none if its index is missing or cannot be read."""
    try:
        return read_frame_times(index_path(video))
    except (OSError, ValueError) as error:
        _log.info("%s: %s", video, error)
        return FrameTimes.none()


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


_log = logging.getLogger(__name__)
_LARGEST_WAV = 2**32 - 1
# Video times are rounded down to 1/90000 s, and frames of equal stamps are this far apart.
_SAME_FRAME_NS = 25_000


class VideoContent(Value):
    """Complete frames of a video file; ``times_s`` ascending."""

    times_s: tuple[float, ...]
    width_px: int
    height_px: int


def repair_wav(path: Path) -> tuple[WavLayout, bool]:
    """Correct the length in a WAV header; return what it says then, and whether that is new.

    Raises OSError if the file cannot be read or written. Raises ValueError if it is no WAV that can be understood.
    """
    with path.open("r+b") as file:
        wav = wav_layout(file)
        size_bytes = file.seek(0, os.SEEK_END)
        true_length = (size_bytes - wav.offset_bytes) // wav.frame_bytes * wav.frame_bytes
        riff_length = min(wav.offset_bytes - 8 + true_length, _LARGEST_WAV)
        true_length = min(true_length, riff_length - wav.offset_bytes + 8)
        file.seek(4)
        if wav.data_bytes == true_length and int.from_bytes(file.read(4), "little") == riff_length:
            return wav, False
        for at, length in ((4, riff_length), (wav.offset_bytes - 4, true_length)):
            file.seek(at)
            file.write(length.to_bytes(4, "little"))
        file.flush()
        os.fsync(file.fileno())
        return replace(wav, data_bytes=true_length), True


def whole_bytes(path: Path) -> int:
    """End of the last complete fragment of a growing mp4, or its size if finished. Raises OSError."""
    at, good, fragmented = 0, 0, False
    with path.open("rb") as file:
        size_bytes = file.seek(0, os.SEEK_END)
        while at + 8 <= size_bytes:
            file.seek(at)
            head = file.read(16)
            length, kind = int.from_bytes(head[:4], "big"), head[4:8]
            if length == 1:
                length = int.from_bytes(head[8:], "big")
            if length < 8 or at + length > size_bytes:
                break
            # A moof describes the following mdat and is useless without it.
            if kind == b"moof":
                fragmented = True
            else:
                good = at + length
            at += length
    return good if fragmented else size_bytes


def content_of(path: Path) -> VideoContent | None:
    """Complete frames of a video; None if unreadable."""
    import av

    try:
        size_bytes = path.stat().st_size
        with av.open(str(path), options=FILM_OPTIONS) as container:
            stream = container.streams.video[0]
            tick_s = float(stream.time_base)
            times_s = []
            for entry in stream.index_entries:
                if entry.pos + entry.size > size_bytes:
                    break
                times_s.append(entry.timestamp * tick_s)
            return VideoContent(tuple(times_s), stream.width, stream.height)
    except (av.error.FFmpegError, OSError, IndexError) as error:
        _log.info("%s cannot be read: %s", path, error)
        return None


def index_lines(video: Path, content: VideoContent, recorded: list[FrameRef], clock: SessionClock) -> bytes | None:
    """Frame index that matches the frames of a video; None if the present one does.

    ``recorded`` are the camera's frames in the log, by stamp. Present lines are preserved; frames without one get
    theirs from the log.
    """
    path = index_path(video)
    try:
        lines = path.read_bytes().split(b"\n")
        times = read_frame_times(path)
    except (OSError, ValueError):
        lines, times = [], FrameTimes.none()
    if lines and times.count == len(content.times_s) and len(lines) == times.count + 2 and not lines[-1]:
        return None
    retained = min(times.count, len(content.times_s))
    head = lines[0] if retained else INDEX_HEAD.rstrip("\n").encode()
    rows = [*lines[1 : retained + 1]]
    if retained < len(content.times_s):
        rows += _missing_lines(content, retained, times, recorded, clock, columns=head.count(b",") + 1)
    return b"\n".join([head, *rows, b""])


def _missing_lines(
    content: VideoContent,
    retained: int,
    times: FrameTimes,
    recorded: list[FrameRef],
    clock: SessionClock,
    *,
    columns: int,
) -> list[bytes]:
    of_size = [
        ref
        for ref in recorded
        if (ref.width_px // 2 * 2, ref.height_px // 2 * 2) == (content.width_px, content.height_px)
    ] or recorded
    if retained:
        zero_ns = int(times.shown_ns[0]) - round(float(times.video_s[0]) * 1e9)
    else:
        zero_ns = of_size[0].shown_ns if of_size else clock.started_ns
    of_size = sorted(of_size, key=lambda ref: ref.shown_ns)
    moments_ns = [ref.shown_ns for ref in of_size]
    rows = []
    for number in range(retained, len(content.times_s)):
        video_s = content.times_s[number]
        at_ns = zero_ns + round(video_s * 1e9)
        at = bisect_left(moments_ns, at_ns - _SAME_FRAME_NS)
        if at < len(of_size) and abs(moments_ns[at] - at_ns) <= _SAME_FRAME_NS:
            cells = index_cells(of_size[at], video_s, clock)
        else:
            cells = f"{video_s:.6f},{at_ns},,{clock.utc(at_ns)},,,,"
        rows.append(",".join(f"{number},{cells}".split(",")[:columns]).encode())
    return rows
