"""When a recording was paused, from the events that tell it."""

from collections.abc import Iterable

from caris_desktop.domain.events import RecordingPaused


def pauses_of(events: Iterable[RecordingPaused], *, ended_ns: int) -> list[tuple[int, int]]:
    """Beginning and end of each pause, in the order of recording; one that nobody ended ends with the session."""
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
