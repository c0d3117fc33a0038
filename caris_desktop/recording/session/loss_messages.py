"""Sentences on repairs, missing data and gaps of a recording, complete for each case, so that they can be translated.

They are stored as plain English text in the session header and the study index, and matched again for display.
"""

from itertools import product

from caris_desktop.domain.recorded_messages import parse_recorded
from caris_desktop.domain.translation import QT_TR_NOOP


def new_index_words(left: int, *, finished: bool) -> str:
    """For truncated events, after ``{seconds}``, or events damaged after the end of the recording."""
    if finished:
        return QT_TR_NOOP(
            "events.mcap was damaged after the recording ended. Its %n remaining values were indexed again.", "", left
        )
    return QT_TR_NOOP(
        "The recording was cut off after {seconds} s. Its %n remaining values were indexed again.", "", left
    )


def lost_values_words(lost: int, *, broken: bool, early: bool) -> str:
    """For lost values; where so, with unreadable bytes and an early end."""
    if broken and early:
        return QT_TR_NOOP(
            "%n of the {recorded} recorded values are missing from events.mcap; {bytes} bytes of it cannot "
            "be read; it ends {seconds} s before the recording did.",
            "",
            lost,
        )
    if broken:
        return QT_TR_NOOP(
            "%n of the {recorded} recorded values are missing from events.mcap; {bytes} bytes of it cannot be read.",
            "",
            lost,
        )
    if early:
        return QT_TR_NOOP(
            "%n of the {recorded} recorded values are missing from events.mcap; it ends {seconds} s before "
            "the recording did.",
            "",
            lost,
        )
    return QT_TR_NOOP("%n of the {recorded} recorded values are missing from events.mcap.", "", lost)


def unread_bytes_words(count: int) -> str:
    """For unreadable bytes without a known loss."""
    return QT_TR_NOOP(
        "%n bytes at the end of events.mcap cannot be read. None of the values counted before is missing.", "", count
    )


def unsaved_pictures_words(count: int) -> str:
    """For the last frames of ``{camera}``, ``{seconds}`` long."""
    return QT_TR_NOOP("The last %n frames of camera {camera} ({seconds} s) were not saved.", "", count)


def pictures_left_words(left: int) -> str:
    """For ``{file}`` with ``{count}`` frames of ``{camera}``."""
    return QT_TR_NOOP("{file} is cut off: of {count} frames of camera {camera}, %n are left.", "", left)


def further_files_words(count: int) -> str:
    """For files that are not listed by name."""
    return QT_TR_NOOP("%n further files are missing or shorter than they were.", "", count)


VIDEO_MISSING = QT_TR_NOOP("{file} is missing: all {count} frames of camera {camera}.")
SOUND_MISSING = QT_TR_NOOP("{file} is missing: {seconds} s of audio.")
SOUND_CUT_OFF = QT_TR_NOOP("{file} is cut off: of {seconds} s of audio, {left} s are left.")
FILE_MISSING = QT_TR_NOOP("{file} is missing.")
FILE_SHORTER = QT_TR_NOOP("{file} has {left} of {all} bytes.")
LOSSES = (
    *(lost_values_words(2, broken=broken, early=early) for broken, early in product((False, True), repeat=2)),
    unread_bytes_words(2),
    unsaved_pictures_words(2),
    pictures_left_words(2),
    further_files_words(2),
    VIDEO_MISSING,
    SOUND_MISSING,
    SOUND_CUT_OFF,
    FILE_MISSING,
    FILE_SHORTER,
)
"""Those with values in them; the others are found as they are."""


def read_loss(recorded: str) -> str:
    """Stored sentence on missing data, for ``tr``."""
    return parse_recorded(recorded, LOSSES)


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
