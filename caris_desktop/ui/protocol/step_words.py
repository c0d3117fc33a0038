"""Durations of protocol steps as text."""

from typing import TYPE_CHECKING

from caris_desktop.domain.events import LATE_FROM_S
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import ProtocolStatus

if TYPE_CHECKING:
    # Imported late: the window is shown before session files are read.
    from caris_desktop.recording.session.session_protocol import StepRecord


def short_time(seconds: float) -> str:
    """Duration as 0:42, 12:05, or 1:02:03 from an hour on."""
    minutes, secs = divmod(max(0, int(seconds)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{secs:02}" if hours else f"{minutes}:{secs:02}"


def time_words(status: ProtocolStatus, now_ns: int) -> str:
    """Elapsed, expected and late time of the current step."""
    return _planned_and_actual(status.elapsed_s(now_ns), status.expected_s, status.late_s(now_ns))


def record_words(record: "StepRecord") -> str:
    """Recorded, planned and late time of a step in a session."""
    if not record.visits:
        return tr("not started")
    words = _planned_and_actual(record.time_s, record.expected_s, record.late_s)
    if record.skipped:
        words = tr("{time} · skipped").format(time=words)
    return words if record.visits == 1 else tr("{time} · started %n times", "", record.visits).format(time=words)


def _planned_and_actual(actual_s: float, expected_s: float, late_s: float) -> str:
    if not expected_s:
        return short_time(actual_s)
    if late_s < LATE_FROM_S:
        return tr("{elapsed} of {expected}").format(elapsed=short_time(actual_s), expected=short_time(expected_s))
    return tr("{elapsed} of {expected} · {late} late").format(
        elapsed=short_time(actual_s), expected=short_time(expected_s), late=short_time(late_s)
    )


def is_late(status: ProtocolStatus, now_ns: int) -> bool:
    """Whether the step is late by a whole second, so that colour and text change together."""
    return status.late_s(now_ns) >= LATE_FROM_S
