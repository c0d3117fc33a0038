"""Reasons for gaps in a recording: stored as plain English text, matched for translation on display."""

from caris_desktop.domain.recorded_messages import parse_recorded
from caris_desktop.domain.translation import QT_TR_NOOP

LEFT_OUT = QT_TR_NOOP("{camera}: skipped because {why}")
OVERWRITTEN = QT_TR_NOOP("{camera}: overwritten before it could be read")
ENCODER_LATE = QT_TR_NOOP("{camera}: the video encoder could not keep up")
OF_CAMERA = QT_TR_NOOP("{camera}: {why}")
SOUND_REFUSED = QT_TR_NOOP("{source}: could not be written to the disk")
OF_SOUND = QT_TR_NOOP("{source}: {why}")
NOT_WRITABLE = QT_TR_NOOP("not writable: {why}")
NO_SOUND = QT_TR_NOOP("invalid audio: {shape} at {rate} Hz")
PICTURE_TOO_SMALL = QT_TR_NOOP("an image of {width}x{height} pixels is too small for a video")
ENCODING_SLOW = QT_TR_NOOP("encoding takes too long")
DISK_NEARLY_FULL = QT_TR_NOOP("the disk is nearly full")
DISK_SLOW = QT_TR_NOOP("the disk is slow")
RECORDER_BEHIND = QT_TR_NOOP("the recorder is behind")
VIDEO_ENDED = QT_TR_NOOP("the video has ended")
WRITTEN_ALREADY = QT_TR_NOOP("audio is already recorded for this time")
_REASONS = (
    LEFT_OUT, OVERWRITTEN, ENCODER_LATE, OF_CAMERA, SOUND_REFUSED, OF_SOUND, NOT_WRITABLE, NO_SOUND, PICTURE_TOO_SMALL,
    ENCODING_SLOW, DISK_NEARLY_FULL, DISK_SLOW, RECORDER_BEHIND, VIDEO_ENDED, WRITTEN_ALREADY,
)  # fmt: skip


def read_reason(recorded: str) -> str:
    """Recorded reason of a gap, for ``tr``."""
    return parse_recorded(recorded, _REASONS)
