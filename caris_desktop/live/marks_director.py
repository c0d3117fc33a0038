"""The wizard's marks: each change of one is an event with the same id. GUI thread."""

import secrets
from collections.abc import Callable
from dataclasses import replace

from PySide6.QtCore import QObject

from caris_desktop.domain import clock
from caris_desktop.domain.events import Event, Marked, MarkKind
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import MarksStatus

_NANOSECONDS = 1_000_000_000


class MarksDirector(QObject):
    """Makes and changes marks and keeps ``state.marks``."""

    def __init__(self, state: LiveState, publish: Callable[[Event], None], parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._state = state
        self._publish = publish
        self._marks: dict[str, Marked] = {}

    def forget(self) -> None:
        """Another session begins: what was marked before belongs to the last one."""
        self._marks.clear()
        self._state.marks.set(MarksStatus())

    def mark(self, label: str, kind: MarkKind, *, earlier_s: float, note: str) -> str:
        now_ns = clock.now_ns()
        start_ns = now_ns - round(earlier_s * _NANOSECONDS) if earlier_s > 0 else None
        return self._keep(Marked(now_ns, label, kind, _new_id(), start_ns, note=note))

    def begin(self, label: str, kind: MarkKind, *, earlier_s: float) -> str:
        now_ns = clock.now_ns()
        start_ns = now_ns - round(max(0.0, earlier_s) * _NANOSECONDS)
        return self._keep(Marked(now_ns, label, kind, _new_id(), start_ns, state="open"))

    def stretch(self, mark_id: str) -> None:
        """The moment becomes a stretch that goes on."""
        mark = self._marks.get(mark_id)
        if mark is not None and mark.state == "done" and mark.end_ns is None:
            start_ns = mark.stamp_ns if mark.start_ns is None else mark.start_ns
            self._keep(replace(mark, stamp_ns=clock.now_ns(), start_ns=start_ns, state="open"))

    def end(self, mark_id: str) -> None:
        mark = self._marks.get(mark_id)
        if mark is not None and mark.state == "open":
            now_ns = clock.now_ns()
            self._keep(replace(mark, stamp_ns=now_ns, end_ns=now_ns, state="done"))

    def end_all(self) -> None:
        """The session ends, and with it every stretch that goes on."""
        for mark_id in tuple(self._marks):
            self.end(mark_id)

    def change(self, mark_id: str, *, label: str | None, earlier_s: float, note: str | None) -> None:
        mark = self._marks.get(mark_id)
        if mark is None:
            return
        start_ns = mark.start_ns
        if earlier_s > 0:
            start_ns = (mark.stamp_ns if start_ns is None else start_ns) - round(earlier_s * _NANOSECONDS)
        elif start_ns is None:
            # From now on the stamp is that of the change.
            start_ns = mark.stamp_ns
        self._keep(
            replace(
                mark,
                stamp_ns=clock.now_ns(),
                start_ns=start_ns,
                label=mark.label if label is None else label,
                note=mark.note if note is None else note,
            )
        )

    def withdraw(self, mark_id: str) -> None:
        mark = self._marks.pop(mark_id, None)
        if mark is None:
            return
        self._publish(replace(mark, stamp_ns=clock.now_ns(), state="withdrawn"))
        self._show(None)

    def _keep(self, mark: Marked) -> str:
        self._marks[mark.mark_id] = mark
        self._publish(mark)
        self._show(mark)
        return mark.mark_id

    def _show(self, last: Marked | None) -> None:
        going_on = tuple(mark for mark in self._marks.values() if mark.state == "open")
        self._state.marks.set(MarksStatus(last, going_on))


def _new_id() -> str:
    return f"m-{secrets.token_hex(4)}"
