"""Accessible descriptions of painted widgets and pictures, for screen readers."""

from collections.abc import Callable, Iterable

from PySide6.QtCore import QEvent, QObject, QTimer
from PySide6.QtGui import QAccessible
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.ui.event_watch import EventWatch
from caris_desktop.ui.widgets.frame_view import FrameView

EVERY_MS = 1000


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
        # Update on focus, and for a screen reader started meanwhile.
        looks = QEvent.Type.FocusIn, QEvent.Type.Enter, QEvent.Type.Show
        EventWatch(self, self.changed_urgently, *looks).add(widget)

    def changed(self) -> None:
        """Update the description now, or once the interval has passed."""
        if not QAccessible.isActive():
            return
        if self._rest.isActive():
            self._waits = True
        else:
            self._notify()

    def changed_urgently(self) -> None:
        """Update the description now."""
        if QAccessible.isActive():
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


TOLD_EVERY_MS = 5000
"""Minimum interval in ms, long enough to hear a sentence to its end."""

_STILL_THERE_S = 5.0


class RecentlyVisible:
    """People seen recently: boxes come and go with single detections, and announcing each change would drown out all
    else.
    """

    def __init__(self) -> None:
        self._seen_s: dict[str, float] = {}

    def add(self, view: FrameView, now_s: float) -> None:
        """Add the visible people; call on each repaint."""
        self._seen_s.update({name: now_s for name, _named in view.visible_detections()})
        self._seen_s = {name: at_s for name, at_s in self._seen_s.items() if now_s - at_s <= _STILL_THERE_S}

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._seen_s)


def video_description(view: FrameView, names: Iterable[str]) -> str:
    """People in view and label texts, or the message in place of the picture."""
    if view.frame is None:
        return sentences(view.words_without_picture())
    listed = ", ".join(names)
    people = tr("In the picture: {names}").format(names=listed) if listed else tr("Nobody in the picture")
    return sentences((people, *warnings_in(view.chips)))


def warnings_in(chips: Iterable[tuple[str, str]]) -> list[str]:
    return [text for text, role in chips if role == "warning"]


def sentences(parts: Iterable[str]) -> str:
    return " ".join(f"{part.rstrip('.')}." for part in parts if part)
