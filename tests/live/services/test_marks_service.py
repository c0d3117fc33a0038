"""Marks set during another action, and their correction."""

from typing import Any

import pytest

from caris_desktop.domain import intents
from caris_desktop.domain.events import Marked, MarkKind
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.live.services.session_service import MarksService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import RecordingStatus

pytestmark = pytest.mark.usefixtures("qapp")


class Desk:
    def __init__(self) -> None:
        self.state = LiveState()
        self.told: list[Any] = []
        self.marks = MarksService(self.state, self.told.append)

    def mark(self, label: str, kind: MarkKind = "mark") -> str:
        asked = intents.Mark(label, kind)
        self.marks.mark(asked)
        return asked.mark_id

    def begin(self, label: str, *, earlier_s: float = 0.0) -> str:
        asked = intents.BeginMark(label, earlier_s=earlier_s)
        self.marks.begin(asked)
        return asked.mark_id

    @property
    def last(self) -> Marked:
        mark: Marked = self.told[-1]
        return mark


@pytest.fixture
def desk() -> Desk:
    return Desk()


def test_a_mark_is_of_the_moment_of_the_key(desk: Desk) -> None:
    mark_id = desk.mark("Confused")
    assert (desk.last.mark_id, desk.last.label, desk.last.start_ns, desk.last.state) == (
        mark_id,
        "Confused",
        None,
        "done",
    )
    assert desk.state.marks.value.last == desk.last


def test_marking_earlier_twice_moves_three_seconds_each(desk: Desk) -> None:
    mark_id = desk.mark("")
    first_ns = desk.last.stamp_ns
    for _ in range(2):
        desk.marks.change(intents.ChangeMark(mark_id, earlier_s=3.0))
    assert desk.last.start_ns == first_ns - 6_000_000_000
    assert desk.last.stamp_ns > first_ns, "when it was changed is kept too"


def test_a_label_or_note_later_leaves_the_moment(desk: Desk) -> None:
    mark_id = desk.mark("", "wizard_error")
    first_ns = desk.last.stamp_ns
    desk.marks.change(intents.ChangeMark(mark_id, "late"))
    desk.marks.write_note(mark_id, "I was reading", "wizard")
    assert (desk.last.label, desk.last.note, desk.last.start_ns) == ("late", "I was reading", first_ns)
    assert desk.last.kind == "wizard_error"


def test_intervals_continue_until_they_end(desk: Desk) -> None:
    first = desk.begin("Laughs", earlier_s=2.0)
    second = desk.begin("Confused")
    assert [mark.mark_id for mark in desk.state.marks.value.open] == [first, second]
    assert desk.told[0].start_ns == desk.told[0].stamp_ns - 2_000_000_000
    desk.marks.end_mark(first)
    desk.marks.end_mark(first)
    assert [mark.mark_id for mark in desk.state.marks.value.open] == [second]
    assert desk.last.end_ns == desk.last.stamp_ns and len(desk.told) == 3
    desk.marks.end_all()
    assert desk.last.mark_id == second and desk.last.state == "done"
    assert desk.state.marks.value.open == ()


def test_a_moment_becomes_an_interval_while_its_key_is_held(desk: Desk) -> None:
    mark_id = desk.mark("Laughs")
    pressed_ns = desk.last.stamp_ns
    desk.marks.open_interval(intents.StretchMark(mark_id))
    assert [mark.mark_id for mark in desk.state.marks.value.open] == [mark_id]
    desk.marks.end_mark(mark_id)
    desk.marks.open_interval(intents.StretchMark(mark_id))
    assert (desk.last.start_ns, desk.last.end_ns) == (pressed_ns, desk.last.stamp_ns)
    assert [mark.state for mark in desk.told] == ["done", "open", "done"]


def test_a_slip_is_withdrawn_and_reported(desk: Desk) -> None:
    mark_id = desk.mark("Confused")
    desk.marks.withdraw(mark_id)
    desk.marks.withdraw(mark_id)
    desk.marks.change(intents.ChangeMark(mark_id, "Laughs"))
    assert [mark.state for mark in desk.told] == ["done", "withdrawn"]
    assert desk.state.marks.value.last is None


@pytest.fixture
def recorded(desk: Desk) -> Desk:
    desk.state.recording.set(RecordingStatus("recording"))
    return desk


def test_earlier_texts_of_a_note_and_removed_notes_are_recorded(recorded: Desk) -> None:
    recorded.marks.add_note(intents.AddNote("Asks  twise\n#confused", earlier_s=2.0, note_id="n-1"))
    at_ns = recorded.last.start_ns
    recorded.marks.write_note("n-1", "Asks twice #confused", "wizard")
    (note,) = recorded.state.notes.value
    assert (note.note, note.tags, note.start_ns, note.rewritten) == (
        "Asks twice #confused", ("confused",), at_ns, True,
    )  # fmt: skip
    recorded.marks.remove_note(intents.RemoveNote("n-1"))
    assert recorded.state.notes.value == ()
    recorded.marks.restore_note(intents.RestoreNote("n-1"))
    recorded.marks.restore_note(intents.RestoreNote("n-1"))
    assert [mark.note for mark in recorded.state.notes.value] == ["Asks twice #confused"]
    assert [(mark.note, mark.state, mark.start_ns) for mark in recorded.told] == [
        ("Asks twise #confused", "done", at_ns), ("Asks twice #confused", "done", at_ns),
        ("Asks twice #confused", "withdrawn", at_ns), ("Asks twice #confused", "done", at_ns),
    ]  # fmt: skip


def test_of_a_mark_only_its_note_is_removed(recorded: Desk) -> None:
    mark_id = recorded.mark("Laughs")
    first_ns = recorded.last.stamp_ns
    recorded.marks.write_note(mark_id, "at the arm", "wizard")
    assert [(note.label, note.note, note.start_ns) for note in recorded.state.notes.value] == [
        ("Laughs", "at the arm", first_ns)
    ]
    recorded.marks.remove_note(intents.RemoveNote(mark_id))
    assert (recorded.last.state, recorded.last.note, recorded.state.notes.value) == ("done", "", ())


def test_a_note_without_a_recording_is_refused_instead_of_lost(desk: Desk) -> None:
    with pytest.raises(UserFacingError, match="Nothing is being recorded now"):
        desk.marks.add_note(intents.AddNote("Asks twice"))
    assert desk.told == []
