"""File names of a session's video and audio, and the camera of a video by its name."""

import re
import struct
from collections.abc import Callable, Iterable
from typing import IO

from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value

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


def free_name(stem: str, suffix: str, is_taken: Callable[[str], bool]) -> str:
    """``STEMSUFFIX``, or numbered from 2 if that is taken."""
    name, number = f"{stem}{suffix}", 2
    while is_taken(name):
        name, number = f"{stem}-{number}{suffix}", number + 1
    return name


# Headers of WAV files with 16-bit samples, also of those that grow or were never completed.

_HEADER = struct.Struct("<4sI4s4sIHHIIHH4sI")
HEADER_BYTES = _HEADER.size


class WavLayout(Value):
    """Format of a WAV file, and where its samples begin. ``data_bytes`` is what the header says of their length."""

    channels: int
    sample_rate_hz: int
    frame_bytes: int
    offset_bytes: int
    data_bytes: int


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
