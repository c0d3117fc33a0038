"""Camera from video files and network streams, through PyAV."""

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.media_checks import FILM_OPTIONS, PictureError, check_size, fitting_size
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.perception.cameras.camera_source import (
    OPEN_TIMEOUT_S,
    SILENCE_S,
    CameraError,
    ChosenCamera,
    Picture,
    cannot_be_reached,
)

# A few broken frames are a network problem; this many mean an unusable file or camera.
_BROKEN_AT_MOST = 50
# The user has confirmed this address, and no other that its server may redirect to.
_LIVE_OPTIONS = {"rtsp_transport": "tcp", "fflags": "nobuffer", "flags": "low_delay", "max_redirects": "0"}


class StreamCamera:
    """Video files and network streams. Sources with a duration play at their own rate."""

    def __init__(self, chosen: ChosenCamera) -> None:
        import av

        self._errors: tuple[type[Exception], ...] = (av.FFmpegError, OSError)
        self._torn: type[Exception] = av.error.InvalidDataError
        self._chosen = chosen
        live = not chosen.recorded
        options = _LIVE_OPTIONS if live else FILM_OPTIONS
        # A file may be called file:../other.mp4, which ffmpeg would take for the other.
        address = chosen.target if live else f"file:{chosen.target}"
        try:
            self._container = av.open(address, options=options, timeout=(OPEN_TIMEOUT_S, SILENCE_S) if live else None)
        except self._errors as error:
            raise self._cannot_open() from error
        if not self._container.streams.video:
            self._container.close()
            raise self._cannot_open()
        self._stream = self._container.streams.video[0]
        self._recorded = chosen.recorded or self._container.duration is not None
        # Frame threading is faster, but delays as many frames as threads.
        self._stream.thread_type = "AUTO" if self._recorded else "SLICE"
        self.width_px, self.height_px = fitting_size(self._stream.width, self._stream.height)
        self.fps = float(self._stream.average_rate) if self._stream.average_rate else None
        self._frames: Iterator[Any] = iter(self._container.decode(self._stream))
        self._quarter_turns = 0
        if self._recorded:
            self._turn_as_commanded()
        self._first_pts_s: float | None = None
        self._last_due_s = 0.0
        self._round_began_s = 0.0
        self._pictures_in_round = 0
        self._broken = 0

    def read(self) -> Picture | None:
        try:
            frame = next(self._frames, None)
            if frame is None and self._chosen.loop and self._pictures_in_round:
                self._container.seek(0)
                self._frames = iter(self._container.decode(self._stream))
                self._round_began_s = self._last_due_s + 1.0 / (self.fps or 25.0)
                self._pictures_in_round = 0
                frame = next(self._frames, None)
        except self._errors as error:
            self._broken += 1
            if isinstance(error, self._torn) and self._broken <= _BROKEN_AT_MOST:
                self._frames = iter(self._container.decode(self._stream))
                raise PictureError("is damaged") from error
            raise CameraError(
                localized(QT_TR_NOOP("The video {name} was interrupted."), name=self._chosen.name),
                QT_TR_NOOP("Check the file, or the camera's network connection."),
            ) from error
        if frame is None:
            if self._recorded and self._pictures_in_round:
                return None
            raise CameraError(
                localized(
                    QT_TR_NOOP("The video {name} has no frames or stopped delivering them."), name=self._chosen.name
                ),
                QT_TR_NOOP("Check the file, or the camera's network connection."),
            )
        self._pictures_in_round += 1
        self._broken = 0
        image_bgr = bgr_of(frame)
        if self._quarter_turns:
            image_bgr = np.ascontiguousarray(np.rot90(image_bgr, self._quarter_turns))
        return Picture(image_bgr, self._due_s(frame) if self._recorded else None)

    def _turn_as_commanded(self) -> None:
        """Apply the rotation of the video's metadata, as of an upright phone: counterclockwise, in degrees."""
        try:
            first = next(self._frames, None)
        except self._errors:
            self._frames = iter(self._container.decode(self._stream))  # reported when it is read
            return
        if first is None:
            return
        self._frames = itertools.chain([first], self._frames)
        self._quarter_turns = round(first.rotation / 90) % 4
        if self._quarter_turns % 2:
            self.width_px, self.height_px = self.height_px, self.width_px

    def close(self) -> None:
        self._container.close()

    def _due_s(self, frame: Any) -> float:
        period_s = 1.0 / (self.fps or 25.0)
        if frame.time is None:
            due_s = self._last_due_s + period_s
        else:
            if self._first_pts_s is None:
                self._first_pts_s = frame.time
            due_s = self._round_began_s + frame.time - self._first_pts_s
        self._last_due_s = max(due_s, self._last_due_s)
        return self._last_due_s

    def _cannot_open(self) -> CameraError:
        if not self._chosen.recorded:
            return cannot_be_reached(self._chosen.name)
        path = Path(self._chosen.target)
        if not path.exists():
            return CameraError(
                localized(QT_TR_NOOP("The video file {path} does not exist."), path=path), QT_TR_NOOP("Check the path.")
            )
        return CameraError(
            localized(QT_TR_NOOP("{path} is not a video file that can be played."), path=path),
            QT_TR_NOOP("Choose another file."),
        )


def bgr_of(frame: Any) -> NDArray[np.uint8]:
    """BGR image of PyAV's frame, scaled to the size limit. Raises PictureError."""
    check_size(frame.width, frame.height)
    width_px, height_px = fitting_size(frame.width, frame.height)
    image_bgr = frame.reformat(width=width_px, height=height_px, format="bgr24").to_ndarray()
    return np.asarray(image_bgr, np.uint8)
