"""What a painted widget shows now, told to screen readers: once in a while at most, and only while one is there."""

from collections.abc import Callable

from PySide6.QtCore import QEvent, QObject, QTimer
from PySide6.QtGui import QAccessible
from PySide6.QtWidgets import QWidget

EVERY_MS = 1000
_LOOKS = (QEvent.Type.FocusIn, QEvent.Type.Enter, QEvent.Type.Show)


class ToldState(QObject):
    """Keeps the accessible description of ``widget`` at what ``words`` gives, which is asked for no more than told.

    Each change is said aloud while the widget has the focus: ``every_ms`` is longer for longer texts.

    Call :meth:`changed` as often as what is shown changes: it costs nothing without a screen reader.
    """

    def __init__(self, widget: QWidget, words: Callable[[], str], *, every_ms: int = EVERY_MS) -> None:
        super().__init__(widget)
        self._widget = widget
        self._words = words
        self._waits = False
        self._rest = QTimer(self, singleShot=True, interval=every_ms)
        self._rest.timeout.connect(self._on_rested)
        widget.installEventFilter(self)

    def changed(self) -> None:
        """Something is shown otherwise: tell it now, or some time after the last time."""
        if not QAccessible.isActive():
            return
        if self._rest.isActive():
            self._waits = True
        else:
            self._tell()

    def _tell(self) -> None:
        self._waits = False
        self._rest.start()
        words = self._words()
        if words != self._widget.accessibleDescription():
            self._widget.setAccessibleDescription(words)

    def _on_rested(self) -> None:
        if self._waits:
            self._tell()

    def eventFilter(self, _watched: QObject, event: QEvent) -> bool:
        # Whoever goes there hears how it is now, and a screen reader that was started since then begins so.
        if event.type() in _LOOKS and QAccessible.isActive():
            self._tell()
        return False
