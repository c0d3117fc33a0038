"""Participants' utterances in their histories, updated by later corrections."""

from collections.abc import Callable

from caris_desktop.domain.corrections import Corrections
from caris_desktop.domain.events import UtteranceCorrected
from caris_desktop.domain.value_class import dataclass
from caris_desktop.people.known import KnownPeople

_KEPT = 200
"""Utterances that are corrected later than after so many others stay as they are in the history."""


class HeardHistory:
    """History entry per utterance."""

    def __init__(self, known: KnownPeople) -> None:
        self._known = known
        self._heard: dict[str, _Heard] = {}
        self._corrections = Corrections()

    def hear(self, utterance_id: str, person_id: str, text: str) -> None:
        """Add an utterance. ``person_id`` is the visit's own id, empty for an unknown speaker."""
        self._heard[utterance_id] = _Heard(person_id, text, "", "")
        if len(self._heard) > _KEPT:
            del self._heard[next(iter(self._heard))]
        self._write(self._heard[utterance_id], person_id, text)

    def correct(self, event: UtteranceCorrected, visit_of: Callable[[str], str]) -> None:
        """Apply a correction. ``visit_of`` returns the visit of a person."""
        self._corrections.take(event)
        heard, made = self._heard.get(event.utterance_id), self._corrections.of(event.utterance_id)
        if heard is None:
            return
        person_id = heard.person_id
        if made.person_id is not None:
            person_id = visit_of(made.person_id) if made.person_id else ""
        if made.speaker not in (None, "participant"):
            person_id = ""
        self._write(heard, person_id, heard.text if made.text is None else made.text)

    def _write(self, heard: "_Heard", person_id: str, text: str) -> None:
        if (person_id, text) == (heard.kept_with, heard.kept):
            return
        if heard.kept_with:
            self._known.take_back_history(heard.kept_with, "heard", heard.kept)
        if person_id:
            self._known.add_history(person_id, "heard", text)
        heard.kept_with, heard.kept = person_id, text


@dataclass(slots=True)
class _Heard:
    """Original speaker and text, and the current history entry."""

    person_id: str
    text: str
    kept_with: str
    kept: str
