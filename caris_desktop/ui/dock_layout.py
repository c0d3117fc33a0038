"""Dock layout trees, the dock layout as a frozen value, and its edits as pure functions.

The tree has a place for every panel, including hidden and floating ones, which are restored there.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

from PySide6.QtCore import QRect, QSize

from caris_desktop.domain.value_class import Value
from caris_desktop.scenario.scenario_model import (
    LayoutNode,
    PanelLeaf,
    PanelName,
    SplitNode,
    TabNode,
    checked_layout,
    layout_data,
    layout_problems,
    panels_in,
)

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
        return tidy(TabNode(tabs, node.current)) if tabs else None
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
            *_, last = groups_in(result)
            result = with_current(with_tab(result, front_of(last), panel), front_of(last))
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
    return tidy(with_group(node, beside, lambda group: _pair(group, panel, side, 0.5)))


def _pair(node: LayoutNode, panel: PanelName, side: Side, share: float) -> SplitNode:
    """The tree with the new ``panel`` at its ``side``."""
    split: Literal["horizontal", "vertical"] = "horizontal" if side in ("left", "right") else "vertical"
    if side in ("left", "above"):
        return SplitNode(split, (PanelLeaf(panel), node), (share, 1 - share))
    return SplitNode(split, (node, PanelLeaf(panel)), (1 - share, share))


def with_current(node: LayoutNode, panel: PanelName) -> LayoutNode:
    """The tree with the panel as its group's current tab."""
    return with_group(node, panel, lambda group: TabNode(group.tabs, panel) if isinstance(group, TabNode) else group)


def with_weights(node: LayoutNode, path: tuple[int, ...], weights: tuple[float, ...]) -> LayoutNode:
    """The tree with new weights in the split at ``path`` (child indices)."""
    split = split_at(node, ())
    if not path:
        return SplitNode(split.split, split.children, _rounded(list(weights)))
    children = list(split.children)
    children[path[0]] = with_weights(children[path[0]], path[1:], weights)
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


def differs(tree: LayoutNode, other: LayoutNode, *, by: float | None) -> bool:
    """Whether panels are placed differently, or any share differs by more than ``by``. Current tabs do not count."""
    if isinstance(tree, SplitNode) and isinstance(other, SplitNode):
        if (tree.split, len(tree.children)) != (other.split, len(other.children)):
            return True
        both = zip(shares(tree), shares(other), strict=True)
        if by is not None and any(abs(before - after) > by for before, after in both):
            return True
        return any(differs(*children, by=by) for children in zip(tree.children, other.children, strict=True))
    return isinstance(tree, SplitNode) or isinstance(other, SplitNode) or panels_in(tree) != panels_in(other)


_LEAST_WINDOW = QSize(240, 160)
_TITLE_PX = 40  # title bar of the window manager, above the window's own area


def on_a_screen(place: QRect, screens: Sequence[QRect]) -> QRect:
    """The rectangle moved, and shrunk if necessary, into the screen with the largest overlap.

    Windows of a disconnected screen stay reachable. ``screens``: available area of each, primary first; without any the
    rectangle is unchanged.
    """
    if not screens:
        return place
    screen = max(screens, key=lambda screen: (place & screen).width() * (place & screen).height())
    below_title = screen.size() - QSize(0, _TITLE_PX)
    size = place.size().boundedTo(below_title).expandedTo(_LEAST_WINDOW).boundedTo(screen.size())
    lowest = max(screen.top(), screen.top() + screen.height() - size.height())
    return QRect(
        max(screen.left(), min(place.left(), screen.left() + screen.width() - size.width())),
        min(max(screen.top() + _TITLE_PX, place.top()), lowest),
        size.width(),
        size.height(),
    )


class Floating(Value):
    """Floating window: its panels and its geometry on the desktop."""

    tree: LayoutNode
    place: QRect


class DockLayout(Value):
    """Dock layout. ``tree`` has all panels; those in ``floating`` are shown there instead, and ``hidden`` ones not at
    all.
    """

    tree: LayoutNode
    hidden: frozenset[PanelName] = frozenset()
    floating: tuple[Floating, ...] = ()

    @property
    def panels(self) -> tuple[PanelName, ...]:
        return panels_in(self.tree)

    @property
    def afloat(self) -> frozenset[PanelName]:
        return frozenset(panel for window in self.floating for panel in panels_in(window.tree))

    def is_shown(self, panel: PanelName) -> bool:
        """Whether the panel is open, docked or floating, even if behind another tab."""
        return panel in self.panels and panel not in self.hidden

    @property
    def docked(self) -> frozenset[PanelName]:
        """Panels in the main window."""
        return frozenset(self.panels) - self.hidden - self.afloat

    @property
    def in_front(self) -> frozenset[PanelName]:
        """Visible panels: neither hidden nor behind another tab."""
        docked = without(self.tree, self.hidden | self.afloat)
        trees = [*([] if docked is None else [docked]), *(window.tree for window in self.floating)]
        return frozenset(front_of(group) for tree in trees for group in groups_in(tree)) - self.hidden

    @property
    def for_file(self) -> LayoutNode | None:
        """The tree as saved in a scenario file: floating panels are docked, because their windows are personal; hidden
        ones are omitted.
        """
        smaller = without(self.tree, self.hidden)
        return None if smaller is None else tidy(smaller)


def arrangement_of(tree: LayoutNode) -> DockLayout:
    """Dock layout from the tree of a file."""
    return DockLayout(tidy(tree))


# ---- edits


def select(arrangement: DockLayout, panel: PanelName) -> DockLayout:
    """Raise the panel's tab."""
    return _with_tree(arrangement, window_of(arrangement, panel), lambda tree: with_current(tree, panel))


def move(arrangement: DockLayout, panel: PanelName, beside: PanelName, side: Side, at: int | None = None) -> DockLayout:
    """Move the panel to a side of another panel's group, docked or floating, without its own tab group.

    ``at``: index among the tabs, not counting the panel itself.
    """
    if panel == beside:
        return arrangement
    loose = _out_of_windows(arrangement, panel)
    window = window_of(loose, beside)
    if window is None and (rest := without(loose.tree, {panel})) is not None:
        loose = replace(loose, tree=rest)  # beside a floating panel it keeps its place, for docking it again
    moved = _with_tree(loose, window, lambda tree: place_next_to(tree, beside, panel, side, at))
    return replace(moved, hidden=arrangement.hidden - {panel})


def move_to_edge(arrangement: DockLayout, panel: PanelName, side: Side) -> DockLayout:
    """Move the panel to an edge of the main window."""
    loose = _out_of_windows(arrangement, panel)
    rest = without(loose.tree, {panel})
    if rest is None or side == "tab":
        return arrangement
    return replace(loose, tree=tidy(_pair(rest, panel, side, 0.25)), hidden=loose.hidden - {panel})


def float_panel(arrangement: DockLayout, panel: PanelName, place: QRect) -> DockLayout:
    """Float the panel in a separate window."""
    if panel not in arrangement.panels:
        return arrangement
    loose = _out_of_windows(arrangement, panel)
    window = Floating(PanelLeaf(panel), place)
    return replace(loose, hidden=loose.hidden - {panel}, floating=(*loose.floating, window))


def dock(arrangement: DockLayout, panel: PanelName) -> DockLayout:
    """Dock the panel at its former place."""
    loose = _out_of_windows(arrangement, panel)
    return replace(loose, tree=with_current(loose.tree, panel))


def hide(arrangement: DockLayout, panel: PanelName) -> DockLayout:
    if panel not in arrangement.panels:
        return arrangement
    return replace(arrangement, hidden=arrangement.hidden | {panel})


def show(arrangement: DockLayout, panel: PanelName) -> DockLayout:
    """Show a hidden panel at its former place, with its tab raised."""
    return select(replace(arrangement, hidden=arrangement.hidden - {panel}), panel)


def add(arrangement: DockLayout, panel: PanelName, beside: Sequence[PanelName]) -> DockLayout:
    """Add a new panel in a tab with the first of ``beside`` that the main window shows, else with any panel."""
    if panel in arrangement.panels:
        return show(arrangement, panel)
    docked = arrangement.docked
    among = [each for each in (*beside, *arrangement.panels) if each in docked] or list(arrangement.panels)
    return replace(arrangement, tree=place_next_to(arrangement.tree, among[0], panel, "tab"))


def remove(arrangement: DockLayout, panels: Collection[PanelName]) -> DockLayout | None:
    """Remove the panels entirely; None if nothing is left."""
    tree = without(arrangement.tree, panels)
    if tree is None:
        return None
    return DockLayout(tidy(tree), arrangement.hidden.difference(panels), _windows_without(arrangement, panels))


def resize(
    arrangement: DockLayout, window: int | None, path: tuple[int, ...], weights: tuple[float, ...]
) -> DockLayout:
    """Set the weights of one split, in the main window (None) or a floating one."""
    return _with_tree(arrangement, window, lambda tree: with_weights(tree, path, weights))


def place_window(arrangement: DockLayout, window: int, place: QRect) -> DockLayout:
    """Set the geometry of a floating window."""
    windows = list(arrangement.floating)
    windows[window] = replace(windows[window], place=place)
    return replace(arrangement, floating=tuple(windows))


def clamped(arrangement: DockLayout, screens: Sequence[QRect]) -> DockLayout:
    """Move all floating windows onto existing screens."""
    windows = tuple(replace(window, place=on_a_screen(window.place, screens)) for window in arrangement.floating)
    return replace(arrangement, floating=windows)


def window_of(arrangement: DockLayout, panel: PanelName) -> int | None:
    """Index of the floating window with the panel; None if docked."""
    return next((i for i, window in enumerate(arrangement.floating) if panel in panels_in(window.tree)), None)


def _with_tree(arrangement: DockLayout, index: int | None, change: Callable[[LayoutNode], LayoutNode]) -> DockLayout:
    """The layout with the tree of a floating window changed; None: of the main window."""
    if index is None:
        return replace(arrangement, tree=change(arrangement.tree))
    windows = list(arrangement.floating)
    windows[index] = replace(windows[index], tree=change(windows[index].tree))
    return replace(arrangement, floating=tuple(windows))


def _out_of_windows(arrangement: DockLayout, panel: PanelName) -> DockLayout:
    """Take the panel out of its floating window."""
    return replace(arrangement, floating=_windows_without(arrangement, (panel,)))


def _windows_without(arrangement: DockLayout, panels: Collection[PanelName]) -> tuple[Floating, ...]:
    """The floating windows without some panels; an empty window disappears."""
    return tuple(
        replace(window, tree=tidy(tree))
        for window in arrangement.floating
        if (tree := without(window.tree, panels)) is not None
    )


# ---- serialisation


def arrangement_data(arrangement: DockLayout) -> dict[str, Any]:
    """Layout as JSON data for the settings."""
    return {
        "tree": layout_data(arrangement.tree),
        "hidden": sorted(arrangement.hidden),
        "floating": [
            {"tree": layout_data(window.tree), "place": list(window.place.getRect())}  # type: ignore[call-overload]
            for window in arrangement.floating
        ],
    }


def arrangement_from(data: Any) -> DockLayout:
    """Layout from :func:`arrangement_data`. Raises ValueError for anything else."""
    if not isinstance(data, Mapping):
        raise ValueError("invalid panel layout")  # noqa: TRY004  (readers of settings expect one kind)
    tree = _checked(data.get("tree"))
    hidden, windows = data.get("hidden", []), data.get("floating", [])
    if not isinstance(hidden, list) or not set(map(str, hidden)) <= set(panels_in(tree)):
        raise ValueError("hidden panels that do not exist")
    if not isinstance(windows, list) or not all(isinstance(window, Mapping) for window in windows):
        raise ValueError("the windows are not a list")
    floating = tuple(Floating(_checked(window.get("tree")), _place_from(window.get("place"))) for window in windows)
    afloat = [panel for window in floating for panel in panels_in(window.tree)]
    if len(set(afloat)) != len(afloat) or not set(afloat) <= set(panels_in(tree)):
        raise ValueError("a panel is in two windows")
    return DockLayout(tree, frozenset(panel for panel in panels_in(tree) if panel in hidden), floating)


def _checked(data: Any) -> LayoutNode:
    tree = checked_layout(data)
    for _path, problem in layout_problems(layout_data(tree), ("layout",), set()):
        raise ValueError(f"invalid panel layout: {problem[:200]}")
    return tidy(tree)


def _place_from(data: Any) -> QRect:
    valid = isinstance(data, list) and len(data) == 4 and all(type(number) is int for number in data)
    if not valid or not all(abs(number) < 100_000 for number in data) or min(data[2:]) <= 0:
        raise ValueError("a window's position is not four numbers in pixels")
    return QRect(*data)
