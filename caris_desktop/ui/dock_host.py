"""Dock panels arranged by a readable tree, and that tree read back from where the docks are."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from PySide6.QtCore import QEvent, QRect, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QResizeEvent, QShowEvent
from PySide6.QtWidgets import QApplication, QDockWidget, QMainWindow, QTabBar, QTabWidget, QWidget

from caris_desktop.scenario.model import LayoutNode, PanelLeaf, PanelName, SplitNode, TabNode
from caris_desktop.ui.panel import Panel, PanelTitleBar

_AREA = Qt.DockWidgetArea.TopDockWidgetArea


@dataclass(frozen=True, slots=True)
class Placed:
    """One panel, or several on top of one another, and the rectangle it fills."""

    node: PanelLeaf | TabNode
    left: int
    top: int
    right: int
    bottom: int


def panels_in(node: LayoutNode) -> tuple[PanelName, ...]:
    if isinstance(node, PanelLeaf):
        return (node.panel,)
    if isinstance(node, TabNode):
        return node.tabs
    return tuple(panel for child in node.children for panel in panels_in(child))


def without(node: LayoutNode, absent: frozenset[str]) -> LayoutNode | None:
    """The tree without some panels; None when nothing is left."""
    if isinstance(node, PanelLeaf):
        return None if node.panel in absent else node
    if isinstance(node, TabNode):
        tabs = tuple(panel for panel in node.tabs if panel not in absent)
        if len(tabs) > 1:
            return TabNode(tabs, node.current if node.current in tabs else tabs[0])
        return PanelLeaf(tabs[0]) if tabs else None
    kept = [
        (smaller, weight)
        for child, weight in zip(node.children, node.weights, strict=True)
        if (smaller := without(child, absent)) is not None
    ]
    if len(kept) <= 1:
        return kept[0][0] if kept else None
    return SplitNode(node.split, tuple(child for child, _ in kept), tuple(weight for _, weight in kept))


def with_tab(node: LayoutNode, beside: PanelName, panel: PanelName) -> LayoutNode:
    """The tree with ``panel`` in front of ``beside``, in one set of tabs."""
    if isinstance(node, SplitNode):
        return SplitNode(node.split, tuple(with_tab(child, beside, panel) for child in node.children), node.weights)
    if beside not in panels_in(node):
        return node
    return TabNode((*panels_in(node), panel), panel)


def tree_from_rectangles(placed: Sequence[Placed]) -> LayoutNode | None:
    """Cut the rectangles apart, first where a straight line passes between them, and so on inside each part."""
    if not placed:
        return None
    if len(placed) == 1:
        return placed[0].node
    for direction in ("horizontal", "vertical"):
        groups = _cut(placed, direction)
        if len(groups) > 1:
            sizes = [_extent(group, direction) for group in groups]
            children = [tree_from_rectangles(group) for group in groups]
            return SplitNode(
                direction,
                tuple(child for child in children if child is not None),
                tuple(round(size / sum(sizes), 3) for size in sizes),
            )
    # Overlapping rectangles (a panel is being dragged): keep everything, as tabs.
    names = tuple(name for item in placed for name in panels_in(item.node))
    return TabNode(names, names[0])


def _span(item: Placed, direction: str) -> tuple[int, int]:
    return (item.left, item.right) if direction == "horizontal" else (item.top, item.bottom)


def _cut(placed: Sequence[Placed], direction: Literal["horizontal", "vertical"]) -> list[list[Placed]]:
    groups: list[list[Placed]] = []
    reach = 0
    for item in sorted(placed, key=lambda item: _span(item, direction)):
        start, end = _span(item, direction)
        if not groups or start > reach:
            groups.append([item])
            reach = end
        else:
            groups[-1].append(item)
            reach = max(reach, end)
    return groups


def _extent(group: Sequence[Placed], direction: str) -> int:
    spans = [_span(item, direction) for item in group]
    return max(end for _, end in spans) - min(start for start, _ in spans)


class DockHost(QMainWindow):
    """The dock area. ``layout_changed`` follows each rearrangement by the wizard."""

    layout_changed = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowFlags(Qt.WindowType.Widget)
        self.setObjectName("dock_host")
        self.setDockOptions(QMainWindow.DockOption.AllowNestedDocks | QMainWindow.DockOption.AllowTabbedDocks)
        self.setTabPosition(Qt.DockWidgetArea.AllDockWidgetAreas, QTabWidget.TabPosition.North)
        self.setContextMenuPolicy(Qt.ContextMenuPolicy.NoContextMenu)
        self._docks: dict[PanelName, QDockWidget] = {}
        self._tree: LayoutNode | None = None
        self._arranging = False
        self._read_back = QTimer(self, singleShot=True, interval=0)
        self._read_back.timeout.connect(self._on_rearranged)

    @property
    def docks(self) -> Mapping[PanelName, QDockWidget]:
        return self._docks

    @property
    def tree(self) -> LayoutNode | None:
        """The arrangement as it stands, weights included; closed panels are left out."""
        return self._tree

    def clear(self) -> None:
        """Delete all docks with their panels."""
        self._arranging = True
        for dock in self._docks.values():
            self.removeDockWidget(dock)
            dock.hide()
            dock.setParent(None)
            dock.deleteLater()
        self._docks.clear()
        self._tree = None

    def show_layout(self, panels: Mapping[PanelName, Panel], tree: LayoutNode) -> None:
        """Replace everything by ``panels``, arranged as ``tree`` says."""
        self.clear()
        for name in panels_in(tree):
            self._docks[name] = self._make_dock(name, panels[name])
        first = self._docks[_representative(tree)]
        self.addDockWidget(_AREA, first)
        self._place(tree)
        self._tree = tree
        for dock in self._docks.values():
            dock.show()
        self._raise_current(tree)
        for dock in self._docks.values():
            dock.visibilityChanged.connect(self._schedule_read_back)
            dock.dockLocationChanged.connect(self._schedule_read_back)
        self._style_tabs()
        self._arranging = False
        self._apply_weights()

    def _style_tabs(self) -> None:
        for bar in self.findChildren(QTabBar):
            bar.setExpanding(False)
            bar.setDrawBase(False)
            # Many tabs in a narrow dock scroll: "D…" names no panel.
            bar.setElideMode(Qt.TextElideMode.ElideNone)
            bar.setUsesScrollButtons(True)
            bar.setAccessibleName("Panels in tabs")
        for dock in self._docks.values():
            title_bar = dock.titleBarWidget()
            if isinstance(title_bar, PanelTitleBar):
                title_bar.set_tabbed(bool(self.tabifiedDockWidgets(dock)))

    def is_open(self, name: PanelName) -> bool:
        """Whether the panel is there, be it behind another tab."""
        dock = self._docks.get(name)
        return dock is not None and not dock.isHidden()

    def add_panel(self, name: PanelName, panel: Panel, beside: Sequence[PanelName] = ()) -> None:
        """Add one panel in a tab in front of the first of ``beside`` that is open, else of any open one."""
        neighbour = next((each for each in (*beside, *self._docks) if self.is_open(each)), None)
        dock = self._docks[name] = self._make_dock(name, panel)
        self._arranging = True
        if neighbour is None:
            self.addDockWidget(_AREA, dock)
            self._tree = PanelLeaf(name)
        else:
            self.tabifyDockWidget(self._docks[neighbour], dock)
            self._tree = PanelLeaf(name) if self._tree is None else with_tab(self._tree, neighbour, name)
        dock.show()
        dock.raise_()
        dock.visibilityChanged.connect(self._schedule_read_back)
        dock.dockLocationChanged.connect(self._schedule_read_back)
        self._style_tabs()
        self._arranging = False
        self._apply_weights()
        self.layout_changed.emit()

    def remove_panel(self, name: PanelName) -> None:
        """Take the panel away and delete it."""
        dock = self._docks.pop(name, None)
        if dock is None:
            return
        self._arranging = True
        # The tree must not name a dock that is gone, not even until it is read back.
        self._tree = None if self._tree is None else without(self._tree, frozenset({name}))
        self.removeDockWidget(dock)
        dock.hide()
        dock.setParent(None)
        dock.deleteLater()
        self._style_tabs()
        self._arranging = False
        self._apply_weights()
        self.layout_changed.emit()

    def _make_dock(self, name: PanelName, panel: Panel) -> QDockWidget:
        # With a parent from the first: else it is a window for a moment, and takes the activation from ours.
        dock = QDockWidget(panel.shown_title, self)
        panel.title_changed.connect(dock.setWindowTitle)
        dock.setObjectName(f"dock_{name}")
        dock.setFeatures(
            QDockWidget.DockWidgetFeature.DockWidgetClosable | QDockWidget.DockWidgetFeature.DockWidgetMovable
        )
        dock.setTitleBarWidget(PanelTitleBar(panel))
        dock.setWidget(panel)
        # Behind another tab a widget still counts as visible for Qt; the dock knows better.
        dock.visibilityChanged.connect(panel.set_in_view)
        return dock

    def close_panel(self, name: PanelName) -> None:
        """Hide the panel; ``show_panel`` brings it back where it was."""
        dock = self._docks.get(name)
        if dock is not None:
            dock.close()

    def show_panel(self, name: PanelName) -> None:
        """Open the panel if it is closed and bring it to the front of its tabs."""
        dock = self._docks.get(name)
        if dock is not None:
            dock.show()
            dock.raise_()

    def _place(self, node: LayoutNode) -> None:
        if isinstance(node, TabNode):
            for earlier, later in itertools.pairwise(node.tabs):
                self.tabifyDockWidget(self._docks[earlier], self._docks[later])
        elif isinstance(node, SplitNode):
            orientation = _orientation(node)
            first_docks = [self._docks[_representative(child)] for child in node.children]
            for before, after in itertools.pairwise(first_docks):
                self.splitDockWidget(before, after, orientation)
            for child in node.children:
                self._place(child)

    def _raise_current(self, node: LayoutNode) -> None:
        if isinstance(node, TabNode):
            self._docks[node.current or node.tabs[0]].raise_()
        elif isinstance(node, SplitNode):
            for child in node.children:
                self._raise_current(child)

    def _apply_weights(self) -> None:
        if self._tree is None or not self.isVisible():
            return
        self._arranging = True
        # Outer splits first: an inner one can only divide what the outer one gave it.
        self._resize(self._tree, self.size())
        self._arranging = False

    def _resize(self, node: LayoutNode, size: QSize) -> None:
        if not isinstance(node, SplitNode):
            return
        horizontal = node.split == "horizontal"
        whole = (size.width() if horizontal else size.height()) - 8 * (len(node.children) - 1)
        total = sum(node.weights)
        lengths = [max(1, round(whole * weight / total)) for weight in node.weights]
        docks = [self._docks[_representative(child)] for child in node.children]
        self.resizeDocks(docks, lengths, _orientation(node))
        for child, length in zip(node.children, lengths, strict=True):
            self._resize(child, QSize(length, size.height()) if horizontal else QSize(size.width(), length))

    def read_layout(self) -> LayoutNode | None:
        """The tree that the docks form now."""
        placed: list[Placed] = []
        seen: set[PanelName] = set()
        for name, dock in self._docks.items():
            if name in seen or dock.isHidden() or dock.isFloating():
                continue
            group = [name, *self._tabbed_with(dock)]
            seen.update(group)
            front = next((member for member in group if not self._docks[member].visibleRegion().isEmpty()), name)
            rectangle: QRect = self._docks[front].geometry()
            node: PanelLeaf | TabNode = (
                PanelLeaf(name) if len(group) == 1 else TabNode(tuple(self._tab_order(group)), front)
            )
            placed.append(Placed(node, rectangle.left(), rectangle.top(), rectangle.right(), rectangle.bottom()))
        return tree_from_rectangles(placed)

    def _tabbed_with(self, dock: QDockWidget) -> list[PanelName]:
        by_dock = {id(candidate): name for name, candidate in self._docks.items()}
        return [
            by_dock[id(other)]
            for other in self.tabifiedDockWidgets(dock)
            if id(other) in by_dock and not other.isHidden()
        ]

    def _tab_order(self, group: Sequence[PanelName]) -> list[PanelName]:
        titles = {self._docks[name].windowTitle(): name for name in group}
        for bar in self.findChildren(QTabBar):
            texts = [bar.tabText(index) for index in range(bar.count())]
            if set(texts) == set(titles):
                return [titles[text] for text in texts]
        return list(group)

    def _schedule_read_back(self) -> None:
        if not self._arranging and self.isVisible():
            self._read_back.start()

    def _on_rearranged(self) -> None:
        self._style_tabs()
        tree = self.read_layout()
        if tree is not None and tree != self._tree:
            self._tree = tree
            self.layout_changed.emit()

    def event(self, event: QEvent) -> bool:
        handled = super().event(event)
        if event.type() == QEvent.Type.MouseButtonRelease:
            self._schedule_read_back()
        return bool(handled)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        # Qt gives what a resize adds to whatever is hungriest; the weights say who should have it.
        if self._tree is not None and not QApplication.mouseButtons():
            self._apply_weights()
        elif self._tree is not None:
            QTimer.singleShot(0, self, self._apply_weights)

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        QTimer.singleShot(0, self, self._apply_weights)


def _representative(node: LayoutNode) -> PanelName:
    return panels_in(node)[0]


def _orientation(node: SplitNode) -> Qt.Orientation:
    return Qt.Orientation.Horizontal if node.split == "horizontal" else Qt.Orientation.Vertical
