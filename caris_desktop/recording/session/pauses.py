"""Pauses of a recording, from its events."""

from collections.abc import Iterable

from caris_desktop.domain.events import RecordingPaused


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
