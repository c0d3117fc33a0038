"""Fragmented mp4 of one camera: readable while it grows, after a kill, and if truncated.

Its index ``video-CAMERA.frames.csv`` has for each frame the video time, the arrival, and the capture time if known. The
H.264 encoder is this machine's graphics hardware if that works, else x264 with a preset by load.
"""

import io
import logging
import os
import threading
from array import array
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.translation import localized
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.session import loss_messages
from caris_desktop.recording.session.media_files import INDEX_HEAD, index_cells
from caris_desktop.recording.session.session_header import SessionClock, VideoInfo

_log = logging.getLogger(__name__)
TICKS_PER_S = 90_000
# Fragments that end at key frames, even in a closed file: a kill loses at most one, and a truncated copy is readable up
# to its end. A plain mp4 is unreadable without its single index.
MUXER = {"movflags": "frag_keyframe+empty_moov+default_base_moof", "flush_packets": "1"}
_PROBE_WAIT_S = 2.0
_TRIAL_PX, _TRIAL_FRAMES, _TRIAL_KEYS = (640, 480), 12, (0, 6)
_LARGEST_TRIAL_DELAY = 3
# Measured: a 1280x720 stream at 30 Hz uses 0.1 core with ultrafast and 0.2 with veryfast, whose files are half the
# size; superfast costs as much as veryfast.
_GOOD_PRESET, _GOOD_CORES_720P = "veryfast", 0.2
_SHARE_OF_IDLE = 0.08
_PIXELS_720P = 1280 * 720


class Encoder(Value):
    """H.264 encoder with options. ``title`` goes into ``session.json``."""

    name: str
    options: tuple[tuple[str, str], ...]
    pixel_format: str = "yuv420p"
    title: str = ""
    hardware: bool = True


def x264(preset: str) -> Encoder:
    # zerolatency: no frame waits in the encoder; one thread: the robot's video must not starve perception and driving.
    options = (("preset", preset), ("tune", "zerolatency"), ("crf", "23"), ("threads", "1"))
    return Encoder("libx264", options, title=f"libx264 {preset}", hardware=False)


FASTEST = x264("ultrafast")
# No B frames and no frames in flight: after a kill the video ends with the events.
_HARDWARE = (
    Encoder(
        "h264_nvenc",
        (
            ("preset", "p4"),
            ("tune", "ull"),
            ("rc", "vbr"),
            ("cq", "25"),
            ("bf", "0"),
            ("delay", "0"),
            ("forced-idr", "1"),
        ),
        title="h264_nvenc",
    ),
    Encoder(
        "h264_qsv",
        (("preset", "veryfast"), ("global_quality", "25"), ("bf", "0"), ("async_depth", "1"), ("forced_idr", "1")),
        "nv12",
        "h264_qsv",
    ),
    Encoder("h264_amf", (("usage", "lowlatency"), ("rc", "cqp"), ("qp_i", "24"), ("qp_p", "26")), "nv12", "h264_amf"),
    Encoder("h264_videotoolbox", (("realtime", "1"), ("allow_sw", "0"), ("b:v", "6M")), "nv12", "h264_videotoolbox"),
    Encoder("h264_mf", (("hw_encoding", "1"), ("scenario", "live_streaming")), "nv12", "h264_mf"),
    Encoder("h264_vaapi", (("async_depth", "1"), ("bf", "0")), "nv12", "h264_vaapi"),
    Encoder("h264_v4l2m2m", (("bf", "0"),), "yuv420p", "h264_v4l2m2m"),
)


def add_stream(container: Any, encoder: Encoder, width_px: int, height_px: int) -> Any:
    """Add a video stream to ``container`` (PyAV) in ticks of 1/90000 s. Raises ValueError for an unknown encoder."""
    stream = container.add_stream(encoder.name, options=dict(encoder.options))
    stream.width, stream.height = width_px, height_px
    stream.pix_fmt = encoder.pixel_format
    stream.time_base = Fraction(1, TICKS_PER_S)
    stream.codec_context.time_base = Fraction(1, TICKS_PER_S)
    return stream


def works(encoder: Encoder) -> bool:
    """Trial encoding: True if every frame is returned, with the requested key frames and without long delay."""
    import av

    width_px, height_px = _TRIAL_PX
    image_bgr = np.zeros((height_px, width_px, 3), np.uint8)
    written = io.BytesIO()
    delay = 0
    try:
        with av.open(written, "w", format="mp4", options=MUXER) as container:
            stream = add_stream(container, encoder, width_px, height_px)
            for number in range(_TRIAL_FRAMES):
                image_bgr[:, number * 16 :] = 20 * number
                frame = av.VideoFrame.from_ndarray(image_bgr, format="bgr24")
                frame.pts, frame.time_base = number * 3000, Fraction(1, TICKS_PER_S)
                if number in _TRIAL_KEYS:
                    frame.pict_type = av.video.frame.PictureType.I
                packets = stream.encode(frame)
                delay += 1 - len(packets)
                container.mux(packets)
                if delay > _LARGEST_TRIAL_DELAY:
                    return False
            container.mux(stream.encode(None))
        written.seek(0)
        with av.open(written) as container:
            keys = [frame.key_frame for frame in container.decode(video=0)]
    except (av.error.FFmpegError, OSError, ValueError, RuntimeError) as error:
        _log.debug("%s: %s", encoder.name, error)
        return False
    return len(keys) == _TRIAL_FRAMES and all(keys[number] for number in _TRIAL_KEYS)


class Encoders:
    """Selects an encoder for each new video. Any thread."""

    def __init__(self, candidates: tuple[Encoder, ...] = _HARDWARE) -> None:
        self._candidates = candidates
        self._usable: tuple[Encoder, ...] = ()
        self._probed = threading.Event()
        self._failed: set[str] = set()
        psutil.cpu_percent(None)

    def probe(self) -> None:
        """Try the hardware encoders. Runs in a separate thread, as drivers may be slow."""
        try:
            # The first that works: the table is in order of preference.
            self._usable = next(((encoder,) for encoder in self._candidates if works(encoder)), ())
        finally:
            self._probed.set()
        _log.info("video is encoded by %s", " or ".join(one.title for one in self._usable) or "the processor")

    def choose(self, width_px: int, height_px: int, *, fast: bool = False) -> tuple[Encoder, ...]:
        """Encoders to try in order. ``fast``: the cheapest for the processor."""
        if not self._probed.wait(_PROBE_WAIT_S):
            _log.warning("the graphics driver does not answer: video is encoded by the processor")
            self._probed.set()
        hardware = tuple(encoder for encoder in self._usable if encoder.name not in self._failed)
        preset = "ultrafast" if fast else _preset_for(_idle_cores(), width_px * height_px)
        return tuple(dict.fromkeys((*hardware, x264(preset), FASTEST)))

    def note_failure(self, encoder: Encoder) -> None:
        """Exclude a hardware encoder that failed after its trial."""
        if encoder.hardware:
            self._failed.add(encoder.name)


def _idle_cores() -> float:
    """Recently idle processor cores."""
    return (os.cpu_count() or 1) * (1.0 - psutil.cpu_percent(None) / 100.0)


def _preset_for(idle_cores: float, pixels: int) -> str:
    """The better preset if one video uses little of the idle time, since other load may come later."""
    cores = _GOOD_CORES_720P * pixels / _PIXELS_720P
    return _GOOD_PRESET if cores <= _SHARE_OF_IDLE * idle_cores else "ultrafast"


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
