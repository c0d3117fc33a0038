"""What turns the window into one of a replay: panels that scroll, the timeline below them, and the bar."""

from PySide6.QtWidgets import QSplitter, QVBoxLayout, QWidget

from caris_desktop.live.state import LiveState
from caris_desktop.live.wizard_console import ReplayControls
from caris_desktop.ui.actions import Actions
from caris_desktop.ui.dock_host import DockHost
from caris_desktop.ui.replay.replay_bar import ReplayBar
from caris_desktop.ui.replay.replay_panels import ReplayPanels
from caris_desktop.ui.replay.timeline_view import TimelineView
from caris_desktop.ui.theme import Theme

_PANELS_AND_TIMELINE_PX = (600, 260)


class ReplayParts:
    """The timeline and the bar, with their keys; ``arrange`` puts them into the window."""

    def __init__(self, theme: Theme, replay: ReplayControls, state: LiveState, actions: Actions) -> None:
        self.timeline = TimelineView(theme, replay, state, actions)
        self._bar = ReplayBar(theme, replay, actions)
        self._panels: ReplayPanels | None = None

    def arrange(self, docks: DockHost, middle: QSplitter, column: QVBoxLayout, status_bar: QWidget) -> None:
        """The timeline below ``docks`` in the ``middle`` of the window, the bar above the status bar."""
        self._panels = ReplayPanels(docks)
        middle.insertWidget(0, self._panels)
        middle.addWidget(self.timeline)
        middle.setStretchFactor(0, 1)
        middle.setStretchFactor(1, 0)
        middle.setSizes(list(_PANELS_AND_TIMELINE_PX))
        column.insertWidget(column.indexOf(status_bar), self._bar)

    def fit(self) -> None:
        """The panels were built anew."""
        if self._panels is not None:
            self._panels.fit()
