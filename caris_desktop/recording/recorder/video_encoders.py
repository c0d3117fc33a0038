"""H.264 encoders of this machine: graphics hardware if it works, else x264 with a preset by load."""

import io
import logging
import os
import threading
from fractions import Fraction
from typing import Any

import numpy as np
import psutil

from caris_desktop.domain.value_class import Value

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
