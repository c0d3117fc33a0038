"""Texts about other people in the study's database (notes, robot speech) that may name the erased person."""

from collections.abc import Callable, Collection

from caris_desktop.recording.forgetting.text_erasure import TextWork

Rewrite = Callable[[str, str], str]
"""Receives the owner of a text and the text; returns the text to store."""


class DatabaseTexts:
    """``pass_through`` applies a function to each text of the database. Those of ``person_ids`` are deleted anyway."""

    def __init__(
        self, work: TextWork, file: str, pass_through: Callable[[Rewrite], None], person_ids: Collection[str]
    ) -> None:
        self._work = work
        self._file = file
        self._pass_through = pass_through
        self._ids = frozenset(person_ids)

    def treat(self) -> None:
        """List the places, and replace those to redact."""
        to_change = False

        def scan(whose: str, text: str) -> str:
            nonlocal to_change
            if whose not in self._ids:
                found = self._work.find(text, self._file, lambda: f"data stored about {whose}")
                to_change = to_change or any(decision == "redact" for _, _, decision in found)
            return text

        self._pass_through(scan)
        if to_change:
            self._pass_through(self._without)

    def naming(self) -> int:
        """Number of texts that name the person without a decision to keep them."""
        count = 0

        def scan(whose: str, text: str) -> str:
            nonlocal count
            count += self._without(whose, text) != text
            return text

        self._pass_through(scan)
        return count

    def _without(self, _whose: str, text: str) -> str:
        return self._work.redact(text, self._file, yaml=False)[0]
