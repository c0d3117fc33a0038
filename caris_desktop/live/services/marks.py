"""The wizard's marks: each change of one is an event with the same id. GUI thread."""

from collections.abc import Callable
from dataclasses import replace

from PySide6.QtCore import QObject

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import Event, Marked
from caris_desktop.live.service import Handlers, Service
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import MarksStatus

_NANOSECONDS = 1_000_000_000


class MarksService(Service):
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

    def handlers(self) -> Handlers:
        return {
            intents.Mark: self.mark,
            intents.BeginMark: self.begin,
            intents.StretchMark: self.stretch,
            intents.EndMark: lambda asked: self.end_mark(asked.mark_id, asked.actor),
            intents.ChangeMark: self.change,
            intents.WithdrawMark: self.withdraw,
        }

    def mark(self, asked: intents.Mark) -> None:
        now_ns = clock.now_ns()
        start_ns = now_ns - round(asked.earlier_s * _NANOSECONDS) if asked.earlier_s > 0 else None
        self._keep(Marked(now_ns, asked.label, asked.kind, asked.mark_id, start_ns, note=asked.note, actor=asked.actor))

    def begin(self, asked: intents.BeginMark) -> None:
        now_ns = clock.now_ns()
        start_ns = now_ns - round(asked.earlier_s * _NANOSECONDS)
        self._keep(Marked(now_ns, asked.label, asked.kind, asked.mark_id, start_ns, state="open", actor=asked.actor))

    def stretch(self, asked: intents.StretchMark) -> None:
        """The moment becomes a stretch that goes on."""
        mark = self._marks.get(asked.mark_id)
        if mark is not None and mark.state == "done" and mark.end_ns is None:
            start_ns = mark.stamp_ns if mark.start_ns is None else mark.start_ns
            self._keep(replace(mark, stamp_ns=clock.now_ns(), start_ns=start_ns, state="open", actor=asked.actor))

    def end_mark(self, mark_id: str, actor: Actor = CONSOLE) -> None:
        mark = self._marks.get(mark_id)
        if mark is not None and mark.state == "open":
            now_ns = clock.now_ns()
            self._keep(replace(mark, stamp_ns=now_ns, end_ns=now_ns, state="done", actor=actor))

    def end_all(self, actor: Actor = CONSOLE) -> None:
        """The session ends, and with it every stretch that goes on."""
        for mark_id in tuple(self._marks):
            self.end_mark(mark_id, actor)

    def change(self, asked: intents.ChangeMark) -> None:
        mark = self._marks.get(asked.mark_id)
        if mark is None:
            return
        start_ns = mark.start_ns
        if asked.earlier_s > 0:
            start_ns = (mark.stamp_ns if start_ns is None else start_ns) - round(asked.earlier_s * _NANOSECONDS)
        elif start_ns is None:
            # From now on the stamp is that of the change.
            start_ns = mark.stamp_ns
        self._keep(
            replace(
                mark,
                stamp_ns=clock.now_ns(),
                start_ns=start_ns,
                label=mark.label if asked.label is None else asked.label,
                note=mark.note if asked.note is None else asked.note,
                actor=asked.actor,
            )
        )

    def withdraw(self, asked: intents.WithdrawMark) -> None:
        mark = self._marks.pop(asked.mark_id, None)
        if mark is None:
            return
        self._publish(replace(mark, stamp_ns=clock.now_ns(), state="withdrawn", actor=asked.actor))
        self._show(None)

    def _keep(self, mark: Marked) -> None:
        self._marks[mark.mark_id] = mark
        self._publish(mark)
        self._show(mark)

    def _show(self, last: Marked | None) -> None:
        going_on = tuple(mark for mark in self._marks.values() if mark.state == "open")
        self._state.marks.set(MarksStatus(last, going_on))
