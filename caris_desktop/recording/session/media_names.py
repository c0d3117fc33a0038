"""File names of a session's video and audio, and the camera of a video by its name."""

import re
from collections.abc import Callable, Iterable

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
