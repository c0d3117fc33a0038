"""Fragmented mp4 of one camera: readable while it grows, after a kill, and if truncated.

Its index ``video-CAMERA.frames.csv`` has for each frame the video time, the arrival, and the capture time if known.
"""

import logging
from array import array
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.translation import localized
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.recorder.video_encoders import MUXER, TICKS_PER_S, Encoder, add_stream
from caris_desktop.recording.session import loss_messages
from caris_desktop.recording.session.media_files import INDEX_HEAD, index_cells
from caris_desktop.recording.session.session_header import SessionClock, VideoInfo

_log = logging.getLogger(__name__)
KEY_FRAME_EVERY_S = 0.4


class VideoFileWriter:
    """Frames of one size, shown at capture time (else arrival): time 0 is ``first_stamp_ns``.

    Index lines are written just before their frames, so that after a kill every frame has its line; the last lines may
    lack frames. ``frames`` counts those on disk, ``last_stamp_ns`` is the stamp of the last one.
    """

    def __init__(
        self,
        path: Path,
        *,
        width_px: int,
        height_px: int,
        encoder: Encoder,
        clock: SessionClock,
        on_full: Callable[[], bool],
    ) -> None:
        """Raises OSError if the files cannot be created, ValueError for an unsupported size, and PyAV's errors if the
        encoder does not open.
        """
        import av

        self.path = path
        self.encoder = encoder
        self.taken = 0
        self.frames = 0
        self.first_stamp_ns = 0
        self.last_stamp_ns = 0
        self.width_px, self.height_px = width_px // 2 * 2, height_px // 2 * 2
        if not (self.width_px and self.height_px):
            raise ValueError(localized(loss_messages.PICTURE_TOO_SMALL, width=width_px, height=height_px))
        self._av = av
        self._clock = clock
        self._last_tick = -1
        self._last_key_tick = 0
        # Stamps and lines of frames still in the encoder, and of those still in the muxer.
        self._encoding: deque[tuple[int, str]] = deque()
        self._muxed: list[tuple[int, str]] = []
        self._delays_ns = array("q")
        self._uncertainty_ns = 0
        self.file = DiskFile(path, on_full=on_full)
        try:
            self.index = DiskFile(path.with_suffix(".frames.csv"), on_full=on_full)
        except OSError:
            self.file.close()
            path.unlink(missing_ok=True)
            raise
        try:
            self.index.write(INDEX_HEAD.encode())
            self._container = av.open(self.file, "w", format="mp4", options=MUXER)
            self._stream = add_stream(self._container, encoder, self.width_px, self.height_px)
            self._stream.codec_context.open()
        except Exception:
            self.file.discard()
            self._close_files()
            path.unlink(missing_ok=True)
            self.index.path.unlink(missing_ok=True)
            raise

    def write(self, image_bgr: NDArray[np.uint8], ref: FrameRef) -> None:
        """Encode ``image_bgr``: uint8, shape (height, width, 3); an odd last row or column is cropped. It must not
        change before the next call.

        Raises OSError, and PyAV's errors.
        """
        first = self._last_tick < 0
        self.taken += 1
        if first:
            self.first_stamp_ns = ref.shown_ns
        tick = max((ref.shown_ns - self.first_stamp_ns) * TICKS_PER_S // 1_000_000_000, self._last_tick + 1)
        even = np.ascontiguousarray(image_bgr[: self.height_px, : self.width_px])
        frame = self._av.VideoFrame.from_numpy_buffer(even, format="bgr24")
        frame.pts, frame.time_base = tick, self._stream.time_base
        if first or tick - self._last_key_tick >= KEY_FRAME_EVERY_S * TICKS_PER_S:
            frame.pict_type = self._av.video.frame.PictureType.I
            self._last_key_tick = tick
        if ref.taken_ns is not None:
            self._delays_ns.append(ref.stamp_ns - ref.taken_ns)
            self._uncertainty_ns = max(self._uncertainty_ns, ref.taken_uncertainty_ns or 0)
        self._encoding.append((ref.shown_ns, f"{index_cells(ref, tick / TICKS_PER_S, self._clock)}\n"))
        self._mux(self._stream.encode(frame))
        self._last_tick = tick

    def close(self) -> None:
        """Write the last fragment atomically, and close the file. Raises OSError."""
        try:
            self._mux(self._stream.encode(None))
            self.file.hold_back()
            with self._lines_first():
                self._container.close()
                self.file.commit()
            self.file.sync()
            self.index.sync()
        finally:
            self._close_files()

    def abandon(self) -> None:
        """Stop without flushing the encoder: the file on disk is readable and stays as it is."""
        self.file.discard()
        try:
            self._container.close()
        except (OSError, self._av.error.FFmpegError):
            _log.debug("closing an abandoned video", exc_info=True)
        self._close_files()

    def info(self, camera: str, *, left_out: int = 0) -> VideoInfo:
        """Entry of ``session.json``, with ``left_out`` frames that were not given to this video."""
        duration_s = (self.last_stamp_ns - self.first_stamp_ns) / 1e9
        return VideoInfo(
            file_name=self.path.name,
            camera=camera,
            frames=self.frames,
            width_px=self.width_px,
            height_px=self.height_px,
            first_stamp_ns=self.first_stamp_ns,
            last_stamp_ns=self.last_stamp_ns,
            index_file=self.index.path.name,
            encoder=self.encoder.title,
            rate_hz=round((self.frames - 1) / duration_s, 3) if self.frames > 1 and duration_s > 0 else 0.0,
            left_out=left_out,
            delay_ms=round(median(self._delays_ns) / 1e6, 3) if self._delays_ns else None,
            uncertainty_ms=round(self._uncertainty_ns / 1e6, 3) if self._delays_ns else None,
        )

    @property
    def lost(self) -> int:
        """Frames accepted and, after closing or abandoning, not in the file."""
        return self.taken - self.frames

    @property
    def written_bytes(self) -> int:
        return self.file.written_bytes + self.index.written_bytes

    def _mux(self, packets: list[Any]) -> None:
        for packet in packets:
            if packet.is_keyframe:
                # Makes the muxer write its fragment.
                with self._lines_first():
                    self._container.mux(packet)
            else:
                self._container.mux(packet)
            self._muxed.append(self._encoding.popleft())

    @contextmanager
    def _lines_first(self) -> Iterator[None]:
        """Context that writes the index lines of the muxer's frames before the frames themselves."""
        size_before, frames_before, last_before_ns = self.index.size_bytes, self.frames, self.last_stamp_ns
        held, self._muxed = self._muxed, []
        try:
            if held:
                self.index.write("".join(f"{self.frames + at},{line}" for at, (_, line) in enumerate(held)).encode())
                self.frames += len(held)
                self.last_stamp_ns = held[-1][0]
            yield
        except Exception:
            self.index.end_at(size_before)
            self.frames, self.last_stamp_ns = frames_before, last_before_ns
            raise

    def _close_files(self) -> None:
        self.file.close()
        self.index.close()
