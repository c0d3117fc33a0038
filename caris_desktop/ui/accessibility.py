"""Accessible roles and descriptions of self-painted widgets, and screen reader announcements.

Qt reports an unknown class as ``Client``, which screen readers skip. A widget class sets ``accessible_role``
(:func:`has_role` for a class that is not ours) and, where its name does not say what it shows, ``accessible_words()``,
which is called only when a screen reader asks; setting a description makes a screen reader ask. ``accessible_parts()``
returns widgets that Qt does not report: those in a table, which has only cells.
"""

import sys
from collections.abc import Sequence
from functools import partial

from PySide6.QtCore import QObject, QTimer
from PySide6.QtGui import QAccessible, QAccessibleAnnouncementEvent, QAccessibleInterface
from PySide6.QtWidgets import QAccessibleWidget, QWidget

from caris_desktop.domain import events
from caris_desktop.domain.actor import OTHER_WIZARD
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import IN_SESSION, RecordingStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui.event_messages import event_sentence
from caris_desktop.ui.focus_widget import window_of
from caris_desktop.ui.people.shown_people import name_of

_ROLE = "accessible_role"


class _Interface(QAccessibleWidget):
    """Accessible interface that holds no reference to its widget, and so does not prolong its life."""

    def text(self, kind: QAccessible.Text) -> str:
        words = getattr(self.object(), "accessible_words", None) if kind == QAccessible.Text.Description else None
        return super().text(kind) if words is None else str(words())

    def childCount(self) -> int:
        return super().childCount() + len(self._parts())

    def child(self, index: int) -> QAccessibleInterface:
        own = super().childCount()
        return super().child(index) if index < own else QAccessible.queryAccessibleInterface(self._parts()[index - own])

    def _parts(self) -> Sequence[QWidget]:
        parts = getattr(self.object(), "accessible_parts", None)
        return () if parts is None else parts()


def install_accessible_roles() -> None:
    """Install the factory once per application, before the first widget is shown; PySide keeps the reference given
    here.
    """
    if not _installed:
        _installed.append(_interface)
        QAccessible.installFactory(_interface)


_installed: list[object] = []


def has_role(widget: QWidget, role: QAccessible.Role) -> None:
    """Set the role of a widget. Call it before setting the name, because Qt may query the role at once."""
    setattr(widget, _ROLE, role)


def _interface(_class_name: str, thing: QObject | None) -> QAccessibleInterface | None:
    """Accessible interface of a widget; Qt asks for each class of the widget, most derived first."""
    role = getattr(thing, _ROLE, None)
    if role is None or not isinstance(thing, QWidget):
        return None
    return _Interface(thing, role)


KEPT_MS = 10_000
"""Lifetime in ms: a screen reader on a busy machine queries late."""
_AFTER_CHANGES_MS = 1000  # Orca drops what comes while more than fifty changes of the window wait


class Announcement(QWidget):
    """One sentence as a notification widget: screen readers on Linux speak these, and only newer ones handle Qt's
    announcement events.
    """

    accessible_role = QAccessible.Role.Notification

    def __init__(self, window: QWidget, text: str) -> None:
        super().__init__(window)
        self.setObjectName("announcement")
        self.setAccessibleName(text)
        self.setFixedSize(1, 1)
        self._goes = QTimer(self, singleShot=True, interval=KEPT_MS)
        self._goes.timeout.connect(self.deleteLater)

    def say(self) -> None:
        """Announce it; again if it is already visible."""
        self.hide()
        self.show()
        self._goes.start()


class Announcements(QObject):
    """Announces events without a widget of their own: goal reached, stop released, recording started, photo taken,
    another wizard's actions. Popups and banners announce themselves.
    """

    def __init__(self, window: QWidget, console: WizardConsole) -> None:
        super().__init__(window)
        self._window, self._console = window, console
        self._recording = console.state.recording.value
        if console.state.present.live:
            console.state.event_happened.connect(self._on_event)
            console.state.recording.changed.connect(self._on_recording)

    def _on_event(self, event: object) -> None:
        if not QAccessible.isActive():
            return
        match event:
            case events.EmergencyStopChanged(latched=latched):
                announces = not latched  # the emergency banner announces the stop
            case events.LinkChanged(state=state):
                announces = state == "connected"
            case events.GoalChanged() | events.PhotoTaken() | events.PersonRenamed() | events.Marked():
                announces = True
            case _:
                announces = False
        if announces or getattr(event, "actor", "").startswith(OTHER_WIZARD):
            # Deferred, as the console knows a person's new name only after the event.
            QTimer.singleShot(0, self, partial(self._announce, event))

    def _announce(self, event: object) -> None:
        sentence = event_sentence(event, partial(name_of, self._console))
        announce(self._window, "" if sentence is None else sentence[1])

    def _on_recording(self, status: RecordingStatus) -> None:
        """Announce the start, pauses and the end, whose events are only in the record."""
        before, self._recording = self._recording, status
        folder = status.folder or before.folder
        if status.state == before.state or folder is None:
            return
        match status.state:
            case "recording" if before.state == "paused":
                text = tr("Recording resumed")
            case "recording":
                text = tr("Recording started ({folder})").format(folder=folder.name)
            case "paused":
                text = tr("Recording paused")
            case "idle" if before.state in IN_SESSION:
                text = tr("Recording ended ({folder})").format(folder=folder.name)
            case _:
                text = ""
        QTimer.singleShot(_AFTER_CHANGES_MS, self, partial(announce, self._window, text))


def announce(widget: QWidget, text: str) -> None:
    """Announce ``text`` in the window of ``widget``; does nothing without a screen reader."""
    if not text or not QAccessible.isActive():
        return
    window = window_of(widget)
    if sys.platform != "linux":
        QAccessible.updateAccessibility(QAccessibleAnnouncementEvent(window, text))
        return
    there = (one for one in window.findChildren(Announcement) if one.accessibleName() == text)
    (next(there, None) or Announcement(window, text)).say()
