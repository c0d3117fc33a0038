"""Dock layout as a frozen value, and its edits as pure functions.

The tree has a place for every panel, including hidden and floating ones, which are restored there.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

from caris_desktop.domain.value_class import Value
from caris_desktop.scenario.scenario_model import (
    LayoutNode,
    PanelLeaf,
    PanelName,
    checked_layout,
    layout_data,
    layout_problems,
    panels_in,
)
from caris_desktop.ui.layout.layout_rect import Rect, on_a_screen
from caris_desktop.ui.layout.layout_tree import (
    Side,
    front_of,
    groups_in,
    place_next_to,
    put_at_edge,
    tidy,
    with_current,
    with_weights,
    without,
)


class Floating(Value):
    """Floating window: its panels and its geometry on the desktop."""

    tree: LayoutNode
    place: Rect


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
    index = window_of(arrangement, panel)
    if index is None:
        return replace(arrangement, tree=with_current(arrangement.tree, panel))
    return _with_window(arrangement, index, lambda tree: with_current(tree, panel))


def move(arrangement: DockLayout, panel: PanelName, beside: PanelName, side: Side, at: int | None = None) -> DockLayout:
    """Move the panel to a side of another panel's group, docked or floating, without its own tab group.

    ``at``: index among the tabs, not counting the panel itself.
    """
    if panel == beside:
        return arrangement
    index = window_of(arrangement, beside)
    loose = _out_of_windows(arrangement, panel)
    hidden = arrangement.hidden - {panel}
    if index is None:
        rest = without(loose.tree, {panel})
        if rest is None:
            return arrangement
        return replace(loose, tree=place_next_to(rest, beside, panel, side, at), hidden=hidden)
    # Its place in the main window is stored for docking it again.
    index = window_of(loose, beside)
    if index is None:
        return arrangement
    moved = _with_window(loose, index, lambda tree: place_next_to(tree, beside, panel, side, at))
    return replace(moved, hidden=hidden)


def move_to_edge(arrangement: DockLayout, panel: PanelName, side: Side) -> DockLayout:
    """Move the panel to an edge of the main window."""
    loose = _out_of_windows(arrangement, panel)
    rest = without(loose.tree, {panel})
    if rest is None or side == "tab":
        return arrangement
    return replace(loose, tree=put_at_edge(rest, panel, side), hidden=loose.hidden - {panel})


def float_panel(arrangement: DockLayout, panel: PanelName, place: Rect) -> DockLayout:
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
    tree = without(arrangement.tree, frozenset(panels))
    if tree is None:
        return None
    windows = [
        Floating(tidy(left), window.place)
        for window in arrangement.floating
        if (left := without(window.tree, frozenset(panels))) is not None
    ]
    return DockLayout(tidy(tree), arrangement.hidden - frozenset(panels), tuple(windows))


def resize(
    arrangement: DockLayout, window: int | None, path: tuple[int, ...], weights: tuple[float, ...]
) -> DockLayout:
    """Set the weights of one split, in the main window or a floating one."""
    if window is None:
        return replace(arrangement, tree=with_weights(arrangement.tree, path, weights))
    return _with_window(arrangement, window, lambda tree: with_weights(tree, path, weights))


def place_window(arrangement: DockLayout, window: int, place: Rect) -> DockLayout:
    """Set the geometry of a floating window."""
    windows = list(arrangement.floating)
    windows[window] = replace(windows[window], place=place)
    return replace(arrangement, floating=tuple(windows))


def clamped(arrangement: DockLayout, screens: Sequence[Rect]) -> DockLayout:
    """Move all floating windows onto existing screens."""
    windows = tuple(replace(window, place=on_a_screen(window.place, screens)) for window in arrangement.floating)
    return replace(arrangement, floating=windows)


def window_of(arrangement: DockLayout, panel: PanelName) -> int | None:
    """Index of the floating window with the panel; None if docked."""
    return next((i for i, window in enumerate(arrangement.floating) if panel in panels_in(window.tree)), None)


def _with_window(arrangement: DockLayout, index: int, change: Callable[[LayoutNode], LayoutNode]) -> DockLayout:
    windows = list(arrangement.floating)
    windows[index] = replace(windows[index], tree=change(windows[index].tree))
    return replace(arrangement, floating=tuple(windows))


def _out_of_windows(arrangement: DockLayout, panel: PanelName) -> DockLayout:
    """Take the panel out of its floating window; an empty window disappears."""
    windows = [
        replace(window, tree=tidy(left))
        for window in arrangement.floating
        if (left := without(window.tree, {panel})) is not None
    ]
    return replace(arrangement, floating=tuple(windows))


# ---- serialisation


def arrangement_data(arrangement: DockLayout) -> dict[str, Any]:
    """Layout as JSON data for the settings."""
    return {
        "tree": layout_data(arrangement.tree),
        "hidden": sorted(arrangement.hidden),
        "floating": [
            {
                "tree": layout_data(window.tree),
                "place": [window.place.left, window.place.top, window.place.width, window.place.height],
            }
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


def _place_from(data: Any) -> Rect:
    valid = isinstance(data, list) and len(data) == 4 and all(type(number) is int for number in data)
    if not valid or not all(abs(number) < 100_000 for number in data) or min(data[2:]) <= 0:
        raise ValueError("a window's position is not four numbers in pixels")
    return Rect(*data)
