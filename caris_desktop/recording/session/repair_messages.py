"""Sentences on repairs and missing data of a session, complete for each case, so that they can be translated.

Missing data is stored as plain text in the session header and the study index; ``LOSSES`` are the templates that match
it.
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
