"""What the video and sound files of a session are called, and which camera a video belongs to by its name."""

import re
from collections.abc import Iterable

_NAME = re.compile(r"(?P<first>.*?)(-\d+)?\.mp4")


def video_file_name(camera: str, taken: set[str]) -> str:
    """``video-CAMERA.mp4`` with nothing in the name that could leave the folder, and not yet ``taken``."""
    return _free_name(f"video-{in_file_names(camera) or 'camera'}", ".mp4", taken)


def audio_file_name(source: str, taken: set[str]) -> str:
    """``audio-SOURCE.wav`` with nothing in the name that could leave the folder, and not yet ``taken``."""
    return _free_name(f"audio-{in_file_names(source) or 'sound'}", ".wav", taken)


def camera_of_video(file_name: str, cameras: Iterable[str]) -> str:
    """One of ``cameras``, or what the file is named after. A camera's second file has a number behind its name."""
    of_name = {video_file_name(camera, set()): camera for camera in cameras}
    match = _NAME.fullmatch(file_name)
    first = file_name if match is None else f"{match['first']}.mp4"
    plain = first.removesuffix(".mp4").removeprefix("video-")
    return of_name.get(file_name) or of_name.get(first) or plain


def in_file_names(text: str) -> str:
    """A name as a part of a file's name; empty where nothing of it can be one."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", text).strip("-")[:40]


def _free_name(stem: str, suffix: str, taken: set[str]) -> str:
    name, number = f"{stem}{suffix}", 2
    while name in taken:
        name, number = f"{stem}-{number}{suffix}", number + 1
    return name
