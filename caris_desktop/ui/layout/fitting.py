"""Layout adaptation to screen size: folds panels into tabs on small screens and spreads tabs on large ones."""

from collections.abc import Mapping

from caris_desktop.domain.intents import SizeClass
from caris_desktop.scenario.scenario_model import LayoutNode, PanelLeaf, PanelName, SplitNode, TabNode, panels_in
from caris_desktop.ui.layout.dock_geometry import GAP_PX, Room, least_room, lengths
from caris_desktop.ui.layout.layout_tree import (
    front_of,
    groups_in,
    path_of,
    shares,
    split_at,
    tidy,
    with_weights,
    without,
)

COMPACT_BELOW: Room = (1500, 700)  # A 1366x768 screen leaves about 1350x630 for panels.
LARGE_FROM: Room = (2300, 1100)

COMFORT: Mapping[PanelName, Room] = {
    "video": (420, 300),
    "speak": (400, 232),
    "conversation": (380, 240),
    "map": (300, 250),
    "drive": (290, 230),
    "people": (300, 190),
    "assistant": (320, 250),
    "session": (300, 220),
    "robot": (300, 220),
    "face": (260, 210),
    "photos": (300, 240),
    "motion": (300, 200),
    "notes": (300, 200),
    "diagnostics": (340, 220),
}
"""Comfortable size of each panel, title bar included."""

IMPORTANCE: tuple[PanelName, ...] = (
    "video", "speak", "conversation", "map", "assistant", "people", "drive", "notes", "session", "face", "robot",
    "photos", "motion", "diagnostics",
)  # fmt: skip
"""Panels by importance; the last ones are folded into tabs first."""
ALWAYS_SEEN = 3  # this many of the most important panels are never folded; they shrink instead
_OTHER_ROOM: Room = (280, 200)
_LEAST_PICTURE: Room = (200, 150)
_ENOUGH = 0.85  # of the possible height of a picture: with less, what lies beside it becomes a tab


def size_class(width: int, height: int) -> SizeClass:
    if width < COMPACT_BELOW[0] or height < COMPACT_BELOW[1]:
        return "compact"
    return "large" if width >= LARGE_FROM[0] and height >= LARGE_FROM[1] else "usual"


def fitted(tree: LayoutNode, width: int, height: int, aspect: float | None = None) -> LayoutNode:
    """The tree adapted to this size, and on a small screen to pictures with this ``aspect``: as large as the others
    permit, without bars beside them.
    """
    kind = size_class(width, height)
    if kind == "compact":
        small = tidy(_compact(tidy(tree), width, height))
        return small if aspect is None else tidy(_around_picture(small, width, height, aspect))
    return tidy(_spread(tidy(tree), width, height)) if kind == "large" else tidy(tree)


def _around_picture(tree: LayoutNode, width: int, height: int, aspect: float) -> LayoutNode:
    path = path_of(tree, "video")
    splits, room = [split_at(tree, path[:depth]) for depth in range(len(path))], (width, height)
    nearest: dict[str, int] = {}
    totals, now = [0, 0], [width, height]
    for depth, (split, index) in enumerate(zip(splits, path, strict=True)):
        axis = 0 if split.split == "horizontal" else 1
        nearest[split.split] = depth
        totals[axis] = now[axis] - GAP_PX * (len(split.children) - 1)
        now[axis] = round(totals[axis] * shares(split)[index])
    across, down = nearest.get("horizontal"), nearest.get("vertical")
    if across is None or down is None:
        return tree
    beside, around = (_others(splits[depth], path[depth]) for depth in (across, down))
    most_height = totals[1] - sum(_need_in_front(child, 1) for child, _share in around)
    in_row = across > down  # something lies beside the picture in the same column
    most_width = totals[0] - sum(_need_in_front(child, 0) for child, _share in beside) if in_row else now[0]
    if most_height < _LEAST_PICTURE[1] or most_width < _LEAST_PICTURE[0]:
        if not in_row:
            return tree
        most_width = 0
    picture_height = min(most_height, most_width / aspect)
    if in_row and picture_height < _ENOUGH * most_height and all(_rank(child) >= ALWAYS_SEEN for child, _ in beside):
        folded = [panel for child, _share in beside for panel in panels_in(child)]
        rest = without(tree, folded)
        if rest is not None and isinstance(rest, SplitNode):
            for panel in folded:
                rest = _with_tabs(rest, PanelLeaf(panel))
            return _around_picture(tidy(rest), *room, aspect)
    lengths_at = {across: aspect * picture_height, down: picture_height}
    for depth, length in lengths_at.items():
        axis = 0 if depth == across else 1
        others = _others(splits[depth], path[depth])
        needs = [_need_in_front(child, axis) for child, _share in others]
        left = lengths(totals[axis] - round(length), [share for _child, share in others], needs, 0)
        weights = [float(max(1, each)) for each in left]
        weights.insert(path[depth], length)
        tree = with_weights(tree, path[:depth], tuple(weights))
    return tree


def _others(split: SplitNode, index: int) -> list[tuple[LayoutNode, float]]:
    parts = list(zip(split.children, shares(split), strict=True))
    return parts[:index] + parts[index + 1 :]


def _comfort(panel: PanelName) -> Room:
    return COMFORT.get(panel, _OTHER_ROOM)


def _need(node: LayoutNode, axis: int) -> int:
    """Extent in which every panel has its comfortable size, also those behind tabs."""
    return least_room(node, panels_in(node), _comfort)[axis]


def _need_in_front(node: LayoutNode, axis: int) -> int:
    """Extent in which every visible panel has its comfortable size."""
    fronts = {front_of(group) for group in groups_in(node)}

    def room(panel: PanelName) -> Room:
        return _comfort(panel) if panel in fronts else (0, 0)

    return least_room(node, panels_in(node), room)[axis]


def _rank(node: LayoutNode) -> int:
    """Importance rank of the node's most important panel; lower is more important."""
    return min(map(_importance, panels_in(node)))


def _importance(panel: PanelName) -> int:
    return IMPORTANCE.index(panel) if panel in IMPORTANCE else len(IMPORTANCE)


def _compact(node: LayoutNode, width: int, height: int) -> LayoutNode:
    """Fold the least important parts of each split into tabs until the rest have enough space."""
    if not isinstance(node, SplitNode):
        return node
    axis = 0 if node.split == "horizontal" else 1
    length_px = (width, height)[axis]
    parts = list(zip(node.children, shares(node), strict=True))
    while (
        len(parts) > 1
        and sum(_need_in_front(child, axis) for child, _ in parts) + GAP_PX * (len(parts) - 1) > length_px
    ):
        foldable = [i for i in range(len(parts)) if _rank(parts[i][0]) >= ALWAYS_SEEN]
        if not foldable:
            break
        least = max(foldable, key=lambda i: _rank(parts[i][0]))
        folded, share = parts.pop(least)
        host = max(range(len(parts)), key=lambda i: (_rank(parts[i][0]), -abs(i - least)))
        child, part = parts[host]
        parts[host] = (_with_tabs(child, folded), part + share)
    if len(parts) == 1:
        return _compact(parts[0][0], width, height)
    room = length_px - GAP_PX * (len(parts) - 1)
    given = lengths(room, [share for _, share in parts], [_need_in_front(child, axis) for child, _ in parts], 0)
    children = tuple(
        _compact(child, *((length, height) if axis == 0 else (width, length)))
        for (child, _), length in zip(parts, given, strict=True)
    )
    return SplitNode(node.split, children, tuple(float(max(1, length)) for length in given))


def _with_tabs(node: LayoutNode, folded: LayoutNode) -> LayoutNode:
    """The tree with the panels of ``folded`` added to its least important tab group."""
    if isinstance(node, SplitNode):
        host = max(range(len(node.children)), key=lambda i: _rank(node.children[i]))
        children = list(node.children)
        children[host] = _with_tabs(children[host], folded)
        return SplitNode(node.split, tuple(children), node.weights)
    # The most important of the groups' current tabs stays in front.
    front: PanelName = min([front_of(node), *map(front_of, groups_in(folded))], key=_importance)
    return TabNode((*panels_in(node), *panels_in(folded)), front)


def _spread(node: LayoutNode, width: int, height: int) -> LayoutNode:
    """Spread tabs side by side or stacked as long as each has its comfortable size."""
    if isinstance(node, SplitNode):
        axis = 0 if node.split == "horizontal" else 1
        length_px = (width, height)[axis] - GAP_PX * (len(node.children) - 1)
        children = tuple(
            _spread(child, *((round(length_px * share), height) if axis == 0 else (width, round(length_px * share))))
            for child, share in zip(node.children, shares(node), strict=True)
        )
        return SplitNode(node.split, children, node.weights)
    if isinstance(node, PanelLeaf):
        return node
    for axis, split in ((0, "horizontal"), (1, "vertical")):
        for alone in range(len(node.tabs) - 1, 0, -1):
            parts = _first_alone(node, alone)
            across = max(_need(part, 1 - axis) for part in parts)
            along = sum(_need(part, axis) for part in parts) + GAP_PX * (len(parts) - 1)
            if along <= (width, height)[axis] and across <= (width, height)[1 - axis]:
                needs = tuple(float(_need(part, axis)) for part in parts)
                return SplitNode("horizontal" if split == "horizontal" else "vertical", parts, needs)
    return node


def _first_alone(node: TabNode, count: int) -> tuple[LayoutNode, ...]:
    """The current and other panels alone, ``count`` in all; the rest in tabs."""
    front = front_of(node)
    ordered = (front, *(panel for panel in node.tabs if panel != front))
    rest = ordered[count:]
    last: LayoutNode = PanelLeaf(rest[0]) if len(rest) == 1 else TabNode(rest, rest[0])
    return (*(PanelLeaf(panel) for panel in ordered[:count]), last)
