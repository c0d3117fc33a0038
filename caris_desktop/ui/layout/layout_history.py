"""Undo and redo of dock layout edits."""

from caris_desktop.ui.layout.dock_layout import DockLayout

MOST_KEPT = 200


class History:
    """Undo and redo stacks of layouts; each call gets the current one."""

    def __init__(self) -> None:
        self._before: list[tuple[str, DockLayout]] = []
        self._after: list[tuple[str, DockLayout]] = []

    def note(self, what: str, before: DockLayout) -> None:
        """Record an edit ``what`` of ``before``; clears the redo stack."""
        self._before.append((what, before))
        del self._before[:-MOST_KEPT]
        self._after.clear()

    @property
    def undoes(self) -> str:
        """Description of the edit to undo; empty if none."""
        return self._before[-1][0] if self._before else ""

    @property
    def redoes(self) -> str:
        return self._after[-1][0] if self._after else ""

    def undo(self, present: DockLayout) -> DockLayout | None:
        if not self._before:
            return None
        what, before = self._before.pop()
        self._after.append((what, present))
        return before

    def redo(self, present: DockLayout) -> DockLayout | None:
        if not self._after:
            return None
        what, after = self._after.pop()
        self._before.append((what, present))
        return after
