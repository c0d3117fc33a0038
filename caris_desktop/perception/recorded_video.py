"""Reader of recorded video frames in sequence, on demand."""

import contextlib
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.media_checks import FILM_OPTIONS

log = logging.getLogger(__name__)

_USUAL_FPS = 25.0
# FFmpeg would render a text file as images of its characters.
_LETTERS = ("ansi", "bintext", "xbin", "idf")
_TORN_AT_MOST = 50
"""In a row: so many are a file that is of no use."""


class VideoFileError(Exception):
    """File that cannot be read as a video. The message is for the wizard."""


class VideoFile(contextlib.AbstractContextManager["VideoFile"]):
    """Video file with frames in order. Use it in a ``with``.

    ``pictures_about`` is the declared number of frames, 0 if unknown. ``torn`` counts undecodable frames so far, which
    are skipped.

    Raises
    ------
    VideoFileError
        When it cannot be opened or has no video.
    """

    def __init__(self, path: Path) -> None:
        import av

        self._errors: tuple[type[Exception], ...] = (av.FFmpegError, OSError, ValueError)
        self._path = path
        self.torn = 0
        if not path.exists():
            raise VideoFileError(f"The video {path} does not exist.")
        if not path.is_file():
            raise VideoFileError(f"{path} is not a file.")
        try:
            self._container = av.open(str(path), options=FILM_OPTIONS)
        except self._errors as error:
            log.info("could not open %s", path, exc_info=True)
            raise VideoFileError(f"{path.name} cannot be read as a video.") from error
        videos = [stream for stream in self._container.streams.video if stream.codec_context.name not in _LETTERS]
        if not videos:
            self._container.close()
            raise VideoFileError(f"{path.name} contains no video.")
        self._stream: Any = videos[0]
        self._stream.thread_type = "AUTO"
        self.fps = float(self._stream.average_rate or _USUAL_FPS)
        self.pictures_about = int(self._stream.frames or (self._container.duration or 0) / 1e6 * self.fps)

    def __exit__(self, *_error: object) -> None:
        self._container.close()

    def pictures(self) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        """Seconds since the first frame, non-decreasing, and uint8 BGR, shape (height, width, 3).

        Raises
        ------
        VideoFileError
            When there is no picture in it, or nothing but torn ones from some place on.
        """
        first_s: float | None = None
        stamp_s, count = -1.0 / self.fps, 0
        for frame in self._frames():
            stamp_s, before_s = stamp_s + 1.0 / self.fps, stamp_s
            if frame.time is not None:
                first_s = frame.time if first_s is None else first_s
                stamp_s = max(before_s, frame.time - first_s)
            count += 1
            image_bgr = frame.to_ndarray(format="bgr24")
            # As the file says, for an upright phone: counterclockwise, in degrees.
            yield stamp_s, np.ascontiguousarray(np.rot90(image_bgr, round(frame.rotation / 90)), np.uint8)
        if not count:
            raise VideoFileError(f"{self._path.name} contains no frames.")

    def _frames(self) -> Iterator[Any]:
        in_a_row = 0
        decoded = iter(self._container.decode(self._stream))
        while True:
            try:
                frame = next(decoded, None)
            except self._errors as error:
                self.torn, in_a_row = self.torn + 1, in_a_row + 1
                if in_a_row > _TORN_AT_MOST:
                    raise VideoFileError(f"{self._path.name} is damaged or truncated.") from error
                decoded = iter(self._container.decode(self._stream))
                continue
            if frame is None:
                return
            in_a_row = 0
            yield frame
