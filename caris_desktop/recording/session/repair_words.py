"""Sentences on what a repair found, whole ones for each case, so that they can be said in another language."""

from caris_desktop.domain.translation import QT_TR_NOOP


def new_index_words(left: int, *, finished: bool) -> str:
    """Of events that were cut off, after so many ``{seconds}``, or were damaged after the recording had ended."""
    if finished:
        return QT_TR_NOOP(
            "events.mcap was damaged after the recording had ended. The %n values that are left in it got a new index.",
            "",
            left,
        )
    return QT_TR_NOOP(
        "The recording was cut off after {seconds} s. The %n values that are left in it got a new index.", "", left
    )


def lost_values_words(lost: int, *, broken: bool, early: bool) -> str:
    """How many there are, and, where it is so, that bytes cannot be read and that the record ends early."""
    if broken and early:
        return QT_TR_NOOP(
            "%n of the {recorded} values that were recorded are missing from events.mcap; {bytes} bytes of it cannot be"
            " read; it ends {seconds} s before the recording did.",
            "",
            lost,
        )
    if broken:
        return QT_TR_NOOP(
            "%n of the {recorded} values that were recorded are missing from events.mcap; {bytes} bytes of it cannot be"
            " read.",
            "",
            lost,
        )
    if early:
        return QT_TR_NOOP(
            "%n of the {recorded} values that were recorded are missing from events.mcap; it ends {seconds} s before"
            " the recording did.",
            "",
            lost,
        )
    return QT_TR_NOOP("%n of the {recorded} values that were recorded are missing from events.mcap.", "", lost)
