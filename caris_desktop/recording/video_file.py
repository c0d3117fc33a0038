"""One camera's mp4: readable while it grows and after a kill, an ordinary mp4 once it is closed."""

import logging
import re
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from caris_desktop.recording.disk_file import DiskFile

_log = logging.getLogger(__name__)
KEY_FRAME_EVERY_S = 0.4
_TICKS_PER_S = 90_000
# ``hybrid_fragmented`` writes fragments (each ends at a key frame, so a kill costs at most one) and turns the whole
# into a plain mp4 with one index when the file is closed.
_MUXER = {
    "movflags": "hybrid_fragmented+frag_keyframe+empty_moov+default_base_moof",
    "flush_packets": "1",
}
# zerolatency: no frame waits in the encoder; one thread: the robot's video must not starve perception and driving.
_ENCODER = {"preset": "ultrafast", "tune": "zerolatency", "crf": "23", "threads": "1"}


def video_file_name(camera: str, taken: set[str]) -> str:
    """``video-CAMERA.mp4`` with nothing in the name that could leave the folder, and not yet ``taken``."""
    plain = re.sub(r"[^A-Za-z0-9_-]+", "-", camera).strip("-")[:40] or "camera"
    name, number = f"video-{plain}.mp4", 2
    while name in taken:
        name, number = f"video-{plain}-{number}.mp4", number + 1
    return name


class VideoFile:
    """Frames of one size, shown at the times they were taken: time 0 is ``first_stamp_ns``."""

    def __init__(self, path: Path, *, width_px: int, height_px: int, on_full: Callable[[], bool]) -> None:
        """Raises OSError when the file cannot be made, ValueError when the size cannot be encoded."""
        import av

        self.path = path
        self.frames = 0
        self.first_stamp_ns = 0
        self.last_stamp_ns = 0
        self.width_px, self.height_px = width_px // 2 * 2, height_px // 2 * 2
        if not (self.width_px and self.height_px):
            raise ValueError(f"a picture of {width_px}x{height_px} pixels is too small for a video")
        self._av = av
        self._last_tick = -1
        self._last_key_tick = 0
        self.file = DiskFile(path, on_full=on_full)
        self._container = av.open(self.file, "w", format="mp4", options=_MUXER)
        self._stream = self._container.add_stream("libx264", options=_ENCODER)
        self._stream.width, self._stream.height = self.width_px, self.height_px
        self._stream.pix_fmt = "yuv420p"
        self._stream.time_base = Fraction(1, _TICKS_PER_S)
        self._stream.codec_context.time_base = Fraction(1, _TICKS_PER_S)

    def write(self, image_bgr: NDArray[np.uint8], *, stamp_ns: int) -> None:
        """``image_bgr``: uint8, shape (height, width, 3); an odd last row or column is cut off. Raises OSError."""
        if not self.frames:
            self.first_stamp_ns = stamp_ns
        tick = max((stamp_ns - self.first_stamp_ns) * _TICKS_PER_S // 1_000_000_000, self._last_tick + 1)
        even = np.ascontiguousarray(image_bgr[: self.height_px, : self.width_px])
        frame = self._av.VideoFrame.from_ndarray(even, format="bgr24")
        frame.pts, frame.time_base = tick, Fraction(1, _TICKS_PER_S)
        if not self.frames or tick - self._last_key_tick >= KEY_FRAME_EVERY_S * _TICKS_PER_S:
            frame.pict_type = self._av.video.frame.PictureType.I
            self._last_key_tick = tick
        for packet in self._stream.encode(frame):
            self._container.mux(packet)
        self._last_tick, self.last_stamp_ns = tick, stamp_ns
        self.frames += 1

    def close(self) -> None:
        """Turn the file into a plain mp4. Raises OSError; the video then stays readable as fragments."""
        try:
            for packet in self._stream.encode(None):
                self._container.mux(packet)
            self.file.hold_back()
            self._container.close()
            self.file.commit()
            self.file.sync()
        finally:
            self.file.close()

    def abandon(self) -> None:
        """Stop here, whatever the encoder still holds: what is on disk is readable and is left alone."""
        self.file.discard()
        try:
            self._container.close()
        except (OSError, self._av.error.FFmpegError):
            _log.debug("closing an abandoned video", exc_info=True)
        self.file.close()
