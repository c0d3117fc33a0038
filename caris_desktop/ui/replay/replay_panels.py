"""Scroll area for the panels of a replay, above the timeline. They only display."""

from PySide6.QtCore import QSize, Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QFrame, QScrollArea

from caris_desktop.scenario.scenario_model import LayoutNode, PanelLeaf, PanelName, TabNode
from caris_desktop.ui.dock_host import DockHost

LEAST_PX = 200
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
    """On a low screen the panels scroll, at a height that shows the whole video without scrolling."""

    def __init__(self, docks: DockHost) -> None:
        super().__init__()
        self.setObjectName("replay_panels")
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self._least_px = LEAST_PX
        self.setMinimumHeight(LEAST_PX)
        self._docks = docks
        self.setWidget(docks)
        docks.layout_changed.connect(self.fit)

    def set_least(self, height_px: int) -> None:
        """Set the minimum height."""
        self._least_px = height_px
        self.setMinimumHeight(height_px)
        self.updateGeometry()

    def minimumSizeHint(self) -> QSize:
        return QSize(super().minimumSizeHint().width(), self._least_px)

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
