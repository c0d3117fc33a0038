"""Where the window lies on the screen, from one run to the next."""

from typing import Any, Protocol

from PySide6.QtCore import QByteArray, QSize
from PySide6.QtWidgets import QWidget

WINDOW_FRAME = QSize(16, 48)  # what a window manager may put around a window
_ROOMY = QSize(1680, 1000)


class Settings(Protocol):
    """What the window needs of QSettings."""

    def value(self, key: str, defaultValue: Any = None) -> Any: ...  # noqa: N803

    def setValue(self, key: str, value: Any) -> None: ...


class WindowPlace:
    """Keeps the geometry of ``window`` in the settings, and puts it there again."""

    def __init__(self, window: QWidget, settings: Settings | None) -> None:
        self._window = window
        self._settings = settings
        self._key = "window/geometry"
        self._fills_screen = False

    def use_replay(self) -> None:
        """A replay has a place of its own."""
        self._key = "replay/geometry"
        if self._settings is not None:
            self.restore()

    def restore(self) -> None:
        window = self._window
        geometry = self._settings.value(self._key) if self._settings is not None else None
        # Qt refuses what was kept of a screen of quite another size, as of a laptop in its dock: that is a first time.
        restored = isinstance(geometry, QByteArray) and window.restoreGeometry(geometry)
        if not restored:
            window.resize(_ROOMY)
        room = window.screen().availableSize() - WINDOW_FRAME
        # A window taller than its screen hides the status bar below the edge, title bar included.
        window.resize(window.size().boundedTo(room))
        self._fills_screen = not restored and window.size() != _ROOMY

    def show(self) -> None:
        """Show it where it was last time. The first time it fills a small screen, where every pixel is needed."""
        if self._fills_screen:
            self._window.showMaximized()
        else:
            self._window.show()

    def keep(self) -> None:
        if self._settings is not None:
            self._settings.setValue(self._key, self._window.saveGeometry())
