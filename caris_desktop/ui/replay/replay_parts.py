"""Replay mode of the main window: scrolling panels, the timeline below them, and the replay bar."""

from PySide6.QtCore import QEvent, QObject, Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QFrame, QScrollArea, QSplitter, QVBoxLayout, QWidget

from caris_desktop.live.state import LiveState
from caris_desktop.live.wizard_console import ReplayControls
from caris_desktop.scenario.scenario_model import LayoutNode, PanelLeaf, PanelName, TabNode
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.dock_host import DockHost
from caris_desktop.ui.panel import TITLE_HEIGHT_PX
from caris_desktop.ui.replay.replay_bar import ReplayBar
from caris_desktop.ui.replay.timeline_view import LOW_PX, TimelineView
from caris_desktop.ui.theme import Theme

_PANELS_AND_TIMELINE_PX = (600, 260)
_SMALL_BELOW_PX = (880, 600)
"""Below this window size, the bar has a single line and the panels are lower."""

_LOWEST_PX = 380
_LEAST_PANELS_PX = 120
DRAWER_BELOW_PX = _LEAST_PANELS_PX + 8 + LOW_PX
"""Below this total height, only one of panels and timeline is open at a time."""


class ReplayWidgets(QObject):
    """Timeline and replay bar with their keys; ``arrange`` places them in the window."""

    def __init__(self, theme: Theme, replay: ReplayControls, state: LiveState, actions: Actions) -> None:
        super().__init__()
        self.timeline = TimelineView(theme, replay, state, actions)
        self.timeline.open_requested.connect(self._open_timeline)
        self._bar = ReplayBar(theme, replay, actions)
        self._panels: ReplayPanels | None = None
        self._middle: QSplitter | None = None
        self._window: QWidget | None = None
        self._small: bool | None = None
        self._drawer = self._timeline_open = False

    def arrange(self, docks: DockHost, middle: QSplitter, column: QVBoxLayout, status_bar: QWidget) -> None:
        """Place the timeline below ``docks`` in the ``middle`` of the window, and the bar above the status bar."""
        self._panels, self._middle, self._window = ReplayPanels(docks), middle, middle.window()
        middle.insertWidget(0, self._panels)
        middle.addWidget(self.timeline)
        middle.setStretchFactor(0, 1)
        middle.setStretchFactor(1, 0)
        middle.setSizes(list(_PANELS_AND_TIMELINE_PX))
        column.insertWidget(column.indexOf(status_bar), self._bar)
        for watched in (self._window, middle):
            watched.installEventFilter(self)
        # Otherwise the window could be shrunk only in steps.
        self._window.setMinimumHeight(_LOWEST_PX)
        self._use_window_size()

    def fit(self) -> None:
        """Adjust after the panels were rebuilt."""
        if self._panels is not None:
            self._panels.fit()

    def show_panels(self) -> None:
        """Close the timeline if it is a drawer over the panels."""
        if self._drawer and self._timeline_open:
            self._open_timeline(False)

    def take_focus(self) -> None:
        """Take the focus: no field gets typed keys in a replay, and Space plays."""
        taker = self._window if self._drawer and not self._timeline_open else self.timeline
        if taker is not None:
            taker.setFocus(Qt.FocusReason.OtherFocusReason)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        if event.type() == QEvent.Type.Resize:
            if watched is self._window:
                self._use_window_size()
            elif watched is self._middle:
                self._use_room()
        return False

    def _use_window_size(self) -> None:
        if self._window is None or self._panels is None:
            return
        small = self._window.width() < _SMALL_BELOW_PX[0] or self._window.height() < _SMALL_BELOW_PX[1]
        if small != self._small:
            self._small = small
            self._bar.set_one_line(small)
            self._panels.setMinimumHeight(_LEAST_PANELS_PX if small else PANELS_LEAST_PX)

    def _use_room(self) -> None:
        if self._middle is None or self._window is None:
            return
        drawer = self._middle.height() < DRAWER_BELOW_PX
        if drawer != self._drawer:
            self._drawer = drawer
            had_focus = self._window.focusWidget() is self.timeline.canvas
            self._show_drawer()
            if had_focus:
                self.take_focus()

    def _open_timeline(self, opened: bool) -> None:
        self._timeline_open = opened
        self._show_drawer()
        self.take_focus()

    def _show_drawer(self) -> None:
        """Show the panels with the timeline's title below, or the timeline."""
        if self._panels is None or self._middle is None:
            return
        self.timeline.show_as_drawer(None if not self._drawer else self._timeline_open)
        self._panels.setVisible(not (self._drawer and self._timeline_open))
        timeline_px = _PANELS_AND_TIMELINE_PX[1]
        if self._drawer:
            timeline_px = TITLE_HEIGHT_PX
        elif self._small:
            timeline_px = LOW_PX
        self._middle.setSizes([max(1, self._middle.height() - timeline_px), timeline_px])


PANELS_LEAST_PX = 200
_LEAST_PANEL_PX = 56


def lower_edge(node: LayoutNode, panel: PanelName) -> float | None:
    """Lower edge of the panel as a share of the tree's height; None if it is not in the tree."""
    if isinstance(node, PanelLeaf):
        return 1.0 if node.panel == panel else None
    if isinstance(node, TabNode):
        return 1.0 if panel in node.tabs else None
    above, total = 0.0, sum(node.weights)
    for child, weight in zip(node.children, node.weights, strict=True):
        edge = lower_edge(child, panel)
        if edge is not None:
            return edge if node.split == "horizontal" else (above + edge * weight) / total
        above += weight
    return None


class ReplayPanels(QScrollArea):
    """Scroll area for the panels of a replay, above the timeline. They only display.

    On a low screen the panels scroll, at a height that shows the whole video without scrolling.
    """

    def __init__(self, docks: DockHost) -> None:
        super().__init__()
        self.setObjectName("replay_panels")
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setMinimumHeight(PANELS_LEAST_PX)
        self._docks = docks
        self.setWidget(docks)
        docks.layout_changed.connect(self.fit)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self.fit()

    def fit(self) -> None:
        """Set the height at which the video ends at the bottom of the view."""
        tree = self._docks.tree
        edge = lower_edge(tree, "video") if tree is not None else None
        for dock in self._docks.docks.values():
            panel = dock.widget()
            if panel is not None:
                # Panels' own minimum sizes are for operating them, which a replay does not.
                panel.setMinimumHeight(_LEAST_PANEL_PX)
        self._docks.setMinimumHeight(round(self.viewport().height() / edge) if edge else 0)
