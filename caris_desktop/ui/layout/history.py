"""Undo and redo of what was done to an arrangement."""

from caris_desktop.ui.layout.arrangement import Arrangement

MOST_KEPT = 200


class History:
    """Arrangements that were, and those that were undone; the present one is told to each call."""

    def __init__(self) -> None:
        self._before: list[tuple[str, Arrangement]] = []
        self._after: list[tuple[str, Arrangement]] = []

    def note(self, what: str, before: Arrangement) -> None:
        """``what`` is about to be done to ``before``; what was undone cannot be done again then."""
        self._before.append((what, before))
        del self._before[:-MOST_KEPT]
        self._after.clear()

    @property
    def undoes(self) -> str:
        """What would be undone, in words; empty where there is nothing."""
        return self._before[-1][0] if self._before else ""

    @property
    def redoes(self) -> str:
        return self._after[-1][0] if self._after else ""

    def undo(self, present: Arrangement) -> Arrangement | None:
        if not self._before:
            return None
        what, before = self._before.pop()
        self._after.append((what, present))
        return before

    def redo(self, present: Arrangement) -> Arrangement | None:
        if not self._after:
            return None
        what, after = self._after.pop()
        self._before.append((what, present))
        return after
