"""Throttled accessible description of a painted widget, updated only while a screen reader runs."""

from collections.abc import Callable

from PySide6.QtCore import QEvent, QObject, QTimer
from PySide6.QtGui import QAccessible
from PySide6.QtWidgets import QWidget

EVERY_MS = 1000
_LOOKS = (QEvent.Type.FocusIn, QEvent.Type.Enter, QEvent.Type.Show)


class ThrottledAccessibleDescription(QObject):
    """Sets the accessible description of ``widget`` to ``words()``, which is called only when needed.

    Changes are spoken while the widget is focused: use a longer ``every_ms`` for longer texts.

    Call :meth:`changed` on every change: it is free without a screen reader.
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
        """Update the description now, or once the interval has passed."""
        if not QAccessible.isActive():
            return
        if self._rest.isActive():
            self._waits = True
        else:
            self._notify()

    def _notify(self) -> None:
        self._waits = False
        self._rest.start()
        words = self._words()
        if words != self._widget.accessibleDescription():
            self._widget.setAccessibleDescription(words)

    def _on_rested(self) -> None:
        if self._waits:
            self._notify()

    def eventFilter(self, _watched: QObject, event: QEvent) -> bool:
        # Update on focus, and for a screen reader started meanwhile.
        if event.type() in _LOOKS and QAccessible.isActive():
            self._notify()
        return False
