"""Video and photo writers in separate threads, so that encoding never delays events."""

import logging
import math
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.events import PhotoTaken
from caris_desktop.domain.file_replacement import no_room, replace_file
from caris_desktop.domain.process_settings import RECORD_NICENESS
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.photo_file import CAMERA, PEOPLE, POSE, TIME, with_texts
from caris_desktop.recording.recorder.recorder_messages import TakePhoto
from caris_desktop.recording.recorder.video_writer import FASTEST, Encoder, Encoders, VideoFileWriter
from caris_desktop.recording.session import loss_messages
from caris_desktop.recording.session.media_files import video_file_name
from caris_desktop.recording.session.session_header import SessionClock, VideoInfo

_log = logging.getLogger(__name__)
IMAGE_LOST = QT_TR_NOOP("The image was lost before it could be saved."), QT_TR_NOOP("Take the photo again.")
"""What it means that a photo was not taken, and what to do."""
MAX_QUEUED_BYTES = 64 * 1024 * 1024
_CROWDED_SHARE = 0.6


class MediaFailed(Value):
    """``lost`` frames of ``camera``'s video, or one photo, were not written."""

    kind: str
    camera: str
    lost: int
    disk_full: bool
    detail: str


_LARGEST_STEP = 4
# Waiting time and its duration that lower the rate; short bursts do not.
_TOO_LATE_S, _LATE_FOR_NS = 0.3, 1_000_000_000
_IN_TIME_S = 0.1
_SETTLE_NS = 1_500_000_000
_CALM_NS = 6_000_000_000
_LONGEST_PATIENCE_NS = 96_000_000_000
_BUSY_AT_MOST = 0.75

Change = Literal["", "lowered", "raised"]


class VideoRate:
    """Frame rate reduction of a camera: encode every second or fourth frame while the machine is overloaded.

    Rate of one camera. The recorder's main thread calls ``wants``, the encoder's thread ``observe``.
    """

    def __init__(self) -> None:
        self._step = 1
        self.least_step = 1
        self._offered = 0
        self._changed_ns = 0
        self._late_since_ns: int | None = None
        self._patience_ns = _CALM_NS // 2
        self._encoded: deque[tuple[int, float, float]] = deque()

    @property
    def step(self) -> int:
        """1: every frame is encoded, 2: every second one, and so on."""
        return max(self._step, self.least_step)

    @property
    def lowest(self) -> bool:
        return self._step >= _LARGEST_STEP

    def wants(self) -> bool:
        """True if the next frame is to be encoded."""
        self._offered += 1
        return self._offered % self.step == 0

    def observe(self, now_ns: int, *, waited_s: float, took_s: float, crowded: bool = False) -> Change:
        """Add an encoded frame: its waiting time and encoding time. Returns the change from now on.

        Lowers the rate when frames wait too long, at once if ``crowded`` reports a nearly full queue; raises it when
        twice the frames would not keep the encoder busy.
        """
        self._encoded.append((now_ns, waited_s, took_s))
        while now_ns - self._encoded[0][0] > _CALM_NS:
            self._encoded.popleft()
        if waited_s <= _TOO_LATE_S:
            self._late_since_ns = None
        elif self._late_since_ns is None:
            self._late_since_ns = now_ns
        late = self._late_since_ns is not None and now_ns - self._late_since_ns >= _LATE_FOR_NS
        if (late or crowded) and not self.lowest and now_ns - self._changed_ns >= _SETTLE_NS:
            # Each failed attempt doubles the wait before the next one.
            self._patience_ns = min(2 * self._patience_ns, _LONGEST_PATIENCE_NS)
            return self._change(now_ns, self._step * 2, "lowered")
        if self._step > 1 and now_ns - self._changed_ns >= self._patience_ns:
            busy = sum(took_s for _, _, took_s in self._encoded) / (_CALM_NS / 1e9)
            latest_s = max(waited_s for _, waited_s, _ in self._encoded)
            more = self.step / max(self._step // 2, self.least_step)
            if latest_s < _IN_TIME_S and busy * more < _BUSY_AT_MOST:
                return self._change(now_ns, self._step // 2, "raised")
        return ""

    def forget(self) -> None:
        """Reset to every frame after another measure, and allow it time to take effect."""
        self._step = 1
        self._encoded.clear()

    def _change(self, now_ns: int, step: int, change: Change) -> Change:
        self._step, self._changed_ns, self._late_since_ns = step, now_ns, None
        self._encoded.clear()
        return change


class VideoRateChanged(Value):
    """From now on every ``step``-th frame of ``camera`` is encoded; ``change`` gives the direction."""

    camera: str
    step: int
    change: Change


MediaResult = PhotoTaken | MediaFailed | VideoRateChanged
_Frame = tuple[FrameRef, NDArray[np.uint8], int]
_Photo = tuple[PhotoTaken, NDArray[np.uint8], Mapping[str, str]]


class MediaWriter:
    """Queues images from the recorder's main thread, which collects results with :meth:`results`."""

    def __init__(
        self,
        folder: Path,
        clock: SessionClock,
        encoders: Encoders,
        *,
        on_full: Callable[[], bool],
    ) -> None:
        self._folder = folder
        self._clock = clock
        self._encoders = encoders
        self._on_full = on_full
        self._budget = _Budget(MAX_QUEUED_BYTES)
        self._results: deque[MediaResult] = deque()
        self._names: set[str] = set()
        self._cameras: dict[str, _CameraThread] = {}
        self._least_step = 1
        self._photos: _PhotoThread | None = None

    def wants(self, camera: str) -> bool:
        """True if the next frame of ``camera`` is to be added; call once per frame."""
        thread = self._camera(camera)
        if thread.rate.wants():
            return True
        thread.left_out += 1
        return False

    def add_frame(self, ref: FrameRef, image_bgr: NDArray[np.uint8]) -> bool:
        """Queue a frame; False if the queue is full."""
        if not self._budget.take(image_bgr.nbytes):
            return False
        self._camera(ref.camera).add((ref, image_bgr, time.monotonic_ns()))
        return True

    def add_photo(self, taken: PhotoTaken, image_bgr: NDArray[np.uint8], texts: Mapping[str, str]) -> bool:
        """Queue a PNG for its ``file_name`` in the session's folder; ``taken`` is returned once it is on disk.
        ``texts`` as in ``photo_file``. False as for :meth:`add_frame`.
        """
        if not self._budget.take(image_bgr.nbytes):
            return False
        if self._photos is None:
            self._photos = _PhotoThread(self._folder, self._results, self._budget, self._on_full)
        self._photos.add((taken, image_bgr, texts))
        return True

    def end_videos(self) -> None:
        """End the videos after the queued frames; later frames begin new files."""
        for camera in self._cameras.values():
            camera.add(None)

    def stop_video(self) -> None:
        """On a full disk: write no more video, so that it does not use released reserve. Any thread."""
        for camera in tuple(self._cameras.values()):
            camera.no_room = True

    def limit_rate(self, least_step: int) -> None:
        """Encode at most every ``least_step``-th frame."""
        self._least_step = least_step
        for camera in self._cameras.values():
            camera.rate.least_step = least_step

    def results(self) -> list[MediaResult]:
        """Photos, failures and rate changes since the last call."""
        taken = []
        while self._results:
            taken.append(self._results.popleft())
        return taken

    def close(self, *, timeout_s: float) -> tuple[VideoInfo, ...]:
        """Write the queue, close the videos, end the threads; return the videos."""
        for camera in self._cameras.values():
            camera.end()
        if self._photos is not None:
            self._photos.add(None)
        if not self.wait(timeout_s=timeout_s):
            _log.error("the video was not closed within %.0f s; it stays readable as it is", timeout_s)
        return self.infos()

    def wait(self, *, timeout_s: float) -> bool:
        """After :meth:`close`: True once everything is closed."""
        deadline_s = time.monotonic() + timeout_s
        threads = [camera.thread for camera in self._cameras.values()]
        if self._photos is not None:
            threads.append(self._photos.thread)
        for thread in threads:
            thread.join(max(0.0, deadline_s - time.monotonic()))
        return not any(thread.is_alive() for thread in threads)

    def infos(self) -> tuple[VideoInfo, ...]:
        """Videos so far, in the order in which they ended."""
        return tuple(info for camera in self._cameras.values() for info in camera.infos())

    def files(self) -> list[DiskFile]:
        """Files being written. Any thread."""
        return [file for camera in tuple(self._cameras.values()) for file in camera.files()]

    @property
    def written_bytes(self) -> int:
        photos = 0 if self._photos is None else self._photos.written_bytes
        return photos + sum(camera.written_bytes for camera in self._cameras.values())

    def _camera(self, name: str) -> "_CameraThread":
        camera = self._cameras.get(name)
        if camera is None:
            camera = _CameraThread(name, self._new_video, self._encoders.note_failure, self._results, self._budget)
            camera.rate.least_step = self._least_step
            self._cameras[name] = camera
        return camera

    def _new_video(self, camera: str, image_bgr: NDArray[np.uint8], fast: bool) -> VideoFileWriter:
        """Open a new video with the first encoder that works. Runs in the camera's thread."""
        height_px, width_px = image_bgr.shape[:2]
        with self._budget.lock:
            name = video_file_name(camera, self._names)
            self._names.add(name)
        choices = self._encoders.choose(width_px, height_px, fast=fast)
        for encoder in choices:
            try:
                return VideoFileWriter(
                    self._folder / name,
                    width_px=width_px,
                    height_px=height_px,
                    encoder=encoder,
                    clock=self._clock,
                    on_full=lambda: False,
                )
            except Exception as error:
                if not encoder.hardware:
                    raise
                # Some drivers limit the number of open encoders.
                _log.warning("%s does not open for %s (%s): the next one is tried", encoder.title, camera, error)
        raise ValueError("no video encoder could be opened")


class _Budget:
    """Limit on queued image bytes."""

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._taken_bytes = 0
        self.lock = threading.Lock()

    def take(self, size_bytes: int) -> bool:
        with self.lock:
            if self._taken_bytes + size_bytes > self._most_bytes:
                return False
            self._taken_bytes += size_bytes
            return True

    @property
    def crowded(self) -> bool:
        """True if the queue is nearly full."""
        return self._taken_bytes > _CROWDED_SHARE * self._most_bytes

    def give_back(self, size_bytes: int) -> None:
        with self.lock:
            self._taken_bytes -= size_bytes


class _CameraThread:
    """Video files of one camera in sequence."""

    def __init__(
        self,
        camera: str,
        new_video: Callable[[str, NDArray[np.uint8], bool], VideoFileWriter],
        note_failure: Callable[[Encoder], None],
        results: deque[MediaResult],
        budget: _Budget,
    ) -> None:
        self.rate = VideoRate()
        self._camera = camera
        self._new_video = new_video
        self._note_failure = note_failure
        self._results = results
        self._budget = budget
        self._frames: deque[_Frame | None] = deque()
        self._changed = threading.Condition()
        self._ended = False
        self._refused = False
        self.no_room = False
        self._fast = False
        self._video: VideoFileWriter | None = None
        self._finished: list[VideoInfo] = []
        self._finished_bytes = 0
        self.left_out = 0
        self.thread = threading.Thread(target=self._run, name=f"video-{camera}", daemon=True)
        self.thread.start()

    def add(self, frame: _Frame | None) -> None:
        """Queue a frame, or None to end the video."""
        with self._changed:
            self._frames.append(frame)
            self._changed.notify()

    def end(self) -> None:
        with self._changed:
            self._ended = True
            self._changed.notify()

    @property
    def _refuses(self) -> bool:
        return self._refused or self.no_room

    def files(self) -> list[DiskFile]:
        video = self._video
        return [] if video is None else [video.file, video.index]

    def infos(self) -> list[VideoInfo]:
        video = self._video
        return [*self._finished, *([] if video is None else [video.info(self._camera, left_out=self.left_out)])]

    @property
    def written_bytes(self) -> int:
        video = self._video
        return self._finished_bytes + (0 if video is None else video.written_bytes)

    def _run(self) -> None:
        be_nice()
        while True:
            with self._changed:
                while not self._frames and not self._ended:
                    self._changed.wait()
                if not self._frames:
                    break
                frame = self._frames.popleft()
            if frame is None:
                self._close()
                self._refused = False
                continue
            ref, image_bgr, queued_ns = frame
            begun_ns = time.monotonic_ns()
            self._write(ref, image_bgr)
            self._budget.give_back(image_bgr.nbytes)
            ended_ns = time.monotonic_ns()
            del frame, image_bgr
            if self._refuses:
                continue  # frames left out say nothing about the encoding speed
            waited_s, took_s = (begun_ns - queued_ns) / 1e9, (ended_ns - begun_ns) / 1e9
            crowded = self._budget.crowded and waited_s > took_s
            self._adapt(self.rate.observe(ended_ns, waited_s=waited_s, took_s=took_s, crowded=crowded))
        self._close()

    def _adapt(self, change: Change) -> None:
        video = self._video
        if change == "lowered" and video is not None and not video.encoder.hardware and video.encoder != FASTEST:
            # Before dropping frames, use a cheaper encoder setting; its stream differs, so in a new file.
            _log.warning("video of %s: %s is too slow here; %s next", self._camera, video.encoder.title, FASTEST.title)
            self._fast = True
            self._close()
            self.rate.forget()
        elif change:
            self._results.append(VideoRateChanged(self._camera, self.rate.step, change))

    def _write(self, ref: FrameRef, image_bgr: NDArray[np.uint8]) -> None:
        if self._refuses:
            self._results.append(MediaFailed("video", self._camera, 1, False, loss_messages.VIDEO_ENDED))
            return
        try:
            self._video_for(image_bgr).write(image_bgr, ref)
        except Exception as error:
            # PyAV raises its own error types; none may end the thread.
            _log.exception("video of camera %s", self._camera)
            video, lost = self._video, 1
            if video is not None:
                video.abandon()
                lost = max(1, video.lost)
                self._finish(video)
            full = isinstance(error, OSError) and no_room(error)
            if video is not None and video.encoder.hardware and not full:
                # The next frame begins a new file with software encoding.
                self._note_failure(video.encoder)
            else:
                self._refused = True
            self._results.append(
                MediaFailed("video" if self._refused else "encoder", self._camera, lost, full, str(error))
            )

    def _video_for(self, image_bgr: NDArray[np.uint8]) -> VideoFileWriter:
        video = self._video
        if video is not None and (video.height_px, video.width_px) == tuple(
            size_px // 2 * 2 for size_px in image_bgr.shape[:2]
        ):
            return video
        self._close()
        self._video = video = self._new_video(self._camera, image_bgr, self._fast)
        return video

    def _close(self) -> None:
        video = self._video
        if video is None:
            return
        try:
            video.close()
        except Exception as error:
            _log.exception("closing the video of camera %s", self._camera)
            full = isinstance(error, OSError) and no_room(error)
            self._results.append(MediaFailed("video index", self._camera, video.lost, full, str(error)))
        self._finish(video)

    def _finish(self, video: VideoFileWriter) -> None:
        self._finished.append(video.info(self._camera, left_out=self.left_out))
        self._finished_bytes += video.written_bytes
        self.left_out = 0
        self._video = None


def photo_event(request: TakePhoto, file_name: str) -> PhotoTaken:
    """Event for a photo once it is on disk."""
    ref = request.ref
    return PhotoTaken(
        ref.stamp_ns, ref.camera, ref.sequence, file_name, request.actor, request.person_id,
        person_ids=request.person_ids, pose_in_map=request.pose_in_map,
    )  # fmt: skip


def texts_for(request: TakePhoto, utc: str) -> dict[str, str]:
    """Texts for a photo's file."""
    pose = request.pose_in_map
    return {
        TIME: utc,
        CAMERA: request.ref.camera,
        PEOPLE: " ".join(request.person_ids),
        POSE: "" if pose is None else f"{pose.x_m:.3f} {pose.y_m:.3f} {math.degrees(pose.heading_rad):.1f}",
    }


def write_photo(
    image_bgr: NDArray[np.uint8], path: Path, *, texts: Mapping[str, str], on_full: Callable[[], bool] = lambda: False
) -> Path:
    """Write a PNG atomically. Raises OSError, ValueError."""
    import cv2

    try:
        encoded, png = cv2.imencode(".png", image_bgr)
    except cv2.error as error:
        raise ValueError(str(error)) from error
    if not encoded:
        raise ValueError("the image could not be encoded")
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, with_texts(png.tobytes(), texts), durable=False, on_full=on_full)
    return path


class _PhotoThread:
    """Writes PNG files in sequence."""

    def __init__(self, folder: Path, results: deque[MediaResult], budget: _Budget, on_full: Callable[[], bool]) -> None:
        self._folder = folder
        self._results = results
        self._budget = budget
        self._on_full = on_full
        self._photos: deque[_Photo | None] = deque()
        self._waiting = threading.Semaphore(0)
        self.written_bytes = 0
        self.thread = threading.Thread(target=self._run, name="photos", daemon=True)
        self.thread.start()

    def add(self, photo: _Photo | None) -> None:
        """Queue a photo, or None to end the thread."""
        self._photos.append(photo)
        self._waiting.release()

    def _run(self) -> None:
        be_nice()
        while True:
            self._waiting.acquire()
            photo = self._photos.popleft()
            if photo is None:
                return
            taken, image_bgr, texts = photo
            self._write(taken, image_bgr, texts)
            self._budget.give_back(image_bgr.nbytes)

    def _write(self, taken: PhotoTaken, image_bgr: NDArray[np.uint8], texts: Mapping[str, str]) -> None:
        try:
            path = write_photo(image_bgr, self._folder / taken.file_name, texts=texts, on_full=self._on_full)
            self.written_bytes += path.stat().st_size
        except (OSError, ValueError) as error:
            _log.exception("photo %s", taken.file_name)
            full = isinstance(error, OSError) and no_room(error)
            self._results.append(MediaFailed("photo", taken.camera, 1, full, str(error)))
        else:
            self._results.append(taken)


def be_nice() -> None:
    """Lower the priority of the calling thread: events and the console come first."""
    if sys.platform == "linux":
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), RECORD_NICENESS)
