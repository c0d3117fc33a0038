"""What a screen reader says by itself, wherever the wizard is in the window: alarms, refusals, questions, stops."""

import sys
from functools import partial

from PySide6.QtCore import QObject, QTimer
from PySide6.QtGui import QAccessible, QAccessibleAnnouncementEvent
from PySide6.QtWidgets import QWidget

from caris_desktop.domain import events
from caris_desktop.domain.actor import OTHER_WIZARD
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui.event_words import event_sentence
from caris_desktop.ui.people.shown_people import name_of

KEPT_MS = 10_000
"""A screen reader on a busy machine asks late for what came up."""


class Announcement(QWidget):
    """One sentence, as a notification that comes up: on Linux screen readers say those, and only newer ones hear of
    Qt's announcements.
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
        """Once more where it is there already."""
        self.hide()
        self.show()
        self._goes.start()


class Announcements(QObject):
    """What happens without a word of its own on the screen: a goal is reached, the stop released, a recording begins,
    another wizard does something. What comes up as a card or a band announces itself.
    """

    def __init__(self, window: QWidget, console: WizardConsole) -> None:
        super().__init__(window)
        self._window, self._console = window, console
        if console.state.present.live:
            console.state.event_happened.connect(self._on_event)

    def _on_event(self, event: object) -> None:
        if not QAccessible.isActive():
            return
        match event:
            case events.EmergencyStopChanged(latched=latched):
                own = not latched  # the band says that it is on
            case events.LinkChanged(state=state):
                own = state == "connected"
            case events.GoalChanged() | events.SessionStarted() | events.SessionEnded() | events.RecordingPaused():
                own = True
            case _:
                own = False
        if own or getattr(event, "actor", "").startswith(OTHER_WIZARD):
            told = event_sentence(event, partial(name_of, self._console))
            announce(self._window, "" if told is None else told[1])


def announce(widget: QWidget, text: str) -> None:
    """Have it said now, in the window of ``widget``; nothing without a screen reader."""
    if not text or not QAccessible.isActive():
        return
    window = widget.window()
    if sys.platform != "linux":
        QAccessible.updateAccessibility(QAccessibleAnnouncementEvent(window, text))
        return
    there = (one for one in window.findChildren(Announcement) if one.accessibleName() == text)
    (next(there, None) or Announcement(window, text)).say()
