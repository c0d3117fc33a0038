"""Trees of panels: taking a panel out, putting it somewhere, sharing the room; each gives a new tree."""

from collections.abc import Collection, Iterator
from typing import Literal

from caris_desktop.scenario.model import LayoutNode, PanelLeaf, PanelName, SplitNode, TabNode

Side = Literal["tab", "left", "right", "above", "below"]
"""Where a panel goes in relation to another: into one set of tabs with it, or beside it."""
_DIGITS = 4  # of a share: a tenth of a pixel on the widest screen


def panels_in(node: LayoutNode) -> tuple[PanelName, ...]:
    if isinstance(node, PanelLeaf):
        return (node.panel,)
    if isinstance(node, TabNode):
        return node.tabs
    return tuple(panel for child in node.children for panel in panels_in(child))


def groups_in(node: LayoutNode) -> Iterator[PanelLeaf | TabNode]:
    """Panels alone and sets of tabs, from left and top."""
    if isinstance(node, SplitNode):
        for child in node.children:
            yield from groups_in(child)
    else:
        yield node


def front_of(group: PanelLeaf | TabNode) -> PanelName:
    if isinstance(group, PanelLeaf):
        return group.panel
    return group.current if group.current is not None else group.tabs[0]


def shares(node: SplitNode) -> tuple[float, ...]:
    """The weights as parts of one."""
    total = sum(node.weights)
    return tuple(weight / total for weight in node.weights)


def tidy(node: LayoutNode) -> LayoutNode:
    """The same arrangement as it is always written: no tabs of one panel, no split in a split of its direction, and
    weights that are shares of one. A current tab is always named.
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
    """Shares with few digits that add up to one, so that they stay as they are when they are tidied again."""
    if sum(parts) == 1 and all(round(part, _DIGITS) == part for part in parts):
        return tuple(parts)
    unit = 10**_DIGITS
    whole = [max(1, round(part / sum(parts) * unit)) for part in parts]
    whole[whole.index(max(whole))] += unit - sum(whole)
    return tuple(part / unit for part in whole)


def without(node: LayoutNode, absent: Collection[str]) -> LayoutNode | None:
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


def permitted(node: LayoutNode, possible: Collection[str]) -> LayoutNode:
    """The tree without panels that are not possible; the picture where nothing else is."""
    return without(node, frozenset(panels_in(node)) - frozenset(possible)) or PanelLeaf("video")


def with_the_panels_of(tree: LayoutNode, arranged: LayoutNode) -> LayoutNode:
    """``arranged`` with the panels of ``tree`` and no others: what it lacks comes into the tabs of its last group."""
    wanted = panels_in(tree)
    result = without(arranged, frozenset(panels_in(arranged)) - frozenset(wanted))
    if result is None:
        return tree
    for panel in wanted:
        if panel not in panels_in(result):
            last = panels_in(result)[-1]
            front = next(front_of(group) for group in groups_in(result) if last in panels_in(group))
            result = with_current(with_tab(result, last, panel), front)
    return result


def with_tab(node: LayoutNode, beside: PanelName, panel: PanelName, at: int | None = None) -> LayoutNode:
    """The tree with ``panel`` in front of ``beside``, in one set of tabs; as its ``at``-th, or else the last one."""
    if isinstance(node, SplitNode):
        children = tuple(with_tab(child, beside, panel, at) for child in node.children)
        return SplitNode(node.split, children, node.weights)
    tabs = panels_in(node)
    if beside not in tabs:
        return node
    index = len(tabs) if at is None else max(0, min(at, len(tabs)))
    return TabNode((*tabs[:index], panel, *tabs[index:]), panel)


def put_beside(node: LayoutNode, beside: PanelName, panel: PanelName, side: Side, at: int | None = None) -> LayoutNode:
    """The tidy tree with ``panel``, which is not in it, at ``side`` of the group of ``beside``: it takes half of its
    room.
    """
    if side == "tab":
        return tidy(with_tab(node, beside, panel, at))
    return tidy(_split_group(node, beside, panel, side))


def _split_group(node: LayoutNode, beside: PanelName, panel: PanelName, side: Side) -> LayoutNode:
    if isinstance(node, SplitNode):
        return SplitNode(
            node.split, tuple(_split_group(child, beside, panel, side) for child in node.children), node.weights
        )
    return _pair(node, PanelLeaf(panel), side, 0.5) if beside in panels_in(node) else node


def put_at_edge(node: LayoutNode, panel: PanelName, side: Side, share: float = 0.25) -> LayoutNode:
    """The tidy tree with ``panel`` beside everything else."""
    return tidy(_pair(node, PanelLeaf(panel), side, share))


def _pair(node: LayoutNode, new: LayoutNode, side: Side, share: float) -> SplitNode:
    split: Literal["horizontal", "vertical"] = "horizontal" if side in ("left", "right") else "vertical"
    if side in ("left", "above"):
        return SplitNode(split, (new, node), (share, 1 - share))
    return SplitNode(split, (node, new), (1 - share, share))


def with_current(node: LayoutNode, panel: PanelName) -> LayoutNode:
    """The tree with the panel in front of its tabs."""
    if isinstance(node, SplitNode):
        return SplitNode(node.split, tuple(with_current(child, panel) for child in node.children), node.weights)
    return TabNode(node.tabs, panel) if isinstance(node, TabNode) and panel in node.tabs else node


def with_weights(node: LayoutNode, path: tuple[int, ...], weights: tuple[float, ...]) -> LayoutNode:
    """The tree with other weights in the split that ``path`` leads to, child by child."""
    if not path:
        return SplitNode(split_at(node, ()).split, split_at(node, ()).children, _rounded(list(weights)))
    whole, (first, *rest) = split_at(node, ()), path
    children = list(whole.children)
    children[first] = with_weights(children[first], tuple(rest), weights)
    return SplitNode(whole.split, tuple(children), whole.weights)


def path_of(node: LayoutNode, panel: PanelName) -> tuple[int, ...]:
    """Which children lead to the group that has the panel; empty where the whole tree is that group, or none has it."""
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
    """The tree without its weights and without which tab is in front: what the wizard means by an arrangement."""
    if isinstance(node, SplitNode):
        return (node.split, tuple(shape(child) for child in node.children))
    return panels_in(node)


def differs(tree: LayoutNode, other: LayoutNode, *, by: float | None) -> bool:
    """Whether panels lie elsewhere, or have a share of the room that is another one ``by`` more than this. Which tab is
    in front does not count.
    """
    if isinstance(tree, SplitNode) and isinstance(other, SplitNode):
        if (tree.split, len(tree.children)) != (other.split, len(other.children)):
            return True
        both = zip(shares(tree), shares(other), strict=True)
        if by is not None and any(abs(before - after) > by for before, after in both):
            return True
        return any(differs(*children, by=by) for children in zip(tree.children, other.children, strict=True))
    return shape(tree) != shape(other)
