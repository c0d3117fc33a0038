"""Final marks and notes of a session: one record per mark, from all of its changes."""

import re
from collections.abc import Iterable

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import Marked, MarkKind
from caris_desktop.domain.value_class import Value

_TAG = re.compile(r"(?<!\S)#(\w[\w-]*)")


class FinalMark(Value):
    """Point or interval (with ``end_ns`` >= ``start_ns``) in session time.

    ``marked_ns`` is when ``actor`` created it; ``open_at_end``: an interval that only the end of the session closed.
    ``rewritten``: its note was changed.
    """

    mark_id: str
    label: str
    kind: MarkKind
    start_ns: int
    end_ns: int | None
    note: str
    marked_ns: int
    open_at_end: bool = False
    actor: Actor = ""
    rewritten: bool = False

    @property
    def duration_s(self) -> float | None:
        return None if self.end_ns is None else (self.end_ns - self.start_ns) / 1e9

    @property
    def tags(self) -> tuple[str, ...]:
        """Words of the note after a #, in order."""
        return tuple(dict.fromkeys(_TAG.findall(self.note)))


def notes_among(marks: Iterable[FinalMark]) -> tuple[FinalMark, ...]:
    """Notes, and marks with a note."""
    return tuple(mark for mark in marks if mark.kind == "note" or mark.note)


def final_marks_of(events: Iterable[Marked], *, ended_ns: int) -> tuple[FinalMark, ...]:
    """Final marks in order of time, without withdrawn ones, from ``events`` in recording order. Marks of older sessions
    without ids get mark-1, mark-2...
    """
    histories: dict[str, list[Marked]] = {}
    for number, event in enumerate(events, start=1):
        histories.setdefault(event.mark_id or f"mark-{number}", []).append(event)
    marks = [_final(mark_id, history, ended_ns) for mark_id, history in histories.items()]
    return tuple(sorted((mark for mark in marks if mark is not None), key=lambda mark: mark.start_ns))


def _final(mark_id: str, history: list[Marked], ended_ns: int) -> FinalMark | None:
    first, last = history[0], history[-1]
    if last.state == "withdrawn":
        return None
    # A change without times leaves them as they were.
    starts_ns = [event.start_ns for event in history if event.start_ns is not None]
    start_ns = starts_ns[-1] if starts_ns else first.stamp_ns
    end_ns = last.end_ns
    if end_ns is None and last.state == "open":
        end_ns = ended_ns
    elif end_ns is None:
        opened = [index for index, event in enumerate(history) if event.state == "open"]
        if opened:
            closing = history[opened[-1] + 1]
            ends_ns = [event.end_ns for event in history[opened[-1] + 1 :] if event.end_ns is not None]
            end_ns = ends_ns[-1] if ends_ns else closing.stamp_ns
    return FinalMark(
        mark_id=mark_id,
        label=last.label,
        kind=last.kind,
        start_ns=start_ns,
        end_ns=None if end_ns is None else max(start_ns, end_ns),
        note=last.note,
        marked_ns=first.stamp_ns,
        open_at_end=last.state == "open",
        actor=first.actor,
        rewritten=len({event.note for event in history if event.note}) > 1,
    )
