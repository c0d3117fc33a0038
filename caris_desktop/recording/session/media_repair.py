"""Repair of audio and video files of an interrupted recording: headers and indexes that match the content."""

import logging
import os
from bisect import bisect_left
from dataclasses import replace
from pathlib import Path

from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.value_class import Value
from caris_desktop.domain.video_files import FILM_OPTIONS
from caris_desktop.recording.session.frame_times import (
    INDEX_HEAD,
    FrameTimes,
    index_cells,
    index_path,
    read_frame_times,
)
from caris_desktop.recording.session.media_files import wav_layout
from caris_desktop.recording.session.session_clock import SessionClock

_log = logging.getLogger(__name__)
_LARGEST_WAV = 2**32 - 1
# Video times are rounded down to 1/90000 s, and frames of equal stamps are this far apart.
_SAME_FRAME_NS = 25_000


class VideoContent(Value):
    """Complete frames of a video file; ``times_s`` ascending."""

    times_s: tuple[float, ...]
    width_px: int
    height_px: int


class SoundContent(Value):
    """Audio in a WAV file. ``samples`` counts those of one channel."""

    sample_rate_hz: int
    channels: int
    samples: int
    repaired: bool

    @property
    def duration_s(self) -> float:
        return self.samples / max(1, self.sample_rate_hz)


def repair_wav(path: Path) -> SoundContent:
    """Correct the length in a WAV header.

    Raises
    ------
    OSError
        If the file cannot be read or written.
    ValueError
        If it is no WAV that can be understood.
    """
    with path.open("r+b") as file:
        wav = wav_layout(file)
        size_bytes = file.seek(0, os.SEEK_END)
        true_length = (size_bytes - wav.offset_bytes) // wav.frame_bytes * wav.frame_bytes
        riff_length = min(wav.offset_bytes - 8 + true_length, _LARGEST_WAV)
        true_length = min(true_length, riff_length - wav.offset_bytes + 8)
        file.seek(4)
        content = SoundContent(wav.sample_rate_hz, wav.channels, true_length // wav.frame_bytes, repaired=False)
        if wav.data_bytes == true_length and int.from_bytes(file.read(4), "little") == riff_length:
            return content
        for at, length in ((4, riff_length), (wav.offset_bytes - 4, true_length)):
            file.seek(at)
            file.write(length.to_bytes(4, "little"))
        file.flush()
        os.fsync(file.fileno())
        return replace(content, repaired=True)


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
    of_size = [ref for ref in recorded if _even_size(ref) == (content.width_px, content.height_px)] or recorded
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


def _even_size(ref: FrameRef) -> tuple[int, int]:
    return ref.width_px // 2 * 2, ref.height_px // 2 * 2
