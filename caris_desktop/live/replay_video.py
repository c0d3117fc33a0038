"""Video of a recorded session, decoded in background threads."""

import logging
import threading
from collections import OrderedDict
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.sensing import FrameRef
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session.session_reader import Session

_log = logging.getLogger(__name__)
_MAX_FRAMES = 12
KEY_FRAMES_FROM_RATE = 3.0
THUMBNAIL_WIDTH_PX = 160
_PICTURE_HOLDS_NS = 2_000_000_000
_EMPTY: NDArray[np.uint8] = np.zeros((0, 0, 3), np.uint8)


class ReplayFrames:
    """FrameReader of a replay: cache of the last decoded frames."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._images: OrderedDict[tuple[str, int], NDArray[np.uint8]] = OrderedDict()

    def add(self, ref: FrameRef, image_bgr: NDArray[np.uint8]) -> None:
        with self._lock:
            self._images[(ref.camera, ref.sequence)] = image_bgr
            while len(self._images) > _MAX_FRAMES:
                self._images.popitem(last=False)

    def read(self, ref: FrameRef) -> NDArray[np.uint8] | None:
        with self._lock:
            return self._images.get((ref.camera, ref.sequence))


class ReplayVideo:
    """Decodes the newest requested frame of each camera, with a thread per camera.

    ``shown(generation, ref)`` is called in that thread.
    """

    def __init__(self, session: Session, frames: ReplayFrames, on_frame: Callable[[int, FrameRef], None]) -> None:
        self._session = session
        self._frames = frames
        self._on_frame = on_frame
        self._decoders: dict[str, _Decoder] = {}
        self._closed = False

    def show(self, generation: int, ref: FrameRef, *, nearest_key: bool = False) -> None:
        """Request a frame. ``nearest_key`` decodes key frames only: for high rates and thumbnails. GUI thread."""
        if self._closed:
            return
        if ref.camera not in self._decoders:
            self._decoders[ref.camera] = _Decoder(self._session, self._frames, self._on_frame)
        self._decoders[ref.camera].show(generation, ref, nearest_key=nearest_key)

    def close(self) -> None:
        self._closed = True
        for decoder in self._decoders.values():
            decoder.close()


class _Decoder:
    """Decoder thread of a camera."""

    def __init__(self, session: Session, frames: ReplayFrames, on_frame: Callable[[int, FrameRef], None]) -> None:
        self._session = session
        self._frames = frames
        self._on_frame = on_frame
        self._changed = threading.Condition()
        self._request: tuple[int, FrameRef, bool] | None = None
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="replay-video", daemon=True)
        self._thread.start()

    def show(self, generation: int, ref: FrameRef, *, nearest_key: bool) -> None:
        with self._changed:
            self._request = (generation, ref, nearest_key)
            self._changed.notify()

    def close(self) -> None:
        with self._changed:
            self._ended = True
            self._changed.notify()
        self._thread.join(5.0)

    def _run(self) -> None:
        reader = VideoReader(self._session)
        try:
            while (request := self._next()) is not None:
                generation, ref, nearest_key = request
                try:
                    picture = reader.frame_at(ref.camera, ref.stamp_ns, nearest_key=nearest_key)
                except Exception:
                    _log.exception("the video of %s cannot be read", ref.camera)
                    continue
                if picture is not None:
                    self._frames.add(ref, picture.image_bgr)
                    self._on_frame(generation, ref)
        finally:
            reader.close()

    def _next(self) -> tuple[int, FrameRef, bool] | None:
        """Next request; None to end."""
        with self._changed:
            while self._request is None and not self._ended:
                self._changed.wait()
            request, self._request = self._request, None
            return None if self._ended else request


class ReplayThumbnails:
    """Thumbnails, newest request first. ``made(camera, at_ns, image_bgr)`` is called in its thread; the image is empty
    if there is none.
    """

    def __init__(self, session: Session, made: Callable[[str, int, NDArray[np.uint8]], None]) -> None:
        self._session = session
        self._made = made
        self._changed = threading.Condition()
        self._pending: OrderedDict[tuple[str, int], None] = OrderedDict()
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="replay-thumbnails", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def request(self, camera: str, at_ns: int) -> None:
        with self._changed:
            self._pending[(camera, at_ns)] = None
            self._pending.move_to_end((camera, at_ns))
            while len(self._pending) > 200:
                self._pending.popitem(last=False)
            self._changed.notify()

    def close(self) -> None:
        with self._changed:
            self._ended = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join(5.0)

    def _run(self) -> None:
        reader = VideoReader(self._session)
        try:
            while True:
                with self._changed:
                    while not self._pending and not self._ended:
                        self._changed.wait()
                    if self._ended:
                        return
                    camera, at_ns = self._pending.popitem(last=True)[0]
                try:
                    found = reader.info_at(camera, at_ns)
                    # No image long after a frame, as in a pause or after the end of the video.
                    there = found is not None and at_ns - found.stamp_ns < _PICTURE_HOLDS_NS
                    image_bgr = reader.thumbnail(camera, at_ns, THUMBNAIL_WIDTH_PX) if there else None
                except Exception:
                    _log.exception("a thumbnail of %s cannot be made", camera)
                    image_bgr = None
                self._made(camera, at_ns, _EMPTY if image_bgr is None else image_bgr)
        finally:
            reader.close()
