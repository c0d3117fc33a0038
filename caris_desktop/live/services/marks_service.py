"""Mark service: marks and notes of the wizard; each change is an event with the same id. GUI thread."""

from collections.abc import Callable
from dataclasses import replace

from PySide6.QtCore import QObject

from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import Event, Marked
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.translation import tr
from caris_desktop.live.service import Handlers, Service
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import MarksStatus
from caris_desktop.recording.session.session_marks import final_marks_of, notes_among

_NANOSECONDS = 1_000_000_000


class MarksService(Service):
    """Creates and changes marks and notes, and maintains ``state.marks`` and ``state.notes``."""

    def __init__(self, state: LiveState, publish: Callable[[Event], None], parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._state = state
        self._publish = publish
        self._marks: dict[str, Marked] = {}
        self._withdrawn: dict[str, Marked] = {}
        self._of_notes: list[Marked] = []

    def forget(self) -> None:
        """Start a new session without earlier marks."""
        self._marks.clear()
        self._withdrawn.clear()
        self._of_notes.clear()
        self._state.marks.set(MarksStatus())
        self._state.notes.set(())

    def handlers(self) -> Handlers:
        return {
            intents.Mark: self.mark,
            intents.BeginMark: self.begin,
            intents.StretchMark: self.open_interval,
            intents.EndMark: lambda intent: self.end_mark(intent.mark_id, intent.actor),
            intents.ChangeMark: self.change,
            intents.WithdrawMark: lambda intent: self.withdraw(intent.mark_id, intent.actor),
            intents.AddNote: self.add_note,
            intents.ChangeNote: lambda intent: self.write_note(intent.note_id, intent.text, intent.actor),
            intents.RemoveNote: self.remove_note,
            intents.RestoreNote: self.restore_note,
        }

    def mark(self, intent: intents.Mark) -> None:
        now_ns = clock.now_ns()
        start_ns = now_ns - round(intent.earlier_s * _NANOSECONDS) if intent.earlier_s > 0 else None
        self._persist(Marked(now_ns, intent.label, intent.kind, intent.mark_id, start_ns, actor=intent.actor))

    def begin(self, intent: intents.BeginMark) -> None:
        now_ns = clock.now_ns()
        start_ns = now_ns - round(intent.earlier_s * _NANOSECONDS)
        self._persist(
            Marked(now_ns, intent.label, intent.kind, intent.mark_id, start_ns, state="open", actor=intent.actor)
        )

    def open_interval(self, intent: intents.StretchMark) -> None:
        """Turn the moment into an open interval."""
        mark = self._marks.get(intent.mark_id)
        if mark is not None and mark.state == "done" and mark.end_ns is None:
            now_ns = clock.now_ns()
            self._persist(replace(mark, stamp_ns=now_ns, start_ns=_moment_ns(mark), state="open", actor=intent.actor))

    def end_mark(self, mark_id: str, actor: Actor = CONSOLE) -> None:
        mark = self._marks.get(mark_id)
        if mark is not None and mark.state == "open":
            now_ns = clock.now_ns()
            self._persist(replace(mark, stamp_ns=now_ns, end_ns=now_ns, state="done", actor=actor))

    def end_all(self, actor: Actor = CONSOLE) -> None:
        """End all open intervals with the session."""
        for mark_id in tuple(self._marks):
            self.end_mark(mark_id, actor)

    def change(self, intent: intents.ChangeMark) -> None:
        mark = self._marks.get(intent.mark_id)
        if mark is None:
            return
        start_ns = _moment_ns(mark) - round(intent.earlier_s * _NANOSECONDS)
        label = mark.label if intent.label is None else intent.label
        # The stamp becomes the time of the change.
        self._persist(replace(mark, stamp_ns=clock.now_ns(), start_ns=start_ns, label=label, actor=intent.actor))

    def withdraw(self, mark_id: str, actor: Actor = CONSOLE) -> None:
        mark = self._marks.pop(mark_id, None)
        if mark is None:
            return
        self._withdrawn[mark_id] = mark
        self._notify(replace(mark, stamp_ns=clock.now_ns(), state="withdrawn", actor=actor))
        self._show(None)

    def add_note(self, intent: intents.AddNote) -> None:
        text = _written(intent.text)
        if self._state.recording.value.state != "recording":
            raise UserFacingError(
                tr(
                    "The note was not "
                    "saved."), tr("Nothing is being recorded now, so the note would not belong to a session."),
                tr("Start or continue the recording, then press Enter again."), severity="warning",
            )  # fmt: skip
        now_ns = clock.now_ns()
        at_ns = now_ns - round(intent.earlier_s * _NANOSECONDS)
        self._persist(Marked(now_ns, "", "note", intent.note_id, at_ns, note=text, actor=intent.actor))

    def write_note(self, note_id: str, text: str, actor: Actor) -> None:
        mark = self._of_this_session(note_id)
        if mark.kind == "note":
            text = _written(text)
        at_ns = _moment_ns(mark)
        self._persist(replace(mark, stamp_ns=clock.now_ns(), start_ns=at_ns, note=" ".join(text.split()), actor=actor))

    def remove_note(self, intent: intents.RemoveNote) -> None:
        if self._of_this_session(intent.note_id).kind == "note":
            self.withdraw(intent.note_id, intent.actor)
        else:
            self.write_note(intent.note_id, "", intent.actor)

    def restore_note(self, intent: intents.RestoreNote) -> None:
        note = self._withdrawn.pop(intent.note_id, None)
        if note is not None:
            self._persist(replace(note, stamp_ns=clock.now_ns(), start_ns=_moment_ns(note), actor=intent.actor))

    def _of_this_session(self, note_id: str) -> Marked:
        mark = self._marks.get(note_id)
        if mark is None:
            raise UserFacingError(
                tr("That note belongs to another session."), tr("Nothing was changed."),
                tr("Change it in the session in which it was written."), severity="warning",
            )  # fmt: skip
        return mark

    def _persist(self, mark: Marked) -> None:
        self._marks[mark.mark_id] = mark
        self._notify(mark)
        self._show(mark)

    def _notify(self, mark: Marked) -> None:
        self._publish(mark)
        known = any(earlier.mark_id == mark.mark_id for earlier in self._of_notes)
        if known or mark.kind == "note" or mark.note:
            self._of_notes.append(mark)
            marks = final_marks_of(self._of_notes, ended_ns=mark.stamp_ns)
            self._state.notes.set(notes_among(marks))

    def _show(self, last: Marked | None) -> None:
        going_on = tuple(mark for mark in self._marks.values() if mark.state == "open")
        self._state.marks.set(MarksStatus(last, going_on))


def _moment_ns(mark: Marked) -> int:
    return mark.stamp_ns if mark.start_ns is None else mark.start_ns


def _written(text: str) -> str:
    text = " ".join(text.split())
    if not text:
        raise UserFacingError(
            tr("A note needs text."),
            tr("The note is unchanged."),
            tr("Remove the note if you do not need it."),
            severity="warning",
        )
    return text
