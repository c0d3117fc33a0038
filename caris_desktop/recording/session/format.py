"""Session format shared by writer and reader: version, and media entries of ``session.json``."""

from caris_desktop.domain.value_class import dataclass

# 1 and 2 had our own schemas only, null for None, and no actor; 2 added the checksums.
FORMAT, FORMAT_VERSION = "caris-desktop session", 3
TRIAL_METADATA = "trial."


@dataclass(frozen=True, slots=True)
class VideoInfo:
    """What ``session.json`` says of one video. Time 0 of the video is ``first_stamp_ns`` of the session clock.

    ``rate_hz`` is its mean frame rate; ``left_out`` counts frames that were not encoded, to keep up. ``delay_ms`` is
    how long a frame took from the camera to here (the median) and ``uncertainty_ms`` how far off that may be at most;
    the video shows frames when they were taken. None: not known, and they are shown when they arrived.
    """

    file_name: str
    camera: str
    frames: int
    width_px: int
    height_px: int
    first_stamp_ns: int
    last_stamp_ns: int
    index_file: str
    encoder: str
    rate_hz: float
    left_out: int
    delay_ms: float | None = None
    uncertainty_ms: float | None = None


@dataclass(frozen=True, slots=True)
class AudioInfo:
    """What ``session.json`` says of one sound file. Its time 0 is ``first_stamp_ns`` of the session clock.

    ``samples`` counts those of one channel; ``last_stamp_ns`` is the end of the last one.
    """

    file_name: str
    source: str
    sample_rate_hz: int
    channels: int
    samples: int
    first_stamp_ns: int
    last_stamp_ns: int
