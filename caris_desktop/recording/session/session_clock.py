"""Session time: conversion of session clock nanoseconds to session seconds, UTC and local time."""

from collections.abc import Iterable
from datetime import UTC, datetime

from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import RecordingPaused
from caris_desktop.domain.value_class import Value


class SessionClock(Value):
    """Session clock; second 0 is ``started_ns``."""

    anchor: ClockAnchor
    started_ns: int

    def session_s(self, stamp_ns: int) -> float:
        """Seconds since the session start; negative for earlier values."""
        return (stamp_ns - self.started_ns) / 1e9

    def at_utc(self, utc_ns: int) -> int:
        """Session time of a moment in UTC."""
        return utc_ns - self.anchor.utc_ns + self.anchor.monotonic_ns

    def utc(self, stamp_ns: int) -> str:
        """ISO 8601 in UTC, microseconds: ``2026-11-21T10:14:02.123456Z``."""
        seconds, nanoseconds = divmod(self.anchor.utc_ns_at(stamp_ns), 1_000_000_000)
        moment = datetime.fromtimestamp(seconds, UTC)
        return f"{moment:%Y-%m-%dT%H:%M:%S}.{nanoseconds // 1000:06d}Z"

    def wall(self, stamp_ns: int) -> str:
        """Local time: ``10:14:02.123``."""
        seconds, nanoseconds = divmod(self.anchor.utc_ns_at(stamp_ns), 1_000_000_000)
        moment = datetime.fromtimestamp(seconds, UTC).astimezone()
        return f"{moment:%H:%M:%S}.{nanoseconds // 1_000_000:03d}"


def clock_text(seconds: float) -> str:
    """``12:04``, or ``1:02:04`` from an hour on."""
    sign = "−" if seconds < -0.5 else ""
    total_s = round(abs(seconds))
    hours, rest = divmod(total_s, 3600)
    return f"{sign}{hours}:{rest // 60:02d}:{rest % 60:02d}" if hours else f"{sign}{rest // 60}:{rest % 60:02d}"


# Pauses of a recording, from its events.


def pauses_of(events: Iterable[RecordingPaused], *, ended_ns: int) -> list[tuple[int, int]]:
    """Start and end of each pause in recording order; an unfinished one ends with the session."""
    pauses: list[tuple[int, int]] = []
    began_ns: int | None = None
    for event in events:
        if event.paused and began_ns is None:
            began_ns = event.stamp_ns
        elif not event.paused and began_ns is not None:
            pauses.append((began_ns, event.stamp_ns))
            began_ns = None
    if began_ns is not None and began_ns < ended_ns:
        pauses.append((began_ns, ended_ns))
    return pauses
