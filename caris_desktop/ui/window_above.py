"""Windows of the console that lie above its main window, for what opens below them."""

from collections.abc import Sequence

from PySide6.QtCore import QRect, Qt
from PySide6.QtWidgets import QApplication, QWidget

_BESIDE_PX = 12


class WindowAbove(QWidget):
    """Window managers keep it above its parent's window."""

    def __init__(self, parent: QWidget, kind: Qt.WindowType) -> None:
        super().__init__(parent, kind)
        self.is_back = False

    def step_back(self, *, back: bool) -> None:
        """Out of the way of what has just been opened below it, and back once that is closed."""
        self.is_back = back

    def place_in(self, widget: QWidget) -> QRect:
        """Where it lies, with its frame, in the pixels of ``widget``."""
        frame = self.frameGeometry()
        return QRect(widget.mapFromGlobal(frame.topLeft()), frame.size())


def windows_above(window: QWidget) -> list[WindowAbove]:
    """Those on show that belong to ``window``."""
    return [
        each
        for each in QApplication.topLevelWidgets()
        if isinstance(each, WindowAbove)
        and each.isVisible()
        and (parent := each.parentWidget()) is not None
        and parent.window() is window
    ]


def clear_place(card: QRect, area: QRect, taken: Sequence[QRect]) -> QRect | None:
    """``card``, or as little beside it in ``area`` as brings it clear of what is ``taken``; None where nothing does."""
    lefts = [card.left()]
    for each in taken:
        lefts += (each.left() - card.width() - _BESIDE_PX, each.left() + each.width() + _BESIDE_PX)
    for left in sorted(lefts, key=lambda left: abs(left - card.left())):
        found = QRect(left, card.top(), card.width(), card.height())
        if area.contains(found) and not any(found.intersects(each) for each in taken):
            return found
    return None
