"""Window geometry, saved and restored between runs; places of other windows, and of popups clear of them."""

from collections.abc import Sequence
from typing import Any, Protocol

from PySide6.QtCore import QByteArray, QEvent, QPoint, QRect, QSize, Qt
from PySide6.QtWidgets import QApplication, QWidget

WINDOW_FRAME = QSize(16, 48)  # upper bound of the window decoration
_ROOMY = QSize(1680, 1000)
_LEAST_HEIGHT_PX, _BELOW_RED_PX = 480, 8


class Settings(Protocol):
    """The part of QSettings that the window uses."""

    def value(self, key: str, defaultValue: Any = None) -> Any: ...  # noqa: N803

    def setValue(self, key: str, value: Any) -> None: ...


class WindowPlace:
    """Saves the geometry of ``window`` in the settings and restores it."""

    def __init__(self, window: QWidget, settings: Settings | None) -> None:
        self._window = window
        self._settings = settings
        self._key = "window/geometry"
        self._fills_screen = False

    def use_replay(self) -> None:
        """Use a separate geometry for replays."""
        self._key = "replay/geometry"
        if self._settings is not None:
            self.restore()

    def restore(self) -> None:
        window = self._window
        geometry = self._settings.value(self._key) if self._settings is not None else None
        # Qt rejects a geometry saved on a screen of very different size, such as a docked laptop's: treated as a first
        # start.
        restored = isinstance(geometry, QByteArray) and window.restoreGeometry(geometry)
        if not restored:
            window.resize(_ROOMY)
        room = window.screen().availableSize() - WINDOW_FRAME
        # A window taller than its screen would hide its title bar and status bar.
        window.resize(window.size().boundedTo(room))
        self._fills_screen = not restored and window.size() != _ROOMY

    def show(self) -> None:
        """Show the window at its last position. The first time it is maximised on a small screen."""
        if self._fills_screen:
            self._window.showMaximized()
        else:
            self._window.show()

    def save(self) -> None:
        if self._settings is not None:
            self._settings.setValue(self._key, self._window.saveGeometry())


def _room_next_to(parent: QWidget, room: QRect) -> QRect:
    """Screen area below that window's red button, unless too small."""
    red = parent.findChild(QWidget, "emergency_stop")
    below = QRect(room)
    below.setTop(room.top() + WINDOW_FRAME.height())
    if red is not None and red.isVisible():
        below.setTop(max(below.top(), red.mapToGlobal(red.rect().bottomLeft()).y() + _BELOW_RED_PX))
        if below.height() - WINDOW_FRAME.height() < _LEAST_HEIGHT_PX:
            below.setTop(room.top() + WINDOW_FRAME.height())
    return below


def bring_up(window: QWidget) -> None:
    """Show a window centred on its owner, without covering the red button, and focus it."""
    parent = window.parentWidget()
    if parent is not None and not window.isVisible():
        # Window managers place it in a corner.
        room = _room_next_to(parent, window.screen().availableGeometry())
        window.resize(window.size().boundedTo(room.size() - WINDOW_FRAME))
        place = QRect(QPoint(), window.size() + WINDOW_FRAME)
        place.moveCenter(parent.frameGeometry().center())
        place.moveRight(min(place.right(), room.right()))
        place.moveBottom(min(place.bottom(), room.bottom()))
        window.move(max(place.left(), room.left()), max(place.top(), room.top()))
    raise_window(window)


def raise_window(window: QWidget) -> None:
    """Show and focus a window where it is."""
    window.show()
    window.raise_()
    window.activateWindow()


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
