"""Layout trees: remove, insert and resize panels; each function returns a new tree."""

from collections.abc import Callable, Collection, Iterator
from typing import Literal

from caris_desktop.scenario.scenario_model import LayoutNode, PanelLeaf, PanelName, SplitNode, TabNode, panels_in

Side = Literal["tab", "left", "right", "above", "below"]
"""Position of a panel relative to another: in its tab group, or at a side."""
_DIGITS = 4  # of a share: a tenth of a pixel on the widest screen


def groups_in(node: LayoutNode) -> Iterator[PanelLeaf | TabNode]:
    """Single panels and tab groups, from left to right and top to bottom."""
    if isinstance(node, SplitNode):
        for child in node.children:
            yield from groups_in(child)
    else:
        yield node


def with_group(node: LayoutNode, panel: PanelName, change: Callable[[PanelLeaf | TabNode], LayoutNode]) -> LayoutNode:
    """The tree with the group of ``panel`` changed."""
    if isinstance(node, SplitNode):
        children = tuple(with_group(child, panel, change) for child in node.children)
        return SplitNode(node.split, children, node.weights)
    return change(node) if panel in panels_in(node) else node


def front_of(group: PanelLeaf | TabNode) -> PanelName:
    if isinstance(group, PanelLeaf):
        return group.panel
    return group.current if group.current is not None else group.tabs[0]


def shares(node: SplitNode) -> tuple[float, ...]:
    """Weights normalised to a sum of one."""
    total = sum(node.weights)
    return tuple(weight / total for weight in node.weights)


def tidy(node: LayoutNode) -> LayoutNode:
    """Canonical form: no tab group of one panel, no split nested in a split of the same direction, normalised weights,
    and an explicit current tab.
    """
    if isinstance(node, PanelLeaf):
        return node
    if isinstance(node, TabNode):
        if len(node.tabs) == 1:
            return PanelLeaf(node.tabs[0])
        return TabNode(node.tabs, node.current if node.current in node.tabs else node.tabs[0])
    flat: list[tuple[LayoutNode, float]] = []
    for child, share in zip(map(tidy, node.children), shares(node), strict=True):
        if isinstance(child, SplitNode) and child.split == node.split:
            flat.extend((inner, share * part) for inner, part in zip(child.children, shares(child), strict=True))
        else:
            flat.append((child, share))
    if len(flat) == 1:
        return flat[0][0]
    return SplitNode(node.split, tuple(child for child, _ in flat), _rounded([share for _, share in flat]))


def _rounded(parts: list[float]) -> tuple[float, ...]:
    """Shares rounded to few digits that still sum to one, so that the canonical form is stable."""
    if sum(parts) == 1 and all(round(part, _DIGITS) == part for part in parts):
        return tuple(parts)
    unit = 10**_DIGITS
    units = [max(1, round(part / sum(parts) * unit)) for part in parts]
    units[units.index(max(units))] += unit - sum(units)
    return tuple(part / unit for part in units)


def without(node: LayoutNode, absent: Collection[str]) -> LayoutNode | None:
    """The tree without some panels; None if nothing is left."""
    if isinstance(node, PanelLeaf):
        return None if node.panel in absent else node
    if isinstance(node, TabNode):
        tabs = tuple(panel for panel in node.tabs if panel not in absent)
        if len(tabs) > 1:
            return TabNode(tabs, node.current if node.current in tabs else tabs[0])
        return PanelLeaf(tabs[0]) if tabs else None
    remaining = [
        (smaller, weight)
        for child, weight in zip(node.children, node.weights, strict=True)
        if (smaller := without(child, absent)) is not None
    ]
    if len(remaining) <= 1:
        return remaining[0][0] if remaining else None
    return SplitNode(node.split, tuple(child for child, _ in remaining), tuple(weight for _, weight in remaining))


def permitted(node: LayoutNode, possible: Collection[str]) -> LayoutNode:
    """The tree without panels that are not possible; only the video if nothing is left."""
    return without(node, frozenset(panels_in(node)) - frozenset(possible)) or PanelLeaf("video")


def with_the_panels_of(tree: LayoutNode, arranged: LayoutNode) -> LayoutNode:
    """``arranged`` with exactly the panels of ``tree``: missing ones are added to its last tab group."""
    panels = panels_in(tree)
    result = without(arranged, frozenset(panels_in(arranged)) - frozenset(panels))
    if result is None:
        return tree
    for panel in panels:
        if panel not in panels_in(result):
            last = panels_in(result)[-1]
            front = next(front_of(group) for group in groups_in(result) if last in panels_in(group))
            result = with_current(with_tab(result, last, panel), front)
    return result


def with_tab(node: LayoutNode, beside: PanelName, panel: PanelName, at: int | None = None) -> LayoutNode:
    """The tree with ``panel`` as the current tab in the group of ``beside``, at index ``at`` or last."""

    def inserted(group: PanelLeaf | TabNode) -> TabNode:
        tabs = panels_in(group)
        index = len(tabs) if at is None else max(0, min(at, len(tabs)))
        return TabNode((*tabs[:index], panel, *tabs[index:]), panel)

    return with_group(node, beside, inserted)


def place_next_to(
    node: LayoutNode, beside: PanelName, panel: PanelName, side: Side, at: int | None = None
) -> LayoutNode:
    """Canonical tree with the new ``panel`` at ``side`` of the group of ``beside``, with half of its space."""
    if side == "tab":
        return tidy(with_tab(node, beside, panel, at))
    return tidy(with_group(node, beside, lambda group: _pair(group, PanelLeaf(panel), side, 0.5)))


def put_at_edge(node: LayoutNode, panel: PanelName, side: Side, share: float = 0.25) -> LayoutNode:
    """Canonical tree with ``panel`` at an outer edge."""
    return tidy(_pair(node, PanelLeaf(panel), side, share))


def _pair(node: LayoutNode, new: LayoutNode, side: Side, share: float) -> SplitNode:
    split: Literal["horizontal", "vertical"] = "horizontal" if side in ("left", "right") else "vertical"
    if side in ("left", "above"):
        return SplitNode(split, (new, node), (share, 1 - share))
    return SplitNode(split, (node, new), (1 - share, share))


def with_current(node: LayoutNode, panel: PanelName) -> LayoutNode:
    """The tree with the panel as its group's current tab."""
    return with_group(node, panel, lambda group: TabNode(group.tabs, panel) if isinstance(group, TabNode) else group)


def with_weights(node: LayoutNode, path: tuple[int, ...], weights: tuple[float, ...]) -> LayoutNode:
    """The tree with new weights in the split at ``path`` (child indices)."""
    if not path:
        return SplitNode(split_at(node, ()).split, split_at(node, ()).children, _rounded(list(weights)))
    split, (first, *rest) = split_at(node, ()), path
    children = list(split.children)
    children[first] = with_weights(children[first], tuple(rest), weights)
    return SplitNode(split.split, tuple(children), split.weights)


def path_of(node: LayoutNode, panel: PanelName) -> tuple[int, ...]:
    """Child indices that lead to the panel's group; empty if the whole tree is that group, or if no group has it."""
    if not isinstance(node, SplitNode):
        return ()
    for number, child in enumerate(node.children):
        if panel in panels_in(child):
            return (number, *path_of(child, panel))
    return ()


def split_at(node: LayoutNode, path: tuple[int, ...]) -> SplitNode:
    for index in path:
        node = split_at(node, ()).children[index]
    if not isinstance(node, SplitNode):
        raise TypeError("there is no split at that path")
    return node


def shape(node: LayoutNode) -> object:
    """Structure of the tree without weights and current tabs."""
    if isinstance(node, SplitNode):
        return (node.split, tuple(shape(child) for child in node.children))
    return panels_in(node)


def differs(tree: LayoutNode, other: LayoutNode, *, by: float | None) -> bool:
    """Whether panels are placed differently, or any share differs by more than ``by``. Current tabs do not count."""
    if isinstance(tree, SplitNode) and isinstance(other, SplitNode):
        if (tree.split, len(tree.children)) != (other.split, len(other.children)):
            return True
        both = zip(shares(tree), shares(other), strict=True)
        if by is not None and any(abs(before - after) > by for before, after in both):
            return True
        return any(differs(*children, by=by) for children in zip(tree.children, other.children, strict=True))
    return shape(tree) != shape(other)
