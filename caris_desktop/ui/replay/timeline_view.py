"""The timeline of a replay: what happened and what coders make of it, in tiers under one ruler."""

from PySide6.QtWidgets import QWidget

from caris_desktop.live.intents import ReplayControls
from caris_desktop.live.state import LiveState
from caris_desktop.ui.actions import Actions
from caris_desktop.ui.theme import Theme


class TimelineView(QWidget):
    """Shows the record and edits annotations; ``actions`` gets the keys of the timeline."""

    def __init__(self, theme: Theme, replay: ReplayControls, state: LiveState, actions: Actions) -> None:
        super().__init__()
        self.setObjectName("timeline_view")
        self._theme = theme
        self._replay = replay
        self._state = state

    def give_up(self) -> None:
        """Esc: whatever was begun in the timeline is forgotten. The window connects it to ``escape_pressed``."""
