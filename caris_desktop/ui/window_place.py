"""Window geometry, saved and restored between runs; places of the other windows."""

from typing import Any, Protocol

from PySide6.QtCore import QByteArray, QPoint, QRect, QSize
from PySide6.QtWidgets import QWidget

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
