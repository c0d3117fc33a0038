"""Prompt context of a question to the language model, and its size. GUI thread."""

from collections import Counter
from collections.abc import Container, Sequence

from caris_desktop.conversation.conversation_transcript import Turn
from caris_desktop.conversation.prompts import (
    MAX_HISTORY_CHARACTERS,
    MAX_LABEL_CHARACTERS,
    ContextPart,
    context_lines,
    conversation_words,
)
from caris_desktop.domain.events import Marked
from caris_desktop.domain.sensing import People
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import ContextPartStatus
from caris_desktop.people.presence import PersonRow
from caris_desktop.scenario.scenario_model import AssistantPeople


class AssistantContext:
    """Collects the context from the state, and the wizard's notes from marks."""

    def __init__(self, state: LiveState) -> None:
        self._state = state
        self._notes: dict[str, Marked] = {}
        self._forgotten: frozenset[str] = frozenset()

    def take_mark(self, mark: Marked) -> None:
        """Add a mark with a note; withdrawn or empty ones are removed."""
        if mark.state == "withdrawn" or not mark.note.strip():
            self._notes.pop(mark.mark_id, None)
        else:
            self._notes[mark.mark_id] = mark

    def forget(self) -> None:
        """Start a new participant: earlier turns and notes are excluded."""
        self._notes.clear()
        self._forgotten = frozenset(turn.utterance_id for turn in self._turns())

    def included(self, detail: AssistantPeople, notes: str, leave_out: Container[str] = ()) -> ContextPart:
        """Context without the parts left out. ``detail``: permitted data about people; ``notes``: the notes as text."""
        if detail == "history" and "history" in leave_out:
            detail = "names"
        rows: Sequence[PersonRow] = self._state.persons.value
        labels = {row.person_id: describe_person(row, "names" if detail == "history" else detail) for row in rows}
        noted = [f"{mark.label}: {mark.note}" if mark.label else mark.note for mark in self._notes.values()]
        return ContextPart(
            conversation=() if "conversation" in leave_out else self._turns(),
            step="" if "step" in leave_out else self._state.protocol.value.title,
            people=() if "people" in leave_out else [describe_person(row, detail) for row in rows if row.here],
            things=() if "things" in leave_out else self._things_in_view(),
            notes=() if "notes" in leave_out else [*filter(str.strip, [notes]), *noted],
            label_characters=MAX_HISTORY_CHARACTERS if detail == "history" else MAX_LABEL_CHARACTERS,
            label_of=labels.get,
        )

    def parts(self, detail: AssistantPeople, notes: str) -> tuple[ContextPartStatus, ...]:
        """Available parts with their size."""
        along = self.included(detail, notes)
        turns, words = conversation_words(along.conversation)
        lines = context_lines(along)
        found = [ContextPartStatus("conversation", QT_TR_NOOP("Conversation"), turns, words)]
        if "step" in lines:
            found.append(ContextPartStatus("step", QT_TR_NOOP("Step"), 1, _words(lines["step"])))
        if "people" in lines:
            plain = lines["people"]
            if detail == "history":
                plain = context_lines(self.included("names", notes))["people"]
            found.append(ContextPartStatus("people", QT_TR_NOOP("People"), len(along.people), _words(plain)))
            if lines["people"] != plain:
                more = _words(lines["people"]) - _words(plain)
                found.append(ContextPartStatus("history", QT_TR_NOOP("Person history"), len(along.people), more))
        if "things" in lines:
            things = len(list(along.things))
            found.append(ContextPartStatus("things", QT_TR_NOOP("Objects in view"), things, _words(lines["things"])))
        if "notes" in lines:
            found.append(ContextPartStatus("notes", QT_TR_NOOP("Notes"), len(along.notes), _words(lines["notes"])))
        return tuple(part for part in found if part.count)

    def _turns(self) -> Sequence[Turn]:
        turns: Sequence[Turn] = self._state.transcript.value
        return [turn for turn in turns if turn.utterance_id not in self._forgotten]

    def _things_in_view(self) -> list[str]:
        """Objects detected by the cameras. Cameras may see the same object, so the maximum of their counts is used."""
        most: Counter[str] = Counter()
        for camera in self._state.cameras.value:
            stream = self._state.people_of(camera)
            if stream.freshness == "fresh" and isinstance(stream.value, People):
                most |= Counter(thing.label for thing in stream.value.things)
        return sorted(most.elements())


def describe_person(person: PersonRow, detail: AssistantPeople) -> str:
    """A person as described to the language model."""
    if detail == "numbers" or not person.known:
        return f"person {person.number}"
    if detail == "names":
        return person.name
    details = (person.group and f"group {person.group}", ", ".join(person.tags), person.note, person.summary)
    known = "; ".join(filter(None, details))
    return f"{person.name} ({known})" if known else person.name


def _words(text: str) -> int:
    return len(text.split())
