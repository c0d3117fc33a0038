"""Pictures of a session's videos, taken in the order of time: what exports need of them."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from caris_desktop.recording.session_reader import Session

_log = logging.getLogger(__name__)
# Neighbouring frames of the fastest cameras are 4 ms apart; a video rounds its times to 11 µs.
_SAME_FRAME_NS = 1_500_000
# Decoding on is cheaper than jumping to a key frame, which comes every 0.4 s, up to about this far.
_JUMP_NS = 2_000_000_000


@dataclass(frozen=True, slots=True)
class VideoStretch:
    """One video file of a session; time 0 of it is ``first_stamp_ns`` of the session clock."""

    path: Path
    camera: str
    first_stamp_ns: int
    last_stamp_ns: int


def videos_of(session: Session) -> tuple[VideoStretch, ...]:
    """The videos that ``session.json`` names and that are there, in the order of time. No path leaves the folder."""
    found = []
    told = session.header.get("videos")
    for entry in told if isinstance(told, list) else ():
        try:
            name, camera = str(entry["file_name"]), str(entry["camera"])
            first_ns, last_ns = int(entry["first_stamp_ns"]), int(entry["last_stamp_ns"])
        except (KeyError, TypeError, ValueError):
            _log.warning("%s names a video in a way that cannot be read: %r", session.folder, entry)
            continue
        path = session.folder / name
        if Path(name).name == name and path.is_file():
            found.append(VideoStretch(path, camera, first_ns, last_ns))
    return tuple(sorted(found, key=lambda stretch: (stretch.first_stamp_ns, stretch.path.name)))


class VideoFrames:
    """Gives the pictures of moments that follow one another; a context manager. One picture per camera is held."""

    def __init__(self, session: Session) -> None:
        self._stretches = videos_of(session)
        self._open: dict[str, _OpenVideo] = {}

    @property
    def cameras(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(stretch.camera for stretch in self._stretches))

    def at(self, camera: str, stamp_ns: int) -> NDArray[np.uint8] | None:
        """The frame of ``camera`` stamped ``stamp_ns``: uint8 BGR, shape (height, width, 3).

        None where the video lacks it, or where an earlier call asked for a later one.
        """
        stretch = self._stretch(camera, stamp_ns)
        if stretch is None:
            return None
        video = self._open.get(camera)
        if video is None or video.path != stretch.path:
            if video is not None:
                video.close()
            video = self._open[camera] = _OpenVideo(stretch)
        return video.at(stamp_ns)

    def close(self) -> None:
        for video in self._open.values():
            video.close()
        self._open.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _stretch(self, camera: str, stamp_ns: int) -> VideoStretch | None:
        for stretch in self._stretches:
            begins_ns, ends_ns = stretch.first_stamp_ns - _SAME_FRAME_NS, stretch.last_stamp_ns + _SAME_FRAME_NS
            if stretch.camera == camera and begins_ns <= stamp_ns <= ends_ns:
                return stretch
        return None


class _OpenVideo:
    """One file, decoded forward."""

    def __init__(self, stretch: VideoStretch) -> None:
        self.path = stretch.path
        self._first_ns = stretch.first_stamp_ns
        self._container: Any = None
        self._frames: Iterator[Any] = iter(())
        self._at: tuple[int, Any] | None = None
        self._ended = False
        import av

        self._errors: tuple[type[Exception], ...] = (av.error.FFmpegError, OSError, ValueError, IndexError)
        try:
            self._container = av.open(str(stretch.path))
            self._stream = self._container.streams.video[0]
            self._frames = self._container.decode(self._stream)
        except self._errors as error:
            _log.warning("%s cannot be read: %s", self.path, error)
            self._ended = True

    def at(self, stamp_ns: int) -> NDArray[np.uint8] | None:
        try:
            self._go_to(stamp_ns)
        except self._errors as error:
            _log.warning("%s breaks off: %s", self.path, error)
            self._ended = True
        if self._at is None or abs(self._at[0] - stamp_ns) > _SAME_FRAME_NS:
            return None
        image_bgr: NDArray[np.uint8] = self._at[1].to_ndarray(format="bgr24")
        return image_bgr

    def close(self) -> None:
        if self._container is not None:
            self._container.close()

    def _go_to(self, stamp_ns: int) -> None:
        if self._ended:
            return
        at_ns = self._first_ns if self._at is None else self._at[0]
        if stamp_ns - at_ns > _JUMP_NS:
            ticks = round((stamp_ns - self._first_ns - _JUMP_NS // 2) / 1e9 / float(self._stream.time_base))
            self._container.seek(ticks, stream=self._stream)
            self._frames = self._container.decode(self._stream)
        while self._at is None or self._at[0] < stamp_ns - _SAME_FRAME_NS:
            frame = next(self._frames, None)
            if frame is None:
                self._ended = True
                return
            if frame.pts is not None:
                self._at = self._first_ns + round(frame.pts * frame.time_base * 1_000_000_000), frame
