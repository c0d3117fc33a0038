"""Event filter for what happens to other widgets and is reported by no signal of Qt."""

from collections.abc import Callable

from PySide6.QtCore import QEvent, QObject, Signal


class EventWatch(QObject):
    """Calls ``slot``, which may take the object of the event, at events of these types, before they are handled.

    ``parent``: the object of the slot.
    """

    happened = Signal(object)

    def __init__(self, parent: QObject, slot: Callable[..., object], *types: QEvent.Type) -> None:
        super().__init__(parent)
        self._types = types
        self.happened.connect(slot)

    def add(self, *watched: QObject) -> None:
        for each in watched:
            each.installEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if event.type() in self._types:
            self.happened.emit(watched)
        return False
