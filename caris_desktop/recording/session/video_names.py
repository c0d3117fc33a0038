"""Which camera a video belongs to, where only its file name tells."""

import re
from collections.abc import Iterable

from caris_desktop.recording.recorder.video_file import video_file_name

_NAME = re.compile(r"(?P<first>.*?)(-\d+)?\.mp4")


def camera_of_video(file_name: str, cameras: Iterable[str]) -> str:
    """One of ``cameras``, or what the file is named after. A camera's second file has a number behind its name."""
    of_name = {video_file_name(camera, set()): camera for camera in cameras}
    match = _NAME.fullmatch(file_name)
    first = file_name if match is None else f"{match['first']}.mp4"
    plain = first.removesuffix(".mp4").removeprefix("video-")
    return of_name.get(file_name) or of_name.get(first) or plain
