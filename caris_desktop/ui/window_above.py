"""Floating windows of the console, parts that popups leave in sight, and placement of popups clear of them."""

from collections.abc import Sequence

from PySide6.QtCore import QEvent, QRect, Qt
from PySide6.QtWidgets import QApplication, QWidget

_BESIDE_PX = 12
PLACE_CHANGES = (QEvent.Type.Resize, QEvent.Type.Move, QEvent.Type.Show, QEvent.Type.Hide)


class WindowAbove(QWidget):
    """Window that window managers keep above its parent's window."""

    def __init__(self, parent: QWidget, kind: Qt.WindowType) -> None:
        super().__init__(parent, kind)
        self.is_back = False

    def step_back(self, *, back: bool) -> None:
        """Lower the window below a popup of the main window, and raise it afterwards."""
        self.is_back = back

    def place_in(self, widget: QWidget) -> QRect:
        """Frame geometry in the coordinates of ``widget``."""
        frame = self.frameGeometry()
        return QRect(widget.mapFromGlobal(frame.topLeft()), frame.size())


class InSight(QWidget):
    """Part of the main window that is seen and used while a popup dims the window."""

    def stay_clear_of(self, card: QWidget) -> None:
        """Never cover this popup."""


def windows_above(window: QWidget) -> list[WindowAbove]:
    """Visible floating windows of ``window``."""
    return [
        each
        for each in QApplication.topLevelWidgets()
        if isinstance(each, WindowAbove)
        and each.isVisible()
        and (parent := each.parentWidget()) is not None
        and parent.window() is window
    ]


def clear_place(card: QRect, area: QRect, taken: Sequence[QRect]) -> QRect | None:
    """``card``, moved sideways within ``area`` as little as needed to clear ``taken``; None if impossible."""
    lefts = [card.left()]
    for each in taken:
        lefts += (each.left() - card.width() - _BESIDE_PX, each.left() + each.width() + _BESIDE_PX)
    for left in sorted(lefts, key=lambda left: abs(left - card.left())):
        found = QRect(left, card.top(), card.width(), card.height())
        if area.contains(found) and not any(found.intersects(each) for each in taken):
            return found
    return None
