"""Displayed dock layout, computed only from the rectangles of the panels."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from caris_desktop.scenario.scenario_model import LayoutNode, PanelLeaf, SplitNode, TabNode
from caris_desktop.ui.dock_host import DockHost


@dataclass(frozen=True)
class Placed:
    """One panel, or several as tabs, and its rectangle."""

    node: PanelLeaf | TabNode
    left: int
    top: int
    right: int
    bottom: int


def seen_in(host: DockHost) -> LayoutNode | None:
    """Displayed layout of the main window."""
    return tree_from_rectangles(shown_in(host))


def shown_in(host: DockHost) -> list[Placed]:
    """Panels in the main window: docks by their rectangles, tabs by their texts."""
    titles = {dock.windowTitle(): name for name, dock in host.docks.items()}
    placed = []
    for name, dock in host.docks.items():
        if not dock.isVisible() or dock.parentWidget() is not host:
            continue
        place = dock.geometry()
        node: PanelLeaf | TabNode = PanelLeaf(name)
        for bar in host.bars:
            tabs = tuple(titles[bar.tabText(index)] for index in range(bar.count()))
            if name in tabs:
                node = TabNode(tabs, titles[bar.tabText(bar.currentIndex())])
                place = place.united(bar.geometry())
        placed.append(Placed(node, place.left(), place.top(), place.right(), place.bottom()))
    return sorted(placed, key=str)


def tree_from_rectangles(placed: Sequence[Placed]) -> LayoutNode | None:
    """Split the rectangles recursively along straight lines between them."""
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
    raise AssertionError(f"panels lie over one another: {placed}")


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
