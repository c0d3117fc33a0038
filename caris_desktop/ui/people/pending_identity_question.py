"""Pending identity question: the suggestion that the yes and no keys answer. One at a time, and never one that was not
read.
"""

from collections.abc import Iterable
from dataclasses import replace

from PySide6.QtCore import QObject

from caris_desktop.domain.value_class import Value
from caris_desktop.live.state import LiveState
from caris_desktop.people.presence import PersonRow

TO_READ_NS = 500_000_000
"""Minimum time before a new question can be answered: the key press may have been for the former one."""


class IdentityQuestion(Value):
    """Question whether ``person_id``, who is present, is ``is_person_id``; not answerable before ``from_ns``."""

    person_id: str
    is_person_id: str
    from_ns: int = 0


def is_asked(person: PersonRow, question: IdentityQuestion | None) -> bool:
    """Whether the question is about this person."""
    return question is not None and person.here and person.person_id == question.person_id


def with_one_question(persons: Iterable[PersonRow], question: IdentityQuestion | None) -> tuple[PersonRow, ...]:
    """Rows with only the pending suggestion, so that no answer goes to another one."""
    return tuple(
        replace(person, suggestions=()) if person.suggestions and not is_asked(person, question) else person
        for person in persons
    )


def next_asked(
    persons: tuple[PersonRow, ...], before: IdentityQuestion | None, *, selected: str, now_ns: int, ended_ns: int
) -> IdentityQuestion | None:
    """Next question: the selected person first, then the current question, then the person present longest.

    ``ended_ns``: when the former question was answered or withdrawn.
    """
    first_come = sorted(persons, key=lambda person: person.since_ns)
    open_now = {each.person_id: each.suggestion.person_id for each in first_come if each.here and each.suggestion}
    if not open_now:
        return None
    if selected in open_now:
        chosen = selected
    elif before is not None and open_now.get(before.person_id) == before.is_person_id:
        chosen = before.person_id
    else:
        chosen = next(iter(open_now))
    if before is not None and (before.person_id, before.is_person_id) == (chosen, open_now[chosen]):
        return before
    replaces = before is not None or now_ns - ended_ns < TO_READ_NS
    return IdentityQuestion(chosen, open_now[chosen], now_ns + TO_READ_NS if replaces else 0)


class PendingIdentityQuestion(QObject):
    """Updates ``state.asked_person`` from the people present."""

    def __init__(self, state: LiveState, parent: QObject) -> None:
        super().__init__(parent)
        self._state = state
        self._ended_ns = -TO_READ_NS
        state.persons.changed.connect(self._refresh)
        state.selected_person.changed.connect(self._refresh)
        self._refresh()

    def _refresh(self, _value: object = None) -> None:
        state, now_ns = self._state, self._state.present.now_ns()
        before: IdentityQuestion | None = state.asked_person.value
        question = next_asked(
            state.persons.value, before, selected=state.selected_person.value, now_ns=now_ns, ended_ns=self._ended_ns
        )
        if before is not None and question is None:
            self._ended_ns = now_ns
        state.asked_person.set(question)
