"""Videos and photos, written by a thread of the recorder so that encoding never delays an event."""

import logging
import os
import sys
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.sensing import FrameRef
from caris_desktop.recording.disk_file import no_room, replace_file
from caris_desktop.recording.video_file import VideoFile, video_file_name

_log = logging.getLogger(__name__)
MAX_QUEUED_BYTES = 64 * 1024 * 1024
_ENCODER_NICENESS = 5


@dataclass(frozen=True, slots=True)
class VideoInfo:
    """What ``session.json`` says of one video. Time 0 of the video is ``first_stamp_ns`` of the session clock."""

    file_name: str
    camera: str
    frames: int
    width_px: int
    height_px: int
    first_stamp_ns: int
    last_stamp_ns: int


@dataclass(frozen=True, slots=True)
class PhotoKept:
    ref: FrameRef
    file_name: str


@dataclass(frozen=True, slots=True)
class MediaFailed:
    """``lost`` frames of ``camera``'s video, or one photo, are not on disk."""

    kind: str
    camera: str
    lost: int
    disk_full: bool
    detail: str


MediaResult = PhotoKept | MediaFailed
_Job = Callable[[], None]


class MediaWriter:
    """Takes pixels from the recorder's main thread; results are collected there with :meth:`results`."""

    def __init__(self, folder: Path, *, on_full: Callable[[], bool], max_queued_bytes: int = MAX_QUEUED_BYTES) -> None:
        self._folder = folder
        self._on_full = on_full
        self._max_queued_bytes = max_queued_bytes
        self._jobs: deque[tuple[_Job, int]] = deque()
        self._queued_bytes = 0
        self._ended = False
        self._changed = threading.Condition()
        self._results: deque[MediaResult] = deque()
        self._open: dict[str, VideoFile] = {}
        self._refused: set[str] = set()
        self._finished: list[VideoInfo] = []
        self._names: set[str] = set()
        self._thread = threading.Thread(target=self._run, name="media", daemon=True)
        self._thread.start()

    def add_frame(self, ref: FrameRef, image_bgr: NDArray[np.uint8]) -> bool:
        """False when the encoder is too far behind to take it."""
        return self._add(lambda: self._write_frame(ref, image_bgr), image_bgr.nbytes)

    def add_photo(self, ref: FrameRef, image_bgr: NDArray[np.uint8], file_name: str) -> bool:
        """Keep the picture as a PNG at ``file_name`` in the session's folder. False as for :meth:`add_frame`."""
        return self._add(lambda: self._write_photo(ref, image_bgr, file_name), image_bgr.nbytes)

    def end_videos(self) -> None:
        """Close the videos after the frames that were added; later frames begin new ones."""
        self._add(self._close_videos, 0)

    def results(self) -> list[MediaResult]:
        """What became of photos, and what went wrong, since the last call."""
        taken = []
        while self._results:
            taken.append(self._results.popleft())
        return taken

    def close(self, *, timeout_s: float) -> tuple[VideoInfo, ...]:
        """Write what is queued, close the videos, end the thread and tell what there is."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        self._thread.join(timeout_s)
        if self._thread.is_alive():
            _log.error("the video was not closed within %.0f s; it stays readable as it is", timeout_s)
        return tuple(self._finished)

    @property
    def written_bytes(self) -> int:
        finished = sum(
            (self._folder / info.file_name).stat().st_size
            for info in tuple(self._finished)
            if (self._folder / info.file_name).exists()
        )
        return finished + sum(video.file.size_bytes for video in tuple(self._open.values()))

    def sync(self) -> None:
        """Bring the videos to the disk. Any thread."""
        for video in tuple(self._open.values()):
            video.file.sync()

    def _add(self, job: _Job, size_bytes: int) -> bool:
        with self._changed:
            if size_bytes and self._queued_bytes + size_bytes > self._max_queued_bytes:
                return False
            self._jobs.append((job, size_bytes))
            self._queued_bytes += size_bytes
            self._changed.notify()
        return True

    def _run(self) -> None:
        if sys.platform == "linux":
            # Of this thread alone: events and the console come first.
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _ENCODER_NICENESS)
        while True:
            with self._changed:
                while not self._jobs and not self._ended:
                    self._changed.wait()
                if not self._jobs:
                    break
                job, size_bytes = self._jobs.popleft()
                self._queued_bytes -= size_bytes
            job()
        self._close_videos()

    def _write_frame(self, ref: FrameRef, image_bgr: NDArray[np.uint8]) -> None:
        if ref.camera in self._refused:
            self._results.append(MediaFailed("video", ref.camera, 1, False, "the video has ended"))
            return
        try:
            self._video_for(ref, image_bgr).write(image_bgr, stamp_ns=ref.stamp_ns)
        except Exception as error:
            # PyAV raises errors of its own kinds; none of them may end the thread that keeps the other cameras.
            _log.exception("video of camera %s", ref.camera)
            self._refused.add(ref.camera)
            video = self._open.pop(ref.camera, None)
            if video is not None:
                video.abandon()
                self._finish(ref.camera, video)
            full = isinstance(error, OSError) and no_room(error)
            self._results.append(MediaFailed("video", ref.camera, 1, full, str(error)))

    def _video_for(self, ref: FrameRef, image_bgr: NDArray[np.uint8]) -> VideoFile:
        video = self._open.get(ref.camera)
        height_px, width_px = image_bgr.shape[0] // 2 * 2, image_bgr.shape[1] // 2 * 2
        if video is not None and (video.width_px, video.height_px) == (width_px, height_px):
            return video
        if video is not None:
            self._close_video(ref.camera)
        name = video_file_name(ref.camera, self._names)
        video = VideoFile(self._folder / name, width_px=width_px, height_px=height_px, on_full=lambda: False)
        self._names.add(name)
        self._open[ref.camera] = video
        return video

    def _close_videos(self) -> None:
        for camera in tuple(self._open):
            self._close_video(camera)
        self._refused.clear()

    def _close_video(self, camera: str) -> None:
        video = self._open.pop(camera)
        try:
            video.close()
        except Exception as error:
            _log.exception("closing the video of camera %s", camera)
            full = isinstance(error, OSError) and no_room(error)
            self._results.append(MediaFailed("video index", camera, 0, full, str(error)))
        self._finish(camera, video)

    def _finish(self, camera: str, video: VideoFile) -> None:
        self._finished.append(
            VideoInfo(
                file_name=video.path.name,
                camera=camera,
                frames=video.frames,
                width_px=video.width_px,
                height_px=video.height_px,
                first_stamp_ns=video.first_stamp_ns,
                last_stamp_ns=video.last_stamp_ns,
            )
        )

    def _write_photo(self, ref: FrameRef, image_bgr: NDArray[np.uint8], file_name: str) -> None:
        import cv2

        try:
            encoded, png = cv2.imencode(".png", image_bgr)
            if not encoded:
                raise ValueError("the picture could not be encoded")  # noqa: TRY301 - one place tells the recorder
            path = self._folder / file_name
            path.parent.mkdir(exist_ok=True)
            replace_file(path, png.tobytes(), durable=False, on_full=self._on_full)
        except (OSError, ValueError, cv2.error) as error:
            _log.exception("photo %s", file_name)
            full = isinstance(error, OSError) and no_room(error)
            self._results.append(MediaFailed("photo", ref.camera, 1, full, str(error)))
        else:
            self._results.append(PhotoKept(ref, file_name))
