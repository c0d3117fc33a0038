"""Corrections of utterances, merged: used by display, language model and export."""

from typing import Literal

from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import UtteranceCorrected
from caris_desktop.domain.value_class import Value

WhoSpoke = Literal["", "robot", "participant", "wizard"]


class Correction(Value):
    """Corrected values; None: as first reported. ``person_by`` identified the person, the console with a likelihood."""

    text: str | None = None
    speaker: WhoSpoke | None = None
    person_id: str | None = None
    tags: tuple[str, ...] | None = None
    person_by: Actor = ""
    person_confidence: float | None = None
    start_ns: int | None = None
    end_ns: int | None = None


class Corrections:
    """Corrections in the order in which they were made; the console never overrides a person's decision."""

    def __init__(self) -> None:
        self._by_people: dict[str, Correction] = {}
        self._by_console: dict[str, Correction] = {}

    def take(self, event: UtteranceCorrected) -> None:
        corrections = self._by_console if event.actor == CONSOLE else self._by_people
        corrections[event.utterance_id] = _later(corrections.get(event.utterance_id, Correction()), event)

    def of(self, utterance_id: str) -> Correction:
        """Effective correction of this utterance."""
        console = self._by_console.get(utterance_id, Correction())
        people = self._by_people.get(utterance_id)
        return console if people is None else _later(console, people)


def _later(before: Correction, after: Correction | UtteranceCorrected) -> Correction:
    person = before if after.person_id is None else after
    return Correction(
        before.text if after.text is None else after.text,
        before.speaker if after.speaker is None else after.speaker,
        person.person_id,
        before.tags if after.tags is None else after.tags,
        person.actor if isinstance(person, UtteranceCorrected) else person.person_by,
        person.person_confidence,
        before.start_ns if after.start_ns is None else after.start_ns,
        before.end_ns if after.end_ns is None else after.end_ns,
    )
